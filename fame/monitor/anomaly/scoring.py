"""Scoring of single points by a model, one after the other, as a running node does; several models as one.

Detectors complement each other: one sees small deviations of the path, another what no path shows. Each member of an
`Ensemble` keeps its own threshold. The score of a run is the largest (any of) or smallest (all of) of its members'
scores, each divided by the member's threshold; 1 is the threshold. Per point, any or all of the members must call it
anomalous.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fame.monitor.anomaly.benign_changes import Change
from fame.monitor.anomaly.recording import ANOMALOUS, Recording
from fame.monitor.pipeline.detectors import combined

if TYPE_CHECKING:
    from fame.monitor.anomaly.model import Model


_LEAST = 1e-9
"""Smallest threshold that a score is divided by: one of 0 is exceeded by any score."""


class Verdict(NamedTuple):
    """The verdict on a point. `magnitude` is in `unit` (``mm`` across the path, ``deg`` turned, ``samples`` late,
    ``rad``); `joint` is the one that is farthest from where it should be; `kind` is ``path``, ``orientation``,
    ``speed`` or empty. They are set for anomalous points only. `votes` are those of the members of an ensemble."""

    anomalous: bool
    magnitude: float = 0.0
    unit: str = ""
    joint: str = ""
    kind: str = ""
    votes: tuple[bool, ...] = ()


BENIGN_POINT = Verdict(False)


class Scorer:
    """Scores points one by one."""

    def reset(self) -> None:
        """The next run begins."""

    def step(self, values: Sequence[float], stamp: float | None = None) -> Verdict:
        """One point: values of the joints in the model's order, and its time (s) if known."""
        raise NotImplementedError

    def changes(self) -> Sequence[Change]:
        """Give the benign changes of the run so far."""
        return ()


class PointScorer(Scorer):
    """Scores each point on its own, by a classifier."""

    def __init__(self, model: Model) -> None:
        self._model, self._benign = model, model.estimator.decision(len(model.joints))

    def step(self, values: Sequence[float], stamp: float | None = None) -> Verdict:
        point = np.asarray(values, dtype=np.float64)
        if self._benign(point):
            return BENIGN_POINT
        joint, apart = self._model.worst_joint(point)
        return Verdict(True, apart, "rad", joint)


class PathScorer(Scorer):
    """For the detector in task space."""

    def __init__(self, model: Model) -> None:
        self._model, self._tracker = model, model.estimator.tracker()

    def reset(self) -> None:
        self._tracker.reset()

    def step(self, values: Sequence[float], stamp: float | None = None) -> Verdict:
        reading = self._tracker.step(values, stamp)
        if not reading.anomalous:
            return BENIGN_POINT
        joint, _ = self._model.worst_joint(np.asarray(values))
        if reading.off_path:
            return Verdict(True, 1000 * reading.deviation, "mm", joint, reading.kind)
        if reading.kind == "orientation":
            return Verdict(True, math.degrees(reading.tilt), "deg", joint, reading.kind)
        return Verdict(True, reading.lateness, "samples", joint, reading.kind)

    def changes(self) -> Sequence[Change]:
        return list(self._tracker.changes())


class Ensemble(NamedTuple):
    """A rule, ``any of`` or ``all of``, and the models that it combines."""

    rule: str
    members: tuple[Any, ...]

    def score(self, scores: Sequence[float]) -> float:
        """Combine the scores of a run by each member, in units of their thresholds."""
        relative = (score / max(member.threshold, _LEAST) for score, member in zip(scores, self.members, strict=True))
        return float(max(relative) if self.rule == "any of" else min(relative))

    def predict(self, recording: Recording) -> Any:
        """Labels (points,): +1 benign, -1 anomalous."""
        votes = np.array([member.predict(recording) == ANOMALOUS for member in self.members])
        return np.where(combined(self.rule, votes), -1, 1)


class EnsembleScorer(Scorer):
    """Scores points by all members. The magnitude is that of the first member that calls a point anomalous."""

    def __init__(self, ensemble: Ensemble) -> None:
        self._decide = any if ensemble.rule == "any of" else all
        self._scorers: list[Scorer] = [member.scorer() for member in ensemble.members]

    def reset(self) -> None:
        for scorer in self._scorers:
            scorer.reset()

    def step(self, values: Sequence[float], stamp: float | None = None) -> Verdict:
        verdicts = [scorer.step(values, stamp) for scorer in self._scorers]
        votes = tuple(verdict.anomalous for verdict in verdicts)
        first = next((verdict for verdict in verdicts if verdict.anomalous), verdicts[0])
        return first._replace(anomalous=self._decide(votes), votes=votes)

    def changes(self) -> Sequence[Change]:
        return [change for scorer in self._scorers for change in scorer.changes()]
