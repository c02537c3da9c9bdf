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
from typing import Any, ClassVar, TypedDict, Unpack

from fame.clock import SECOND, Scheduler
from fame.middleware import messages
from fame.middleware.interface import SENSOR_DATA, Middleware, Node
from fame.monitor.anomaly.live import Collector, Point, RunMonitor, RunReport
from fame.monitor.anomaly.model import Model
from fame.monitor.anomaly.recording import JUMP, Rule
from fame.monitor.pipeline.fields import UnusableMessage, stamp_of
from fame.monitor.pipeline.subscriptions import SilenceWatch

TYPE = "sensor_msgs/msg/JointState"
EMPTY = "std_msgs/msg/Empty"
START, END, ALARM, CHANGE = "/task_start", "/task_end", "/anomaly", "/process_change"
SILENCE = 1.0
"""A topic without a message for this time (s) is silent."""


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


class NodeOptions(TypedDict, total=False):
    """What a node reads: the topic, the field of its messages, the namespace of the node; `report` gets a line for
    everything unusual, `done` is called after the last run that is wanted."""

    topic: str
    field: str
    namespace: str
    report: Callable[[str], object]
    done: Callable[[], object]


class _JointStateNode(ABC):
    """A node that reads joint states and gives them to what judges or collects `runs`; it reports what it cannot use,
    and when they stop. It lives until `close`."""

    name: ClassVar[str]
    moving: ClassVar[str]
    """What is reported of an arm that is under way at first."""
    scheduler: Scheduler
    node: Node
    topic: str

    def __init__(
        self,
        middleware: Middleware,
        scheduler: Scheduler,
        runs: RunMonitor | Collector,
        *,
        signals: bool,
        topic: str = "/joint_states",
        field: str = "position",
        namespace: str = "",
        report: Callable[[str], object] = lambda text: None,
        done: Callable[[], object] = lambda: None,
    ) -> None:
        self.scheduler, self._runs, self._field, self._report, self._done = scheduler, runs, field, report, done
        self._reported: set[str] = set()
        self._last: list[float] = []
        self.node = middleware.node(self.name, namespace)
        self.topic = self.node.subscription(topic, TYPE, self.on_message, SENSOR_DATA).topic
        if signals:
            self.node.subscription(START, EMPTY, self.begin)
            self.node.subscription(END, EMPTY, self.end)
        self._watch = SilenceWatch(
            scheduler, self.topic, SILENCE, report, lambda received: f"; run {runs.run} waits for it"
        )

    @property
    def done(self) -> bool:
        """Whether there are as many runs as were wanted."""
        return self._runs.done

    def begin(self, message: Any = None) -> None:
        """Begin a run."""
        self._runs.begin()
        self._tell()

    def end(self, message: Any = None) -> None:
        """End the current run."""
        self._runs.end()
        self._tell()

    def close(self) -> None:
        """Close all endpoints."""
        self._watch.close()
        self.node.close()

    def on_message(self, message: Any) -> None:
        """Take a joint state. One that cannot be used is reported."""
        if self._runs.done:
            return
        self._watch.on_message()
        try:
            values = values_of(message, self._runs.joints, self._field)
            if self._last and not any(values) and max(map(abs, self._last)) > JUMP:
                raise UnusableMessage("all joints are 0 at once while the arm is away from home")
        except UnusableMessage as reason:
            self._report_once(f"a message is left out: {reason}")
            return
        self._last = values
        if not self._runs.joints and len(message.name) == len(values):
            self._runs.joints = tuple(message.name)
        point = self._runs.step(stamp_of(message) or self.scheduler.now / SECOND, values)
        self._tell(point)
        if self._runs.late:
            self._report_once(self.moving)

    def _tell(self, point: Point | None = None) -> None:
        self._update(point)
        if self._runs.done:
            self._done()

    @abstractmethod
    def _update(self, point: Point | None = None) -> None:
        """Report what has become of the runs, and publish the verdict on a point."""

    def _report_once(self, text: str) -> None:
        if text not in self._reported:
            self._reported.add(text)
            self._report(f"{self.topic}: {text}")


class OperateNode(_JointStateNode):
    """Watches an arm with a stored model, and raises the signal `anomaly`. `report` gets a line for every run too."""

    name = "anomaly_detection"
    moving = "the arm is moving; its runs are scored from its next rest at home on"
    runs: list[RunReport]

    def __init__(
        self,
        middleware: Middleware,
        scheduler: Scheduler,
        model: Model,
        *,
        threshold: float | None = None,
        rule: Rule = "home",
        cycle: int = 0,
        limit: int = 0,
        **options: Unpack[NodeOptions],
    ) -> None:
        monitor = RunMonitor(model, threshold, rule, cycle, limit)
        self.runs, self._reported_runs = monitor.ended, 0
        super().__init__(middleware, scheduler, monitor, signals=rule == "signal", **options)
        self._score = self.node.publisher("anomaly_score", "std_msgs/msg/Float64")
        self._point = self.node.publisher("anomaly_point", "std_msgs/msg/Bool")
        self._alarm = self.node.publisher(ALARM, TYPE)
        self._change = self.node.publisher(CHANGE, "std_msgs/msg/String")

    def close(self) -> None:
        """Close all endpoints; the current run is evaluated up to here."""
        self.end()
        super().close()

    def _update(self, point: Point | None = None) -> None:
        for report in self.runs[self._reported_runs :]:
            self._report(report.text)
            for change in report.changes:
                self._change.publish(messages.create("std_msgs/msg/String", change.text))
        self._reported_runs = len(self.runs)
        if point is None:
            return
        self._score.publish(messages.create("std_msgs/msg/Float64", point.score))
        self._point.publish(messages.create("std_msgs/msg/Bool", point.verdict.anomalous))
        if point.alarm:
            self._alarm.publish(alarm_message(point))
            self._report(alarm_text(point))


class CollectNode(_JointStateNode):
    """Records joint states. `progress` gets the number of complete runs."""

    name = "anomaly_collection"
    moving = "the arm is moving; it is recorded from its next pass of home on"

    def __init__(
        self,
        middleware: Middleware,
        scheduler: Scheduler,
        collector: Collector,
        *,
        progress: Callable[[int], object] = lambda runs: None,
        **options: Unpack[NodeOptions],
    ) -> None:
        self._collector, self._progress, self._told = collector, progress, 0
        super().__init__(middleware, scheduler, collector, signals=True, **options)

    def _update(self, point: Point | None = None) -> None:
        if self._collector.run > self._told:
            self._told = self._collector.run
            self._progress(self._told)


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
