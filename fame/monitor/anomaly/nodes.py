"""The two nodes of anomaly detection: `OperateNode` watches an arm, `CollectNode` records it. Both read joint states.

A message that cannot be used (too few joints, values that are not finite, zeros away from home) is left out and
reported once per reason. A topic that stops is reported; the run waits, and continues with the topic.

`OperateNode` publishes for each joint state, relative to its namespace, ``anomaly_score`` (std_msgs/msg/Float64, the
score of the run so far) and ``anomaly_point`` (std_msgs/msg/Bool, whether the point is anomalous). When the score of a
run exceeds the threshold it publishes ``/anomaly`` once: a sensor_msgs/msg/JointState with the time in its header, the
unit of the magnitude as `frame_id`, the joint as the one name, the magnitude as the one position and the score as the
one effort. At the end of a run it publishes each benign change of the run (another speed, a pause, a start from another
pose, a drift, missing stamps) in words on ``/process_change`` (std_msgs/msg/String).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

from fame.clock import SECOND, Scheduler
from fame.middleware import messages
from fame.middleware.interface import SENSOR_DATA, Middleware, Node
from fame.monitor.anomaly.live import Collector, Point, RunMonitor, RunReport
from fame.monitor.anomaly.model import Model
from fame.monitor.anomaly.recording import JUMP, Rule
from fame.monitor.pipeline.fields import UnusableMessage
from fame.monitor.pipeline.subscriptions import SilenceWatch

TYPE = "sensor_msgs/msg/JointState"
EMPTY = "std_msgs/msg/Empty"
START, END, ALARM, CHANGE = "/task_start", "/task_end", "/anomaly", "/process_change"
SILENCE = 1.0
"""A topic without a message for this time (s) is silent."""


def stamp_of(message: Any) -> float:
    """Give the time of a message in s, 0.0 if it has none."""
    stamp = message.header.stamp
    return float(stamp.sec) + float(stamp.nanosec) * 1e-9


def values_of(message: Any, joints: Sequence[str], field: str = "position") -> list[float]:
    """Give the values of `joints`, in their order; of all, in the message's order, if `joints` is empty.

    Joints of a headerless file have default names (``joint_1`` ...) and are taken by position if no name fits.
    Raises UnusableMessage.
    """
    values = [float(value) for value in getattr(message, field)]
    names = [str(name) for name in message.name]
    if not values:
        raise UnusableMessage(f"its {field} is empty")
    if joints and set(joints) <= set(names) and len(names) == len(values):
        values = [values[names.index(joint)] for joint in joints]
    elif joints and (len(values) != len(joints) or not _are_default_names(joints)):
        missing = [joint for joint in joints if joint not in names]
        lack = f", without {', '.join(missing)}" if missing else ""
        raise UnusableMessage(
            f"it has {len(values)} joints ({', '.join(names) or 'unnamed'}){lack}; the model has {len(joints)}"
        )
    if not all(map(math.isfinite, values)):
        raise UnusableMessage(f"its {field} holds a value that is not finite")
    return values


def _are_default_names(joints: Sequence[str]) -> bool:
    return all(joint.startswith("joint_") and joint.removeprefix("joint_").isdecimal() for joint in joints)


class _JointStateNode(ABC):
    """A node that reads joint states, and reports what it cannot use and when they stop."""

    scheduler: Scheduler
    node: Node
    topic: str

    def __init__(
        self,
        name: str,
        middleware: Middleware,
        scheduler: Scheduler,
        *,
        topic: str,
        field: str,
        namespace: str,
        report: Callable[[str], object],
        silence: float = SILENCE,
    ) -> None:
        self.scheduler, self._field, self._report = scheduler, field, report
        self._reported: set[str] = set()
        self._last: list[float] = []
        self.node = middleware.node(name, namespace)
        self.topic = self.node.subscription(topic, TYPE, self._on_message, SENSOR_DATA).topic
        self._watch = SilenceWatch(
            scheduler, self.topic, silence, report, lambda received: f"; run {self.current_run()} waits for it"
        )

    @abstractmethod
    def current_run(self) -> int:
        """Return the number of the current run."""

    def close(self) -> None:
        """Close all endpoints."""
        self._watch.close()
        self.node.close()

    @abstractmethod
    def _on_message(self, message: Any) -> None:
        """Take a joint state."""

    def _point_of(self, message: Any, joints: Sequence[str]) -> tuple[float, list[float]] | None:
        """Give stamp (s) and values of a message, None if it cannot be used, which is reported."""
        self._watch.on_message()
        try:
            values = values_of(message, joints, self._field)
            if self._last and not any(values) and max(map(abs, self._last)) > JUMP:
                raise UnusableMessage("all joints are 0 at once while the arm is away from home")
        except UnusableMessage as reason:
            self._report_once(f"{self.topic}: a message is left out: {reason}")
            return None
        self._last = values
        return stamp_of(message) or self.scheduler.now / SECOND, values

    def _report_once(self, text: str) -> None:
        if text not in self._reported:
            self._reported.add(text)
            self._report(text)


class OperateNode(_JointStateNode):
    """Watches an arm with a stored model, and raises the signal `anomaly`.

    It lives until `close`. `report` gets a line for every run that ended and everything unusual.
    """

    monitor: RunMonitor

    def __init__(
        self,
        middleware: Middleware,
        scheduler: Scheduler,
        model: Model,
        *,
        topic: str = "/joint_states",
        field: str = "position",
        threshold: float | None = None,
        rule: Rule = "home",
        cycle: int = 0,
        namespace: str = "",
        report: Callable[[str], object] = lambda text: None,
        on_point: Callable[[Point], object] = lambda point: None,
        silence: float = SILENCE,
    ) -> None:
        self.monitor = RunMonitor(model, threshold, rule, cycle)
        self.alarms: list[Point] = []
        self._on_point, self._reported_runs = on_point, 0
        super().__init__(
            "anomaly_detection", middleware, scheduler,
            topic=topic, field=field, namespace=namespace, report=report, silence=silence,
        )  # fmt: skip
        self._score = self.node.publisher("anomaly_score", "std_msgs/msg/Float64")
        self._point = self.node.publisher("anomaly_point", "std_msgs/msg/Bool")
        self._alarm = self.node.publisher(ALARM, TYPE)
        self._change = self.node.publisher(CHANGE, "std_msgs/msg/String")
        if rule == "signal":
            self.node.subscription(START, EMPTY, lambda _: self._begin())
            self.node.subscription(END, EMPTY, lambda _: self._end())

    @property
    def runs(self) -> list[RunReport]:
        """Every run that has ended."""
        return self.monitor.ended

    def current_run(self) -> int:
        """Return the number of the current run."""
        return self.monitor.run

    def close(self) -> None:
        """Close all endpoints; the current run is evaluated up to here."""
        self._end()
        super().close()

    def _begin(self) -> None:
        self.monitor.begin()
        self._report_runs()

    def _end(self) -> None:
        self.monitor.end()
        self._report_runs()

    def _on_message(self, message: Any) -> None:
        taken = self._point_of(message, self.monitor.model.joints)
        if taken is None:
            return
        point = self.monitor.step(*taken)
        self._report_runs()
        if point is not None:
            self._publish(point)
        elif self.monitor.late:
            self._report_once(f"{self.topic}: the arm is moving; its runs are scored from its next rest at home on")

    def _publish(self, point: Point) -> None:
        self._score.publish(messages.create("std_msgs/msg/Float64", point.score))
        self._point.publish(messages.create("std_msgs/msg/Bool", point.verdict.anomalous))
        self._on_point(point)
        if point.alarm:
            self.alarms.append(point)
            self._alarm.publish(alarm_message(point))
            self._report(alarm_text(point))

    def _report_runs(self) -> None:
        """Report the runs that have ended since the last report."""
        for report in self.runs[self._reported_runs :]:
            self._report(report.text)
            for change in report.changes:
                self._change.publish(messages.create("std_msgs/msg/String", change.text))
        self._reported_runs = len(self.runs)


class CollectNode(_JointStateNode):
    """Records joint states. `progress` gets the number of complete runs, `done` is called after the last one wanted."""

    collector: Collector

    def __init__(
        self,
        middleware: Middleware,
        scheduler: Scheduler,
        collector: Collector,
        *,
        topic: str = "/joint_states",
        field: str = "position",
        namespace: str = "",
        report: Callable[[str], object] = lambda text: None,
        progress: Callable[[int], object] = lambda runs: None,
        done: Callable[[], object] = lambda: None,
    ) -> None:
        self.collector, self._progress, self._done = collector, progress, done
        super().__init__(
            "anomaly_collection", middleware, scheduler,
            topic=topic, field=field, namespace=namespace, report=report,
        )  # fmt: skip
        self.node.subscription(START, EMPTY, lambda _: collector.begin())
        self.node.subscription(END, EMPTY, lambda _: self._count(collector.end))

    def current_run(self) -> int:
        """Return the number of the current run."""
        return self.collector.complete

    def _on_message(self, message: Any) -> None:
        if self.collector.done:
            return
        taken = self._point_of(message, self.collector.joints)
        if taken is None:
            return
        names: Sequence[str] = message.name
        if not self.collector.joints and len(names) == len(taken[1]):
            self.collector.joints = tuple(names)
        before = self.collector.late
        self._count(lambda: self.collector.step(*taken))
        if self.collector.late and not before:
            self._report(f"{self.topic}: the arm is moving; it is recorded from its next pass of home on")

    def _count(self, change: Callable[[], object]) -> None:
        """Change the collector, and report a run that is complete thereafter."""
        before = self.collector.complete
        change()
        if self.collector.complete > before:
            self._progress(self.collector.complete)
            if self.collector.done:
                self._done()


def alarm_message(point: Point) -> Any:
    """Give the signal `anomaly` as a message."""
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
