"""Joint states as messages: which of their values belong to which joint, and why one is not taken.

Operate: the node that watches an arm with a stored model, and raises the signal `anomaly`.

It hears joint states and publishes for each, relative to its namespace, ``anomaly_score`` (std_msgs/msg/Float64, the
score of the run so far) and ``anomaly_point`` (std_msgs/msg/Bool, whether the point is anomalous). When the score of a
run exceeds the threshold it publishes ``/anomaly`` once: a sensor_msgs/msg/JointState with the time in its header, the
unit of the magnitude as `frame_id`, the joint as the one name, the magnitude as the one position and the score as the
one effort.

What cannot be used (too few joints, values that are not finite, zeros away from home) is left out and reported once per
reason; a topic that stops is reported, the run waits, and goes on with it.


Collect: the node that records joint states of runs of a task, each with one label."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from fame.clock import SECOND, Scheduler
from fame.middleware import messages
from fame.middleware.interface import SENSOR_DATA, Middleware
from fame.monitor.anomaly.live import Collector, Point, RunMonitor, RunReport
from fame.monitor.anomaly.model import Model
from fame.monitor.anomaly.segmentation import JUMP, Rule
from fame.monitor.silence import SILENCE, Watch

TYPE = "sensor_msgs/msg/JointState"
FIELDS = ("position", "velocity", "effort")


class Unusable(Exception):
    """A message that cannot be taken; its text says what was found."""


def stamp_of(message: Any) -> float:
    """Its time in s; 0.0 if it has none."""
    stamp = message.header.stamp
    return float(stamp.sec) + float(stamp.nanosec) * 1e-9


def values_of(message: Any, joints: Sequence[str], field: str = "position") -> list[float]:
    """The values of `joints`, in their order; of all, in the message's order, if `joints` is empty.

    Joints of a headerless file have made-up names (``joint_1`` ...) and are taken by position if no name fits.
    Raises Unusable.
    """
    found = [float(value) for value in getattr(message, field)]
    names = [str(name) for name in message.name]
    if not found:
        raise Unusable(f"its {field} is empty")
    if joints and set(joints) <= set(names) and len(names) == len(found):
        found = [found[names.index(joint)] for joint in joints]
    elif joints and (len(found) != len(joints) or not _made_up(joints)):
        missing = [joint for joint in joints if joint not in names]
        lack = f", without {', '.join(missing)}" if missing else ""
        raise Unusable(
            f"it has {len(found)} joints ({', '.join(names) or 'unnamed'}){lack}; the model has {len(joints)}"
        )
    if not all(map(math.isfinite, found)):
        raise Unusable(f"its {field} holds a value that is not finite")
    return found


def refuse_dropout(values: list[float], before: Sequence[float]) -> list[float]:
    """The values, unless all are 0 at once while the arm was away from home before. Raises Unusable."""
    if before and not any(values) and max(map(abs, before)) > JUMP:
        raise Unusable("all joints are 0 at once while the arm is away from home")
    return values


def _made_up(joints: Sequence[str]) -> bool:
    return all(joint.startswith("joint_") and joint.removeprefix("joint_").isdecimal() for joint in joints)


SIGNAL_TYPE = TYPE
EMPTY = "std_msgs/msg/Empty"
START, END, ALARM = "/task_start", "/task_end", "/anomaly"


class Operate:
    """The node. It lives until `close`; `report` gets a line for every run that ended and everything unusual."""

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
        self.scheduler, self._field, self._report, self._on_point = scheduler, field, report, on_point
        self._said: set[str] = set()
        self._last: list[float] = []
        self.node = node = middleware.node("anomaly_detection", namespace)
        self._score = node.publisher("anomaly_score", "std_msgs/msg/Float64")
        self._point = node.publisher("anomaly_point", "std_msgs/msg/Bool")
        self._alarm = node.publisher(ALARM, SIGNAL_TYPE)
        self.topic = node.subscription(topic, TYPE, self._heard, SENSOR_DATA).topic
        self._watch = Watch(scheduler, self.topic, report, lambda: f"run {self.monitor.run}", silence)
        if rule == "signal":
            node.subscription(START, EMPTY, lambda _: self._told(self.monitor.begin))
            node.subscription(END, EMPTY, lambda _: self._told(self.monitor.end))
        self._reported = 0

    @property
    def runs(self) -> list[RunReport]:
        """Every run that has ended."""
        return self.monitor.ended

    def close(self) -> None:
        """Leave; the run that goes on is evaluated as far as it got."""
        self._watch.close()
        self._told(self.monitor.end)
        self.node.close()

    def _heard(self, message: Any) -> None:
        self._watch.heard()
        try:
            values = values_of(message, self.monitor.model.joints, self._field)
            self._last = refuse_dropout(values, self._last)
        except Unusable as reason:
            self._once(f"{self.topic}: a message is left out: {reason}")
            return
        point = self.monitor.step(stamp_of(message) or self.scheduler.now / SECOND, values)
        self._tell()
        if point is not None:
            self._publish(point)
        elif self.monitor.late:
            self._once(f"{self.topic}: the arm is under way; what it does is evaluated from its next rest at home on")

    def _publish(self, point: Point) -> None:
        self._score.publish(messages.create("std_msgs/msg/Float64", point.score))
        self._point.publish(messages.create("std_msgs/msg/Bool", point.verdict.anomalous))
        self._on_point(point)
        if point.alarm:
            self.alarms.append(point)
            self._alarm.publish(alarm_message(point))
            self._report(alarm_text(point))

    def _told(self, what: Callable[[], object]) -> None:
        what()
        self._tell()

    def _tell(self) -> None:
        """Report the runs that have ended since the last time."""
        for report in self.runs[self._reported :]:
            self._report(report.text)
        self._reported = len(self.runs)

    def _once(self, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
            self._report(text)


def alarm_message(point: Point) -> Any:
    """The signal `anomaly` as a message."""
    verdict = point.verdict
    return messages.create(
        SIGNAL_TYPE,
        {
            "header": {"stamp": point.stamp, "frame_id": verdict.unit},
            "name": [verdict.joint],
            "position": [verdict.magnitude],
            "effort": [point.score],
        },
    )


def alarm_text(point: Point) -> str:
    """The same in one line."""
    verdict = point.verdict
    return (
        f"run {point.run}: alarm at point {point.index} ({point.stamp:.3f} s), score {point.score:.4f}: "
        f"{verdict.magnitude:.3g} {verdict.unit}, most of all {verdict.joint}"
    )


class Collect:
    """The node. `done` is called after the last run that is wanted; `progress` after each, with their number."""

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
        self.collector = collector
        self._scheduler, self._field, self._report, self._progress, self._done = (
            scheduler,
            field,
            report,
            progress,
            done,
        )
        self._said: set[str] = set()
        self._last: list[float] = []
        self.node = middleware.node("anomaly_collection", namespace)
        self.topic = self.node.subscription(topic, TYPE, self._heard, SENSOR_DATA).topic
        self._watch = Watch(scheduler, self.topic, report, lambda: f"run {collector.complete}")
        self.node.subscription(START, EMPTY, lambda _: collector.begin())
        self.node.subscription(END, EMPTY, lambda _: self._count(collector.end))

    def close(self) -> None:
        """Leave."""
        self._watch.close()
        self.node.close()

    def _heard(self, message: Any) -> None:
        if self.collector.done:
            return
        self._watch.heard()
        try:
            values = values_of(message, self.collector.joints, self._field)
            self._last = refuse_dropout(values, self._last)
        except Unusable as reason:
            text = f"{self.topic}: a message is left out: {reason}"
            if text not in self._said:
                self._said.add(text)
                self._report(text)
            return
        names: Sequence[str] = message.name
        if not self.collector.joints and len(names) == len(values):
            self.collector.joints = tuple(names)
        before = self.collector.late
        self._count(lambda: self.collector.step(stamp_of(message) or self._scheduler.now / SECOND, values))
        if self.collector.late and not before:
            self._report(f"{self.topic}: the arm is under way; it is recorded from its next pass of home on")

    def _count(self, what: Callable[[], object]) -> None:
        before = self.collector.complete
        what()
        if self.collector.complete > before:
            self._progress(self.collector.complete)
            if self.collector.done:
                self._done()
