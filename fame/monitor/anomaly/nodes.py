"""The nodes of anomaly detection, recording nodes of joint states: `RunNode` collects runs of an arm, `OperateNode`
watches it.

A message that cannot be used (too few joints, values that are not finite, zeros away from home) is left out and
reported. A topic that stops is reported; the run waits, and continues with the topic.

`OperateNode` publishes for each joint state, relative to its namespace, ``anomaly_score`` (std_msgs/msg/Float64, the
score of the run so far) and ``anomaly_point`` (std_msgs/msg/Bool, whether the point is anomalous). When the score of a
run exceeds the threshold it publishes ``/anomaly`` once: a sensor_msgs/msg/JointState with the time in its header, the
unit of the magnitude as `frame_id`, the joint as the one name, the magnitude as the one position and the score as the
one effort. At the end of a run it publishes each benign change of the run (another speed, a pause, a start from another
pose, a drift, missing stamps) in words on ``/process_change`` (std_msgs/msg/String).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import starmap
from pathlib import Path
from typing import Any

from fame.clock import Scheduler
from fame.dataclasses import dataclass
from fame.middleware import messages
from fame.middleware.interface import SENSOR_DATA, Middleware, resolve
from fame.monitor.anomaly.live import ArmRuns, Point, RunMonitor, RunReport
from fame.monitor.pipeline.configuration import Configuration, Port
from fame.monitor.pipeline.recording import EMPTY, RecordingNode, RecordingOptions

TYPE = "sensor_msgs/msg/JointState"
START, END, ALARM, CHANGE = "/task_start", "/task_end", "/anomaly", "/process_change"
SCORE, POINT = "anomaly_score", "anomaly_point"
PUBLISHED = {SCORE: "std_msgs/msg/Float64", POINT: "std_msgs/msg/Bool", ALARM: TYPE, CHANGE: "std_msgs/msg/String"}
"""The topics of an `OperateNode`, with their types."""


def bag_topics(topic: str, rule: str) -> dict[str, str]:
    """Return the topics of a bag that such a node takes, with their types."""
    return {resolve(topic, ""): TYPE} | (dict.fromkeys((START, END), EMPTY) if rule == "signal" else {})


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmOptions:
    """Options of a `RunNode`.

    topic, field  what it reads: the topic, relative to `namespace`, the field of its messages
    report        gets a line for everything unusual; `done` is called after the last run that is wanted
    """

    topic: str = "/joint_states"
    field: str = "position"
    namespace: str = ""
    report: Callable[[str], object] = lambda text: None
    done: Callable[[], object] = lambda: None


class RunNode(RecordingNode):
    """Gives joint states to what judges or collects `runs`."""

    def __init__(
        self, middleware: Middleware, scheduler: Scheduler, runs: ArmRuns, arm: ArmOptions | None = None
    ) -> None:
        arm = arm or ArmOptions()
        self._runs, self._say, self._done, self._told_late = runs, arm.report, arm.done, False
        port = Port("joint", arm.topic, TYPE, (arm.field,), SENSOR_DATA)
        begin, end = (START, END) if runs.rule == "signal" else ("", "")
        options = RecordingOptions(
            namespace=arm.namespace, run_topic=begin, end_topic=end, ordered=False, report=arm.report
        )
        configuration = Configuration(Path(runs.name), runs.name, (port,), ())
        super().__init__(middleware, scheduler, configuration, (), options, runs.name)

    def begin(self, message: Any = None) -> None:
        self._runs.begin()
        self._update()

    def end(self, message: Any = None) -> None:
        self._runs.end()
        self._update()

    def _on_sample(self, ports: Sequence[Port], stamp: float, values: Sequence[Any], names: Any) -> None:
        self.rows += 1
        if self._runs.done:
            return
        self._update(self._runs.put(stamp, values[0].tolist(), [name.removeprefix("joint.") for name in names[0]]))
        if self._runs.late and not self._told_late:
            self._told_late = True
            self._say(self._runs.moving)

    def _update(self, point: Point | None = None) -> None:
        """Tell what has become of the runs, and of the last point if it was scored."""
        if self._runs.done:
            self.done = True
            self._done()


class OperateNode(RunNode):
    """Watches an arm with a `monitor`, and raises the signal `anomaly`. `report` gets a line for every run too."""

    runs: list[RunReport]

    def __init__(
        self, middleware: Middleware, scheduler: Scheduler, monitor: RunMonitor, arm: ArmOptions | None = None
    ) -> None:
        self.runs, self._reported_runs = monitor.ended, 0
        super().__init__(middleware, scheduler, monitor, arm)
        self._score, self._point, self._alarm, self._change = starmap(self.node.publisher, PUBLISHED.items())

    def close(self) -> None:
        """Close all endpoints; the current run is evaluated up to here."""
        self.end()
        super().close()

    def _update(self, point: Point | None = None) -> None:
        for report in self.runs[self._reported_runs :]:
            self._say(report.text)
            for change in report.changes:
                self._change.publish(messages.create("std_msgs/msg/String", change.text))
        self._reported_runs = len(self.runs)
        if point is not None:
            self._score.publish(messages.create("std_msgs/msg/Float64", point.score))
            self._point.publish(messages.create("std_msgs/msg/Bool", point.verdict.anomalous))
            if point.alarm:
                self._alarm.publish(alarm_message(point))
                self._say(alarm_text(point))
        super()._update()


def alarm_message(point: Point) -> Any:
    """Return the signal `anomaly` as a message."""
    verdict = point.verdict
    return messages.create(
        TYPE,
        {
            "header": {"stamp": point.stamp, "frame_id": verdict.unit},
            "name": [verdict.joint],
            "position": [verdict.magnitude],
            "effort": [point.score],
        },
    )


def alarm_text(point: Point) -> str:
    """Describe an alarm in one line."""
    verdict = point.verdict
    cause = f"{verdict.kind}, " if verdict.kind in ("noise", "sampling") else ""
    return (
        f"run {point.run}: alarm at point {point.index} ({point.stamp:.3f} s), score {point.score:.4f}: {cause}"
        f"{verdict.magnitude:.3g} {verdict.unit}, most of all {verdict.joint}"
    )
