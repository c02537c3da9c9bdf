"""Collect: the node that records joint states of runs of a task, each with one label."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fame.clock import SECOND, Scheduler
from fame.errors import ConfigError, MissionError
from fame.middleware.interface import SENSOR_DATA, Middleware
from fame.monitor.anomaly.joint_states import TYPE, Unusable, refuse_dropout, stamp_of, values_of
from fame.monitor.anomaly.live import WHOLE, Cutter, Rule
from fame.monitor.anomaly.operate import EMPTY, END, START
from fame.monitor.anomaly.recording import Recording
from fame.monitor.anomaly.runs import NEAR
from fame.monitor.anomaly.silence import Watch


class Collector:
    """Gathers points, run by run, and stops taking them after `limit` whole runs (0: never).

    With the rule ``home`` an arm that is under way at first (`late`) is recorded from its next pass of home on. Runs
    that were cut off, shorter than `WHOLE` of the usual, are left out of the recording; its notes say so.
    Raises ConfigError for the rule ``count`` without a `cycle`.
    """

    def __init__(self, label: int, rule: Rule = "home", *, cycle: int = 0, limit: int = 0) -> None:
        if rule == "count" and cycle < 1:
            raise ConfigError(f"found {cycle} points of a run; with the rule count 1 or more are needed")
        self.label, self.limit = label, limit
        self.late: bool | None = None if rule == "home" else False
        self.joints: tuple[str, ...] = ()
        self.done = False
        self.complete = 0
        self._rule, self._cutter = rule, Cutter(rule, cycle)
        self._running = rule != "signal"
        self._rows: list[tuple[float, int, list[float]]] = []

    def begin(self) -> None:
        """A run begins (rule ``signal``)."""
        self._running = not self.done

    def end(self) -> None:
        """It ends."""
        if self._running:
            self._running = False
            self._another()

    def step(self, stamp: float, values: list[float]) -> None:
        """One more point."""
        if not self._running or self.done:
            return
        if self.late is None:
            self.late = math.hypot(*values) >= NEAR
        own = self._cutter.feed(values)
        if own is not None:
            keep = len(self._rows) - (own - 1)
            moved = [*self._rows[keep:], (stamp, 0, values)]
            if self.late:
                self.late = False
                self._rows = [(time, 0, row) for time, _, row in moved]
                return
            del self._rows[keep:]
            self._another()
            if not self.done:
                self._rows += [(time, self.complete, row) for time, _, row in moved]
        else:
            self._rows.append((stamp, self.complete, values))

    def recording(self) -> Recording:
        """What was collected. Raises MissionError if nothing was."""
        if self.late:
            raise MissionError("nothing was collected: the arm never passed home, where all joints are near 0")
        if not self._rows:
            raise MissionError("nothing was collected: no run began, or the topic was silent")
        stamps, runs, values = zip(*self._rows, strict=True)
        timed = any(stamps)
        recording = Recording(
            self.joints or tuple(f"joint_{number + 1}" for number in range(len(values[0]))),
            np.array(values),
            np.full(len(values), self.label, dtype=np.int64),
            np.array(runs, dtype=np.int64),
            np.array(stamps) if timed else None,
        )
        return _whole(recording)

    def _another(self) -> None:
        self.complete += 1
        self.done = 0 < self.limit <= self.complete


def _whole(recording: Recording) -> Recording:
    """All runs but those that were cut off."""
    lengths = [len(run) for run in recording]
    usual = int(np.quantile(lengths, 0.5, method="higher"))
    cut = [number for number, length in enumerate(lengths) if length < WHOLE * usual]
    notes = [
        f"run {number} is left out: cut off after {lengths[number]} points, the usual is {usual}" for number in cut
    ]
    kept = recording.select([number for number in range(len(lengths)) if number not in cut])
    return replace(kept, notes=tuple(notes))


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
