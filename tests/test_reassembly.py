"""The reassembly: what the joint monitor makes of free and obstructed runs, and the mission that it stops."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from examples import reassembly_table
from fame.errors import ConfigError
from fame.monitor.pipeline.trained_model import TrainedModel
from fame.scenario import Fault, Result, Scenario

EXAMPLE = Path(__file__).parent.parent / "examples" / "reassembly.yaml"
SEEDS = range(8001, 8005)


@cache
def largest(scenario: Any) -> np.ndarray:
    """The largest losses of each joint, on average over some runs; each over its threshold."""
    model = TrainedModel.load(reassembly_table.MODEL, columns=reassembly_table.COLUMNS)
    return reassembly_table.judged(model, scenario, SEEDS).largest


def thresholds() -> np.ndarray:
    return np.array(TrainedModel.load(reassembly_table.MODEL).thresholds)


def test_a_blocked_shoulder_shows_at_joint_0_and_not_at_4_and_5():
    times = largest("blocked_shoulder").mean(axis=0) / largest("none").mean(axis=0)
    assert times[0] > 1.9
    assert times[4:] == pytest.approx(1, abs=0.15)


def test_a_blocked_lid_shows_at_joints_4_and_5_and_not_at_0():
    times = largest("blocked_lid").mean(axis=0) / largest("none").mean(axis=0)
    assert times[4:].min() > 4
    assert times[0] == pytest.approx(1, abs=0.1)


def test_thresholds_per_joint_find_every_obstruction_and_nothing_else():
    assert (largest("none") <= thresholds()).all()
    assert (largest("blocked_shoulder") > thresholds()).any(axis=1).all()
    assert (largest("blocked_lid") > thresholds()).any(axis=1).all()


def mission(*faults: Fault) -> Result:
    return Scenario.load(EXAMPLE, faults=faults).run()


def lines(result: Result) -> list[str]:
    return [event.detail for event in result.reports if event.robot == "Arm"]


def test_undisturbed_the_lid_comes_back_to_the_motor():
    result = mission()
    assert (result.status, lines(result)) == ("completed", [])
    assert result.world is not None
    arm = result.world["robots"]["Arm"]
    assert (arm["lid"], arm["gripper"]) == ("motor", "open")


@pytest.mark.parametrize(
    ("fault", "joints", "before"),
    [
        (Fault("Arm", 6.5, "blocked_shoulder"), ("shoulder_pan",), 9.0),
        (Fault("Arm", 1.0, "blocked_lid"), ("wrist", "elbow", "shoulder_lift"), 7.0),
    ],
)
def test_an_anomaly_stops_the_arm_through_the_event_sub_process(
    fault: Fault, joints: tuple[str, ...], before: float
) -> None:
    result = mission(fault)
    assert result.status == "completed"
    stopped = next(text for text in lines(result) if text.startswith("stopped"))
    assert any(joint in stopped for joint in joints)
    assert result.simulated < before


def test_a_fault_that_the_arm_does_not_have_is_refused_with_those_it_has():
    with pytest.raises(ConfigError, match="blocked_shoulder, blocked_lid, encoders"):
        mission(Fault("Arm", 1.0, "wheels"))
