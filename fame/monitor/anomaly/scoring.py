"""Scoring of single points by a model, one after the other, as a running node does; several detectors as one.

Detectors complement each other: one sees small deviations of the path, another what no path shows. Several in one keep
their own thresholds. The score of a run is the largest (any of) or smallest (all of) of their scores, each divided by
its threshold; 1 is the threshold. Per point, any or all of them must call it anomalous.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fame.monitor.anomaly.benign_changes import NO_READING, Change, PointScores
from fame.monitor.arrays import Floats

if TYPE_CHECKING:
    from fame.monitor.anomaly.paths import Tracker


class PointVerdict(NamedTuple):
    """The verdict on a point. `magnitude` is in `unit` (``mm`` across the path, ``deg`` turned, ``samples`` late,
    ``rad``); `joint` is the one that is farthest from where it should be; `kind` is ``path``, ``orientation``,
    ``speed`` or empty. They are those of the first detector that calls the point anomalous. `votes` are those of all
    detectors."""

    anomalous: bool
    magnitude: float = 0.0
    unit: str = ""
    joint: str = ""
    kind: str = ""
    votes: tuple[bool, ...] = ()


class PointTracker:
    """Scores each point on its own, by what tells whether it is benign."""

    def __init__(self, benign: Callable[[Floats], bool]) -> None:
        self._benign = benign

    def reset(self) -> None:
        """A new run begins."""

    def step(self, values: Sequence[float], stamp: float | None = None) -> PointScores:
        return NO_READING if self._benign(np.asarray(values, dtype=np.float64)) else _NOT_BENIGN

    def changes(self) -> Sequence[Change]:
        return ()


_NOT_BENIGN = NO_READING._replace(anomalous=True)


class Scorer:
    """Scores points by detectors that decide together. `worst` gives the joint of a point that is farthest from where
    it should be, and how far (rad)."""

    def __init__(
        self, rule: str, trackers: Sequence[Tracker | PointTracker], worst: Callable[[Floats], tuple[str, float]]
    ) -> None:
        self._decide, self._trackers, self._worst = any if rule == "any of" else all, trackers, worst

    def reset(self) -> None:
        """The next run begins."""
        for tracker in self._trackers:
            tracker.reset()

    def step(self, values: Sequence[float], stamp: float | None = None) -> PointVerdict:
        """Return one point: values of the joints in the model's order, and its time (s) if known."""
        readings = [tracker.step(values, stamp) for tracker in self._trackers]
        votes = tuple(reading.anomalous for reading in readings)
        if True not in votes:
            return PointVerdict(False, votes=votes)
        first = readings[votes.index(True)]
        joint, apart = self._worst(np.asarray(values, dtype=np.float64))
        magnitude, unit = _magnitude(first) if first.kind else (apart, "rad")
        return PointVerdict(self._decide(votes), magnitude, unit, joint, first.kind, votes)

    def changes(self) -> Sequence[Change]:
        """Return the benign changes of the run so far."""
        return [change for tracker in self._trackers for change in tracker.changes()]


def _magnitude(reading: PointScores) -> tuple[float, str]:
    if reading.off_path:
        return 1000 * reading.deviation, "mm"
    return (math.degrees(reading.tilt), "deg") if reading.kind == "orientation" else (reading.lateness, "samples")
