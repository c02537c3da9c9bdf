"""Signals with ``delivery=acknowledged`` reach every robot that catches them, once and in order, or are reported."""

import re
from pathlib import Path

import pytest

from benchmarks import roaming
from fame.bpmn.reader import read_text
from fame.bpmn.split import split
from fame.bpmn.topics import topic_table
from fame.check import check
from fame.clock import SECOND
from fame.deploy.envelope import Envelope
from fame.middleware import messages
from fame.scenario.explore.exploration import explore
from fame.simulation import Simulation
from tests.deployment_field import BPMN, Field, kill as kill_sender, made, process
from tests.networked_machines import forbidden
from tests.test_resumption import Durable

INT = "std_msgs/msg/Int32"
COUNTS = {"type": INT, "payload": "${n}", "delivery": "acknowledged", "ttl": "20"}


def properties(**given: str) -> str:
    found = "".join(f'<c:property name="{name}" value="{value}"/>' for name, value in given.items())
    return f"<extensionElements><c:properties>{found}</c:properties></extensionElements>"


def event(tag: str, id: str, topic: str = "tick", kind: str = "signal", **given: str) -> str:
    return f'<{tag} id="{id}">{properties(**given)}<{kind}EventDefinition {kind}Ref="{topic}"/></{tag}>'


def pause(id: str, duration: str) -> str:
    timer = f"<timerEventDefinition><timeDuration>{duration}</timeDuration></timerEventDefinition>"
    return f'<intermediateCatchEvent id="{id}">{timer}</intermediateCatchEvent>'


def keeping(id: str, kind: str = "signal", **given: str) -> str:
    """A robot keeps what it catches."""
    return process(
        id,
        f'<startEvent id="{id}s"/><scriptTask id="{id}i"><script>kept = []</script></scriptTask>'
        + event("intermediateCatchEvent", f"{id}c", kind=kind, **given)
        + f'<scriptTask id="{id}k"><script>kept = kept + [tick]</script></scriptTask>',
        (f"{id}s", f"{id}i"),
        (f"{id}i", f"{id}c"),
        (f"{id}c", f"{id}k"),
        (f"{id}k", f"{id}c"),
    )


def team(thrown: dict[str, str] = COUNTS, kind: str = "signal", robots: str = "BC", **caught: str) -> str:
    pools = "".join(f'<participant id="P{name}" name="{name}" processRef="p{name.lower()}"/>' for name in f"A{robots}")
    throw = event("intermediateThrowEvent", "throw", kind=kind, **thrown)
    plain = process(
        "pa",
        '<startEvent id="sa"/><scriptTask id="zero"><script>n, late = 0, []</script></scriptTask>'
        f'<scriptTask id="one"><script>n = n + 1</script></scriptTask>{throw}{pause("pause", "PT0.1S")}'
        '<subProcess id="report" triggeredByEvent="true"><startEvent id="expired" isInterrupting="false">'
        '<signalEventDefinition signalRef="undelivered"/></startEvent>'
        '<scriptTask id="noted"><script>late = late + [undelivered]</script></scriptTask>'
        '<sequenceFlow id="un" sourceRef="expired" targetRef="noted"/></subProcess>',
        ("sa", "zero"),
        ("zero", "one"),
        ("one", "throw"),
        ("throw", "pause"),
        ("pause", "one"),
    )
    return (
        f'<definitions xmlns="{BPMN}" xmlns:c="http://camunda.org/schema/1.0/bpmn" targetNamespace="t">'
        f'<{kind} id="tick" name="tick"/><signal id="undelivered" name="~/undelivered"/>'
        f'<collaboration id="c">{pools}</collaboration>{plain}'
        + "".join(keeping(f"p{name.lower()}", kind, queue="500", **caught) for name in robots)
        + "</definitions>"
    )


def kept(field: Field, robot: str) -> list[int]:
    return list(field.variables(robot)["kept"])


def decision(deployment: str, robot: str, phase: str) -> str:
    return Envelope(deployment=deployment, sequence=1, robot=robot, phase=phase).to_json()


def kill(field: Field, robot: str) -> None:
    """The engine of a robot ends."""
    field.engines.pop(robot).close()


def start(field: Field, robot: str) -> None:
    field.add(robot)


@pytest.mark.parametrize("kind", ["signal", "message"])
def test_each_robot_gets_every_signal_once_and_in_order(kind):
    field = Field("A", "B", "C")
    assert not field.deploy(team(kind=kind)).failed
    field.pass_time(10)
    for robot in "BC":
        assert kept(field, robot) == list(range(1, len(kept(field, robot)) + 1))
        assert len(kept(field, robot)) > 100


def test_the_plain_topic_has_each_signal_once_for_other_nodes():
    field, heard = Field("A", "B"), []
    other = field.middleware.node("other")
    other.subscription("/tick", INT, lambda message: heard.append(message.data))
    field.deploy(team(robots="B"))
    assert heard == list(range(1, len(heard) + 1))
    assert len(heard) > 100
    other.publisher("/tick", INT).publish(messages.create(INT, -1))
    field.pass_time(1)
    assert kept(field, "B").count(-1) == 1


@pytest.mark.parametrize("text", ["no JSON", "{}", '{"robot": 1}'])
def test_what_cannot_be_read_is_reported(text):
    field, notes = Field("A"), []
    field.add("B", on_report=lambda event: notes.append(event.detail))
    field.deploy(team(robots="B"))
    stranger = field.middleware.node("stranger").publisher("/B/bpmn_signal/tick", "std_msgs/msg/String")
    stranger.publish(messages.create("std_msgs/msg/String", text))
    field.pass_time(1)
    assert any("/B/bpmn_signal/tick: a message cannot be read: " in note for note in notes)


def test_a_message_to_one_robot_reaches_it_alone():
    field = Field("A", "B", "C")
    field.deploy(team({**COUNTS, "to": "C"}, kind="message"))
    assert kept(field, "B") == []
    assert kept(field, "C") == list(range(1, len(kept(field, "C")) + 1)) != []


def test_signals_for_a_robot_that_is_gone_are_reported_and_keep_nobody_waiting():
    field = Field("A", "B", "C")
    field.deploy(team())
    before = len(kept(field, "C"))
    kill(field, "B")
    field.pass_time(15)
    assert field.variables("A")["late"] == []
    assert len(kept(field, "C")) > before + 140
    field.pass_time(15)
    texts = field.variables("A")["late"]
    assert texts[0].startswith("/tick: B has not acknowledged ")
    assert all(" within 20 s" in text for text in texts)
    assert not any(": C has" in text for text in texts)


def test_a_thrower_learns_that_a_receiver_is_behind_long_before_signals_expire():
    field = Field("A", "B", "C")
    field.deploy(
        team().replace('name="~/undelivered"', 'name="~/congested"').replace("+ [undelivered]", "+ [congested]")
    )
    kill(field, "B")
    field.pass_time(4)
    assert field.variables("A")["late"] == []
    field.pass_time(2)
    (text,) = field.variables("A")["late"]
    assert re.fullmatch(r"/tick: B has not acknowledged \d+ signals, the oldest for 5\.\d s", text)
    warnings = [text for report in field.said if report.robot == "A" for text in report.warnings]
    assert any(text.startswith("/tick: B has not acknowledged ") for text in warnings)
    start(field, "B")
    field.deploy(team(), id="d2", sequence=2, only=["B"])
    field.pass_time(2)
    said = [report for report in field.said if report.robot == "A"]
    assert not any("has not acknowledged" in text for text in said[-1].warnings)


def test_a_late_joiner_gets_what_is_within_its_time_to_live():
    field = Field("A", "B", "C")
    field.deploy(team())
    kill(field, "B")
    field.pass_time(30)
    start(field, "B")
    field.pass_time(1)
    field.deploy(team(), id="d2", sequence=2, only=["B"])
    taken = kept(field, "B")
    assert taken == list(range(taken[0], taken[-1] + 1))
    assert 150 <= field.variables("A")["n"] - taken[0] - 120 <= 210


def test_redeployment_removes_a_receiver():
    field = Field("A", "B", "C")
    field.deploy(team())
    silent = team().replace(
        'signalRef="tick"/></intermediateCatchEvent>', 'signalRef="other"/></intermediateCatchEvent>'
    )
    silent = silent.replace("<collaboration", '<signal id="other" name="other"/><collaboration', 1)
    field.deploy(silent, id="d2", sequence=2, only=["B"])
    receivers = field.engines["A"].running.acknowledged.outgoing["/tick"].receivers
    assert [receiver.robot for receiver in receivers] == ["C"]
    field.pass_time(30)
    assert field.variables("A")["late"] == []


def test_an_abort_removes_a_receiver_that_holds():
    field = Field("A", "B", "C")
    deployment = made(field, team(), "d1", 1, robots="ABC")
    deployment.begin()
    while "waiting" in {engine.state for engine in field.engines.values()}:
        field.pass_time(0.001)
    kill_sender(deployment)  # before it has told anybody to start
    field.pass_time(1)
    assert {engine.state for engine in field.engines.values()} == {"ready"}
    for robot in "AC":
        field.send(robot, decision("d1", robot, "start"))
    field.pass_time(1)
    assert [one.robot for one in field.engines["A"].running.acknowledged.outgoing["/tick"].receivers] == ["B", "C"]
    field.send("B", decision("d1", "B", "abort"))
    field.pass_time(1)
    assert [one.robot for one in field.engines["A"].running.acknowledged.outgoing["/tick"].receivers] == ["C"]


def test_a_simulated_robot_alone_waits_for_nobody():
    definitions = read_text(
        f'<definitions xmlns="{BPMN}" xmlns:c="http://camunda.org/schema/1.0/bpmn" targetNamespace="t">'
        + '<signal id="tick" name="tick"/>'
        + process(
            "p",
            '<startEvent id="s"/><userTask id="u"/>'
            + event("intermediateThrowEvent", "throw", delivery="acknowledged"),
            ("s", "throw"),
            ("throw", "u"),
        )
        + "</definitions>",
        file="alone.bpmn",
    )
    simulation = Simulation(definitions)
    simulation.run()
    assert simulation.now == 0


def test_a_new_deployment_of_all_gets_nothing_of_the_old_one():
    field = Field("A", "B", "C")
    field.deploy(team())
    field.deploy(team(), id="d2", sequence=2)
    assert kept(field, "B")[:3] == [1, 2, 3]
    assert len(set(kept(field, "B"))) == len(kept(field, "B"))


def told(field: Field, robot: str) -> list[str]:
    """What a robot reports from now on."""
    said: list[str] = []
    report = field.engines[robot].running.host.report
    field.engines[robot].running.host.report = lambda element, text: (said.append(text), report(element, text))
    return said


def test_what_a_new_deployment_ends_before_it_is_acknowledged_is_reported():
    field = Field("A", "B")
    field.deploy(team(robots="B"))
    kill(field, "B")
    field.pass_time(1)
    said = told(field, "A")
    field.deploy(team(robots="B"), id="d2", sequence=2, only=["A"])
    (text,) = said
    assert re.fullmatch(
        r"/tick: B has not acknowledged \d+ of the numbers \d+ to \d+ before the mission was replaced", text
    )


def test_what_a_new_deployment_ends_in_a_queue_is_reported():
    field = Field("A", "B")
    slow = team(robots="B").replace("kept = kept + [tick]", "kept = kept + [tick]\nawait sleep(60)")
    field.deploy(slow)
    thrown, taken, said = field.variables("A")["n"], kept(field, "B"), told(field, "B")
    assert (len(taken), thrown > 50) == (1, True)
    running = field.engines["A"].running
    field.deploy(slow, id="d2", sequence=2)
    (text,) = said
    many = int(re.fullmatch(r"/tick: (\d+) acknowledged signals were not taken from a queue before .*", text)[1])
    assert running.instances[-1].variables["n"] == len(taken) + many


def test_what_a_full_queue_drops_is_reported_when_it_begins_and_counted():
    field = Field("A", "B")
    slow = team(robots="B").replace("kept = kept + [tick]", "kept = kept + [tick]\nif tick == 1:\n    await sleep(20)")
    slow = slow.replace('<c:property name="queue" value="500"/>', '<c:property name="queue" value="5"/>')
    field.deploy(slow)
    said = told(field, "B")
    field.pass_time(15)
    taken, (text,) = kept(field, "B"), said
    many = int(re.fullmatch(r"/tick: (\d+) acknowledged signals were dropped from a full queue", text)[1])
    assert taken == [1, *range(2 + many, 2 + many + len(taken) - 1)]


def test_a_process_that_ends_accepts_nothing_that_it_would_lose():
    field = Field("A", "B")
    field.deploy(team(robots="B"))
    thrower, before = field.engines["A"].running, kept(field, "B")
    assert thrower.acknowledged.owed == []
    field.engines["B"].running.acknowledged.end()
    field.pass_time(1)
    assert thrower.acknowledged.owed == [("B", "/tick")]
    assert kept(field, "B") == before
    field.deploy(team(robots="B"), id="d2", sequence=2, only=["B"])
    assert kept(field, "B")[: len(before) + 1] == [*before, before[-1] + 1]  # the next process gets what was kept


def test_a_mission_that_has_failed_accepts_nothing_more_and_both_ends_say_so():
    field = Field("A", "B")
    breaks = "kept = kept + [tick]\nif tick == 150:\n    await sleep(1)\n    1 / 0"
    field.deploy(team(robots="B").replace("kept = kept + [tick]", breaks))
    thrown, caught = told(field, "A"), told(field, "B")
    field.pass_time(40)
    (lost,) = caught
    many = int(re.fullmatch(r"/tick: (\d+) acknowledged signals were not taken from a queue before .* failed", lost)[1])
    behind, *missed = [text.removeprefix("/tick: B has not acknowledged ") for text in thrown]
    assert re.fullmatch(r"\d+ signals, the oldest for 5.\d s: its mission has failed", behind)
    assert 5 <= many <= 15
    assert missed[0] == f"number {150 + many + 1} within 20 s: its mission has failed"
    assert len(missed) > 50
    assert field.variables("A")["late"] == [f"/tick: B has not acknowledged {text}" for text in missed]
    field.deploy(team(robots="B"), id="d2", sequence=2, only=["B"])
    assert kept(field, "B")[0] == 150 + many + len(missed) + 1  # the next mission gets what is within its time to live


def test_without_a_queue_a_signal_that_no_event_waits_for_is_acknowledged_and_lost():
    field = Field("A", "B")
    busy = team(robots="B").replace('<c:property name="queue" value="500"/>', "")
    field.deploy(busy.replace("kept = kept + [tick]", "kept = kept + [tick]\nawait sleep(1)"))
    field.pass_time(30)
    taken = kept(field, "B")
    assert 30 <= len(taken) <= 45  # one a second
    assert taken == sorted(set(taken))
    assert field.variables("A")["n"] > 300
    assert field.variables("A")["late"] == []


# ---- robots with a state directory -----------------------------------------------------------------------------------


class OneDurable(Durable):
    """A throws, B catches; one of them has a state directory."""

    def __init__(self, folder: Path, robot: str) -> None:
        self.robot = robot
        super().__init__(folder)
        start(self, "B" if robot == "A" else "A")
        self.listen("A", "B")


@pytest.fixture
def durable(request, tmp_path):
    field = OneDurable(tmp_path / "state", request.param)
    yield field
    for engine in field.engines.values():
        engine.close()


@pytest.mark.parametrize("durable", ["B"], indirect=True)
def test_a_receiver_with_a_state_acknowledges_what_is_on_its_disk(durable, monkeypatch):
    durable.deploy(team(robots="B"))
    file, order = durable.engine._keeper.recorder.journal._file, []
    sync, answers = file.sync, "/A/bpmn_answer/tick"
    monkeypatch.setattr(file, "sync", lambda: (order.append("disk"), sync()))
    durable.person.subscription(answers, "std_msgs/msg/String", lambda message: order.append("answer"))
    durable.pass_time(1)
    assert len(order) > 10
    assert order == ["disk", "answer"] * (len(order) // 2)


@pytest.mark.parametrize("durable", ["A", "B"], indirect=True)
def test_a_robot_with_a_state_goes_on_with_its_signals_after_a_crash(durable):
    durable.deploy(team(robots="B"))
    for _ in range(3):
        durable.crash()
        durable.pass_time(1)
        durable.start()
        durable.pass_time(3)
    taken = kept(durable, "B")
    assert taken == list(range(1, len(taken) + 1))
    assert len(taken) > 150
    assert durable.variables("A")["late"] == []


# ---- models ----------------------------------------------------------------------------------------------------------


def test_the_part_of_each_robot_says_that_a_topic_is_acknowledged():
    parts = {
        part.name: read_text(part.source.decode(), file="part.bpmn") for part in split(read_text(team(), file="t.bpmn"))
    }
    assert {name: topic_table(part)["/tick"].ttl for name, part in parts.items()} == {"A": 20, "B": 60, "C": 60}


@pytest.mark.parametrize(
    ("given", "level", "text"),
    [
        ({"ttl": "soon"}, "error", "ttl='soon': expected a time in seconds, more than 0"),
        ({"ttl": "0"}, "error", "ttl='0': expected a time in seconds, more than 0"),
        ({"ttl": "inf"}, "error", "ttl='inf': expected a time in seconds, more than 0"),
        ({"delivery": "certain"}, "error", "delivery='certain': expected acknowledged or no property"),
        ({"scope": "robot"}, "error", "delivery='acknowledged': no other robot catches ~/tick, a topic of one robot"),
        ({"delivery": ""}, "warning", "its property 'ttl' has no effect without delivery=acknowledged"),
        ({"delivery": "", "ttl": "", "delivry": "acknowledged"}, "warning", "did you mean 'delivery'?"),
    ],
)  # fmt: skip
def test_wrong_properties_are_found(given, level, text):
    findings = check(read_text(team({**COUNTS, **given}), file="t.bpmn"))
    assert [finding.level for finding in findings if text in finding.text] == [level]


def test_what_an_exploration_says_of_a_loss_is_that_the_signal_expires(tmp_path):
    path = tmp_path / "team.bpmn"
    path.write_text(team(robots="B"))
    names = [name for search in explore(path, faults=True).searches for name, _, _ in search.faults]
    assert "/tick to B expires" in names
    assert not [name for name in names if "is lost" in name]


def test_a_topic_without_the_property_has_no_more_endpoints_than_before():
    field = Field("A", "B", "C")
    field.deploy(team({"type": INT, "payload": "${n}"}))
    assert not [
        info.name for info in field.middleware.graph() if "bpmn_signal" in info.name or "bpmn_answer" in info.name
    ]
    assert all(engine.running.acknowledged is None for engine in field.engines.values())


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        '{"robot": 1}',
        '{"robot": "A", "life": "x", "sequence": 1, "number": 1, "receiver": "y", "data": "?"}',
    ],
)
def test_a_message_that_cannot_be_read_ends_nothing(text):
    field = Field("A", "B", "C")
    field.deploy(team())
    for topic in ("/B/bpmn_signal/tick", "/A/bpmn_answer/tick"):
        field.person.publisher(topic, "std_msgs/msg/String").publish(messages.create("std_msgs/msg/String", text))
    before = len(kept(field, "B"))
    field.pass_time(2)
    assert len(kept(field, "B")) > before + 10


def test_a_receiver_that_is_found_again_is_asked_at_once():
    field, asked = Field("A", "B"), list[float]()
    field.deploy(team(robots="B"))
    radio = field.middleware.node("radio")

    def hear(message: object) -> None:
        asked.append(field.scheduler.now / SECOND)

    topic = "/C/bpmn_signal/tick", "std_msgs/msg/String"
    end = radio.subscription(*topic, hear)
    field.pass_time(10)
    assert asked[-1] - asked[-2] > 3  # it never answers, and is asked less and less
    end.close()
    field.pass_time(1)
    radio.subscription(*topic, hear)
    before = field.scheduler.now / SECOND
    field.pass_time(1)
    assert before < asked[-1] < before + 0.5


@pytest.mark.processes
@pytest.mark.parametrize("middleware", ["dds", "zenoh"])
def test_every_signal_arrives_once_and_in_order_over_a_link_that_is_down_half_of_the_time(middleware: str) -> None:
    if why := forbidden():
        pytest.skip(why)
    result = roaming.run(middleware, 500)
    assert result["once_and_in_order"], result
    assert result["downs"] > 0
