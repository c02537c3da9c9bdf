"""The reassembly: what the joint monitor makes of free and obstructed runs, and the mission that it stops."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from examples import reassembly_table
from fame.errors import ConfigError
from fame.monitor.pipeline import processors
from fame.monitor.pipeline.filters import LowPass
from fame.monitor.pipeline.processor import Samples, stacked
from fame.monitor.pipeline.threshold import Threshold
from fame.monitor.pipeline.train import losses
from fame.monitor.pipeline.trained_model import TrainedModel
from fame.scenario import Fault, Result, Scenario
from robots.arm.machine import ControlledArm, JointState
from robots.arm.reassembly import recorded

EXAMPLE = Path(__file__).parent.parent / "examples" / "reassembly.yaml"
SEEDS = range(8001, 8005)


@cache
def largest(scenario: Any) -> np.ndarray:
    """The largest losses of each joint, on average over some runs; each over its threshold."""
    model = TrainedModel.load(reassembly_table.MODEL, columns=reassembly_table.COLUMNS)
    return reassembly_table.judged(model, scenario, SEEDS).largest


def thresholds() -> np.ndarray:
    return np.array(TrainedModel.load(reassembly_table.MODEL).thresholds)


@pytest.mark.long
def test_a_blocked_shoulder_shows_at_joint_0_and_not_at_4_and_5():
    times = largest("blocked_shoulder").mean(axis=0) / largest("none").mean(axis=0)
    assert times[0] > 1.9
    assert times[4:] == pytest.approx(1, abs=0.15)


@pytest.mark.long
def test_a_blocked_lid_shows_at_joints_4_and_5_and_not_at_0():
    times = largest("blocked_lid").mean(axis=0) / largest("none").mean(axis=0)
    assert times[4:].min() > 4
    assert times[0] == pytest.approx(1, abs=0.1)


@pytest.mark.long
def test_thresholds_per_joint_find_every_obstruction_and_nothing_else():
    assert (largest("none") <= thresholds()).all()
    assert (largest("blocked_shoulder") > thresholds()).any(axis=1).all()
    assert (largest("blocked_lid") > thresholds()).any(axis=1).all()


# ---- the mission -----------------------------------------------------------------------------------------------------


def mission(*faults: Fault, seed: int = 1) -> Result:
    return Scenario.load(EXAMPLE, faults=faults, seed=seed).run()


@pytest.mark.long
@pytest.mark.parametrize(("seed", "fault"), [(4, None), (9, None), (5, Fault("Arm", 6.5, "blocked_shoulder"))])
def test_live_is_recorded_sample_by_sample(seed: int, fault: Fault | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """The mission with its monitor, and the run computed without them: joint states, and the losses of the monitor."""
    states: list[JointState] = []
    found: list[Samples] = []
    monkeypatch.setattr(ControlledArm, "step", kept(ControlledArm.step, states))
    monkeypatch.setattr(Threshold, "execute", kept(Threshold.execute, found, stacked))
    result = mission(*filter(None, [fault]), seed=seed)
    monkeypatch.undo()
    run = recorded(seed, fault.kind if fault else "none", at=fault.time if fault else None)  # type: ignore[arg-type]
    count = len(states) - 1 if fault else len(states)  # the arm is stopped at the last one
    if fault is None:  # the lid comes back to the motor
        arm = result.world["robots"]["Arm"]  # type: ignore[index]
        assert (result.status, lines(result), arm["lid"], arm["gripper"]) == ("completed", [], "motor", "open")
        assert [each.verdict for each in result.judgements] == ["holds"] * 3
        assert abs(count - len(run.stamps)) <= 1
    count = min(count, len(run.stamps))  # the last cycle may be that of the end
    assert np.array_equal([state.efforts for state in states[:count]], run.efforts[:count])
    assert np.array_equal([state.positions for state in states[:count]], run.positions[:count])

    model = TrainedModel.load(reassembly_table.MODEL)
    efforts = processors.run([LowPass(cutoff=model.before)], {"x": Samples(run.efforts, run.stamps)})["x"]
    expected = losses(model, efforts, stride=5).values
    live = np.concatenate([samples.channels() for samples in found])
    assert len(live) > count / 5 - 50  # the last call of each of the four nodes is up to 20 ms ago
    assert np.allclose(live, expected[: len(live)], rtol=1e-9, atol=0)


def kept(function: Any, into: list[Any], what: Any = None) -> Any:
    """The function, which keeps its result, or `what` of its arguments, too."""

    def call(*arguments: Any) -> Any:
        result = function(*arguments)
        into.append(what(*arguments[1:]) if what else result)
        return result

    return call


def lines(result: Result) -> list[str]:
    return [event.detail for event in result.reports if event.robot == "Arm"]


@pytest.mark.long
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
