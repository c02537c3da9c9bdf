"""Several models as one: ``any of path, rbfsvm``, ``all of ...``.

Detectors complement each other: one sees small deviations of the path, another what no path shows. Each member keeps
its own threshold. The score of a run is the largest (any of) or smallest (all of) of its members' scores, each divided
by the member's threshold; 1 is the threshold. Per point, any or all of the members must call it anomalous.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from fame.monitor.anomaly.benign_changes import Change
from fame.monitor.anomaly.recording import ANOMALOUS, Recording
from fame.monitor.anomaly.scoring import Scorer, Verdict
from fame.monitor.pipeline.detectors import combined

_LEAST = 1e-9
"""Smallest threshold that a score is divided by: one of 0 is exceeded by any score."""


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


class EnsembleScorer:
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
