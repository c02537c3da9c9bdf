"""Live runs: their begin, end and anomaly score, and their recording.

A `RunSegmenter` finds where runs begin. All state of scoring is reset at each boundary. With the rule *home* nothing is
scored before the arm has been seen at rest near home or passing it, because the phase of a run under way is unknown.

During a run its score is its anomalous points divided by the points of a nominal run, at its end by its own points.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fame.errors import ConfigError, MissionError
from fame.monitor.anomaly.benign_changes import Change
from fame.monitor.anomaly.model import Model
from fame.monitor.anomaly.recording import NEAR, STILL, WHOLE, Recording, Rule, RunSegmenter
from fame.monitor.anomaly.scoring import Verdict


@dataclass(frozen=True, slots=True)
class Point:
    """A point as it was scored: its run and number in it (from 0), the verdict, the score so far, and
    whether it raised the alarm of its run."""

    run: int
    index: int
    stamp: float
    verdict: Verdict
    score: float
    alarm: bool


class RunReport(NamedTuple):
    """A run that has ended. `first` is its first anomalous point; `alarm` the one that raised the alarm; `changes` are
    the benign changes of the run, such as another speed."""

    run: int
    points: int
    anomalous: int
    score: float
    above: bool
    whole: bool
    first: Point | None
    alarm: Point | None
    changes: tuple[Change, ...] = ()

    @property
    def text(self) -> str:
        """In one line."""
        verdict = "ANOMALOUS" if self.above else "benign" if self.whole else "not judged"
        cut = "" if self.whole else ", cut off before its end"
        changed = "".join(f"; {change.text}" for change in self.changes)
        points = f"{self.anomalous} of {self.points} points"
        return f"run {self.run}: {verdict}, score {self.score:.4f} ({points}){cut}{changed}"


class RunMonitor:
    """Scores points as they come, run by run, until `limit` runs have ended (0: always).

    `ended` collects the reports of runs, `run` is the number of this one; `waiting` until the first begins, `late`
    if the arm was moving away from home meanwhile.
    """

    model: Model
    joints: tuple[str, ...]
    threshold: float
    run: int
    waiting: bool
    late: bool

    def __init__(
        self, model: Model, threshold: float | None = None, rule: Rule = "home", cycle: int = 0, limit: int = 0
    ) -> None:
        self.model, self.joints = model, model.joints
        self.threshold = model.threshold if threshold is None else threshold
        self.ended: list[RunReport] = []
        self._limit = limit
        self._scorer = model.scorer()
        self._segmenter = RunSegmenter(rule, cycle or model.nominal)
        self._recent: deque[tuple[float, Sequence[float]]] = deque(maxlen=2 * model.nominal)
        self.run = 0
        self._counts: list[int] = []
        self._alarmed: bool = False
        self._running = rule != "signal"
        self.waiting = rule == "home"
        self.late = False
        self._before: tuple[float, Sequence[float]] | None = None
        self._clear()

    def begin(self) -> None:
        """Begin a run (rule ``signal``), and end the current one."""
        self.end()
        self._running = not self.done
        self._clear()

    @property
    def done(self) -> bool:
        """Whether as many runs have ended as were wanted."""
        return 0 < self._limit <= self.run

    def end(self) -> RunReport | None:
        """The run ends. None if there was none."""
        if not self._points:
            return None
        points = self._points
        count = sum(point.verdict.anomalous for point in points)
        votes = [point.verdict.votes or (point.verdict.anomalous,) for point in points]
        score = self.model.run_score([sum(column) for column in zip(*votes, strict=True)], len(points))
        first = next((point for point in points if point.verdict.anomalous), None)
        alarm = next((point for point in points if point.alarm), None)
        whole = len(points) >= WHOLE * self.model.nominal
        changes = tuple(self._scorer.changes())
        report = RunReport(self.run, len(points), count, score, score > self.threshold, whole, first, alarm, changes)
        self.ended.append(report)
        self.run += 1
        if self._segmenter.rule == "signal":
            self._running = False
        self._clear()
        return report

    def step(self, stamp: float, values: Sequence[float]) -> Point | None:
        """One more point: its time (s) and the joints in the model's order. None between runs and before the first."""
        if not self._running or self.done:
            return None
        own = self._segmenter.feed(values)
        self._recent.append((stamp, values))
        if self.waiting and own is None:
            before, self._before = self._before, (stamp, values)
            self.late |= math.hypot(*values) >= NEAR
            if before is None or self.late or not _rests(before[1], values):
                return None
            self._score(*before)
        self.waiting = self.late = False
        if own is None:
            return self._score(stamp, values)
        again = list(self._recent)[-own:]
        del self._points[max(0, len(self._points) - (own - 1)) :]
        self.end()
        return None if self.done else [self._score(*item) for item in again][-1]

    def _score(self, stamp: float, values: Sequence[float]) -> Point:
        verdict = self._scorer.step(values, stamp)
        votes = verdict.votes or (verdict.anomalous,)
        self._counts = [count + vote for count, vote in zip(self._counts, votes, strict=True)]
        score = self.model.run_score(self._counts, self.model.nominal)
        alarm = not self._alarmed and score > self.threshold and not self._segmenter.undecided
        self._alarmed |= alarm
        point = Point(self.run, len(self._points), stamp, verdict, score, alarm)
        self._points.append(point)
        return point

    def _clear(self) -> None:
        self._points: list[Point] = []
        self._counts = [0] * len(self.model.parts)
        self._alarmed = False
        self._scorer.reset()


def _rests(before: Sequence[float], values: Sequence[float]) -> bool:
    """Whether the arm is at rest near home."""
    return math.hypot(*values) < NEAR and max(abs(a - b) for a, b in zip(values, before, strict=True)) < STILL


class Collector:
    """Gathers points, run by run, and stops taking them after `limit` whole runs (0: never).

    With the rule ``home`` an arm that is under way at first (`late`) is recorded from its next pass of home on. Runs
    that were cut off, shorter than `WHOLE` of the usual, are left out of the recording, and noted in it.
    Raises ConfigError for the rule ``count`` without a `cycle`.
    """

    label: int
    limit: int
    done: bool
    run: int

    def __init__(self, label: int, rule: Rule = "home", *, cycle: int = 0, limit: int = 0) -> None:
        if rule == "count" and cycle < 1:
            raise ConfigError(f"expected 1 or more points of a run with the rule count, got {cycle}")
        self.label, self.limit = label, limit
        self.late: bool | None = None if rule == "home" else False
        self.joints: tuple[str, ...] = ()
        self.done = False
        self.run = 0
        self._rule, self._segmenter = rule, RunSegmenter(rule, cycle)
        self._running = rule != "signal"
        self._rows: list[tuple[float, list[float]]] = []
        self._bounds: list[int] = []  # the rows that runs end before

    def begin(self) -> None:
        """A run begins (rule ``signal``)."""
        self._running = not self.done

    def end(self) -> None:
        """It ends."""
        if self._running:
            self._running = False
            self._another(len(self._rows))

    def step(self, stamp: float, values: list[float]) -> None:
        """One more point."""
        if not self._running or self.done:
            return
        if self.late is None:
            self.late = math.hypot(*values) >= NEAR
        self._rows.append((stamp, values))
        own = self._segmenter.feed(values)
        if own is None:
            return
        begin = len(self._rows) - own
        if self.late:
            self.late = False
            del self._rows[:begin]
            return
        self._another(begin)
        if self.done:
            del self._rows[begin:]

    def recording(self) -> Recording:
        """Give what was collected. Raises MissionError if there is nothing."""
        if self.late:
            raise MissionError("nothing was collected: the arm never passed home, where all joints are near 0")
        if not self._rows:
            raise MissionError("nothing was collected: no run began, or the topic was silent")
        stamps, values = zip(*self._rows, strict=True)
        recording = Recording(
            self.joints or tuple(f"joint_{number + 1}" for number in range(len(values[0]))),
            np.array(values),
            np.full(len(values), self.label, dtype=np.int64),
            np.searchsorted(self._bounds, np.arange(len(values)), side="right").astype(np.int64),
            np.array(stamps) if any(stamps) else None,
        )
        return _whole(recording)

    def _another(self, end: int) -> None:
        self._bounds.append(end)
        self.run += 1
        self.done = 0 < self.limit <= self.run


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
