"""Runs of a task that repeats, found in the data of a machine that never stops, and how late each of them began.

A run begins where windows are like the first phases of the training runs (`Phases.unlike`), as like as those were, and
more so than shortly before and after. The phases are as few as tell a begin from every other place of the training
runs. A whole run may be late or early by up to `StartWithin`: the lag is that which made all of its windows so far most
like the phases. So a run that is late is no fault; a step or channel that is late against the others is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fame.monitor.arrays import Floats, Whole
from fame.monitor.pipeline.phases import Phases

WITHIN = 0.2
"""How late or early (s) a whole run may be."""
LIKE = 1.5
"""A begin may be so many times as unlike as the most unlike one of the training."""
_LAGS = 8
"""Lags that are tried, late and early, at most."""
_COMPARED = 16
"""Windows of a begin that are compared, at most: live, each window costs as much."""
_PARTS = (8, 4, 2)
"""Which part of the phases is compared, at least 3 of them."""


def phases_of(detector: Any) -> Phases | None:
    """Return the detector of phases, or that among several."""
    return next((each for each in getattr(detector, "parts", (detector,)) if isinstance(each, Phases)), None)


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
    whole = [windows for windows in runs if len(windows)]
    if detector is None or not whole:
        return {}
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

    def __init__(self, detector: Phases, within: float) -> None:
        steps = min(_LAGS, int(np.ceil(4 * within / detector.step - 1e-9)))
        lags = np.linspace(-within, within, 2 * steps + 1)
        self._lags = lags[np.argsort(np.abs(lags), kind="stable")]  # of equal ones, the least
        self._detector = detector
        self.first: float = detector.begin - 0.1 * detector.step
        """Since the begin of a run (s), from when its windows have a phase."""
        self.until: float = detector.begin + 2 * within - 1e-6
        """Since the begin of a run (s), until when its windows wait."""
        self.begin()

    def begin(self) -> None:
        """Begin a run."""
        self._sums: Floats = np.zeros(len(self._lags))
        self._counts: Floats = np.zeros(len(self._lags))

    def feed(self, windows: Floats, since: Floats) -> Floats:
        """Return the times (n,) on the axis of phases of the next scaled windows of a run, which end at `since` (s).

        They are NaN before the begin of a run that is late: there is no phase yet.
        """
        times = since[:, None] - self._lags
        unlike = self._detector.unlike(windows, times)
        known = np.isfinite(unlike)
        sums = self._sums + np.cumsum(np.where(known, unlike, 0.0), axis=0)
        counts = self._counts + np.cumsum(known, axis=0)
        self._sums, self._counts = sums[-1], counts[-1]
        first = int(np.searchsorted(since, self.until))  # what waited is judged by what it waited for
        rows = np.maximum(np.arange(len(since)), min(first, len(since) - 1))
        mean = np.where(2 * counts[rows] >= counts[rows].max(axis=1, keepdims=True), sums[rows], np.inf)
        best = (mean / np.maximum(counts[rows], 1)).argmin(axis=1)
        times = times[np.arange(len(times)), best]
        return np.asarray(np.where(times < self.first, np.nan, times))
