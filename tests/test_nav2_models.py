"""The call activities of `models/nav2` drive a simulated robot with Nav2: goals, feedback, errors, interruption."""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml
from bpmn_text import process

from fame.middleware import typesystem
from fame.middleware.actions import ActionClient
from fame.robot import Event
from fame.scenario import Result, Scenario

MODELS = Path(__file__).parents[1] / "models"
WORLD = """
model: m.bpmn
duration: 120
world:
  size: [6, 4]
  resolution: 0.1
  obstacles: [{name: rock, at: [3, 1], radius: 0.5}]
  chargers: [{name: dock_1, at: [0.6, 3.4], heading: 180}]
  robots:
    REX: {type: tractor, at: [1, 2], navigation: nav2, planner: {tolerance: 0.1}, battery: {charge: 0.5}}
"""


def data(**values: Any) -> str:
    """A data object with these properties, and its association with an activity."""
    rows = "".join(f'<camunda:property name="{name}" value="{value}"/>' for name, value in values.items())
    return (
        '<dataObjectReference id="D" dataObjectRef="O"><extensionElements><camunda:properties>'
        f'{rows}</camunda:properties></extensionElements></dataObjectReference><dataObject id="O"/>'
    )


def call(called: str, more: str = "") -> str:
    """An activity ``a`` that calls a behaviour with the data object."""
    given = '<property id="P"/><dataInputAssociation id="I"><sourceRef>D</sourceRef><targetRef>P</targetRef>'
    return (
        f'<callActivity id="a" name="Go" calledElement="{called}">{given}</dataInputAssociation></callActivity>{more}'
    )


def mission(tmp_path: Path, content: str, root: str = "", observer: Any = None) -> Result:
    start = '<startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="a"/>'
    text = process(start + content, root=f'<error id="E" errorCode="nav2.goal_occupied"/>{root}')
    (tmp_path / "m.bpmn").write_text(text.replace("<process ", '<process name="REX" ', 1))
    (tmp_path / "s.yaml").write_text(WORLD)
    return Scenario.load(tmp_path / "s.yaml").run(observer=observer)


def rex(result: Result) -> tuple[float, float]:
    assert result.world is not None
    robot = result.world["robots"]["REX"]
    return robot["x"], robot["y"]


def test_a_data_object_gives_the_goal_of_a_navigation(tmp_path: Path) -> None:
    end = '<endEvent id="e"/><sequenceFlow id="g" sourceRef="a" targetRef="e"/>'
    result = mission(tmp_path, call("NavigateToPose", end) + data(x_goal=5, y_goal=1, yaw_goal=1.57))
    assert (result.status, result.messages) == ("completed", [])
    assert rex(result) == pytest.approx((5, 1), abs=0.15)


@pytest.mark.parametrize(
    ("called", "values"),
    [
        ("NavigateThroughPoses", {"poses_goal": "${[[3, 3], [5, 1, 1.57]]}"}),
        ("FollowWaypoints", {"waypoints": "${[[3, 3], [5, 1]]}"}),
        ("DockRobot", {"dock": "dock_1"}),
        ("Spin", {"angle": 1.57}),
        ("BackUp", {"distance": 0.3}),
        ("Wait", {"seconds": 1.5}),
    ],
)
def test_every_action_of_nav2_can_be_called(called: str, values: dict[str, Any], tmp_path: Path) -> None:
    result = mission(
        tmp_path, call(called, '<endEvent id="e"/><sequenceFlow id="g" sourceRef="a" targetRef="e"/>') + data(**values)
    )
    assert (result.status, result.messages) == ("completed", [])


def test_an_error_code_of_nav2_is_a_bpmn_error_by_name(tmp_path: Path) -> None:
    boundary = '<boundaryEvent id="b" attachedToRef="a"><errorEventDefinition errorRef="E"/></boundaryEvent>'
    flow = '<endEvent id="occupied"/><sequenceFlow id="g" sourceRef="b" targetRef="occupied"/>'
    ended: list[str] = []

    def observe(event: Event) -> None:
        if event.what == "enter":
            ended.append(event.element)

    result = mission(tmp_path, call("NavigateToPose", boundary + flow) + data(x_goal=3, y_goal=1), observer=observe)
    assert (result.status, ended[-1]) == ("completed", "occupied")


def test_an_error_that_is_not_caught_says_what_nav2_said(tmp_path: Path) -> None:
    result = mission(tmp_path, call("NavigateToPose") + data(x_goal=3, y_goal=1))
    assert result.status == "failed"
    assert "nav2.goal_occupied" in result.messages[0]
    assert "error code 206, the goal is occupied" in result.messages[0]


def test_an_action_that_nobody_offers_is_unavailable(tmp_path: Path) -> None:
    text = call("UndockRobot") + data()
    assert "nav2.dock_not_valid" in mission(tmp_path, text).messages[0]


RESUMING = """
<subProcess id="a"><startEvent id="s1"/><sequenceFlow id="x" sourceRef="s1" targetRef="set"/>
<scriptTask id="set" scriptFormat="python">
<script>x_goal, y_goal, changed, distance_remaining = 5.0, 3.4, False, 99.0</script>
</scriptTask><sequenceFlow id="y" sourceRef="set" targetRef="go"/>
<callActivity id="go" calledElement="NavigateToPose"/>
<subProcess id="h" triggeredByEvent="true"><extensionElements><camunda:properties>
<camunda:property name="resume" value="true"/></camunda:properties></extensionElements>
<startEvent id="i"><conditionalEventDefinition>
<condition>distance_remaining &lt; 2 and not changed</condition>
</conditionalEventDefinition></startEvent><sequenceFlow id="z" sourceRef="i" targetRef="c"/>
<scriptTask id="c" scriptFormat="python"><script>changed, x_goal, y_goal = True, 1.0, 1.0</script></scriptTask>
</subProcess></subProcess>
"""


def test_an_interruption_cancels_the_goal_and_resume_sends_the_goal_as_it_is_then(tmp_path: Path) -> None:
    """Two metres before (5, 3.4) the navigation is suspended, and its goal is changed to (1, 1)."""
    result = mission(tmp_path, RESUMING)
    assert (result.status, result.messages) == ("completed", [])
    assert rex(result) == pytest.approx((1, 1), abs=0.15)


def passing(called: str, goal: str, condition: str) -> str:
    """A call that is suspended once, when `condition` holds, for 2 s, and resumed."""
    return f"""
<subProcess id="a"><startEvent id="s1"/><sequenceFlow id="x" sourceRef="s1" targetRef="set"/>
<scriptTask id="set" scriptFormat="python">
<script>{goal}; stopped, current_waypoint, number_of_poses_remaining = False, 0, 9</script>
</scriptTask><sequenceFlow id="y" sourceRef="set" targetRef="go"/>
<callActivity id="go" calledElement="{called}"/>
<subProcess id="h" triggeredByEvent="true"><extensionElements><camunda:properties>
<camunda:property name="resume" value="true"/></camunda:properties></extensionElements>
<startEvent id="i"><conditionalEventDefinition><condition>{condition} and not stopped</condition>
</conditionalEventDefinition></startEvent><sequenceFlow id="z" sourceRef="i" targetRef="c"/>
<scriptTask id="c" scriptFormat="python"><script>stopped = True
await sleep(2)</script></scriptTask>
</subProcess></subProcess>
"""


@pytest.mark.parametrize(
    ("called", "goal", "condition", "field"),
    [
        ("NavigateThroughPoses", "poses_goal = [[2, 3], [4, 3], [5, 1]]", "number_of_poses_remaining == 2", "poses"),
        ("FollowWaypoints", "waypoints = [[2, 3], [4, 3], [5, 1]]", "current_waypoint == 1", "goal_index"),
    ],
)
def test_resume_sends_a_new_goal_of_the_poses_that_are_not_passed_yet(
    called: str, goal: str, condition: str, field: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: list[Any] = []
    send = ActionClient.send

    def note(self: Any, goal: Any, *rest: Any, **named: Any) -> Any:
        sent.append(goal)
        return send(self, goal, *rest, **named)

    monkeypatch.setattr(ActionClient, "send", note)
    result = mission(tmp_path, passing(called, goal, condition))
    assert (result.status, result.messages) == ("completed", [])
    assert rex(result) == pytest.approx((5, 1), abs=0.15)
    first, second = (value(goal, field) for goal in sent)
    assert (len(first), len(second)) == (3, 2) if field == "poses" else (first, second) == (0, 1)


def value(goal: Any, field: str) -> Any:
    """A field of a goal that was sent: a mapping or a message."""
    return goal[field] if isinstance(goal, dict) else getattr(goal, field)


@pytest.mark.parametrize("file", sorted((MODELS / "nav2").glob("*.bpmn")), ids=lambda file: file.stem)
def test_every_error_code_of_jazzy_has_a_name(file: Path) -> None:
    """The codes are the constants of the action's result, in the definitions that come with FAME."""
    result = typesystem.definition(f"nav2_msgs/action/{file.stem}_Result")
    codes = {value for name, value in result.constants.items() if value}
    (errors,) = [
        element.get("value")
        for element in ElementTree.parse(file).iter("{http://camunda.org/schema/1.0/bpmn}property")
        if element.get("name") == "errors"
    ]
    named = yaml.safe_load(errors or "")
    assert codes <= named.keys()
    assert all(str(name).startswith("nav2.") for name in named.values())
