"""Runs while they go on: where each begins and ends, and its anomaly score.

Three ways delimit a run. *signal*: somebody says begin and end. *home*: the arm comes near its home posture and leaves
it; the boundary is the nearest point, known as soon as the arm is on its way again, so the points since then move over
to the new run, and no alarm is raised on them before. *count*: every so many points. All state of scoring is reset at
each boundary.

With the rule *home* nothing is judged before the arm has been seen at rest near home, or passing it: of a run that is
under way already it is not known how far it is.

During a run its score is the anomalous points divided by the points of a nominal run, at its end by its own points.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from fame.monitor.anomaly.model import Model, Verdict
from fame.monitor.anomaly.runs import NEAR, STILL

Rule = Literal["signal", "home", "count"]

RISE = 5e-4
"""How much farther from home (rad) than at its nearest the arm is on its way again: ten steps of
the MH5's coarsest encoder."""

WHOLE = 0.8
"""A run with less than this part of the nominal points was cut off."""


class Cutter:
    """Says with each point whether a run begins, and how many points ago it did."""

    def __init__(self, rule: Rule, cycle: int = 0) -> None:
        self.rule, self.cycle = rule, cycle
        self._count = 0
        self._left = False
        self._nearest, self._since = math.inf, 0

    def feed(self, values: Sequence[float]) -> int | None:
        """None: the run goes on. Else a run begins, and the last so many points, this one among them, are its own."""
        self._count += 1
        if self.rule == "count" and self._count > self.cycle > 0:
            self._count = 1
            return 1
        return self._home(math.sqrt(sum(value * value for value in values))) if self.rule == "home" else None

    @property
    def undecided(self) -> bool:
        """Whether the last points may turn out to belong to a new run."""
        return self._left and self._since > 1

    def _home(self, distance: float) -> int | None:
        if distance >= NEAR:
            self._left, self._nearest, self._since = True, math.inf, 0
        elif self._left:
            self._since += 1
            if distance < self._nearest:
                self._nearest, self._since = distance, 1
            elif distance > self._nearest + RISE:
                self._left = False
                return self._since
        return None


@dataclass(frozen=True, slots=True)
class Point:
    """A point as it was scored: its run and number in it (from 0), what it was found to be, the score so far, and
    whether it raised the alarm of its run."""

    run: int
    index: int
    stamp: float
    verdict: Verdict
    score: float
    alarm: bool


class RunReport(NamedTuple):
    """A run that has ended. `first` is its first anomalous point; `alarm` the one that raised the alarm."""

    run: int
    points: int
    anomalous: int
    score: float
    above: bool
    whole: bool
    first: Point | None
    alarm: Point | None

    @property
    def text(self) -> str:
        """In one line."""
        verdict = "ANOMALOUS" if self.above else "benign"
        cut = "" if self.whole else ", cut off before its end"
        return f"run {self.run}: {verdict}, score {self.score:.4f} ({self.anomalous} of {self.points} points){cut}"


class RunMonitor:
    """Scores points as they come, run by run.

    `ended` collects the reports of runs, `run` is the number of this one; `waiting` until the first begins, `late`
    if the arm was found under way meanwhile.
    """

    def __init__(self, model: Model, threshold: float | None = None, rule: Rule = "home", cycle: int = 0) -> None:
        self.model = model
        self.threshold = model.threshold if threshold is None else threshold
        self.ended: list[RunReport] = []
        self._scorer = model.scorer()
        self._cutter = Cutter(rule, cycle or model.nominal)
        self._recent: deque[tuple[float, Sequence[float]]] = deque(maxlen=2 * model.nominal)
        self.run = 0
        self._running = rule != "signal"
        self.waiting = rule == "home"
        self.late = False
        self._before: tuple[float, Sequence[float]] | None = None
        self._clear()

    def begin(self) -> None:
        """A run begins (rule ``signal``); one that goes on ends."""
        self.end()
        self._running = True
        self._clear()

    def end(self) -> RunReport | None:
        """The run ends. None if there was none."""
        if not self._points:
            return None
        points = self._points
        count = sum(point.verdict.anomalous for point in points)
        score = count / len(points)
        first = next((point for point in points if point.verdict.anomalous), None)
        alarm = next((point for point in points if point.alarm), None)
        whole = len(points) >= WHOLE * self.model.nominal
        report = RunReport(self.run, len(points), count, score, score > self.threshold, whole, first, alarm)
        self.ended.append(report)
        self.run += 1
        if self._cutter.rule == "signal":
            self._running = False
        self._clear()
        return report

    def step(self, stamp: float, values: Sequence[float]) -> Point | None:
        """One more point: its time (s) and the joints in the model's order. None between runs and before the first."""
        if not self._running:
            return None
        own = self._cutter.feed(values)
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
        return [self._score(*item) for item in again][-1]

    def _score(self, stamp: float, values: Sequence[float]) -> Point:
        verdict = self._scorer.step(values, stamp)
        self._anomalous += verdict.anomalous
        score = self._anomalous / self.model.nominal
        alarm = not self._alarmed and score > self.threshold and not self._cutter.undecided
        self._alarmed |= alarm
        point = Point(self.run, len(self._points), stamp, verdict, score, alarm)
        self._points.append(point)
        return point

    def _clear(self) -> None:
        self._points: list[Point] = []
        self._anomalous, self._alarmed = 0, False
        self._scorer.reset()


def _rests(before: Sequence[float], values: Sequence[float]) -> bool:
    """Whether the arm is at rest near home."""
    return math.hypot(*values) < NEAR and max(abs(a - b) for a, b in zip(values, before, strict=True)) < STILL
