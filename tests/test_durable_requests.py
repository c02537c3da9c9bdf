"""After a crash a goal is taken up again by its id; else the property `retry` counts; missed timers follow `missed`."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from action_server import DRIVE
from deployment_field import definitions, process
from test_resumption import POOL, Durable

from fame.middleware.actions import ActionServer, ServerGoal
from fame.middleware.interface import DeferredResponse, Node

CAMUNDA = 'xmlns:camunda="http://camunda.org/schema/1.0/bpmn"'


def properties(**named: str) -> str:
    said = "".join(f'<camunda:property name="{name}" value="{value}"/>' for name, value in named.items())
    return f"<extensionElements><camunda:properties {CAMUNDA}>{said}</camunda:properties></extensionElements>"


def mission(content: str, *flows: tuple[str, str], more: str = "") -> str:
    return definitions(POOL, more, process("p", content, *flows))


def driving(**named: str) -> str:
    return calling(action="drive", type=DRIVE, payload="{distance: 3}", **named)


def calling(name: str = "", **named: str) -> str:
    task = f'<serviceTask id="t" name="{name}">{properties(**named)}</serviceTask>'
    return mission(
        f'<startEvent id="s"/>{task}<userTask id="u"/><endEvent id="l"/>'
        '<boundaryEvent id="b" attachedToRef="t"><errorEventDefinition errorRef="E"/></boundaryEvent>',
        ("s", "t"),
        ("t", "u"),
        ("b", "l"),
        more='<error id="E" errorCode="lost"/>',
    )


class Driver:
    """The action ``drive`` of a node: `step` moves all goals by a metre. It says what goals it does not know."""

    def __init__(self, node: Node) -> None:
        self.goals: dict[bytes, list[float]] = {}  # id -> wanted, driven
        self.accepted: list[bytes] = []
        self.ended: dict[bytes, Any] = {}
        self.asked: dict[bytes, list[DeferredResponse]] = {}
        node.service("drive/_action/send_goal", f"{DRIVE}_SendGoal", self._goal)
        node.service("drive/_action/get_result", f"{DRIVE}_GetResult", self._result)
        node.service("drive/_action/cancel_goal", "action_msgs/srv/CancelGoal", lambda request: {})

    def step(self) -> None:
        for id, goal in list(self.goals.items()):
            goal[1] += 1
            if goal[1] >= goal[0]:
                del self.goals[id]
                self.ended[id] = {"status": 4, "result": {"driven": goal[1]}}
                for response in self.asked.get(id, ()):
                    response.respond(self.ended[id])

    def _goal(self, request: Any) -> Any:
        id = bytes(request.goal_id.uuid)
        self.accepted.append(id)
        self.goals[id] = [request.goal.distance, 0.0]
        return {"accepted": True}

    def _result(self, request: Any) -> Any:
        id = bytes(request.goal_id.uuid)
        if id in self.ended:
            return self.ended[id]
        if id not in self.goals:
            return {"status": 0}
        self.asked.setdefault(id, []).append(DeferredResponse())
        return self.asked[id][-1]


@pytest.fixture
def field(tmp_path: Path) -> Iterator[Durable]:
    made = Durable(tmp_path / "state")
    made.driver = Driver(made.middleware.node("driver", "A"))  # type: ignore[attr-defined]
    yield made
    for engine in made.engines.values():
        engine.close()


def again(field: Durable) -> None:
    field.crash()
    field.start()
    field.pass_time(1)


def test_a_goal_that_the_server_still_has_is_taken_up_again(field: Any) -> None:
    field.deploy(driving())
    field.driver.step()
    again(field)
    assert len(field.driver.accepted) == 1
    field.driver.step()
    field.driver.step()
    field.pass_time(1)
    assert field.engine.running.instances[0].waiting == ["u"]
    assert field.variables("A")["drive"].driven == 3


def test_what_waits_for_a_goal_names_its_action(field: Any) -> None:
    field.deploy(driving())
    node = field.engine.running
    (wait,) = node.instances[0].waits()
    assert node.waiting.details(wait)["action"] == "/A/drive"


def test_a_goal_that_ended_meanwhile_gives_its_result(field: Any) -> None:
    field.deploy(driving())
    field.crash()
    for _ in range(3):
        field.driver.step()
    field.start()
    field.pass_time(1)
    assert (len(field.driver.accepted), field.variables("A")["drive"].driven) == (1, 3)


def test_a_goal_that_nobody_knows_any_more_is_sent_again_by_default(field: Any) -> None:
    field.deploy(driving())
    field.driver.goals.clear()
    again(field)
    assert len(field.driver.accepted) == 2
    assert len(set(field.driver.accepted)) == 2
    assert field.engine.running.instances[0].waiting == ["t"]


def test_with_never_it_fails_as_lost(field: Any) -> None:
    field.deploy(driving(retry="never"))
    field.driver.goals.clear()
    again(field)
    assert len(field.driver.accepted) == 1
    assert field.engine.running.instances[-1].visits["l"] == 1


def test_with_ask_it_is_an_incident_that_somebody_retries(field: Any) -> None:
    field.options["hold_errors"] = True
    field.engines.pop("A").close()
    field.state.close()
    field.start()
    field.deploy(driving(retry="ask"))
    field.driver.goals.clear()
    again(field)
    field.pass_time(1)
    assert [id for id, code, text in field.engine.running.incidents if code == "lost"] == ["t"]
    field.engine.running.retry("t")
    field.pass_time(1)
    assert len(field.driver.accepted) == 2


def pressing(retry: str, name: str = "") -> str:
    return calling(name, service="press", type="std_srvs/srv/Trigger", retry=retry)


def suspended(field: Any) -> None:
    field.engine.running.suspension.suspend("ann")
    field.pass_time(1)


def continued(field: Any) -> None:
    suspended(field)
    field.engine.running.suspension.go_on("ann")


def continued_after_a_crash(field: Any) -> None:
    suspended(field)
    again(field)
    field.engine.running.suspension.go_on("ann")


def migrated(field: Any) -> None:
    retry = field.engine.running.mission.retries().get("t", "safe")
    field.deploy(pressing(retry, "Press"), "d2", 2, migrate=True)
    assert field.engine.deployed == "d2"


@pytest.mark.parametrize("interrupt", [continued, continued_after_a_crash, migrated])
@pytest.mark.parametrize("retry", ["safe", "never"])
def test_a_call_that_was_not_answered_before_a_suspension_follows_retry(field: Any, retry: str, interrupt: Any) -> None:
    asked: list[DeferredResponse] = []

    def press(request: Any) -> DeferredResponse:
        asked.append(DeferredResponse())
        return asked[-1]

    field.middleware.node("button", "A").service("press", "std_srvs/srv/Trigger", press)
    field.deploy(pressing(retry))
    assert len(asked) == 1
    interrupt(field)
    field.pass_time(2)
    assert len(asked) == (2 if retry == "safe" else 1)
    assert field.engine.running.instances[-1].visits.get("l", 0) == (0 if retry == "safe" else 1)
    fate = "call('press'): its task was suspended before it was answered, and its fate is unknown; retry: never"
    assert (fate in field.notes) == (retry == "never")


@pytest.mark.parametrize("interrupt", ["continued", "migrated"])
@pytest.mark.parametrize(("obeys", "goals"), [(True, 2), (False, 1)])
def test_a_goal_that_was_not_cancelled_in_time_is_lost_with_never(
    field: Any, obeys: bool, goals: int, interrupt: str
) -> None:
    """The server has ended it before it is asked to cancel it: what it has done is not done again."""
    begun: list[ServerGoal] = []

    def cancel(goal: ServerGoal) -> None:
        goal.end("canceled" if obeys else "succeeded", {})

    ActionServer(field.middleware.node("mower", "A"), "mow", DRIVE, begun.append, cancel)
    field.deploy(calling(action="mow", type=DRIVE, payload="{distance: 3}", retry="never"))
    assert len(begun) == 1
    if interrupt == "continued":
        continued(field)
    else:
        field.deploy(
            calling("Mow", action="mow", type=DRIVE, payload="{distance: 3}", retry="never"), "d2", 2, migrate=True
        )
    field.pass_time(2)
    assert len(begun) == goals
    assert field.engine.running.instances[-1].visits.get("l", 0) == (0 if obeys else 1)


def test_a_second_crash_finds_the_same_goal(field: Any) -> None:
    field.deploy(driving())
    again(field)
    again(field)
    assert len(field.driver.accepted) == 1
    for _ in range(3):
        field.driver.step()
    field.pass_time(1)
    assert field.variables("A")["drive"].driven == 3


def test_a_script_that_starts_again_finds_the_results_of_its_goals(field: Any) -> None:
    drive = f"await robot.act('drive', '{DRIVE}', distance="
    text = f"one = {drive}1.0)\ntwo = {drive}2.0)"
    sent = field.deploy(
        mission(
            f'<startEvent id="s"/><scriptTask id="t"><script>{text}</script></scriptTask><userTask id="u"/>',
            ("s", "t"),
            ("t", "u"),
        )
    )
    assert sent.robots["A"].state == "started", str(sent.robots["A"])
    field.driver.step()
    field.pass_time(1)
    assert len(field.driver.accepted) == 2
    again(field)
    assert len(field.driver.accepted) == 2
    field.driver.goals.clear()
    for _ in range(2):  # the second, which nobody knows any more, is sent again, once
        again(field)
        assert len(field.driver.accepted) == 3
    field.driver.step()
    field.driver.step()
    field.pass_time(1)
    assert field.engine.running.instances[0].waiting == ["u"]


# ---- timers ----------------------------------------------------------------------------------------------------------


def waiting_for(duration: str, kind: str = "Duration", **named: str) -> str:
    return mission(
        '<startEvent id="s"/><userTask id="u"/>'
        f'<boundaryEvent id="b" attachedToRef="u" cancelActivity="false">{properties(**named) if named else ""}'
        f"<timerEventDefinition><time{kind}>{duration}</time{kind}></timerEventDefinition></boundaryEvent>"
        '<scriptTask id="k"><script>n = globals().get("n", 0) + 1</script></scriptTask>',
        ("s", "u"),
        ("b", "k"),
    )


def visits(field: Durable, element: str) -> int:
    return field.engine.running.instances[0].visits[element]


def away(field: Durable, seconds: float) -> None:
    field.crash()
    field.pass_time(seconds)
    field.start()
    field.pass_time(1)


def test_a_timer_keeps_its_time(field: Durable) -> None:
    field.deploy(waiting_for("PT40S"))  # which takes 12 s
    away(field, 10)
    assert visits(field, "k") == 0
    field.pass_time(20)
    assert visits(field, "k") == 1


@pytest.mark.parametrize(("missed", "times"), [("fire", 1), ("skip", 0)])
def test_a_timer_that_came_due_meanwhile_fires_at_once_or_counts_again(field: Durable, missed: str, times: int) -> None:
    field.deploy(waiting_for("PT20S", missed=missed))
    away(field, 60)
    assert visits(field, "k") == times
    assert any("came due while the engine was away" in note for note in field.notes)
    field.pass_time(20)
    assert visits(field, "k") == 1


def test_the_times_that_a_cycle_has_missed_count_as_one_and_it_goes_on_in_step(field: Durable) -> None:
    field.deploy(waiting_for("R/PT10S", "Cycle"))
    before = visits(field, "k")
    away(field, 60)
    assert visits(field, "k") == before + 1
    field.pass_time(30)
    assert visits(field, "k") == before + 4


def test_a_timer_that_is_to_fail_fails_as_missed(field: Durable) -> None:
    said = properties(missed="fail")
    field.deploy(
        mission(
            f'<startEvent id="s"/><intermediateCatchEvent id="c">{said}<timerEventDefinition><timeDuration>PT20S'
            '</timeDuration></timerEventDefinition></intermediateCatchEvent><endEvent id="e"/>',
            ("s", "c"),
            ("c", "e"),
        )
    )
    away(field, 60)
    error = field.engine.running.instances[-1].error
    assert error is not None
    assert (error.code, error.element) == ("missed", "c")
