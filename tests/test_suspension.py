"""A person suspends a mission, steers the robot, and lets the mission continue; the engine may die meanwhile."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from action_server import DRIVE as DRIVE_TYPE, Server
from bpmn_text import NAMESPACES, properties
from deployment_field import Field, definitions, process
from test_resumption import POOL, Durable, request, told

from fame.cli.robots import rows
from fame.deploy import STRING, Envelope, Report
from fame.deploy.requests import TaskRequest
from fame.fleet.diagnostics import TYPE, WARN
from fame.middleware import messages
from fame.middleware.errors import EndpointWarning

ANN = "ann@desk (unverified)"
DRIVE = definitions(
    POOL,
    process(
        "p",
        '<startEvent id="s"/><callActivity id="go" name="Go" calledElement="q"/><userTask id="u"/>'
        '<boundaryEvent id="late" attachedToRef="go"><timerEventDefinition><timeDuration>PT60S</timeDuration>'
        '</timerEventDefinition></boundaryEvent><userTask id="slow"/>'
        '<boundaryEvent id="lost" attachedToRef="go"><errorEventDefinition errorRef="E"/></boundaryEvent>'
        '<userTask id="mend"/>',
        ("s", "go"),
        ("go", "u"),
        ("late", "slow"),
        ("lost", "mend"),
    ),
    process(
        "q",
        '<startEvent id="qs"/><scriptTask id="first"><script>pass</script></scriptTask>'
        '<scriptTask id="drive"><script>n = globals().get("n", 0)\nwhile True:\n    n += 1\n    await sleep(1)</script>'
        "</scriptTask>",
        ("qs", "first"),
        ("first", "drive"),
    ),
    '<error id="E" errorCode="taken_over"/>',
)


@pytest.fixture
def field(tmp_path: Path) -> Iterator[Durable]:
    made = Durable(tmp_path / "state", safe_state=[("stop", "std_msgs/msg/Bool", {"data": True})])
    made.stops = []
    made.person.subscription("/A/stop", "std_msgs/msg/Bool", lambda message: made.stops.append(made.scheduler.now))
    made.deploy(DRIVE)
    yield made
    for engine in made.engines.values():
        engine.close()


def ask(field: Durable, act: str, element: str = "", **more: Any) -> Report:
    """The robot's answer to a request of Ann."""
    request(field, act=act, element=element, **{"who": "ann@desk", **more})
    return next(report for report in reversed(field.said) if report.answer)


def n(field: Durable) -> int:
    (root,) = field.engine.running.engine.instances.values()
    (inner,) = root.root.children
    return int(inner.variables["n"])


def waiting(field: Durable) -> list[str]:
    return [wait.element for wait in field.engine.running.waiting_tokens()]


def test_a_suspended_mission_stands_still_in_the_safe_state_through_its_calls_and_then_begins_again(
    field: Durable,
) -> None:
    before, stopped = n(field), len(field.stops)
    assert ask(field, "suspend").answer == "suspended"
    assert len(field.stops) > stopped
    field.pass_time(20)
    assert n(field) <= before + 1
    assert field.said[-1].state == "suspended"
    assert ask(field, "continue").answer == "continued"
    field.pass_time(5)
    assert n(field) > before + 4
    assert field.said[-1].state == "running"


def test_who_suspends_it_again_while_its_scripts_leave_holds_it(field: Durable) -> None:
    leaving = "try:\n    await sleep(99)\nfinally:\n    await sleep(0.5)"
    task = f'<startEvent id="s"/><scriptTask id="t"><script>{leaving}</script></scriptTask>'
    field.deploy(definitions(POOL, process("p", task, ("s", "t"))), id="next")
    field.pass_time(1)
    node = field.engine.running
    node.suspension.suspend("ann")
    node.suspension.go_on("ann")
    node.suspension.suspend("bob")
    assert node.leaving
    field.pass_time(20)
    assert (node.suspension.by, node.holds, node.engine.held is None) == ("bob", {"a person"}, False)
    node.suspension.go_on("bob")
    assert node.engine.held is None


def test_the_status_says_who_suspended_it_and_what_ends_that(field: Durable) -> None:
    ask(field, "suspend")
    field.pass_time(3)
    report = field.said[-1]
    assert (report.suspended["by"], report.suspended["holder"]) == (ANN, "")
    shown = [row[6] for row in rows("A", report)]
    assert shown[0].startswith(f"suspended by {ANN} since ")
    assert f"suspended by {ANN}; fame continue A ends that" in shown


def test_why_it_waits_names_the_person(field: Durable) -> None:
    ask(field, "suspend")
    node = field.engine.running
    (wait,) = [wait for wait in next(iter(node.engine.instances.values())).waits() if wait.node.id == "drive"]
    assert {"suspended": True, "by": ANN}.items() <= node.waiting.details(wait).items()


def test_details_change_with_what_the_middleware_warns_of(field: Durable) -> None:
    waits = field.engine.running.waiting
    waits.refresh_publishers()
    assert not waits.refresh_publishers()
    field.middleware.warnings.append(EndpointWarning("/go", "hears nothing", "mismatch"))
    assert waits.refresh_publishers()
    assert not waits.refresh_publishers()


def test_deadlines_go_on_while_it_is_suspended(field: Durable) -> None:
    ask(field, "suspend")
    field.pass_time(80)
    assert waiting(field) == ["drive"]
    ask(field, "continue")
    assert waiting(field) == ["slow"]


def test_a_restarted_engine_comes_back_suspended_with_its_author(field: Durable) -> None:
    ask(field, "suspend")
    since = field.said[-1].suspended["since"]
    before = n(field)
    field.crash()
    field.pass_time(10)
    field.start()
    field.pass_time(3)
    assert field.said[-1].state == "suspended"
    assert field.said[-1].suspended == {"by": ANN, "since": since, "holder": ""}
    assert n(field) == before
    ask(field, "continue")
    field.pass_time(3)
    assert n(field) > before
    field.crash()
    field.start()
    field.pass_time(3)
    assert field.said[-1].state == "running"


def test_who_suspended_and_continued_it_is_in_the_journal_and_the_log(field: Durable) -> None:
    ask(field, "suspend")
    ask(field, "continue", who="bob@field")
    text = field.engine._keeper.directory.segments()[-1].read_text()
    for note in (f"suspended by {ANN}", "continued by bob@field (unverified)"):
        assert note in text
        assert note in field.notes


def test_what_is_not_suspended_does_not_continue(field: Durable) -> None:
    assert ask(field, "continue").reason == "A: no person has suspended its mission"
    assert ask(field, "fail", "go").reason == "A: no person has suspended its mission"


def test_a_drawn_activity_is_restarted_with_what_it_calls(field: Durable) -> None:
    ask(field, "suspend")
    assert ask(field, "restart", "go").answer == "restarted"
    ask(field, "continue")
    assert field.engine.running.instances[0].visits["first"] == 2
    assert waiting(field) == ["drive"]


def test_a_skipped_activity_is_left_when_the_mission_continues(field: Durable) -> None:
    ask(field, "suspend")
    ask(field, "skip", "go")
    assert waiting(field) == []
    ask(field, "continue")
    assert waiting(field) == ["u"]


def test_a_failed_activity_raises_taken_over_which_its_boundary_event_catches(field: Durable) -> None:
    ask(field, "suspend")
    assert ask(field, "fail", "go").answer == "made to fail"
    assert (waiting(field), field.said[-1].state) == (["mend"], "running")
    assert f"failed by {ANN}" in field.notes


def test_what_another_hold_keeps_does_not_fail_yet(tmp_path: Path) -> None:
    field = Durable(tmp_path / "state", hold_errors=True)
    field.deploy(DRIVE)
    ask(field, "suspend")
    field.engine.running.hold("disk")
    assert ask(field, "fail", "go").reason == "go: cannot fail yet: the robot also holds for disk"
    field.engine.running.release("disk")
    assert ask(field, "fail", "first").reason == "first: has no token; tokens are at: drive, go"
    assert ask(field, "fail", "drive").answer == "made to fail"
    assert waiting(field) == ["mend"]
    field.engine.close()


def test_a_failure_that_nothing_catches_is_an_incident(tmp_path: Path) -> None:
    field = Durable(tmp_path / "state", hold_errors=True)
    field.deploy(DRIVE.replace('errorCode="taken_over"', 'errorCode="other"'))
    ask(field, "suspend")
    ask(field, "fail", "go")
    assert (field.said[-1].state, field.said[-1].incidents[0]["code"]) == ("incident", "taken_over")
    ask(field, "retry", "go")
    assert (field.said[-1].state, waiting(field)) == ("running", ["drive"])
    field.engine.close()


def test_what_a_person_no_longer_suspends_comes_back_with_its_incident_alone(tmp_path: Path) -> None:
    field = Durable(tmp_path / "state", hold_errors=True)
    field.deploy(DRIVE.replace('errorCode="taken_over"', 'errorCode="other"'))
    ask(field, "suspend")
    ask(field, "fail", "go")
    ask(field, "suspend")
    assert ask(field, "continue").answer == "no longer suspended"
    field.crash()
    field.start()
    field.pass_time(3)
    assert (field.said[-1].state, field.said[-1].suspended) == ("incident", {})
    field.engine.close()


def test_a_mission_that_is_migrated_meanwhile_stays_suspended_and_a_new_deployment_starts_its_own(
    field: Durable,
) -> None:
    ask(field, "suspend")
    field.deploy(DRIVE.replace("n += 1", "n += 2"), "d2", 2, migrate=True)
    assert (field.engine.deployed, field.said[-1].state, field.said[-1].suspended["by"]) == ("d2", "suspended", ANN)
    before = n(field)
    ask(field, "continue")
    field.pass_time(3)
    assert n(field) >= before + 6
    ask(field, "suspend")
    field.deploy(DRIVE, "d3", 3)
    assert (field.engine.deployed, field.said[-1].state, field.said[-1].suspended) == ("d3", "running", {})


def test_what_a_migration_finds_in_progress_is_done_once_and_stands_still_while_suspended(field: Durable) -> None:
    field.deploy(DRIVE, "d2", 2, migrate=True)
    before = n(field)
    field.pass_time(5)
    assert n(field) == before + 5
    ask(field, "suspend")
    before = n(field)
    field.pass_time(5)
    assert n(field) == before
    ask(field, "continue")
    field.pass_time(5)
    assert n(field) == before + 7  # it begins anew, and the answer takes a second


def test_what_was_held_for_a_deployment_when_the_engine_ended_is_done_once(field: Durable) -> None:
    told(field, "d2", 2, DRIVE, "load", migrate=True)
    field.pass_time(1)
    assert field.engine.running.engine.held is not None
    field.crash()
    field.start()
    field.pass_time(2)
    field.send("A", Envelope(deployment="d2", sequence=2, robot="A", phase="abort").to_json())
    field.pass_time(1)
    before = n(field)
    field.pass_time(5)
    assert (field.engine.deployed, field.engine.running.engine.held, n(field)) == ("d1", None, before + 5)


@pytest.mark.parametrize(
    "asked",
    [
        {"act": "move", "element": "drive", "to": "first"},
        {"act": "set", "values": {"n": 100}},
        {"act": "retry", "element": "drive"},
        {"act": "skip", "element": "go"},
        {"act": "restart", "element": "go"},
        {"act": "complete", "element": "u"},
    ],
    ids=lambda asked: asked["act"],
)
def test_between_its_promise_and_the_start_nobody_changes_what_a_robot_runs(field: Durable, asked: Any) -> None:
    told(field, "d2", 2, DRIVE, "load", migrate=True)
    field.pass_time(1)
    assert field.engine.state == "ready"
    assert ask(field, **asked).reason.startswith(
        "a deployment is under way, which it has promised to start; fame abort"
    )
    field.crash()  # the promise is on the disk
    field.start()
    field.pass_time(2)
    assert "which it has promised to start" in ask(field, **asked).reason
    before = n(field)
    assert ask(field, "suspend").answer == "suspended"
    told(field, "d2", 2, "", "start")
    field.pass_time(1)
    assert (field.engine.deployed, n(field), waiting(field)) == ("d2", before, ["drive"])


def test_what_was_answered_is_answered_alike_when_it_arrives_again_after_a_promise_or_its_end(field: Durable) -> None:
    def answers(id: str) -> list[str]:
        asked = TaskRequest(id=id, element="", act="set", values={"m": 100}).to_json()
        field.person.publisher("/A/bpmn_task", STRING).publish(messages.create(STRING, asked))
        field.pass_time(0.2)
        return [report.answer for report in field.said if report.deployment == id]

    assert answers("before") == ["set"]
    told(field, "d2", 2, DRIVE, "load", migrate=True)
    field.pass_time(1)
    assert answers("before") == ["set", "set"]
    assert answers("while") == ["refused"]
    field.send("A", Envelope(deployment="d2", sequence=2, robot="A", phase="abort").to_json())
    field.pass_time(1)
    assert answers("while") == ["refused", "refused"]


# ---- goals that still run ------------------------------------------------------------------------------------------

GOAL = definitions(
    POOL,
    process(
        "p",
        '<startEvent id="s"/><serviceTask id="go">'
        f"{properties(action='drive', type=DRIVE_TYPE, payload='{distance: 9}')}</serviceTask>",
        ("s", "go"),
    ),
).replace("<definitions ", f"<definitions xmlns:camunda='{NAMESPACES['camunda']}' ")
REFUSED = "/A/drive: a cancelled goal still runs: its server refuses to cancel it"


@pytest.fixture
def driving() -> Field:
    """A robot that drives, and a server that does not obey."""
    made = Field("A", diagnostics=True)
    made.server = Server(made.middleware.node("base", "A"))
    made.server.obeys = False
    made.statuses = []
    made.person.subscription("/diagnostics", TYPE, lambda message: made.statuses.append(message.status[0]))
    made.deploy(GOAL)
    assert len(made.server.goals) == 1
    return made


def test_while_its_goal_still_runs_a_suspended_robot_says_so(driving: Field) -> None:
    answer = ask(driving, "suspend", who="ann@desk")
    assert answer.reason == "its goal still runs until its server has cancelled it: /A/drive"
    driving.pass_time(1)
    said = driving.said[-1]
    assert (said.state, said.goals, said.warnings) == ("suspended", ["/A/drive"], [REFUSED])
    told = [row[6] for row in rows("A", said)]
    assert f"suspended by {ANN}; fame continue A ends that; its goal still runs: /A/drive" in told
    assert f"warning: {REFUSED}" in told
    status = driving.statuses[-1]
    assert (status.level, status.message) == (WARN, f"suspended by {ANN}; its goal still runs: /A/drive")
    driving.server.end(driving.server.cancelled[0], 4)
    driving.pass_time(1)
    assert (driving.said[-1].goals, driving.said[-1].warnings) == ([], [])


@pytest.mark.parametrize("migrate", [True, False])
def test_the_next_process_knows_what_its_server_has_not_cancelled_for_the_last_one(
    driving: Field, migrate: bool
) -> None:
    driving.deploy(GOAL.replace("distance: 9", "distance: 8"), "d2", 2, migrate=migrate)
    assert (driving.engines["A"].deployed, driving.said[-1].warnings) == ("d2", [REFUSED])
    assert [wanted for wanted, _ in driving.server.goals.values()] == [9.0, 8.0]
    driving.server.end(next(iter(driving.server.goals)), 4)
    driving.pass_time(1)
    assert driving.said[-1].warnings == []


# ---- the lease -------------------------------------------------------------------------------------------------------


def test_one_person_at_a_time_steers_and_the_status_says_who(field: Durable) -> None:
    assert ask(field, "take_over", lease="1").answer == "taken over"
    assert (field.said[-1].state, field.said[-1].suspended["holder"]) == ("suspended", ANN)
    assert f"suspended by {ANN}, {ANN} steers it" in [row[6] for row in rows("A", field.said[-1])]
    refusal = f"A: {ANN} steers it; fame suspend stops it"
    assert ask(field, "take_over", who="bob@field", lease="2").reason == refusal
    assert ask(field, "continue", who="bob@field").reason == refusal
    assert ask(field, "continue", lease="1").answer == "continued"
    assert ask(field, "take_over", who="bob@field", lease="2").answer == "taken over"


def test_a_lease_that_is_not_prolonged_ends_and_the_robot_stays_suspended(field: Durable) -> None:
    locks: list[bool] = []
    field.person.subscription("/A/taken_over", "std_msgs/msg/Bool", lambda message: locks.append(message.data))
    for _ in range(5):
        ask(field, "take_over", lease="1")  # each takes a second
    assert field.said[-1].suspended["holder"] == ANN
    stopped = len(field.stops)
    field.pass_time(4)
    assert (field.said[-1].suspended["holder"], field.said[-1].suspended["by"]) == ("", ANN)
    assert locks == [True] * 5 + [False]
    assert len(field.stops) > stopped
    assert f"{ANN} steers no longer: lost" in field.notes


def test_after_a_restart_of_the_engine_nobody_steers(field: Durable) -> None:
    ask(field, "take_over", lease="1")
    field.crash()
    field.start()
    field.pass_time(1)
    assert (field.said[-1].state, field.said[-1].suspended["holder"]) == ("suspended", "")


def test_while_somebody_steers_no_deployment_is_accepted_and_nobody_steers_during_one(field: Durable) -> None:
    ask(field, "take_over", lease="1")
    field.deploy(DRIVE, "d2", 2)
    assert f"{ANN} steers the robot" in {report.reason for report in field.said if report.answer == "refused"}
    field.pass_time(4)
    told(field, "d3", 3, DRIVE, "load")
    field.pass_time(1)
    assert field.engine.state == "ready"
    assert ask(field, "take_over", lease="2").reason == "a deployment is under way: nobody takes the robot over"


@pytest.fixture
def holding(tmp_path: Path) -> Iterator[Durable]:
    """A robot of which one branch has failed, for which it holds, and the other one waits for a person."""
    made = Durable(tmp_path / "state", hold_errors=True)
    made.deploy(
        definitions(
            POOL,
            process(
                "p",
                '<startEvent id="s"/><parallelGateway id="f"/><scriptTask id="bad"><script>raise ValueError("no")'
                '</script></scriptTask><userTask id="u" name="Release"/><endEvent id="e"/>',
                *(("s", "f"), ("f", "bad"), ("f", "u"), ("bad", "e"), ("u", "e")),
            ),
        )
    )
    yield made
    for engine in made.engines.values():
        engine.close()


def test_a_robot_that_holds_for_an_incident_does_not_continue_and_says_what_ends_that(holding: Durable) -> None:
    ask(holding, "suspend")
    report = ask(holding, "continue")
    assert report.answer == "no longer suspended"
    assert report.reason == (
        "no person suspends it, but it still holds for an incident at bad (fame retry A bad, or fame skip)"
    )
    holding.pass_time(2)
    assert (holding.said[-1].state, holding.said[-1].suspended) == ("incident", {})


def test_a_task_completed_meanwhile_waits_for_nobody_and_goes_on_when_the_robot_does(holding: Durable) -> None:
    report = ask(holding, "complete", "u")
    assert (report.answer, report.reason) == ("completed", "u; it goes on when what suspends it ends")
    holding.pass_time(2)
    node = holding.engine.running
    (shown,) = [wait for wait in holding.said[-1].waits if wait["element"] == "u"]
    assert shown["suspended"] == "has been completed; goes on when the robot continues"
    assert shown["for"] == "the end of its suspension: it has been completed"
    (wait,) = [wait for wait in next(iter(node.engine.instances.values())).waits() if wait.node.id == "u"]
    details = node.waiting.details(wait)
    assert (details["kind"], "topics" in details) == ("due", False)
    again = ask(holding, "complete", "u")
    assert (again.answer, again.reason) == ("refused", "u: has been completed; it goes on when what suspends it ends")
    assert ask(holding, "skip", "bad").answer == "skipped"
    assert holding.said[-1].completed == 1
