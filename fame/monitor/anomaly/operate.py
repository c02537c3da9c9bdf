"""Operate: the node that watches an arm with a stored model, and raises the signal `anomaly`.

It hears joint states and publishes for each, relative to its namespace, ``anomaly_score`` (std_msgs/msg/Float64, the
score of the run so far) and ``anomaly_point`` (std_msgs/msg/Bool, whether the point is anomalous). When the score of a
run exceeds the threshold it publishes ``/anomaly`` once: a sensor_msgs/msg/JointState with the time in its header, the
unit of the magnitude as `frame_id`, the joint as the one name, the magnitude as the one position and the score as the
one effort.

What cannot be used (too few joints, values that are not finite, zeros away from home) is left out and reported once per
reason; a topic that stops is reported, the run waits, and goes on with it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from fame.clock import SECOND, Scheduler
from fame.middleware import messages
from fame.middleware.interface import SENSOR_DATA, Middleware
from fame.monitor.anomaly.joint_states import TYPE, Unusable, refuse_dropout, stamp_of, values_of
from fame.monitor.anomaly.live import Point, Rule, RunMonitor, RunReport
from fame.monitor.anomaly.model import Model
from fame.monitor.anomaly.silence import SILENCE, Watch

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
        """Leave; the run that goes on is judged as far as it got."""
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
            self._once(f"{self.topic}: the arm is under way; what it does is judged from its next rest at home on")

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
