"""Collect and operate as nodes: joint states on topics, runs cut apart, the signal raised."""

import numpy as np
import pytest

pytest.importorskip("scipy")

from arm_data import needs_data, path_model, runs

from fame.clock import SECOND, Scheduler
from fame.errors import ConfigError, MissionError
from fame.middleware import messages
from fame.middleware.local import LocalMiddleware
from fame.monitor.anomaly.live import Collector, RunMonitor
from fame.monitor.anomaly.nodes import TYPE, ArmOptions, OperateNode, RunNode
from robots.arm.sabotage import alter, knots
from robots.arm.task import MH5

PERIOD = SECOND // 40


class Arm:
    """Publishes joint states, one every 25 ms."""

    def __init__(self) -> None:
        self.scheduler = Scheduler()
        self.middleware = LocalMiddleware(self.scheduler)
        self.node = self.middleware.node("arm")
        self.joints = self.node.publisher("/joint_states", TYPE)
        self.heard: list[object] = []
        self.middleware.node("listener").subscription("/anomaly", TYPE, self.heard.append)
        self.texts: list[str] = []

    def play(self, values: np.ndarray, names: tuple[str, ...] = MH5.joints) -> None:
        for row in values.tolist():
            stamp = {"sec": self.scheduler.now // SECOND, "nanosec": self.scheduler.now % SECOND}
            content = {"header": {"stamp": stamp}, "name": list(names), "position": row}
            self.joints.publish(messages.create(TYPE, content))
            self.scheduler.run(self.scheduler.now + PERIOD)

    def signal(self, topic: str) -> None:
        self.node.publisher(topic, "std_msgs/msg/Empty").publish(messages.create("std_msgs/msg/Empty"))
        self.scheduler.run(self.scheduler.now)

    def operate(self, **options) -> OperateNode:
        arm = ArmOptions(report=self.texts.append)
        return OperateNode(self.middleware, self.scheduler, RunMonitor(path_model(), **options), arm)


@pytest.mark.long
@needs_data
def test_benign_runs_pass_and_a_sabotaged_one_raises_the_signal_once():
    arm = Arm()
    operate = arm.operate()
    arm.play(np.vstack([runs(21), alter(runs(23), knots("b", 0.5)).values, runs(25)]))
    operate.close()
    assert [report.above for report in operate.runs] == [False, True, False]
    [signal] = arm.heard
    assert signal.header.frame_id == "mm"
    assert 0.05 < signal.position[0] < 1.2
    assert signal.name[0] in MH5.joints
    assert any("run 1: alarm at point" in text for text in arm.texts)
    assert any(text.startswith("run 1: ANOMALOUS, score") for text in arm.texts)


@pytest.mark.long
@needs_data
@pytest.mark.parametrize(("threshold", "verdict"), [(None, "ANOMALOUS"), (9.0, "not judged")])
def test_a_run_of_an_arm_that_freezes_ends_and_the_next_one_is_judged(threshold: float | None, verdict: str):
    arm = Arm()
    operate = arm.operate(threshold=threshold)
    frozen = np.repeat(runs(21)[200:201], 3 * 518, axis=0)
    arm.play(np.vstack([runs(21)[:200], frozen[:-200]]))
    assert operate.runs == []
    arm.play(frozen)
    [report] = operate.runs
    assert not report.judged
    assert len(arm.heard) == (threshold is None)  # the path detector knows that the arm is late
    said = next(text for text in arm.texts if text.startswith("run 0: ") and "alarm" not in text)
    assert said.startswith(f"run 0: {verdict}, score")
    assert "the arm did not come home within 3 times the longest run" in said
    assert arm.texts[-1] == "the arm is away from home; its runs are scored from its next rest at home on"
    arm.play(np.vstack([runs(21)[200:], runs(23, 25)]))
    operate.close()
    assert [(each.run, each.judged, each.above) for each in operate.runs[1:]] == [(1, True, False), (2, True, False)]


@needs_data
def test_runs_are_cut_live_as_they_are_cut_afterwards():
    arm = Arm()
    operate = arm.operate()
    arm.play(runs(21, 22))
    operate.close()
    assert [report.points for report in operate.runs] == [len(runs(number)) for number in (21, 22)]


@needs_data
def test_signals_delimit_runs_and_a_task_cut_off_is_said():
    arm = Arm()
    operate = arm.operate(rule="signal")
    arm.play(runs(21)[:50])
    arm.signal("/task_start")
    arm.play(runs(21)[:300])
    arm.signal("/task_end")
    arm.play(runs(21)[300:])
    operate.close()
    [report] = operate.runs
    assert (report.points, report.whole) == (300, False)
    assert arm.texts[-1].endswith("cut off before its end")


@needs_data
def test_a_message_of_too_few_joints_is_left_out_and_said_once():
    arm = Arm()
    operate = arm.operate()
    arm.play(runs(21)[:5, :5], MH5.joints[:5])
    operate.close()
    assert operate.runs == []
    assert [text for text in arm.texts if "without joint_t; the model has 6" in text] == arm.texts[:1]


@needs_data
def test_collecting_stops_after_the_runs_that_are_wanted():
    arm = Arm()
    counted: list[int] = []
    collector = Collector(-1, limit=2, progress=counted.append)
    RunNode(arm.middleware, arm.scheduler, collector)
    arm.play(runs(21, 23, 25))
    found = collector.recording()
    assert counted == [1, 2]
    assert (found.joints, found.run_labels()) == (MH5.joints, [-1, -1])
    assert np.allclose(found.values, runs(21, 23))
    assert found.stamps is not None
    assert np.diff(found.stamps) == pytest.approx(0.025)


def test_cycles_are_counted():
    arm = Arm()
    collector = Collector(1, "count", cycle=4, limit=2)
    RunNode(arm.middleware, arm.scheduler, collector)
    arm.play(np.ones((11, 6)))
    assert collector.recording().runs.tolist() == [0, 0, 0, 0, 1, 1, 1, 1]


@needs_data
def test_an_arm_under_way_is_recorded_from_home_on():
    arm = Arm()
    collector = Collector(1)
    RunNode(arm.middleware, arm.scheduler, collector, ArmOptions(report=arm.texts.append))
    arm.play(np.vstack([runs(21)[250:], runs(22, 23)]))
    assert [len(run) for run in collector.recording()] == [len(runs(22)), len(runs(23))]
    assert "the arm is moving" in arm.texts[0]


@needs_data
def test_a_run_that_was_cut_off_is_left_out_of_what_is_learned_from():
    arm = Arm()
    collector = Collector(1)
    RunNode(arm.middleware, arm.scheduler, collector)
    arm.play(np.vstack([runs(21, 22), runs(23)[:200]]))
    found = collector.recording()
    assert found.count == 2
    assert "run 2 is left out: cut off after" in found.notes[0]


@needs_data
def test_an_arm_that_never_comes_home_is_said():
    collector = Collector(1)
    for row in runs(21)[200:260].tolist():
        collector.step(0.0, row)
    with pytest.raises(MissionError, match="never passed home"):
        collector.recording()


def test_counting_without_a_count_is_refused():
    with pytest.raises(ConfigError, match="expected 1 or more points of a run with the rule count, got 0"):
        Collector(1, "count")


@needs_data
def test_signals_delimit_what_is_collected():
    arm = Arm()
    collector = Collector(1, "signal")
    RunNode(arm.middleware, arm.scheduler, collector)
    arm.play(runs(21)[:50])
    for number in (21, 22):
        arm.signal("/task_start")
        arm.play(runs(number))
        arm.signal("/task_end")
        arm.play(runs(number)[:10])
    assert [len(run) for run in collector.recording()] == [len(runs(21)), len(runs(22))]


@needs_data
def test_zeros_in_mid_motion_are_left_out_and_said():
    arm = Arm()
    operate = arm.operate()
    values = runs(21).copy()
    values[250] = 0
    arm.play(values)
    operate.close()
    assert operate.runs[0].points == len(values) - 1
    assert "all joints are 0 at once" in arm.texts[0]


def test_nothing_collected_is_an_error():
    with pytest.raises(MissionError, match="nothing was collected"):
        Collector(1).recording()
    assert Collector(1).recorded == 0


def test_a_run_without_a_point_is_none():
    collector = Collector(1, "signal", limit=3)
    for points in (4, 0, 4, 5):
        collector.begin()
        for _ in range(points):
            collector.step(0.0, [1.0, 2.0])
        collector.end()
    assert (collector.done, collector.recorded) == (True, 3)
    assert collector.recording().runs.tolist() == [0] * 4 + [1] * 4 + [2] * 5
