"""OutputMatrix: the confusion matrix and what follows from it. Positive means anomalous (label -1)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fame.monitor.anomaly.recording import ANOMALOUS, Recording


class Matrix(NamedTuple):
    """Counts of points or runs."""

    tp: int
    fp: int
    tn: int
    fn: int

    @property
    def accuracy(self) -> float:
        return _ratio(self.tp + self.tn, sum(self))

    @property
    def recall(self) -> float:
        return _ratio(self.tp, self.tp + self.fn)

    @property
    def precision(self) -> float:
        return _ratio(self.tp, self.tp + self.fp)

    @property
    def f1(self) -> float:
        return _ratio(2 * self.tp, 2 * self.tp + self.fp + self.fn)

    def plus(self, other: Matrix) -> Matrix:
        """Both counts together."""
        return Matrix(*(mine + its for mine, its in zip(self, other, strict=True)))


class OutputMatrix:
    """The published role."""

    def output_matrix(self, true_y: Any, pred_y: Any) -> Matrix:
        """The matrix of true and predicted labels (+1 benign, -1 anomalous), of points or of runs."""
        true, found = (np.asarray(labels).ravel() == ANOMALOUS for labels in (true_y, pred_y))
        counts = ((true & found), (~true & found), (~true & ~found), (true & ~found))
        return Matrix(*(int(part.sum()) for part in counts))


def run_scores(recording: Recording, predicted: Any) -> list[float]:
    """The anomaly score of each run: its anomalous points divided by all its points."""
    return [float(np.mean(predicted[rows] == ANOMALOUS)) for rows in recording.slices()]


def by_point(recording: Recording, predicted: Any) -> Matrix:
    return OutputMatrix().output_matrix(recording.labels, predicted)


def by_run(labels: list[int], scores: list[float], threshold: float) -> Matrix:
    """A run is anomalous if its score exceeds the threshold."""
    return OutputMatrix().output_matrix(labels, [-1 if score > threshold else 1 for score in scores])


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else 0.0
