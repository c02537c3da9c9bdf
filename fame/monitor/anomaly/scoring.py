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

from fame.monitor.anomaly.benign_changes import Change
from fame.monitor.arrays import Floats

if TYPE_CHECKING:
    from fame.monitor.anomaly.paths import PathDetector


class PointVerdict(NamedTuple):
    """The verdict on a point. `magnitude` is in `unit` (``mm`` across the path, ``deg`` turned, ``samples`` late,
    ``rad``); `joint` is the one that is farthest from where it should be; `kind` is ``path``, ``orientation``,
    ``speed`` or empty. They are set for anomalous points only. `votes` are those of several detectors."""

    anomalous: bool
    magnitude: float = 0.0
    unit: str = ""
    joint: str = ""
    kind: str = ""
    votes: tuple[bool, ...] = ()


BENIGN_POINT = PointVerdict(False)


class Scorer:
    def reset(self) -> None:
        """Begin the next run."""

    def step(self, values: Sequence[float], stamp: float | None = None) -> PointVerdict:
        """Score one point: values of the joints in the model's order, and its time (s) if known."""
        raise NotImplementedError

    def changes(self) -> Sequence[Change]:
        """Return the benign changes of the run so far."""
        return ()


Worst = Callable[[Floats], tuple[str, float]]
"""Gives the joint of a point that is farthest from where it should be, and how far (rad)."""


class PointScorer(Scorer):
    """Scores each point on its own, by what tells whether it is benign."""

    def __init__(self, benign: Callable[[Floats], bool], worst: Worst) -> None:
        self._benign, self._worst = benign, worst

    def step(self, values: Sequence[float], stamp: float | None = None) -> PointVerdict:
        point = np.asarray(values, dtype=np.float64)
        if self._benign(point):
            return BENIGN_POINT
        joint, apart = self._worst(point)
        return PointVerdict(True, apart, "rad", joint)


class PathScorer(Scorer):
    """For the detector in task space."""

    def __init__(self, detector: PathDetector, worst: Worst) -> None:
        self._tracker, self._worst = detector.tracker(), worst

    def reset(self) -> None:
        self._tracker.reset()

    def step(self, values: Sequence[float], stamp: float | None = None) -> PointVerdict:
        reading = self._tracker.step(values, stamp)
        if not reading.anomalous:
            return BENIGN_POINT
        joint, _ = self._worst(np.asarray(values))
        if reading.off_path:
            return PointVerdict(True, 1000 * reading.deviation, "mm", joint, reading.kind)
        if reading.kind == "orientation":
            return PointVerdict(True, math.degrees(reading.tilt), "deg", joint, reading.kind)
        return PointVerdict(True, reading.lateness, "samples", joint, reading.kind)

    def changes(self) -> Sequence[Change]:
        return list(self._tracker.changes())


class SeveralScorer(Scorer):
    """Scores points by several. The magnitude is that of the first that calls a point anomalous."""

    def __init__(self, rule: str, scorers: Sequence[Scorer]) -> None:
        self._decide, self._scorers = any if rule == "any of" else all, scorers

    def reset(self) -> None:
        for scorer in self._scorers:
            scorer.reset()

    def step(self, values: Sequence[float], stamp: float | None = None) -> PointVerdict:
        verdicts = [scorer.step(values, stamp) for scorer in self._scorers]
        votes = tuple(verdict.anomalous for verdict in verdicts)
        first = next((verdict for verdict in verdicts if verdict.anomalous), verdicts[0])
        return first._replace(anomalous=self._decide(votes), votes=votes)

    def changes(self) -> Sequence[Change]:
        return [change for scorer in self._scorers for change in scorer.changes()]
