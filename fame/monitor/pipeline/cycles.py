"""Runs of a task that repeats, found in the data of a machine that never stops, and how late each of them began.

A run begins where windows are like the first phases of the training runs (`Phases.unlike`), as like as those were, and
more so than shortly before and after. The phases are as few as tell a begin from every other place of the training
runs. A whole run may be late or early by up to `StartWithin`: the lag is that which made all of its windows so far most
like the phases. So a run that is late is no fault; a step or channel that is late against the others is. Runs whose
steps last longer now and then have such lags of their own, by which the search goes beyond `StartWithin`; otherwise a
run that begins as late would lack them. Begin and lag are found by the channels that tell most of the phase.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fame.dataclasses import replace
from fame.monitor.arrays import Floats, Whole
from fame.monitor.pipeline.phases import Phases

WITHIN = 0.2
"""How late or early (s) a whole run may be."""
LIKE = 1.5
"""How many times as unlike a begin may be as the most unlike one of the training."""
_LAGS = 8
"""Lags up to `StartWithin` that are tried, late and early, at most."""
_TELLING = 16
"""Channels by which begin and lag are found, at most: each costs as much."""
_COMPARED = 16
"""Windows of a begin that are compared, at most: live, each window costs as much."""
_APART = 0.6
"""Phases between two lags that are tried, about."""
_TINY = 1e-9
_PARTS = (8, 4, 2)
"""Which part of the phases is compared, at least 3 of them."""


def phases_of(detector: Any) -> Phases | None:
    """Return the detector of phases, or that among several."""
    return next((each for each in getattr(detector, "parts", (detector,)) if isinstance(each, Phases)), None)


def telling(detector: Phases) -> tuple[Phases, Whole]:
    """Return the phases of the channels that change most, in units of their scale, from one to the next, and which.

    What changes between two lags that are tried adds to the scale: in between, unlikeness is a parabola.
    """
    changes = np.abs(np.diff(detector.location, axis=0, append=detector.location[-1:]))
    order = np.argsort(-(changes / detector.scale).mean(axis=(0, 1)), kind="stable")
    chosen = np.sort(order[:_TELLING])
    location, scale, changes = (each[:, :, chosen] for each in (detector.location, detector.scale, changes))
    return replace(detector, location=location.copy(), scale=np.hypot(scale, _APART * changes)), chosen


def compared(count: int) -> Whole:
    """Return which of the first `count` windows of a run are compared: at most `_COMPARED`."""
    return np.unique(np.linspace(0, count - 1, _COMPARED).astype(np.int64))


def offsets_of(detector: Phases, apart: float) -> Floats:
    """Return how long (s) before the end of the first phase a run's first window may end, of those `apart` (s)."""
    return np.arange(0.0, apart - 1e-9, max(detector.step, apart / _LAGS))


def unlike_begin(detector: Phases, windows: Floats, count: int, apart: float) -> Floats:
    """Return how unlike each of scaled windows is to each of the compared ones of a begin: (n, offsets, compared)."""
    times = detector.begin + offsets_of(detector, apart)[:, None] + apart * compared(count)
    found = detector.unlike(windows, np.broadcast_to(times.reshape(1, -1), (len(windows), times.size)))
    return np.nan_to_num(found.reshape(len(windows), *times.shape), nan=np.inf)


def scores_of(unlike: Floats, count: int) -> tuple[Floats, Whole]:
    """Return for each window how unlike a begin it and those behind it are, with the best offset (its index)."""
    starts, places = max(0, len(unlike) - count + 1), compared(count)
    each = [unlike[place : place + starts, :, column] for column, place in enumerate(places)]
    scores = np.mean(each, axis=0)
    return scores.min(axis=1), scores.argmin(axis=1)


def found_of(detector: Phases | None, runs: Sequence[Floats], apart: float) -> dict[str, Any]:
    """Return as conditions of a model how a begin is found, by the scaled windows of the training runs, `apart` (s)."""
    if detector is None or not any(map(len, runs)):
        return {}
    detector, chosen = telling(detector)
    whole = [windows[:, :, chosen] for windows in runs if len(windows)]
    lasts = (len(detector.rows) or len(detector.location)) * detector.step
    for part in _PARTS:
        count = max(3, int(lasts / part / apart))
        scores = [
            score
            for score in (scores_of(unlike_begin(detector, windows, count, apart), count)[0] for windows in whole)
            if len(score)
        ]
        usual = max((float(score[0]) for score in scores), default=np.inf)
        other = min((float(score[count // 2 :].min()) for score in scores if len(score) > count // 2), default=np.inf)
        if LIKE * usual < other < np.inf:
            text = f"a run begins where the data are like the first {count * apart:.3g} s of the training runs"
            return {
                "begins": {"count": count, "limit": LIKE * usual},
                "begins_text": f"{text}: up to {LIKE * usual:.3g}; all else in them is {other:.3g} or more",
            }
    return {"begins_text": "a run cannot be told by its begin: other parts of the training runs are like it"}


class Lag:
    """The lag of the run that goes on. Its first windows wait until they show how late it may be."""

    def __init__(self, detector: Phases, within: float, spread: float = 0.0) -> None:
        """Search the lags up to `within`, and a `spread` (s) beyond."""
        reach = within + spread
        steps = min(np.ceil(_LAGS * reach / within), np.ceil(4 * reach / detector.step - 1e-9)) if within else 0
        step = reach / steps if steps else 0.0
        self._lags: Floats = step * np.arange(-steps - 1, steps + 2) if steps else np.zeros(1)  # one more to each side
        self._detector = detector
        self.first: float = detector.begin - 0.49 * detector.step
        """Since the begin of a run (s), from when its windows have a phase."""
        self._comparable = self.first + float(self._lags[-1])  # since then windows have a phase, whatever the lag
        self.until: float = detector.begin + float(self._lags[-1]) + within - 1e-6
        """Since the begin of a run (s), until when its windows wait."""
        self.begin()

    def begin(self) -> None:
        """Begin a run."""
        self._sums: Floats = np.zeros(len(self._lags))
        self._counts: Floats = np.zeros(len(self._lags))
        self._due, self._last = -np.inf, 0.0

    def feed(self, windows: Floats, since: Floats) -> Floats:
        """Return the times (n,) on the axis of phases of the next scaled windows of a run, which end at `since` (s).

        They are NaN before the begin of a run that is late: there is no phase yet. Windows closer to each other than
        phases are tell nothing new: one for each phase is compared.
        """
        places, new = self._compared(since), not self._counts.any()
        lags = np.array([self._last])
        if places:
            times = since[places, None] - self._lags
            unlike = self._detector.unlike(windows[places], times)
            known = np.isfinite(unlike)
            sums = self._sums + np.cumsum(np.where(known, unlike, 0.0), axis=0)
            counts = self._counts + np.cumsum(known, axis=0)
            self._sums, self._counts = sums[-1], counts[-1]
            mean = sums / np.maximum(counts, 1) + _TINY * np.abs(self._lags)  # of equal ones, the least
            enough = 2 * counts >= counts.max(axis=1, keepdims=True)
            lags = np.append(lags, self._least(np.where(enough, mean, np.inf)))
            self._last = float(lags[-1])
        last = np.searchsorted(places, np.arange(len(since)), side="right")
        waited = int(np.searchsorted(since[places], self.until))  # what waited is judged by what it waited for
        found = lags[np.maximum(last, min(waited + 1, len(places)) if waited or new else 0)]
        return np.asarray(np.where(since - found < self.first, np.nan, since - found))

    def _compared(self, since: Floats) -> list[int]:
        """Return which of the windows are compared: those that are a phase apart."""
        places = []
        for place, time in enumerate(since.tolist()):
            if time >= max(self._due, self._comparable):
                places.append(place)
                self._due = time + 0.99 * self._detector.step
        return places

    def _least(self, unlike: Floats) -> Floats:
        """Return the lag (n,) at which each row of (n, lags) is least: by the parabola through it and its neighbours,
        as runs need not be late by one of the lags."""
        rows, best = np.arange(len(unlike)), unlike.argmin(axis=1)
        lags = self._lags[best]
        if len(self._lags) < 3:
            return np.asarray(lags)
        place = np.clip(best, 1, len(self._lags) - 2)
        before, here, after = (unlike[rows, place + each] for each in (-1, 0, 1))
        with np.errstate(invalid="ignore"):
            bend, slope = before - 2 * here + after, before - after
        inside = (best == place) & np.isfinite(bend) & (bend > _TINY)
        shift = np.where(inside, 0.5 * slope / np.where(inside, bend, 1.0), 0.0)
        return np.asarray(lags + shift * (self._lags[1] - self._lags[0]))


def spread_of(detector: Phases, windows: Floats, times: Floats, within: float) -> float:
    """Return the largest lag (s) that a run of the training has in the end of its own, at most `within`: by the scaled
    windows of all runs in order, each with the time at its end, NaN where it has no phase."""
    detector, chosen = telling(detector)
    filled = np.nan_to_num(times, nan=np.inf)
    begins = np.flatnonzero(filled[1:] < filled[:-1]) + 1
    lag, largest = Lag(detector, within, within), 0.0
    for run, at in zip(np.split(windows[:, :, chosen], begins), np.split(times, begins), strict=True):
        known = np.isfinite(at)
        lag.begin()
        found = at[known] - lag.feed(run[known], at[known])
        largest = max(largest, float(np.abs(found[-1])) if np.isfinite(found[-1]) else 0.0)
    return min(within, largest)
