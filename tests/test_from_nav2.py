"""docs/from_nav2.md: the patrol as a diagram does what its script and its state machine say."""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from fame.bpmn import read
from fame.bpmn.draw.diagram import draw
from fame.cli import main
from fame.scenario import Scenario

DOCS = Path(__file__).parent.parent / "docs"
PAGE = (DOCS / "from_nav2.md").read_text(encoding="utf-8")
CLOSED = (4.0, 3.0)
"""The place that Nav2 finds no way to."""


class Pose:
    def __init__(self) -> None:
        self.header = SimpleNamespace()
        self.pose = SimpleNamespace(position=SimpleNamespace(), orientation=SimpleNamespace())


def is_closed(pose: Pose) -> bool:
    return (pose.pose.position.x, pose.pose.position.y) == CLOSED


class Navigator:
    """What the script uses of Nav2's BasicNavigator: a rejected goal leaves the result of the one before."""

    def __init__(self, node_name: str = "basic_navigator", namespace: str = "") -> None:
        self.result: str | None = None

    def goToPose(self, pose: Pose) -> bool:
        if not is_closed(pose):
            self.result = "succeeded"
        return not is_closed(pose)

    def isTaskComplete(self) -> bool:
        return True

    def getResult(self) -> str | None:
        return self.result


class CbState:
    def __init__(self, outcomes: list[str], callback: Any) -> None:
        self.outcomes, self.callback = outcomes, callback

    def __call__(self, blackboard: dict) -> str:
        return self.callback(blackboard)


class ActionState:
    outcomes = ("succeeded", "aborted", "canceled")

    def __init__(self, action_type: object, action_name: str, create_goal_handler: Any) -> None:
        self.goal_of = create_goal_handler

    def __call__(self, blackboard: dict) -> str:
        return "aborted" if is_closed(self.goal_of(blackboard).pose) else "succeeded"


class StateMachine:
    def __init__(self, outcomes: list[str]) -> None:
        self.outcomes, self.states = outcomes, {}

    def add_state(self, name: str, state: Any, transitions: dict[str, str]) -> None:
        assert {*state.outcomes} == transitions.keys()
        self.states[name] = state, transitions

    def __call__(self, blackboard: dict | None = None) -> str:
        blackboard = {} if blackboard is None else blackboard
        at = next(iter(self.states))
        while at not in self.outcomes:
            state, transitions = self.states[at]
            at = transitions[state(blackboard)]
        return at


STAND_INS = {
    "rclpy": {"init": lambda: None},
    "geometry_msgs.msg": {"PoseStamped": Pose},
    "nav2_simple_commander.robot_navigator": {
        "BasicNavigator": Navigator,
        "TaskResult": SimpleNamespace(SUCCEEDED="succeeded"),
    },
    "nav2_msgs.action": {"NavigateToPose": SimpleNamespace(Goal=SimpleNamespace)},
    "yasmin": {"CbState": CbState, "StateMachine": StateMachine},
    "yasmin_ros": {"ActionState": ActionState},
    "yasmin_ros.basic_outcomes": {"ABORT": "aborted", "CANCEL": "canceled", "SUCCEED": "succeeded"},
}
"""What the programs import, with the names of the public sources."""


def test_both_programs_report_the_place_without_a_way(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for module in STAND_INS:
        for name in (module.partition(".")[0], module):
            monkeypatch.setitem(sys.modules, name, SimpleNamespace(**STAND_INS.get(name, {}), **{"__path__": []}))
    variables: dict[str, Any] = {}
    for program in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL):
        exec(compile(program, "from_nav2.md", "exec"), variables)
        assert capsys.readouterr().out.splitlines() == ["REX no way to 4.0 3.0", "DINGO no way to 4.0 3.0"]


def test_the_patrol_of_the_page_passes_its_places_and_reports_the_one_without_a_way() -> None:
    lines: list[tuple[str, str]] = []
    scenario = Scenario.load(DOCS / "from_nav2.yaml")
    result = scenario.run(
        observer=lambda event: lines.append((event.robot, event.detail)) if event.what == "log" else None
    )
    assert result.status == "completed"
    assert lines == [("REX", "no way to 4 3"), ("DINGO", "no way to 4 3")]


def test_the_three_patrols_have_the_same_places() -> None:
    (written,) = re.findall(r"ROUNDS = (.*)", PAGE)
    processes = read(DOCS / "from_nav2.bpmn").processes
    plans = [node.script.text for one in processes for node in one.body.nodes if node.label == "Plan Round"]
    drawn = [ast.literal_eval(plan.partition("=")[2].strip()) for plan in plans]
    assert drawn == [[list(place) for place in places] for places in ast.literal_eval(written).values()]


def test_the_picture_of_the_page_is_that_of_the_model() -> None:
    assert (DOCS / "images" / "from_nav2.svg").read_text(encoding="utf-8") == draw(read(DOCS / "from_nav2.bpmn"))


def test_no_order_of_messages_leaves_a_robot_waiting(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "--explore", str(DOCS / "from_nav2.bpmn")]) == 0
    assert "all states explored" in capsys.readouterr().out
