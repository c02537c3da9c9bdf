"""Robots get their processes over topics: all or none, the newest of a burst, the old one kept if the new is wrong."""

import json
from functools import partial
from pathlib import Path

import pytest
from deployment_field import BPMN, LATE, TEAM, Field, definitions, made, patrol, process

import fame
from fame import deploy
from fame.bpmn.library import Library
from fame.bpmn.reader import read_text
from fame.cli.robots import rows
from fame.clock import SECOND, Kind, Scheduler
from fame.deploy import EngineNode
from fame.deploy.assignment import assign_robots
from fame.middleware import messages
from fame.middleware.interface import EndpointWarning, QoS
from fame.middleware.local import LocalMiddleware
from fame.robot.events import Event
from fame.robot.waiting_tokens import PublisherGap, PublisherGaps
from fame.scenario.deployment import Sending


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
    assert field.said[-1].hash == deploy.model_hash(patrol(1).encode())
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
    assert said == ["waiting up to 10 s: t.bpmn: pool 'A' has no robot A; there are no robots"]
    assert scheduler.now // SECOND == 10


def test_a_sender_names_the_robots_that_are_there() -> None:
    field = Field("REX")
    sending = Sending(read_text(TEAM, file="t.bpmn"), field.scheduler, field.middleware)
    with pytest.raises(
        fame.DeploymentError, match=r"pool 'A' has no robot A; the robots are REX; start an engine with"
    ):
        sending.deploy([], 10.0, print)


@pytest.mark.parametrize(("late", "found"), [(18, True), (22, False)])
def test_a_sender_waits_as_long_after_each_engine_that_comes(late: int, found: bool) -> None:
    field = Field()
    for robot, after in (("A", 9), ("B", late)):
        field.scheduler.after(after * SECOND, partial(EngineNode, robot, scheduler=field.scheduler,
                                                      middleware=field.middleware), Kind.TIMER)  # fmt: skip
    sending = Sending(read_text(TEAM, file="t.bpmn"), field.scheduler, field.middleware)
    if found:
        assert sending.deploy([], 10.0).started == ["A", "B"]
    else:
        with pytest.raises(fame.DeploymentError, match="pool 'B' has no robot B"):
            sending.deploy([], 10.0)


@pytest.mark.parametrize("comes_back", [True, False])
def test_an_engine_that_is_lost_before_the_first_word_is_waited_for(comes_back: bool) -> None:
    field = Field("A", "B")
    field.scheduler.after(3 * SECOND // 10, field.engines["B"].close, Kind.TIMER)
    if comes_back:
        again = partial(EngineNode, "B", scheduler=field.scheduler, middleware=field.middleware)
        field.scheduler.after(2 * SECOND, again, Kind.TIMER)
    examined: list[list[str]] = []
    sending = Sending(read_text(TEAM, file="t.bpmn"), field.scheduler, field.middleware)
    if comes_back:
        assert sending.deploy([], 10.0, examine=lambda found: examined.append(sorted(found))).started == ["A", "B"]
    else:
        with pytest.raises(fame.DeploymentError, match="pool 'B' has no robot B"):
            sending.deploy([], 10.0, examine=lambda found: examined.append(sorted(found)))
    assert examined == [["A", "B"]]


def test_if_one_robot_stays_silent_nobody_starts():
    field = Field("A")
    sent = field.deploy(TEAM, robots=["A", "B"])
    assert sent.failed
    assert "did not answer" in sent.robots["B"].reason or "not discovered" in sent.robots["A"].reason
    assert field.engines["A"].running is None
    assert field.engines["A"].state == "waiting"


@pytest.mark.parametrize(("patience", "failed"), [(10, True), (30, False)])
def test_a_robot_waits_half_as_long_for_the_others_as_its_sender(patience: int, failed: bool) -> None:
    field = Field("A")
    sent = made(field, TEAM, "d1", 1, patience=patience)
    sent.begin()
    field.pass_time(8)
    field.add("B")
    field.pass_time(3)
    assert (sent.done, sent.failed) == (True, failed)
    if failed:
        assert sent.robots["A"].reason == "/go (subscriber) not discovered within 5 s"


def test_an_engine_tells_whoever_looks_at_it_what_it_refused_and_the_others_why_it_was_called_off():
    field, told = Field("B"), []
    field.add("A", on_report=told.append, trusted=[object()])
    sent = field.deploy(TEAM, robots=["A", "B"])
    assert sent.failed
    assert {event.detail for event in told} == {
        "refused: not signed; this robot runs only deployments signed with a trusted key"
        " (of a team of fame run: its --key)"
    }
    assert sent.robots["B"].reason in ("had not answered yet", "called off because of A")


def test_what_it_refused_is_an_answer_if_somebody_waits_for_one():
    field, told = Field("B"), []
    field.add("A", on_report=told.append)
    field.listen("A")
    field.send("A", patrol(2).replace("mark = 2", "mark = = 2"))
    field.pass_time(0.1)
    unknown = deploy.Envelope(deployment="d9", sequence=3, robot="A", phase="start")
    field.send("A", unknown.to_json())
    field.pass_time(0.1)
    assert [event.what for event in told] == ["report", "answer"]


def test_an_engine_tells_once_what_it_refused_though_it_answers_again():
    field, told = Field(), []
    field.add("A", on_report=told.append)
    field.listen("A")
    asked = '<serviceTask id="g" xmlns:c="http://camunda.org/schema/1.0/bpmn" c:type="external" c:topic="grip"/>'
    sent = field.deploy(definitions(process("A", f'<startEvent id="s"/>{asked}', ("s", "g"))), robots=["A"])
    assert sent.robots["A"].state == "refused"
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
    report = [report for report in field.said if report.robot == "B" and report.error][-1]
    assert sent.source_map("B").report(report).error == said.format(folder=tmp_path)
    assert sent.source_map("B").place("B.bpmn", 999) == ("B.bpmn", 999)
    assert sent.source_map("B").place("DB.bpmn", 8) == ("DB.bpmn", 8)


def test_fame_status_speaks_of_the_drawn_activity(tmp_path):
    task = JUMP[JUMP.index("<scriptTask") : JUMP.index("<sequenceFlow")]
    (tmp_path / "Jump.bpmn").write_text(JUMP.replace(task, '<userTask id="jump" name="Get up"/>'))
    field = Field("A", "B")
    field.deploy(
        CLIMB.replace("WORK", "2").replace('id="call"', 'id="call" name="Over the wall"'), library=Library(tmp_path)
    )
    (wait,) = field.engines["B"].running.waiting_tokens()
    place = f'"Over the wall" (call), inside it Jump at "Get up" ({wait.element})'
    shown = [row for report in field.said if report.robot == "B" and report.waits for row in rows("B", report)]
    assert shown[-1][4:7:2] == (place, "a person to complete it")


def test_a_report_is_mapped_to_the_files_of_its_sender_field_by_field(tmp_path):
    (tmp_path / "Jump.bpmn").write_text(JUMP)
    field = Field("A", "B")
    sent = field.deploy(CLIMB.replace("WORK", "1 / 0"), library=Library(tmp_path))
    report = [report for report in field.said if report.robot == "B" and report.error][-1]
    assert report.errors[-1]["file"] == "B.bpmn"
    mapped = sent.source_map("B").report(report)
    (error,) = mapped.errors
    assert (error["file"], error["line"], error["element"]) == ("team.bpmn", 10, "jump")
    assert error["text"] == "ZeroDivisionError: division by zero"
    assert mapped.error == report.error.replace(f"B.bpmn:{report.errors[-1]['line']}", "team.bpmn:10")


def test_what_a_robot_refuses_has_its_place_as_fields():
    field = Field("A")
    field.send("A", patrol(2).replace("mark = 2", "mark = = 2"))
    field.pass_time(0.1)
    refusal = field.said[-1]
    assert [refusal.problem[name] for name in ("file", "line", "element")] == ["A.bpmn", 1, "t"]
    assert refusal.reason == f"A.bpmn:1: t: {refusal.problem['text']}"


def test_a_topic_whose_other_end_does_not_come_is_named():
    field = Field("A")
    field.send("A", patrol(1))
    field.pass_time(0.1)
    sent = field.deploy(TEAM, robots=["A", "B"])
    assert "/go (subscriber)" in sent.robots["A"].reason
    assert (sent.robots["B"].state, sent.robots["B"].reason) == ("silent", "had not answered yet")
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
    reasons = [standing.reason for standing in sent.robots.values() if standing.state == "refused"]
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
    field.send("A", sent.envelopes["A"].to_json())
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
    for robot, envelope in late.envelopes.items():
        field.send(robot, envelope.to_json())
    field.pass_time(0.1)
    assert [report.answer for report in field.said[-2:]] == ["stale", "stale"]
    assert {engine.deployed for engine in field.engines.values()} == {"d2"}


def test_only_some_robots_may_be_sent_to():
    field = Field("A", "B")
    field.deploy(TEAM)
    kept = field.engines["B"].running
    sent = field.deploy(TEAM, "d2", 2, only=["A"])
    assert not sent.failed
    assert list(sent.robots) == ["A"]
    assert field.engines["B"].running is kept
    for wrong, text in (("Z", "named Z .the model is for A, B.; known are: A, B"), ("a", "named a .*did you mean 'A'")):
        with pytest.raises(fame.DeploymentError, match=text):
            field.deploy(TEAM, "d3", 3, only=[wrong])
    with pytest.raises(fame.DeploymentError, match="the model has no pool for C: it is for A, B"):
        assign_robots(read_text(TEAM, file="m.bpmn"), ["A", "C"], found=True, only=["C"])


def test_an_envelope_for_another_robot_or_with_another_hash_is_refused():
    field = Field("A", "B")
    sent = field.deploy(TEAM)
    field.send("B", sent.envelopes["A"].to_json())
    changed = json.loads(sent.envelopes["A"].to_json()) | {"deployment": "d9", "sequence": 9, "hash": "0" * 64}
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


def test_a_script_may_bring_its_robot_to_rest_before_the_next_process_begins():
    leaving = patrol(1).replace("mark = 1", "try:\n    await sleep(9)\nfinally:\n    await sleep(0.5)\n    log('out')")
    lines: list[tuple[float, str]] = []
    field = Field()
    engine = field.add("A", on_report=lambda event: lines.append((event.time / SECOND, event.detail)))
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


def test_a_report_tells_since_when_tokens_wait_for_which_topic_and_who_publishes_there():
    field = Field("A")
    field.pass_time(2)
    field.send("A", patrol(1))
    field.pass_time(3)
    assert field.said[-1].waits == [
        {"element": "c", "for": "topic /stop, which no other node publishes", "since": 2.0, "topics": {"/stop": 0}}
    ]
    field.person.publisher("/stop", "std_msgs/msg/Empty")
    field.pass_time(1)
    assert field.said[-1].waits == [{"element": "c", "for": "topic /stop", "since": 2.0, "topics": {"/stop": 1}}]


def test_a_report_tells_that_a_publisher_was_gone_and_came_back_while_a_token_waited():
    field = Field("A")
    field.send("A", patrol(1))
    field.pass_time(2)
    publisher = field.person.publisher("/stop", "std_msgs/msg/Empty")
    field.pass_time(2)
    publisher.close()
    field.pass_time(20)
    assert field.said[-1].waits[0]["for"] == "topic /stop, which no other node publishes"
    publisher = field.person.publisher("/stop", "std_msgs/msg/Empty")
    field.pass_time(3.5)
    (wait,) = field.said[-1].waits
    assert wait["for"] == "topic /stop (/person was gone for 20 s until 2 s ago: its messages of that time may be lost)"


def test_what_was_gone_before_a_token_waited_is_nothing_to_tell():
    gaps = PublisherGaps()
    gaps.update(0, {"/stop": ["/a", "/b"]})
    gaps.update(5, {"/stop": ["/b"]})
    gaps.update(9, {"/stop": ["/a", "/b"]})
    assert gaps.since(9, ["/stop"]) is None
    assert gaps.since(8, ["/stop"]) == PublisherGap("/a", 5, 9)
    gaps.update(10, {"/other": []})
    gaps.update(11, {"/stop": ["/a"]})
    assert gaps.since(8, ["/stop", "/other"]) is None


def test_what_the_middleware_warns_of_is_told_once_and_stays_in_the_reports():
    field = Field("A")
    told: list[Event] = []
    field.engines["A"]._on_report = told.append
    field.middleware.warn(EndpointWarning("/x", "/b hears nothing from /a", "mismatch"))
    field.pass_time(5)
    assert [event.detail for event in told] == ["/x: /b hears nothing from /a"]
    assert field.said[-1].warnings == ["/x: /b hears nothing from /a"]


def test_lost_messages_are_told_as_they_grow_and_counted_in_the_reports_and_in_fame_status():
    field = Field("A")
    told: list[Event] = []
    field.engines["A"]._on_report = told.append
    field.middleware.node("b", "A").subscription("/x", deploy.STRING, lambda message: None, QoS(depth=5))
    publisher = field.person.publisher("/x", deploy.STRING)
    for _ in range(2):
        for _ in range(7):
            publisher.publish(messages.create(deploy.STRING, "x"))
        field.pass_time(3)
    text = "/x: /A/b lost {} messages, which came faster than it takes them or not at all"
    assert [event.detail for event in told] == [text.format(2), text.format(4)]
    assert field.said[-1].warnings == [text.format(4)]
    assert [row[-2] for row in rows("A", field.said[-1])][-1] == f"warning: {text.format(4)}"


def test_a_robot_that_no_pool_wants_belongs_to_others_and_is_left_alone():
    field = Field("A", "B", "Z")
    sent = field.deploy(TEAM)
    assert (sent.failed, list(sent.robots)) == (False, ["A", "B"])
    assert field.engines["Z"].state == "waiting"


def test_a_model_for_one_robot_goes_to_it_though_others_that_play_its_pools_are_not_there():
    field = Field("A")
    sent = field.deploy(TEAM.replace('name="go"', 'name="~/go"'), only=["A"])
    assert (sent.failed, list(sent.robots)) == (False, ["A"])


@pytest.mark.long
def test_after_hundreds_of_redeployments_everything_is_as_after_ten():
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
    after_ten = redeploy(50)
    after_many = redeploy(300)
    assert after_many[:4] == after_ten[:4]
    assert after_many[4] <= after_ten[4] + 50
