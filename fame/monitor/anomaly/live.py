"""Live runs: their begin, end and anomaly score, and their recording.

A `RunSegmenter` finds where runs begin. All state of scoring is reset at each boundary. With the rule *home* nothing is
scored before the arm has been seen at rest near home or passing it, because the phase of a run under way is unknown.

During a run its score is its anomalous points divided by the points of a nominal run, at its end by its own points.

An arm that has frozen, or its joint states, never comes home. A run that is away from home for `LONG` times the longest
run of the training ends there: it is not judged, unless its score so far is above the threshold.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from typing import ClassVar, NamedTuple

import numpy as np

from fame.dataclasses import dataclass, replace
from fame.errors import ConfigError, MissionError
from fame.monitor.anomaly.benign_changes import Change
from fame.monitor.anomaly.model import Model
from fame.monitor.anomaly.recording import JUMP, NEAR, STILL, WHOLE, Recording, Rule, RunSegmenter, made_up
from fame.monitor.anomaly.scoring import PointVerdict
from fame.monitor.pipeline.fields import UnusableMessage, unusable

LONG = 3.0
"""How many times the longest run of the training an arm may be away from home."""


@dataclass(frozen=True, slots=True)
class Point:
    """A point as it was scored: its run and number in it (from 0), the verdict, the score so far, and
    whether it raised the alarm of its run."""

    run: int
    index: int
    stamp: float
    verdict: PointVerdict
    score: float
    alarm: bool


class RunReport(NamedTuple):
    """A run that has ended. `alarm` is the point that raised the alarm; `changes` are the benign changes of the run,
    such as another speed; `still` are the joints that hardly moved in a run without an alarm, as a dead sensor;
    `away`: the run ended because the arm did not come home."""

    run: int
    points: int
    anomalous: int
    score: float
    above: bool
    whole: bool
    alarm: Point | None
    changes: tuple[Change, ...] = ()
    still: tuple[str, ...] = ()
    away: bool = False

    @property
    def judged(self) -> bool:
        """Whether the run is benign if it is not anomalous."""
        return self.whole and not self.still

    @property
    def text(self) -> str:
        """In one line."""
        verdict = "ANOMALOUS" if self.above else "benign" if self.judged else "not judged"
        cut = "" if self.whole else ", cut off before its end"
        cut = f", the arm did not come home within {LONG:g} times the longest run" if self.away else cut
        cut += f", {', '.join(self.still)} hardly moved" if self.still else ""
        changed = "".join(f"; {change.text}" for change in self.changes)
        points = f"{self.anomalous} of {self.points} points"
        return f"run {self.run}: {verdict}, score {self.score:.4f} ({points}){cut}{changed}"


class ArmRuns(ABC):
    """Takes joint states and cuts them into runs, until `limit` runs have ended (0: always).

    joints  names, in the order of the values of a point; empty: that of the first message
    run     the number of this run
    late    whether the arm is moving away from home, so that its runs begin later; `moving` is what to say of that
    name    of the node that gives it the joint states
    """

    limit: int
    name: ClassVar[str]
    moving: ClassVar[str]
    joints: tuple[str, ...] = ()
    late: bool = False
    run: int = 0

    def __init__(self, rule: Rule, cycle: int, limit: int) -> None:
        self.rule, self.limit = rule, limit
        self._segmenter = RunSegmenter(rule, cycle)
        self._running = rule != "signal"
        self._last: list[float] = []

    @property
    def done(self) -> bool:
        """Whether as many runs have ended as were wanted."""
        return 0 < self.limit <= self.run

    def put(self, stamp: float, values: list[float], names: Sequence[str]) -> Point | None:
        """Take a joint state and the names of its joints, if they are known; give the point as it was scored, None if
        it was not. Raises UnusableMessage."""
        values = in_order(values, names, self.joints)
        if self._last and not any(values) and max(map(abs, self._last)) > JUMP:
            raise UnusableMessage("all joints are 0 at once while the arm is away from home")
        self._last, self.joints = values, self.joints or tuple(names)
        return self.step(stamp, values)

    @abstractmethod
    def begin(self) -> None:
        """Begin a run (rule ``signal``)."""

    @abstractmethod
    def end(self) -> None:
        """End the run."""

    @abstractmethod
    def step(self, stamp: float, values: list[float]) -> Point | None:
        """Take one more point: its time (s) and the values of the joints in their order; give it as `put`."""


def in_order(values: list[float], names: Sequence[str], joints: Sequence[str]) -> list[float]:
    """Return the values of `joints`, in their order; all, in the order of the message, if `joints` is empty.

    Joints of a headerless file have default names (``joint_1`` ...) and are taken by position if no name fits.
    Raises UnusableMessage.
    """
    if not joints:
        return values
    if set(joints) <= set(names):
        return [values[names.index(joint)] for joint in joints]
    if len(values) == len(joints) and all(map(made_up, joints)):
        return values
    missing = [joint for joint in joints if joint not in names]
    lack = f", without {', '.join(missing)}"
    text = f"it has {len(values)} joints ({', '.join(names) or 'unnamed'}){lack}; the model has {len(joints)}"
    raise unusable(text, names, joints)


class RunMonitor(ArmRuns):
    """Scores points as they come. `ended` collects the reports of runs; `waiting` until the first begins."""

    model: Model

    name = "anomaly_detection"
    moving = "the arm is away from home; its runs are scored from its next rest at home on"

    def __init__(
        self, model: Model, threshold: float | None = None, rule: Rule = "home", cycle: int = 0, limit: int = 0
    ) -> None:
        super().__init__(rule, cycle or model.nominal, limit)
        self.model, self.joints = model, model.joints
        self.threshold: float = model.threshold if threshold is None else threshold
        self.ended: list[RunReport] = []
        self._scorer = model.scorer()
        self._recent: deque[tuple[float, Sequence[float]]] = deque(maxlen=2 * model.nominal)
        self._points: list[Point] = []
        self._values: list[Sequence[float]] = []
        self._counts: list[int] = []
        self._alarmed: bool = False
        self._away: int = 0  # points since the arm was at home
        self.waiting: bool = rule == "home"
        self._longest = LONG * int(model.conditions.get("longest", model.nominal))
        self._clear()

    def begin(self) -> None:
        self.end()
        self._running = not self.done
        self._clear()

    def end(self, *, away: bool = False) -> None:
        if not self._points:
            return
        points = self._points
        count = sum(point.verdict.anomalous for point in points)
        votes = zip(*(point.verdict.votes for point in points), strict=True)
        score = self.model.run_score(list(map(sum, votes)), self.model.nominal if away else len(points))
        alarm = next((point for point in points if point.alarm), None)
        whole = len(points) >= WHOLE * self.model.nominal and not away
        changes, above = tuple(self._scorer.changes()), score > self.threshold
        still = () if above else self.model.still(np.array(self._values))
        self.ended.append(RunReport(self.run, len(points), count, score, above, whole, alarm, changes, still, away))
        self.run += 1
        if self.rule == "signal":
            self._running = False
        self._clear()

    def step(self, stamp: float, values: Sequence[float]) -> Point | None:
        """Score one more point. None between runs and before the first."""
        if not self._running or self.done:
            return None
        own = self._segmenter.feed(values)
        self._recent.append((stamp, values))
        self._away = self._away + 1 if self.rule == "home" and math.hypot(*values) >= NEAR else 0
        if self._away > self._longest and not self.waiting:
            self.end(away=True)
            self.waiting = True
        if self.waiting and own is None:
            self.late |= math.hypot(*values) >= NEAR
            if len(self._recent) < 2 or self.late or not _rests(self._recent[-2][1], values):
                return None
            self._score(*self._recent[-2])
        self.waiting = self.late = False
        if own is None:
            return self._score(stamp, values)
        again = list(self._recent)[-own:]
        own_begin = max(0, len(self._points) - (own - 1))
        del self._points[own_begin:], self._values[own_begin:]
        self.end()
        return None if self.done else [self._score(*item) for item in again][-1]

    def _score(self, stamp: float, values: Sequence[float]) -> Point:
        verdict = self._scorer.step(values, stamp)
        self._counts = [count + vote for count, vote in zip(self._counts, verdict.votes, strict=True)]
        score = self.model.run_score(self._counts, self.model.nominal)
        alarm = not self._alarmed and score > self.threshold and not self._segmenter.undecided
        self._alarmed |= alarm
        point = Point(self.run, len(self._points), stamp, verdict, score, alarm)
        self._points.append(point)
        self._values.append(values)
        return point

    def _clear(self) -> None:
        self._points, self._values = [], []
        self._counts = [0] * len(self.model.parts)
        self._alarmed, self._away = False, 0
        self._scorer.reset()


def _rests(before: Sequence[float], values: Sequence[float]) -> bool:
    """Return whether the arm is at rest near home."""
    return math.hypot(*values) < NEAR and max(abs(a - b) for a, b in zip(values, before, strict=True)) < STILL


class Collector(ArmRuns):
    """Gathers points.

    With the rule ``home`` an arm that is under way at first (`late`) is recorded from its next pass of home on. Runs
    that were cut off, shorter than `WHOLE` of the usual, are left out of the recording, and noted in it.
    `progress` gets the number of runs when one has ended.
    Raises ConfigError for the rule ``count`` without a `cycle`.
    """

    label: int

    name = "anomaly_collection"
    moving = "the arm is moving; it is recorded from its next pass of home on"

    def __init__(
        self,
        label: int,
        rule: Rule = "home",
        *,
        cycle: int = 0,
        limit: int = 0,
        progress: Callable[[int], object] = lambda runs: None,
    ) -> None:
        if rule == "count" and cycle < 1:
            raise ConfigError(f"expected 1 or more points of a run with the rule count, got {cycle}")
        super().__init__(rule, cycle, limit)
        self.label, self._progress = label, progress
        self.rows: list[tuple[float, list[float]]] = []
        self._bounds: list[int] = []  # the rows that runs end before

    def begin(self) -> None:
        self._running = not self.done

    def end(self) -> None:
        if self._running:
            self._running = False
            self._another(len(self.rows))

    def step(self, stamp: float, values: list[float]) -> None:
        """Take one more point."""
        if not self._running or self.done:
            return
        if self.rule == "home" and not self.rows:
            self.late = math.hypot(*values) >= NEAR
        self.rows.append((stamp, values))
        own = self._segmenter.feed(values)
        if own is None:
            return
        begin = len(self.rows) - own
        if self.late:
            self.late = False
            del self.rows[:begin]
            return
        self._another(begin)
        if self.done:
            del self.rows[begin:]

    def recording(self) -> Recording:
        """Return what was collected. Raises MissionError if there is nothing."""
        if self.late:
            raise MissionError("nothing was collected: the arm never passed home, where all joints are near 0")
        if not self.rows:
            raise MissionError("nothing was collected: no run began, or the topic was silent")
        stamps, values = zip(*self.rows, strict=True)
        recording = Recording(
            self.joints or tuple(f"joint_{number + 1}" for number in range(len(values[0]))),
            np.array(values),
            np.full(len(values), self.label, dtype=np.int64),
            np.searchsorted(self._bounds, np.arange(len(values)), side="right").astype(np.int64),
            np.array(stamps) if any(stamps) else None,
        )
        return _whole(recording)

    @property
    def recorded(self) -> int:
        """How many of the runs that have ended are in the recording; 0 if nothing was collected."""
        return self.recording().count if self.rows and not self.late else 0

    def _another(self, end: int) -> None:
        if end == (self._bounds[-1] if self._bounds else 0):
            return  # a run without a point
        self._bounds.append(end)
        self.run += 1
        self._progress(self.run)


def _whole(recording: Recording) -> Recording:
    """Return all runs but those that were cut off."""
    lengths = [len(run) for run in recording]
    usual = int(np.quantile(lengths, 0.5, method="higher"))
    cut = [number for number, length in enumerate(lengths) if length < WHOLE * usual]
    notes = [
        f"run {number} is left out: cut off after {lengths[number]} points, the usual is {usual}" for number in cut
    ]
    kept = recording.select([number for number in range(len(lengths)) if number not in cut])
    return replace(kept, notes=tuple(notes))
