"""What an engine publishes for RViz on /mission_markers: the robot's state, its goals and zones."""

from __future__ import annotations

from typing import Any

import pytest
from bpmn_text import document, properties
from deployment_field import Field

from fame.cli import main
from fame.fleet.markers import ARROW, LINE_STRIP, TEXT, TYPE
from fame.middleware.actions import ActionServer

NAVIGATE = {name: f"nav2_msgs/action/Navigate{name}" for name in ("ToPose", "ThroughPoses")}
POSE = "{pose: {header: {frame_id: site}, pose: {position: {x: ${x}, y: 2}}}}"
FIELD = """corners = [{'x': 0.0}, {'x': 4.0}, {'x': 4.0, 'y': 3.0}]
field = {'header': {'frame_id': 'map'}, 'polygon': {'points': corners}}
odd, x = {'header': 1, 'polygon': {'points': [{'x': 'far'}]}}, 5"""


def mission(payload: str = POSE, name: str = "ToPose") -> str:
    goal = properties(action=name, type=NAVIGATE[name], payload=payload)
    nodes = f"""<startEvent id="s"/><scriptTask id="k"><script>{FIELD}</script></scriptTask>
<serviceTask id="go" name="Go to the field">{goal}</serviceTask><userTask id="ask" name="Ask Ann"/>
<sequenceFlow id="f1" sourceRef="s" targetRef="k"/><sequenceFlow id="f2" sourceRef="k" targetRef="go"/>
<sequenceFlow id="f3" sourceRef="go" targetRef="ask"/>"""
    return document(f'<process id="p" isExecutable="true">{nodes}</process>')


class Robot(Field):
    """An engine that publishes markers, its Nav2, and what RViz gets."""

    def __init__(self) -> None:
        super().__init__("REX", markers="REX/base_link")
        self.heard: list[Any] = []
        self.goals: list[Any] = []
        self.person.subscription("/mission_markers", TYPE, self.heard.append)
        node = self.middleware.node("nav2", "REX")
        for name, type in NAVIGATE.items():
            ActionServer(node, name, type, self.goals.append, lambda goal: True)

    def markers(self, kind: str) -> list[Any]:
        """Those of a kind, in the last message after two seconds."""
        self.pass_time(2)
        return [one for one in self.heard[-1].markers if one.ns == f"REX/{kind}"]


@pytest.fixture
def robot() -> Robot:
    return Robot()


def test_a_robot_without_a_mission_shows_that_it_waits(robot: Robot) -> None:
    (state,) = robot.markers("state")
    assert (state.type, state.text, state.header.frame_id) == (TEXT, "REX: waiting", "REX/base_link")
    assert (len(robot.heard), state.lifetime.sec, state.frame_locked) == (2, 3, True)


def test_a_goal_is_an_arrow_until_it_has_ended(robot: Robot) -> None:
    robot.send("REX", mission())
    arrow, text = robot.markers("goals")
    assert (arrow.type, arrow.header.frame_id, text.text) == (ARROW, "site", 'REX: "Go to the field" (go)')
    assert [(one.pose.position.x, one.pose.position.y, one.pose.orientation.w) for one in (arrow, text)] == [
        (5, 2, 1)
    ] * 2
    robot.goals[0].end("succeeded", {})
    assert robot.markers("goals") == []
    (state,) = robot.markers("state")
    assert state.text.splitlines() == ["REX: running", '"Ask Ann" (ask)']


def test_a_suspended_goal_is_none_and_the_state_says_who_suspended_it(robot: Robot) -> None:
    robot.send("REX", mission())
    (state,) = robot.markers("state")
    robot.engines["REX"].running.suspension.suspend("ann")
    assert robot.markers("goals") == []
    (held,) = robot.markers("state")
    assert held.text.startswith("REX: suspended by ann")
    assert (held.color.r > held.color.g, state.color.g > state.color.r) == (True, True)


def test_a_goal_through_poses_has_an_arrow_for_each(robot: Robot) -> None:
    poses = f"{{poses: [{POSE[7:-1]}, {POSE[7:-1]}]}}"
    robot.send("REX", mission(poses, "ThroughPoses"))
    assert [one.type for one in robot.markers("goals")] == [ARROW, TEXT] * 2


def test_a_polygon_of_a_variable_is_a_zone_and_what_only_looks_like_one_is_left_out(robot: Robot) -> None:
    robot.send("REX", mission())
    line, text = robot.markers("zones")
    assert (line.type, line.header.frame_id, text.text) == (LINE_STRIP, "map", "field")
    assert [(point.x, point.y) for point in line.points] == [(0, 0), (4, 0), (4, 3), (0, 0)]
    ids = [one.id for one in robot.heard[-1].markers]
    assert len(ids) == len(set(ids))


@pytest.mark.parametrize("frame", ["", "a b", "/REX/base_link", "ü", "<b>"])
def test_what_tf2_takes_for_no_frame_is_refused(frame: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["engine", "REX", "--markers", frame]) == 2
    assert "expected a frame such as NAME/base_link, got" in capsys.readouterr().err


def test_robots_of_one_command_have_frames_of_their_own(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["engine", "REX", "DINGO", "--markers", "REX/base_link"]) == 2
    assert "--markers of several robots needs NAME, as in NAME/base_link" in capsys.readouterr().err
