"""Divides the windows of a machine into runs of its task, and tells the time of each on the axis of phases.

A run begins where a trigger says so (`fame.monitor.pipeline.run_trigger`); without one, where the data are like the
begin of the training runs (`fame.monitor.pipeline.cycles`), and with the first sample after a gap. It lasts as long as
the longest training run by more than their spread, at most; where nothing tells its end, as long as the shortest one:
what comes then may be of the next run. A window that is not wholly in a run belongs to none.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from fame.monitor.arrays import Floats
from fame.monitor.pipeline.cycles import WITHIN, Lag, offsets_of, scores_of, telling, unlike_begin
from fame.monitor.pipeline.phases import Phases
from fame.monitor.pipeline.trained_model import TrainedModel

HELD = 1000
"""Windows outside of every run that are held, at most, until they turn out to be the begin of one."""
Spans: TypeAlias = Sequence[tuple[float, float]]
"""From when to when (s) runs last; the end is inf while that of the last one is not known."""
_Window: TypeAlias = tuple[Any, float]  # with the stamp of its end


def inside(stamps: Floats, length: float, spans: Spans | None) -> NDArray[np.bool_]:
    """Return which windows of a length (s), which end at `stamps`, lie wholly in a run; all, if no trigger tells."""
    if spans is None:
        return np.ones(len(stamps), dtype=np.bool_)
    begins, ends = np.array(spans).reshape(-1, 2).T
    place = np.searchsorted(begins, stamps, side="right") - 1
    known = place >= 0
    first = np.where(known, np.append(begins, np.inf)[place], np.inf)
    return np.asarray(known & (stamps - length >= first - 1e-6) & (stamps <= np.append(ends, -np.inf)[place]))


class RunFinder:
    """Finds runs in the windows of a model as they come.

    spans     those of a trigger; None without one
    searched  whether begins are searched in the data
    """

    spans: Spans | None = None
    searched: bool = True

    def __init__(self, detector: Phases, trained: TrainedModel, apart: float) -> None:
        """Windows of `trained` follow each other `apart` (s)."""
        conditions = trained.conditions
        self._phases, self._channels = telling(detector)
        self._mean, self._scale = trained.mean[self._channels], trained.scale[self._channels]
        self._apart, self._begins = apart, conditions.get("begins")
        self._least, self._most = conditions.get("seconds", (0.0, np.inf))
        settings = conditions.get("settings", {})  # those of a model from before `StartWithin` lack it: it knows no lag
        within = settings.get("start_within", 0.0 if settings else WITHIN)
        self._spread: float = conditions.get("spread", 0.0)
        self._lag = Lag(self._phases, within, self._spread)
        self.latest: float = within + self._spread
        """How late (s) a run may begin."""
        self.longest: float = 2 * self._most - self._least + self.latest
        """How long (s) a run may last."""
        self._given, self._run, self._end, self._first = np.inf, np.inf, -np.inf, -np.inf
        self._unlike: list[tuple[float, Floats]] = []  # stamps of the last windows, how unlike a begin each is
        self._outside: list[_Window] = []  # the last ones that belong to no run yet
        self._waiting: list[_Window] = []  # those of the begin of a run, until its lag is known

    def feed(self, windows: Floats, stamps: Floats, begins: Floats) -> tuple[list[tuple[Any, float, float]], bool]:
        """Take the next windows, with the stamps of their ends and of the first sample behind the last gap.

        Return those of runs, each with its stamp and time, and whether others lie outside of every run.
        """
        kept, outside = list[tuple[Any, float, float]](), False
        parts = np.flatnonzero(np.diff(begins, prepend=self._given) != 0).tolist()
        steps = range(len(windows)) if self._single else sorted({0, *parts})
        for first, last in pairwise([*steps, len(windows)]):
            part = list(zip(windows[first:last], stamps[first:last].tolist(), strict=True))
            if begins[first] != self._given:  # the first run, or one after a gap
                self._given, self._unlike, self._waiting = float(begins[first]), [], []
                if self.spans is None:
                    self._begin(self._given, 0.0)
            if (begin := self._told(part[-1][1]) if self.spans is not None else self._found(part)) is not None:
                part = [each for each in self._outside if each[1] >= begin + self._lag.first] + part
                self._outside, self._waiting = [], []
                self._begin(begin, self._spread)
            until = self._until()
            inside = [each for each in part if each[1] <= until]
            self._outside = [*self._outside, *part[len(inside) :]][-HELD:]
            outside |= not inside
            kept += self._timed(self._waiting + inside)
        return kept, outside

    @property
    def _single(self) -> bool:
        """Whether any window may be the first one of a run."""
        return self.spans is not None or (self.searched and self._begins is not None)

    def _begin(self, begin: float, doubt: float) -> None:
        """Begin a run, before which there are samples if its begin is in `doubt` (s)."""
        self._run, self._first = begin, self._lag.first + doubt
        self._lag.begin()

    def _until(self) -> float:
        """Return the stamp (s) of the last window of the run."""
        if self.spans is not None:
            return min(self._end, self._run + self.longest)
        return self._run + (self._least if self._single else self.longest)

    def _timed(self, inside: list[_Window]) -> list[tuple[Any, float, float]]:
        """Return windows of the run with their times, unless they wait."""
        self._waiting = inside if inside and inside[-1][1] - self._run < self._lag.until else []
        if self._waiting or not inside:
            return []
        values, stamps = (np.array(each) for each in zip(*inside, strict=True))
        times = self._lag.feed(self._scaled(values), stamps - self._run)
        return [each for each in zip(values, stamps, times, strict=True) if each[2] >= self._first]

    def _scaled(self, windows: Floats) -> Floats:
        return np.asarray((windows[:, :, self._channels] - self._mean) / self._scale)

    def _told(self, stamp: float) -> float | None:
        """Return the begin of the new run in which the trigger puts a stamp, or None."""
        begin, self._end = next((each for each in reversed(self.spans or ()) if each[0] <= stamp), (-np.inf, -np.inf))
        return begin if begin not in (self._run, -np.inf) else None

    def _found(self, part: Sequence[_Window]) -> float | None:
        """Take the next windows. Return the begin (s) of a new run that the last of these belong to, or None."""
        if not self._single or self._begins is None:
            return None
        count, detector = self._begins["count"], self._phases
        for values, stamp in part:
            self._unlike.append((stamp, unlike_begin(detector, self._scaled(values[None]), count, self._apart)[0]))
        self._unlike = self._unlike[-count - 1 :]
        first = self._unlike[0][0]
        if len(self._unlike) <= count or first - self._run < count * self._apart + detector.begin:
            return None
        scores, offsets = scores_of(np.array([unlike for _, unlike in self._unlike]), count)
        begin = first - detector.begin - float(offsets_of(detector, self._apart)[offsets[0]])
        return begin if scores[0] <= min(scores[1], self._begins["limit"]) else None
