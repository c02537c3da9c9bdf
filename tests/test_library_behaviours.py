"""The behaviours of the library end, by arriving or by their documented errors, also when sensors are noisy."""

import math
from pathlib import Path
from typing import Any

import pytest
import yaml
from recorded_runs import record

from fame.log import Recording
from fame.scenario import Fault, Result, Scenario

MODEL = """<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" id="d" targetNamespace="t">
  <collaboration id="c"><participant id="p" name="REX" processRef="r"/></collaboration>
  <process id="r" isExecutable="true">
    <startEvent id="s"/>
    <scriptTask id="i"><script>{inputs}</script></scriptTask>
    <callActivity id="a" calledElement="{behaviour}"/>
    <endEvent id="e"/>
    <sequenceFlow id="f" sourceRef="s" targetRef="i"/>
    <sequenceFlow id="g" sourceRef="i" targetRef="a"/>
    <sequenceFlow id="h" sourceRef="a" targetRef="e"/>
  </process>
</definitions>"""


def played(
    folder: Path, behaviour: str, inputs: str, rex: dict[str, Any], *faults: Fault, **world: Any
) -> tuple[Result, list[str]]:
    """How one behaviour goes for REX on a ground of 6 x 4 m, and the codes of its errors."""
    (folder / "m.bpmn").write_text(MODEL.format(behaviour=behaviour, inputs=inputs))
    said = {"model": "m.bpmn", "world": {"size": [6, 4], **world, "robots": {"REX": {"at": [1, 2], **rex}}}}
    (folder / "s.yaml").write_text(yaml.safe_dump(said))
    result = Scenario.load(folder / "s.yaml", duration=120, seed=1, faults=faults).run()
    return result, [str(error.code) for error in result.robots[0].errors]


@pytest.mark.parametrize("noise", [0.0, 0.005, 0.03])
@pytest.mark.parametrize(("behaviour", "inputs"), [("GoTo", "x_goal, y_goal = 5, 2"), ("Turn", "angle = 20.0")])
def test_blocked_wheels_are_noticed_however_noisy_the_odometry_is(
    tmp_path: Path, behaviour: str, inputs: str, noise: float
) -> None:
    rex = {"type": "car", "odom": {"speed_noise": noise}}
    assert played(tmp_path, behaviour, inputs, rex, Fault("REX", 2.0, "wheels"))[1] == ["blocked"]


@pytest.mark.long
@pytest.mark.parametrize("distance", [0.55, 0.6, 0.65])
def test_a_thing_just_before_a_corner_of_the_way_is_passed_in_the_end(tmp_path: Path, distance: float) -> None:
    """It is nearer than a robot drives up to, and not so near that it is in the way: there GoTo crept forever."""
    things = {
        "obstacles": [{"name": "wall", "at": [3, 1.2], "size": [0.2, 2.4]}],
        "targets": [{"name": "box", "at": [2.55 + distance, 2.85], "radius": 0.2}],
    }
    result, errors = played(tmp_path, "GoTo", "x_goal, y_goal = 5, 1", {"type": "car"}, **things)
    assert (result.status, errors) in (("completed", []), ("failed", ["blocked"]))


@pytest.mark.parametrize(
    ("goal", "why"),
    [
        ("40, 2", "x=40 y=2: outside the map (x -0.05 to 6.05 m, y -0.05 to 4.05 m)"),
        ("3, 2", "x=3 y=2: too close to an obstacle"),
        ("5, 2", "x=5 y=2: obstacles are all around"),
    ],
)
def test_the_error_names_the_goal_and_why_there_is_no_way(tmp_path: Path, goal: str, why: str) -> None:
    walls = [{"name": "block", "at": [3, 2], "size": [2, 2]}]
    walls += [{"name": "wall", "at": [4.5, 2], "size": [0.2, 4]}] if goal == "5, 2" else []
    result, _ = played(tmp_path, "GoTo", f"x_goal, y_goal = {goal}", {"type": "car"}, obstacles=walls)
    (error,) = result.robots[0].errors
    assert f"error unreachable was not caught: no way to {why}" in error.text
    assert any(f"no way to {why}" in line for line in result.messages)


def test_a_recording_has_the_goal_and_the_reason_too(tmp_path: Path) -> None:
    (tmp_path / "m.bpmn").write_text(MODEL.format(behaviour="GoTo", inputs="x_goal, y_goal = 40, 2"))
    said = {"model": "m.bpmn", "world": {"size": [6, 4], "robots": {"REX": {"at": [1, 2], "type": "car"}}}}
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(said))
    with Recording(record(Scenario.load(tmp_path / "s.yaml", duration=20), tmp_path / "run.mcap")) as recording:
        reports = [event.detail for event in recording.events() if event.what == "report"]
    assert len(reports) == 1
    assert "no way to x=40 y=2: outside the map" in reports[0]


def test_a_low_take_off_ends_too(tmp_path: Path) -> None:
    sure = {"position_noise": 0, "heading_noise": 0, "speed_noise": 0}
    result, _ = played(tmp_path, "TakeOff", "pass", {"type": "drone", "height": 0.5, "odom": sure})
    assert result.status == "completed"


def test_a_take_off_ends_at_its_height(tmp_path: Path) -> None:
    result, _ = played(tmp_path, "TakeOff", "await sleep(3)", {"type": "drone"})
    assert result.world is not None
    assert math.isclose(result.world["robots"]["REX"]["altitude"], 1.5, abs_tol=0.1)
