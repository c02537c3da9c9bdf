"""Robots get their processes over topics: all or none, the newest of a burst, the old one kept if the new is wrong."""

import json
from pathlib import Path

import pytest

import fame
from fame import deployment
from fame.bpmn.reader import read_text
from fame.clock import SECOND, Scheduler
from fame.deployment import Deployment, EngineNode, Report
from fame.library import Library
from fame.middleware import messages
from fame.middleware.local import LocalMiddleware
from fame.remote.sending import Sending

BPMN = "http://www.omg.org/spec/BPMN/20100524/MODEL"


def process(id: str, content: str, *flows: tuple[str, str]) -> str:
    arrows = "".join(
        f'<sequenceFlow id="{id}f{n}" sourceRef="{source}" targetRef="{target}"/>'
        for n, (source, target) in enumerate(flows)
    )
    return f'<process id="{id}" isExecutable="true">{content}{arrows}</process>'


def definitions(*content: str) -> str:
    return f'<definitions xmlns="{BPMN}" targetNamespace="t">{"".join(content)}</definitions>'


def patrol(mark: int) -> str:
    """A process that sets `mark` and then waits for a signal for ever."""
    return definitions(
        '<signal id="S" name="stop"/>',
        process(
            "p",
            f'<startEvent id="s"/><scriptTask id="t"><script>mark = {mark}</script></scriptTask>'
            '<intermediateCatchEvent id="c"><signalEventDefinition signalRef="S"/></intermediateCatchEvent>',
            ("s", "t"),
            ("t", "c"),
        ),
    )


LATE = "<timerEventDefinition><timeDuration>5s</timeDuration></timerEventDefinition>"
TEAM = definitions(
    '<signal id="S" name="go"/><collaboration id="c"><participant id="A" name="A" processRef="pa"/>'
    '<participant id="B" name="B" processRef="pb"/></collaboration>',
    process(
        "pa",
        '<startEvent id="sa"/><intermediateThrowEvent id="throw"><signalEventDefinition signalRef="S"/>'
        '</intermediateThrowEvent><userTask id="ua"/>',
        ("sa", "throw"),
        ("throw", "ua"),
    ),
    process(
        "pb",
        '<startEvent id="sb"><signalEventDefinition signalRef="S"/></startEvent><userTask id="ub"/>',
        ("sb", "ub"),
    ),
)


class Field:
    """Robots with engines, a plain publisher, and all that the robots have said."""

    def __init__(self, *robots: str) -> None:
        self.scheduler = Scheduler()
        self.middleware = LocalMiddleware(self.scheduler)
        self.engines = {name: EngineNode(name, scheduler=self.scheduler, middleware=self.middleware) for name in robots}
        self.listen(*robots)

    def listen(self, *robots: str) -> None:
        self.person = self.middleware.node("person")
        self.publishers = {name: self.person.publisher(f"/{name}/bpmn_process", deployment.STRING) for name in robots}
        self.said: list[Report] = []
        for name in robots:
            self.person.subscription(f"/{name}/bpmn_status", deployment.STRING, self._hear, deployment.STATUS_QOS)

    def _hear(self, message) -> None:
        self.said.append(Report(**json.loads(message.data)))

    def send(self, robot: str, text: str) -> None:
        self.publishers[robot].publish(messages.create(deployment.STRING, text))

    def pass_time(self, seconds: float) -> None:
        self.scheduler.run(self.scheduler.now + round(seconds * SECOND))

    def deploy(self, text: str, id: str = "d1", sequence: int = 1, **options) -> Deployment:
        sent = Deployment(
            read_text(text, file="team.bpmn"),
            id=id,
            sequence=sequence,
            scheduler=self.scheduler,
            middleware=self.middleware,
            ended=lambda deployment: None,
            **options,
        )
        sent.begin()
        self.pass_time(12)
        return sent

    def answers(self) -> list[str]:
        return [report.answer for report in self.said if report.answer]

    def variables(self, robot: str) -> dict:
        return self.engines[robot].running.instances[-1].variables


def test_a_robot_waits_for_its_process_and_says_so_every_second():
    field = Field("A")
    field.pass_time(3.5)
    assert [(report.state, report.time) for report in field.said] == [("waiting", float(n)) for n in range(4)]


def test_a_bare_model_from_a_plain_publisher_runs_at_once():
    field = Field("A")
    field.send("A", patrol(1))
    field.pass_time(0.1)
    assert field.variables("A") == {"mark": 1}
    assert field.answers() == ["started"]
    assert field.said[-1].hash == deployment.model_hash(patrol(1).encode())
    assert field.said[-1].waits[0]["element"] == "c"


def test_a_collaboration_starts_when_all_are_ready_and_no_first_message_is_lost():
    field = Field("A", "B")
    sent = field.deploy(TEAM)
    assert (sent.done, sent.failed) == (True, False)
    assert field.engines["A"].running.instances[0].waiting == ["ua"]
    assert field.engines["B"].running.instances[0].waiting == ["ub"]
    assert field.answers() == ["ready", "ready", "started", "started"]


def test_a_sender_says_whom_it_waits_for():
    scheduler, said = Scheduler(), []
    sending = Sending(read_text(TEAM, file="t.bpmn"), scheduler, LocalMiddleware(scheduler))
    with pytest.raises(fame.DeploymentError, match=r"pool 'A' has no robot A.*; start an engine with"):
        sending.deploy([], 10.0, said.append)
    assert said == ["waiting up to 10 s: t.bpmn: pool 'A' has no robot A; there are no robots at all"]
    assert scheduler.now // SECOND == 10


def test_if_one_robot_stays_silent_nobody_starts():
    field = Field("A")
    sent = field.deploy(TEAM, robots=["A", "B"])
    assert sent.failed
    assert "did not answer" in sent.standings["B"].reason or "nobody came" in sent.standings["A"].reason
    assert field.engines["A"].running is None
    assert field.engines["A"].state == "waiting"


def test_an_engine_tells_whoever_looks_at_it_what_it_refused_and_the_others_why_it_was_called_off():
    field, told = Field("B"), []
    field.engines["A"] = EngineNode(
        "A", scheduler=field.scheduler, middleware=field.middleware, on_report=told.append, trusted=[object()]
    )
    sent = field.deploy(TEAM, robots=["A", "B"])
    assert sent.failed
    assert {event.detail for event in told} == {"refused: not signed; this robot runs only what a trusted key signed"}
    assert sent.standings["B"].reason in ("had not answered yet", "called off because of A")


def test_what_it_refused_is_an_answer_if_somebody_waits_for_one():
    field, told = Field("B"), []
    field.engines["A"] = EngineNode("A", scheduler=field.scheduler, middleware=field.middleware, on_report=told.append)
    field.listen("A")
    field.send("A", patrol(2).replace("mark = 2", "mark = = 2"))
    field.pass_time(0.1)
    unknown = deployment.Envelope(deployment="d9", sequence=3, robot="A", phase="start")
    field.send("A", unknown.to_json())
    field.pass_time(0.1)
    assert [event.what for event in told] == ["report", "answer"]


def test_an_engine_tells_once_what_it_refused_though_it_answers_again():
    field, told = Field(), []
    field.engines["A"] = EngineNode("A", scheduler=field.scheduler, middleware=field.middleware, on_report=told.append)
    field.listen("A")
    asked = '<serviceTask id="g" xmlns:c="http://camunda.org/schema/1.0/bpmn" c:type="external" c:topic="grip"/>'
    sent = field.deploy(definitions(process("A", f'<startEvent id="s"/>{asked}', ("s", "g"))), robots=["A"])
    assert sent.standings["A"].state == "refused"
    assert field.answers() == ["refused", "refused"]  # the second to the word that calls it off
    assert len(told) == 1


JUMP = f"""<definitions xmlns="{BPMN}" targetNamespace="t">
<process id="Jump"><startEvent id="s"/>
<scriptTask id="jump"><script>
high = 3
raise BpmnError("fell")</script></scriptTask>
<sequenceFlow id="j" sourceRef="s" targetRef="jump"/></process></definitions>"""
CLIMB = f"""<definitions xmlns="{BPMN}" targetNamespace="t">
<collaboration id="c">
<participant id="A" name="A" processRef="pa"/>
<participant id="B" name="B" processRef="pb"/></collaboration>
<process id="pa"><startEvent id="sa"/>
</process>
<process id="pb">
<startEvent id="s"/>
<scriptTask id="jump"><script>tries = 1
tries = WORK</script></scriptTask>
<callActivity id="call"
 calledElement="Jump"/>
<sequenceFlow id="f" sourceRef="s" targetRef="jump"/><sequenceFlow id="g" sourceRef="jump" targetRef="call"/>
</process></definitions>"""


@pytest.mark.parametrize(
    ("work", "said"),
    [
        ("1 / 0", "B: jump (team.bpmn:10): ZeroDivisionError: division by zero"),
        ("2", "B: jump_2 ({folder}/Jump.bpmn:5): error fell was not caught"),
    ],
)
def test_a_sender_tells_what_a_robot_says_with_the_places_of_its_own_files(work, said, tmp_path):
    (tmp_path / "Jump.bpmn").write_text(JUMP)
    field = Field("A", "B")
    sent = field.deploy(CLIMB.replace("WORK", work), library=Library(tmp_path))
    assert not sent.failed
    error = field.engines["B"].running.instances[-1].error
    assert "B.bpmn:" in str(error)
    assert sent.in_own_files("B", str(error)) == said.format(folder=tmp_path)
    assert sent.in_own_files("B", "B.bpmn: late, DB.bpmn:8, B.bpmn:999") == "team.bpmn: late, DB.bpmn:8, B.bpmn:999"


def test_a_topic_whose_other_end_does_not_come_is_named():
    field = Field("A")
    field.send("A", patrol(1))
    field.pass_time(0.1)
    sent = field.deploy(TEAM, robots=["A", "B"])
    assert "/go (subscriber)" in sent.standings["A"].reason
    assert (sent.standings["B"].state, sent.standings["B"].reason) == ("silent", "had not answered yet")
    assert field.variables("A") == {"mark": 1}


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("garbage", "neither a .bpmn text nor an envelope"),
        ("<definitions", "XML"),
        (f'<!DOCTYPE x [<!ENTITY a "b">]>{patrol(2)}', "DOCTYPE"),
        (patrol(2).replace("mark = 2", "mark = = 2"), "syntax"),
        (
            patrol(2).replace('<signalEventDefinition signalRef="S"/>', LATE),
            "c: timer duration: '5s' is not an ISO 8601",
        ),
    ],
)
def test_a_model_that_does_not_check_leaves_the_old_one_running_and_says_so(text, reason):
    field = Field("A")
    field.send("A", patrol(1))
    field.pass_time(0.1)
    field.send("A", text)
    field.pass_time(0.1)
    refusal = field.said[-1]
    assert (refusal.answer, refusal.state) == ("refused", "running")
    assert reason.casefold() in refusal.reason.casefold()
    assert field.variables("A") == {"mark": 1}


def test_a_sender_does_not_send_what_is_known_to_be_wrong():
    field = Field("A")
    with pytest.raises(fame.ModelError, match=r"^team\.bpmn:1: c: timer duration: '5s' is not an ISO 8601"):
        field.deploy(patrol(2).replace('<signalEventDefinition signalRef="S"/>', LATE), robots=["p"])
    assert field.answers() == []


def test_a_message_type_that_the_sender_does_not_know_is_for_the_robots_to_judge():
    field = Field("A", "B")
    kind = '<extensionElements><c:properties xmlns:c="http://camunda.org/schema/1.0/bpmn"><c:property name="type" '
    kind += 'value="my_robots/msg/Mood"/></c:properties></extensionElements>'
    opening = '<intermediateThrowEvent id="throw">'
    sent = field.deploy(TEAM.replace(opening, opening + kind))
    assert sent.failed
    reasons = [standing.reason for standing in sent.standings.values() if standing.state == "refused"]
    assert reasons
    assert all("my_robots/msg/Mood: there is no such message type" in reason for reason in reasons)


def test_a_new_model_takes_the_place_of_the_old_one():
    field = Field("A")
    field.send("A", patrol(1))
    field.pass_time(0.1)
    old = field.engines["A"].running.instances[0]
    field.send("A", patrol(2))
    field.pass_time(0.1)
    assert old.status == "cancelled"
    assert field.variables("A") == {"mark": 2}


def test_of_a_burst_only_the_newest_is_applied():
    field = Field("A")
    for mark in range(10):
        field.send("A", patrol(mark))
    field.pass_time(0.1)
    assert field.variables("A") == {"mark": 9}
    assert field.answers() == ["superseded"] * 9 + ["started"]


def test_the_same_deployment_again_is_acknowledged_without_effect():
    field = Field("A", "B")
    sent = field.deploy(TEAM)
    instance = field.engines["A"].running.instances[0]
    field.send("A", sent.standings["A"].envelope.to_json())
    field.pass_time(0.1)
    assert field.said[-1].answer == "started"
    assert field.engines["A"].running.instances == [instance]


def test_a_new_deployment_of_the_same_model_is_a_restart():
    field = Field("A", "B")
    field.deploy(TEAM, "d1", 1)
    first = field.engines["A"].running.instances[0]
    field.deploy(TEAM, "d2", 2)
    assert first.status == "cancelled"
    assert field.engines["A"].running.instances[0].status == "running"


def test_an_older_sequence_is_stale():
    field = Field("A", "B")
    late = made(field, TEAM, "d1", 1)
    field.deploy(TEAM, "d2", 2)
    for standing in late.standings.values():
        field.send(standing.robot, standing.envelope.to_json())
    field.pass_time(0.1)
    assert [report.answer for report in field.said[-2:]] == ["stale", "stale"]
    assert {engine.deployed for engine in field.engines.values()} == {"d2"}


def test_only_some_robots_may_be_sent_to():
    field = Field("A", "B")
    field.deploy(TEAM)
    kept = field.engines["B"].running
    sent = field.deploy(TEAM, "d2", 2, only=["A"])
    assert not sent.failed
    assert list(sent.standings) == ["A"]
    assert field.engines["B"].running is kept
    with pytest.raises(fame.DeploymentError, match="named Z"):
        field.deploy(TEAM, "d3", 3, only=["Z"])


def test_an_envelope_for_another_robot_or_with_another_hash_is_refused():
    field = Field("A", "B")
    sent = field.deploy(TEAM)
    field.send("B", sent.standings["A"].envelope.to_json())
    changed = json.loads(sent.standings["A"].envelope.to_json()) | {"deployment": "d9", "sequence": 9, "hash": "0" * 64}
    field.send("A", json.dumps(changed))
    field.pass_time(0.1)
    reasons = [report.reason for report in field.said if report.answer == "refused"]
    assert "meant for robot 'A'" in reasons[0]
    assert "hash" in reasons[1]


def test_a_redeployed_robot_leaves_nothing_behind():
    field = Field("A")

    def ends() -> int:
        return sum(len(info.publishers) + len(info.subscribers) for info in field.middleware.graph())

    counts = set()
    for mark in range(30):
        field.send("A", patrol(mark % 3))
        field.pass_time(0.5)
        counts.add((ends(), len(field.scheduler)))
    assert len({count[0] for count in list(counts)}) == 1
    assert max(count[1] for count in counts) <= 3


def test_the_parts_of_the_example_are_what_the_robots_get():
    field = Field("REX", "DINGO")
    sent = field.deploy(Path("models/ground_vehicles.bpmn").read_text())
    assert not sent.failed
    assert field.engines["REX"].state == "running"
    assert field.engines["DINGO"].state == "idle"


def made(field: Field, text: str, id: str, sequence: int) -> Deployment:
    """A deployment to A and B that has not begun."""
    return Deployment(
        read_text(text, file="team.bpmn"),
        id=id,
        sequence=sequence,
        scheduler=field.scheduler,
        middleware=field.middleware,
        ended=lambda deployment: None,
        robots=["A", "B"],
    )


def dead_after_loading(field: Field, id: str, sequence: int) -> Deployment:
    """A deployment whose sender sent every robot its part and then was no more."""
    sent = made(field, TEAM, id, sequence)
    sent.close()
    for standing in sent.standings.values():
        field.send(standing.robot, standing.envelope.to_json())
    field.pass_time(0.5)
    return sent


def test_robots_whose_sender_died_before_it_told_anybody_to_start_keep_what_they_had():
    field = Field("A", "B")
    field.deploy(TEAM)
    kept = [field.engines[name].running for name in "AB"]
    dead_after_loading(field, "d2", 2)
    assert [field.engines[name].state for name in "AB"] == ["ready", "ready"]
    field.pass_time(10)
    assert [field.engines[name].running for name in "AB"] == kept
    reasons = [report.reason for report in field.said if report.answer == "aborted"]
    assert ["nobody was told to start" in reason for reason in reasons] == [True, True]


def test_a_robot_whose_sender_died_after_it_told_another_to_start_starts_too():
    field = Field("A", "B")
    sent = dead_after_loading(field, "d1", 1)
    field.send("A", sent._envelope("A", "start").to_json())
    field.pass_time(10)
    assert [field.engines[name].deployed for name in "AB"] == ["d1", "d1"]


def test_a_sender_that_is_alive_is_waited_for_however_long_the_others_take():
    field = Field("A")
    sent = made(field, TEAM.replace('name="go"', 'name="~/go"'), "d1", 1)
    sent.begin()
    field.pass_time(9)
    assert (field.engines["A"].state, sent.done) == ("ready", False)
    field.pass_time(3)
    assert (field.engines["A"].state, sent.failed) == ("waiting", True)
    assert sent.standings["B"].reason == "did not answer within 10 s"


def test_a_script_may_bring_its_robot_to_rest_before_the_next_process_begins():
    leaving = patrol(1).replace("mark = 1", "try:\n    await sleep(9)\nfinally:\n    await sleep(0.5)\n    log('out')")
    lines: list[tuple[float, str]] = []
    field = Field()
    engine = EngineNode(
        "A",
        scheduler=field.scheduler,
        middleware=field.middleware,
        on_report=lambda event: lines.append((event.time / SECOND, event.detail)),
    )
    field.engines["A"] = engine
    field.listen("A")
    field.send("A", leaving)
    field.pass_time(1)
    field.send("A", patrol(2))
    field.pass_time(0.2)
    assert (engine.state, field.answers()) == ("loading", ["started"])
    field.send("A", patrol(3))
    field.pass_time(1)
    assert lines == [(1.5, "out")]
    assert field.answers() == ["started", "started", "started"]
    assert field.variables("A") == {"mark": 3}


def test_a_script_that_does_not_end_when_it_is_told_to_does_not_hold_up_the_next_process():
    field = Field("A")
    field.send("A", patrol(1).replace("mark = 1", "try:\n    await sleep(99)\nfinally:\n    await sleep(99)"))
    field.pass_time(1)
    field.send("A", patrol(2))
    field.pass_time(3)
    assert field.variables("A") == {"mark": 2}


def test_an_engine_that_ends_waits_for_its_scripts():
    field = Field("A")
    field.send(
        "A", patrol(1).replace("mark = 1", "try:\n    await sleep(99)\nfinally:\n    await sleep(1)\n    mark = 7")
    )
    field.pass_time(1)
    engine = field.engines["A"]
    assert engine.stop()
    field.pass_time(2)
    assert not engine.stop()
    assert field.variables("A") == {"mark": 7}
    engine.close()


def test_of_two_engines_of_one_robot_the_younger_leaves():
    field = Field()
    elder = EngineNode("A", scheduler=field.scheduler, middleware=field.middleware, wall_time=lambda: 10.0)
    field.pass_time(1)
    EngineNode("A", scheduler=field.scheduler, middleware=field.middleware, wall_time=lambda: 11.0)
    with pytest.raises(fame.FameError, match="there is an engine 'A' already"):
        field.pass_time(1)
    assert elder.state == "waiting"


@pytest.mark.parametrize(
    "change",
    [
        {"robot": 5},
        {"model": ["x"]},
        {"sequence": 1.5},
        {"sequence": -2},
        {"sequence": 10**30},
        {"phase": "run"},
        {"promises": 3},
        {"team": {"a": 1}},
        {"phase": "dance"},
        {"deployment": None},
        {"colour": "red"},
        {"model": "\ud800"},
        {"hash": True},
    ],
    ids=str,
)
def test_an_envelope_that_is_not_as_it_has_to_be_is_refused_and_harms_nobody(change):
    field = Field("A", "B")
    sent = field.deploy(TEAM)
    said = json.loads(sent.standings["A"].envelope.to_json()) | {"deployment": "d9", "sequence": 9} | change
    field.send("A", json.dumps(said))
    field.pass_time(0.1)
    assert (field.said[-1].answer, field.said[-1].state) == ("refused", "running")


@pytest.mark.parametrize("text", ["[" * 100_000, '{"fame": 1, "robot": ' * 10_000, "null", "[]", "0", '"'])
def test_any_text_is_answered(text):
    field = Field("A")
    field.send("A", text)
    field.pass_time(0.1)
    assert field.answers() == ["refused"]


def test_a_mark_of_byte_order_before_a_model_does_no_harm():
    field = Field("A")
    field.send("A", "\ufeff" + patrol(1))
    field.pass_time(0.1)
    assert field.variables("A") == {"mark": 1}


def nested(levels: int) -> str:
    """A process of sub-processes in each other."""
    return definitions(
        process("p", "".join(f'<subProcess id="s{n}">' for n in range(levels)) + "</subProcess>" * levels)
    )


@pytest.mark.parametrize(
    "text",
    [
        nested(240),
        nested(100_000),
        patrol(2).replace("mark = 2", "x = " + "-" * 100_000 + "1"),
        patrol(2).replace("mark = 2", "x = " + " + ".join("1" * 100_000)),
        patrol(2).replace('name="stop"', 'name="&xxe;"').replace("<definitions", '<!DOCTYPE x SYSTEM "x"><definitions'),
    ],
    ids=["240 levels", "100000 levels", "signs", "sums", "external entity"],
)
def test_a_model_that_nothing_can_be_made_of_is_refused_and_leaves_nothing_behind(text):
    field = Field("A")
    field.send("A", patrol(1))
    field.pass_time(0.1)
    nodes = len(field.middleware.nodes)
    field.send("A", text)
    field.pass_time(0.1)
    assert (field.said[-1].answer, field.said[-1].state) == ("refused", "running")
    assert field.variables("A") == {"mark": 1}
    assert len(field.middleware.nodes) == nodes


def test_a_report_that_is_none_harms_no_deployment():
    field = Field("A", "B")
    node = field.middleware.node("liar")
    for robot in "AB":
        liar = node.publisher(f"/{robot}/bpmn_status", deployment.STRING)
        for text in (
            "",
            "[" * 100_000,
            '{"robot": 1, "state": 2}',
            '{"robot": "A", "state": "x", "waits": [1]}',
            '{"robot": "A", "state": "ready", "born": "x"}',
        ):
            liar.publish(messages.create(deployment.STRING, text))
    assert not field.deploy(TEAM).failed


def test_a_report_tells_since_when_tokens_wait_for_which_topic_and_who_publishes_there():
    field = Field("A")
    field.pass_time(2)
    field.send("A", patrol(1))
    field.pass_time(3)
    assert field.said[-1].waits == [
        {"element": "c", "for": "topic /stop, which nobody else publishes", "since": 2.0, "topics": {"/stop": 0}}
    ]
    field.person.publisher("/stop", "std_msgs/msg/Empty")
    field.pass_time(1)
    assert field.said[-1].waits == [{"element": "c", "for": "topic /stop", "since": 2.0, "topics": {"/stop": 1}}]


def test_a_robot_that_no_pool_wants_belongs_to_others_and_is_left_alone():
    field = Field("A", "B", "Z")
    sent = field.deploy(TEAM)
    assert (sent.failed, list(sent.standings)) == (False, ["A", "B"])
    assert field.engines["Z"].state == "waiting"


def test_a_model_for_one_robot_goes_to_it_though_others_that_play_its_pools_are_not_there():
    field = Field("A")
    sent = field.deploy(TEAM.replace('name="go"', 'name="~/go"'), only=["A"])
    assert (sent.failed, list(sent.standings)) == (False, ["A"])


def test_after_a_thousand_redeployments_everything_is_as_after_ten():
    import gc
    import threading

    field = Field("A")
    field.said = []

    def redeploy(times: int) -> tuple[int, ...]:
        for number in range(times):
            field.send("A", patrol(number % 3))
            field.pass_time(0.01)
        field.pass_time(2)
        field.said.clear()
        gc.collect()
        ends = sum(len(info.publishers) + len(info.subscribers) for info in field.middleware.graph())
        return ends, len(field.scheduler), len(field.middleware.nodes), threading.active_count(), len(gc.get_objects())

    redeploy(10)
    after_ten = redeploy(100)
    after_many = redeploy(1000)
    assert after_many[:4] == after_ten[:4]
    assert after_many[4] <= after_ten[4] + 50


class HardOfHearing(Deployment):
    """It does not hear the first answer of each robot: on the status topic a newer report took its place."""

    lost: tuple[str, ...] = ()

    def _heard(self, robot, message):
        report = Report.from_json(message.data)
        if report.answer and report.deployment == self.id and robot not in self.lost:
            self.lost = (*self.lost, robot)
        else:
            super()._heard(robot, message)


@pytest.mark.parametrize("newer", [True, False])
def test_who_misses_an_answer_asks_again_and_ends_with_the_truth(newer):
    field = Field("A", "B")
    options = {"scheduler": field.scheduler, "middleware": field.middleware, "ended": lambda deployment: None}
    older = HardOfHearing(read_text(TEAM, file="team.bpmn"), id="d1", sequence=1, **options)
    older.begin()
    if newer:
        assert not field.deploy(TEAM, id="d2", sequence=2).failed
    else:
        field.pass_time(12)
    assert older.lost == ("A", "B") or older.lost == ("B", "A")
    assert (older.done, older.failed) == (True, newer)
    assert ("superseded" in {each.state for each in older.standings.values()}) is newer
    assert {engine.deployed for engine in field.engines.values()} == {"d2" if newer else "d1"}


# ---- what is decided stays decided -----------------------------------------------------------------------------------


def test_a_robot_that_is_ready_takes_a_newer_one_only_when_the_older_is_decided():
    field = Field("A", "B")
    older = dead_after_loading(field, "d1", 1)
    newer = made(field, TEAM, "d2", 2)
    newer.close()
    field.send("A", newer.standings["A"].envelope.to_json())
    field.pass_time(0.1)
    assert (field.said[-1].answer, field.said[-1].deployment) == ("superseded", "d1")
    for name in "AB":  # its sender had told them already: they keep their word
        field.send(name, older._envelope(name, "start").to_json())
    field.pass_time(0.1)
    assert [field.engines[name].deployed for name in "AB"] == ["d1", "d1"]
    assert field.engines["A"].state == "ready"


def test_a_sender_that_is_not_through_makes_room_for_a_newer_one_at_once():
    field = Field("A")
    older = made(field, TEAM.replace('name="go"', 'name="~/go"'), "d1", 1)  # B never answers
    older.begin()
    field.pass_time(1)
    assert field.engines["A"].state == "ready"
    field.send("A", patrol(5))
    field.pass_time(0.1)
    assert (older.failed, older.standings["A"].state) == (True, "superseded")
    assert field.variables("A") == {"mark": 5}


def test_two_deployments_at_the_same_instant_end_with_one_of_them_everywhere():
    field = Field("A", "B")
    pair = [made(field, TEAM, id, 7) for id in ("d1", "d2")]
    for sent in pair:
        sent.begin()
    field.pass_time(15)
    assert {engine.deployed for engine in field.engines.values()} == {"d2"}
    assert [sent.failed for sent in pair] == [True, False]


class Deaf(Deployment):
    """Nothing that it says to `lost` robots arrives while `words` are left, once they are told to start."""

    lost: tuple[str, ...] = ()
    words = 0

    def _send(self, robot, envelope):
        if robot in self.lost and envelope.phase != "load" and self.words:
            self.words -= 1
        else:
            super()._send(robot, envelope)


THREE = TEAM.replace(
    'name="B" processRef="pb"/>', 'name="B" processRef="pb"><participantMultiplicity minimum="1"/></participant>'
)


def test_a_robot_that_comes_back_in_between_without_its_process_does_not_keep_the_others_from_it():
    field = Field("A", "B_1", "B_2")
    options = {"scheduler": field.scheduler, "middleware": field.middleware, "ended": lambda deployment: None}
    sent = Deaf(read_text(THREE, file="team.bpmn"), id="d1", sequence=1, **options)
    sent.lost, sent.words = ("B_1", "B_2"), 2
    sent.begin()
    field.pass_time(0.5)
    assert [engine.state for engine in field.engines.values()] == ["running", "ready", "ready"]
    killed = field.engines["B_2"]
    killed.status.close()
    killed.candidate.close()
    killed.node.close()
    field.engines["B_2"] = EngineNode("B_2", scheduler=field.scheduler, middleware=field.middleware)
    field.pass_time(3)
    assert [engine.deployed for engine in field.engines.values()] == ["d1", "d1", ""]
    assert (sent.failed, sent.standings["B_2"].state) == (True, "refused")


class Stopped(Deployment):
    """A sender whose process is stopped for a while, after its robots have got their parts."""

    until = 0.0

    def _ask(self):
        if not self._stands(self._ask):
            super()._ask()

    def _heard(self, robot, message):
        if not self._stands(lambda: self._heard(robot, message)):
            super()._heard(robot, message)

    def _stands(self, again) -> bool:
        stands = self._phase == "load" and bool(self._spoke) and self.scheduler.now < self.until * SECOND
        if stands and self.standings:
            self.scheduler.at(round(self.until * SECOND), again)
        return stands


@pytest.mark.parametrize("seconds", [3.0, 5.5, 6.9, 7.1, 9.0])
def test_a_sender_that_was_stopped_starts_all_or_nobody(seconds):
    field = Field("A", "B")
    options = {"scheduler": field.scheduler, "middleware": field.middleware, "ended": lambda deployment: None}
    sent = Stopped(read_text(TEAM, file="team.bpmn"), id="d1", sequence=1, **options)
    sent.begin()
    field.pass_time(0.021)
    sent.until = seconds
    field.pass_time(15)
    deployed = "d1" if seconds < 5 else ""
    assert [engine.deployed for engine in field.engines.values()] == [deployed, deployed]
    assert sent.failed is (seconds > 5)


def test_a_sender_that_leaves_before_it_is_through_calls_it_off():
    field = Field("A")
    sent = made(field, TEAM.replace('name="go"', 'name="~/go"'), "d1", 1)
    sent.begin()
    field.pass_time(1)
    sent.close()
    field.pass_time(0.1)
    assert (field.engines["A"].state, field.answers()[-1]) == ("waiting", "aborted")


def test_a_sender_whose_clock_is_behind_is_newer_all_the_same():
    field = Field("A", "B")
    field.deploy(TEAM, "d1", 10**15)
    sent = field.deploy(TEAM, "d2", 5)
    assert (sent.failed, sent.sequence) == (False, 10**15 + 1)
    assert {engine.deployed for engine in field.engines.values()} == {"d2"}


def test_an_older_model_does_not_take_the_turn_of_a_newer_one_that_waits():
    field = Field("A")
    texts = {id: made_for_one(field, id, sequence) for id, sequence in (("d1", 1), ("d2", 3), ("d3", 2))}
    for text in texts.values():
        field.send("A", text)
    field.pass_time(0.1)
    answers = [(report.deployment, report.answer) for report in field.said if report.answer]
    assert answers == [("d1", "superseded"), ("d3", "stale"), ("d2", "ready")]


def made_for_one(field: Field, id: str, sequence: int) -> str:
    sent = made(field, TEAM.replace('name="go"', 'name="~/go"'), id, sequence)
    sent.close()
    return sent.standings["A"].envelope.to_json()


def test_an_engine_that_ends_says_so_to_whoever_waits_for_it():
    field = Field("A")
    for id, sequence in (("d1", 1), ("d2", 2)):
        field.send("A", made_for_one(field, id, sequence))
        field.pass_time(0.1)
    field.engines["A"].close()
    field.pass_time(0.1)
    ended = [report.deployment for report in field.said if report.reason == "the engine ends"]
    assert ended == ["d2", "d1"]
