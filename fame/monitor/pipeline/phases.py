"""The detector that knows the phase of a run: windows against those of the same time since the start.

Robots repeat. For each phase, a time since the start of the run, or since the active element of the mission began
(`fame.monitor.pipeline.elements`), it has the median of the training runs and a scale:
the median absolute deviation, averaged with the neighbouring phases and shrunk towards that of the channel, since few
runs estimate it badly. A deviation is divided by its scale, and its inverse hyperbolic sine is taken: beyond one scale,
tails count by their logarithm. Deviations of one window belong together, in time and across channels: the inverse root
of their covariance, shrunk by Ledoit and Wolf (2004), gives each direction its due. It is one for all phases: a single
phase has as many deviations as there are runs, fewer than a window has values. The loss of a channel is the mean of the
squares of its part. It sees small changes of shape, but little of a shift, which runs differ by; so the square
of the mean deviation of the window counts as well, and the larger of both is the loss.

A window outside the phases that at least half of the runs have, or of an unknown time, is judged the same way against
all windows of the training, whatever their time. All losses are in units of their usual ones, so that one threshold
holds for all.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from fame.dataclasses import dataclass, field
from fame.errors import ConfigError
from fame.imports import require
from fame.monitor.arrays import Floats, Whole

if TYPE_CHECKING:
    from fame.monitor.pipeline.training_settings import Training

POINTS = 10
"""Values per channel that a window is reduced to, by means of equal parts, where windows are compared to each other."""
LARGEST = 3000
"""Values of a window (samples x channels) whose covariance is computed, at most: a matrix of 72 MB, which takes about
half a core at 100 windows per s."""
_FAR = 4.0
"""Mean square of the deviations beyond which a channel is as unlike as can be: one alone decides nothing."""
_TINY = 1e-12
_SMOOTH = 5
"""Phases over which variances are averaged."""
_PRIOR = 4.0
"""Weight of the variance of a channel in that of one phase, in runs."""
_BETWEEN = 0.3
"""Deviation, in bends of the course, of a run that was sampled between two phases: training runs that begin with their
first sample do not show it."""
_STIFF = 0.05
"""Smallest scale of a phase, relative to that of its channel."""


def refuse_large(windows: Floats, detector: str) -> None:
    """Raise ConfigError for windows (n, samples, channels) whose covariance would be too large."""
    _, window, channels = windows.shape
    size = window * channels
    if size > LARGEST:
        text = (
            f"{detector} needs a matrix of {size} x {size} ({8e-6 * size**2:.0f} MB) for windows of {window} samples "
            f"and {channels} channels; at most {LARGEST} values: Window {LARGEST // channels} or less, or fewer Columns"
        )
        more = ", or Detector phase" if channels * POINTS <= LARGEST and detector != Phases.kind else ""
        raise ConfigError(text + more, element="Training.detector")


def reduced(windows: Floats) -> Floats:
    """Return the means of equal parts of each window: (n, at most `POINTS`, channels)."""
    bounds = np.linspace(0, windows.shape[1], min(POINTS, windows.shape[1]) + 1).astype(int)
    sums = np.add.reduceat(windows, bounds[:-1], axis=1)
    return np.asarray(sums / np.diff(bounds)[None, :, None])


@dataclass(frozen=True, slots=True)
class Phases:
    """What is usual in each phase, and everywhere.

    begin, step  s since the start at the end of the first window, and from one phase to the next
    location     (phases, points, channels), of the reduced windows; `scale` of their deviations
    root         (points x channels, same): whitens the deviations; `elsewhere` those from the mean of all windows
    usual        (3, channels): the losses that count as 1, of shape and shift in a phase, and elsewhere
    rows         (times,): the phase at each step from `begin`, -1 where none is known; empty: all, one per step
    """

    kind: ClassVar[str] = "phase"
    begin: float
    step: float
    location: Floats
    scale: Floats
    root: Floats
    elsewhere: Floats
    usual: Floats
    rows: Whole = field(default_factory=lambda: np.zeros(0, np.int64))

    def phase(self, times: Floats) -> Whole:
        """Return the row of the phase of each time (s on the axis of phases), -1 where none is known."""
        rows = self.rows if len(self.rows) else np.arange(len(self.location))
        found = np.round((times - self.begin) / self.step)
        known = (found >= 0) & (found < len(rows))  # False for NaN
        return np.where(known, rows[np.where(known, found, 0).astype(np.int64)], -1)

    def deviations(self, values: Floats, times: Floats) -> Floats:
        """Return the deviations (n, points, channels) of reduced windows from the phases at `times`, which are known:
        between two phases, from the mean of both, weighted by their distances."""
        place = np.floor((times - self.begin) / self.step + 1e-6)
        share = np.clip((times - self.begin) / self.step - place, 0, 1)[:, None, None]
        near = self.phase(times)
        low, high = (self.phase(self.begin + each * self.step) for each in (place, place + 1))
        low, high = np.where(low < 0, near, low), np.where(high < 0, near, high)
        usual = self.location[low] * (1 - share) + self.location[high] * share
        return np.asarray((values - usual) / self.scale[near])

    def unlike(self, windows: Floats, times: Floats) -> Floats:
        """Return how unlike scaled windows (n, window, channels) are to the phases at `times` (n, m): the mean square
        of the deviations of a channel, at most `_FAR`, on average; NaN where no phase is known."""
        values, found = reduced(windows), np.full(times.shape, np.nan)
        block = max(1, LARGEST**2 // (times.shape[1] * values[0].size)) if len(values) else 1
        for first in range(0, len(values), block):
            part = times[first : first + block]
            known = self.phase(part) >= 0
            rows = np.nonzero(known)[0] + first
            deviations = np.arcsinh(self.deviations(values[rows], part[known]))
            squares = np.einsum("npc,npc->nc", deviations, deviations) / deviations.shape[1]
            found[first : first + block][known] = np.minimum(squares, _FAR).mean(axis=1)
        return found

    def loss(self, windows: Floats, times: Floats | None = None) -> Floats:
        """Return the loss (n, channels) of scaled windows (n, window, channels) that end at `times`, s since the start;
        without them, or where they are NaN, no phase is known."""
        values = reduced(windows)
        times = np.full(len(values), np.nan) if times is None else times
        known, found = self.phase(times) >= 0, np.empty((len(values), values.shape[2]))
        if known.any():
            deviations = self.deviations(values[known], times[known])
            shape, shift = _whitened(deviations, self.root), _shift(deviations)
            found[known] = np.maximum(shape / self.usual[0], shift / self.usual[1])
        if not known.all():
            found[~known] = _whitened(values[~known], self.elsewhere) / self.usual[2]
        return found

    @classmethod
    def fit(cls, windows: Floats, settings: Training, times: Floats | None = None) -> Phases:
        """Learn from windows of several runs in order, each with the time at its end, s on the axis of phases; NaN
        where no phase is to be learned."""
        values = reduced(windows)
        refuse_large(values, cls.kind)
        at = np.zeros(len(values)) if times is None else times
        timed = np.isfinite(at)
        begin, step = float(at[timed].min(initial=np.inf)), _step(at)
        numbers = np.round((at[timed] - begin) / step).astype(np.int64)
        rows = _rows(numbers)
        places, inside = rows[numbers], values[timed][rows[numbers] >= 0]
        numbers, places = numbers[places >= 0], places[places >= 0]
        grouped = _grouped(inside, places)
        location = np.nanmedian(grouped, axis=1)
        scale = np.hypot(_scale(grouped - location[:, None]), _BETWEEN * _bend(location))
        deviations = (inside - location[places]) / scale[places]
        apart = numbers % max(1, settings.window // settings.stride) == 0  # windows that do not overlap
        root, elsewhere = _root(deviations[apart]), _root(inside[apart])
        found = _whitened(deviations, root), _shift(deviations), _whitened(values, elsewhere)
        usual = [np.quantile(part, 0.99, axis=0) for part in found]
        return cls(begin, step, location, scale, root, elsewhere, np.maximum(usual, _TINY), rows)


def _step(times: Floats) -> float:
    """Return the usual time from one window to the next (s), or 1 for a single window."""
    steps = np.diff(times)
    steps = steps[steps > _TINY]
    return float(np.median(steps)) if len(steps) else 1.0


def _rows(numbers: Whole) -> Whole:
    """Number the phases that have windows, at least half as many as the one before or behind; -1 for the others."""
    counts = np.bincount(numbers)
    beside = np.maximum(np.append(0, counts[:-1]), np.append(counts[1:], 0))
    enough = counts >= np.maximum(1, beside / 2)
    return np.where(enough, np.cumsum(enough) - 1, -1)


def _grouped(values: Floats, places: Whole) -> Floats:
    """Return windows by phase: (phases, most, points, channels), NaN where a phase has fewer than the most."""
    order = np.argsort(places, kind="stable")
    first = np.concatenate(([0], np.cumsum(np.bincount(places))[:-1]))
    within = np.arange(len(order)) - first[places[order]]
    grouped = np.full((int(places.max()) + 1, int(within.max()) + 1, *values.shape[1:]), np.nan)
    grouped[places[order], within] = values[order]
    return grouped


def _scale(deviations: Floats) -> Floats:
    """Return a robust deviation per phase, point and channel of (phases, runs, points, channels)."""
    runs = deviations.shape[1]
    variances = (1.4826 * np.nanmedian(np.abs(deviations), axis=1)) ** 2
    edges = np.pad(variances, ((_SMOOTH // 2, _SMOOTH // 2), (0, 0), (0, 0)), mode="edge")
    smooth = np.mean([edges[n : n + len(variances)] for n in range(_SMOOTH)], axis=0)
    pooled = np.mean(variances, axis=(0, 1))
    shrunk = (smooth * runs + pooled * _PRIOR) / (runs + _PRIOR)
    return np.asarray(np.sqrt(np.maximum(shrunk, np.maximum(_STIFF**2 * pooled, _TINY))))


def _bend(location: Floats) -> Floats:
    """Return how far each phase lies from the line through its neighbours, (phases, points, channels)."""
    if len(location) < 3:
        return np.zeros_like(location)
    bends = np.abs(np.diff(location, 2, axis=0))
    return np.concatenate((bends[:1], bends, bends[-1:]))


def _root(deviations: Floats) -> Floats:
    """Return the symmetric root of the inverse covariance of deviations (n, points, channels)."""
    require("sklearn")
    from sklearn.covariance import ledoit_wolf

    flat = np.arcsinh(deviations).reshape(len(deviations), -1)
    covariance, _ = ledoit_wolf(flat, assume_centered=True)
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors / np.sqrt(np.maximum(values, _TINY))) @ vectors.T)


def _whitened(deviations: Floats, root: Floats) -> Floats:
    """Return the mean square of each channel (n, channels) of whitened deviations (n, points, channels)."""
    white = (np.arcsinh(deviations).reshape(len(deviations), -1) @ root).reshape(deviations.shape)
    return np.asarray(np.einsum("npc,npc->nc", white, white) / deviations.shape[1])


def _shift(deviations: Floats) -> Floats:
    """Return the squared mean of each channel (n, channels) of deviations (n, points, channels)."""
    return np.asarray(np.arcsinh(deviations).mean(axis=1) ** 2)
