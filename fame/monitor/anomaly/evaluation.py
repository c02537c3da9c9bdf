"""Evaluation of classifiers: confusion matrices of points and runs, and the table of a learning run.

Positive means anomalous (label -1). A run is anomalous if its anomaly score, its anomalous points divided by all its
points, exceeds the threshold. The classifier that was chosen is marked in the table.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from fame.monitor.anomaly.learning_file import Candidate
from fame.monitor.anomaly.model import Model
from fame.monitor.anomaly.recording import ANOMALOUS, Recording


class ConfusionMatrix(NamedTuple):
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

    def plus(self, other: ConfusionMatrix) -> ConfusionMatrix:
        """Both counts together."""
        return ConfusionMatrix(*(mine + its for mine, its in zip(self, other, strict=True)))


class OutputMatrix:
    """The published role."""

    def output_matrix(self, true_y: Any, pred_y: Any) -> ConfusionMatrix:
        """The matrix of true and predicted labels (+1 benign, -1 anomalous), of points or of runs."""
        true, found = (np.asarray(labels).ravel() == ANOMALOUS for labels in (true_y, pred_y))
        counts = ((true & found), (~true & found), (~true & ~found), (true & ~found))
        return ConfusionMatrix(*(int(part.sum()) for part in counts))


def run_scores(recording: Recording, predicted: Any) -> list[float]:
    """The anomaly score of each run: its anomalous points divided by all its points."""
    return [float(np.mean(predicted[rows] == ANOMALOUS)) for rows in recording.slices()]


def by_point(recording: Recording, predicted: Any) -> ConfusionMatrix:
    return OutputMatrix().output_matrix(recording.labels, predicted)


def by_run(labels: list[int], scores: list[float], threshold: float) -> ConfusionMatrix:
    """A run is anomalous if its score exceeds the threshold."""
    return OutputMatrix().output_matrix(labels, [-1 if score > threshold else 1 for score in scores])


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else 0.0


TRAIN, VALIDATION, TEST = "train", "validation", "test"


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Results of a classifier on some data: matrices of points and runs, score and label of each run."""

    data: str
    points: ConfusionMatrix
    runs: ConfusionMatrix
    scores: tuple[float, ...]
    labels: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class TrainedClassifier:
    """A classifier with its model and its evaluations. `note` names what is doubtful about it."""

    candidate: Candidate
    model: Model
    evaluations: tuple[Evaluation, ...]
    note: str = ""

    def on(self, data: str) -> Evaluation | None:
        return next((item for item in self.evaluations if item.data == data), None)


HEADS = ("", "classifier", "data", "of", "TP", "FP", "TN", "FN", "accuracy", "recall", "precision", "F1", "threshold")
LEARNED_FROM = "train (learned from)"


def rows(learned: Sequence[TrainedClassifier], chosen: TrainedClassifier | None = None) -> list[tuple[str, ...]]:
    """Give the cells of the table, under `HEADS`. Data that was learned from is marked."""
    return [
        (
            "*" if item is chosen else "",
            item.candidate.name,
            data_name(evaluation),
            kind,
            *_cells(matrix),
            f"{item.model.threshold:.4g}",
        )
        for item in learned
        for evaluation in item.evaluations
        for kind, matrix in (("points", evaluation.points), ("runs", evaluation.runs))
    ]


def render(lines: Sequence[Sequence[str]], heads: Sequence[str] = HEADS) -> str:
    """Columns as wide as their longest cell."""
    widths = [max(len(line[column]) for line in (heads, *lines)) for column in range(len(heads))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in (heads, *lines)
    )


def plain(learned: Sequence[TrainedClassifier], chosen: TrainedClassifier) -> list[dict[str, Any]]:
    """The same as plain data for JSON."""
    return [
        {
            "name": item.candidate.name,
            "class": item.candidate.cls,
            "parameters": dict(item.candidate.parameters),
            "reduction": item.candidate.reduction,
            "threshold": item.model.threshold,
            "best": item is chosen,
            "note": item.note,
            "results": [
                {"data": data_name(evaluation), "points": _plain(evaluation.points), "runs": _plain(evaluation.runs)}
                for evaluation in item.evaluations
            ],
        }
        for item in learned
    ]


def data_name(evaluation: Evaluation) -> str:
    return evaluation.data.replace(TRAIN, LEARNED_FROM, 1) if evaluation.data.startswith(TRAIN) else evaluation.data


def _cells(matrix: ConfusionMatrix) -> tuple[str, ...]:
    ratios = (matrix.accuracy, matrix.recall, matrix.precision, matrix.f1)
    return (*map(str, matrix), *(f"{ratio:.4f}" for ratio in ratios))


def _plain(matrix: ConfusionMatrix) -> dict[str, float]:
    ratios = {name: getattr(matrix, name) for name in ("accuracy", "recall", "precision", "f1")}
    return {**matrix._asdict(), **ratios}
