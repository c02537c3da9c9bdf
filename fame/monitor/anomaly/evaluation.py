"""OutputMatrix: the confusion matrix and what follows from it. Positive means anomalous (label -1).

Learning: every classifier of a learning file fitted and judged; the best of them as a model to store.

Each is judged three ways. *train*: on the very data that it learned from, which flatters, and says so. *validation*:
runs are put into contiguous folds, and each fold is judged by a classifier that never saw it; scaling and components
are learned anew without it too. *test*: the testing files, unless one holds training runs, which makes it train.

The threshold on the score of a run is the given number. ``auto`` is the lowest score over the held-out anomalous runs
(the largest value just below it), and must exceed the highest score of held-out benign ones.
The best is the one with the highest F1 of validation runs, then of validation points, then (without anomalous runs F1
is 0) with the highest accuracy; the first among equals.


What learning tells: a line per classifier and data, the best one marked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from fame.monitor.anomaly.learning_file import Entry
from fame.monitor.anomaly.model import Model
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


TRAIN, VALIDATION, TEST = "train", "validation", "test"


@dataclass(frozen=True, slots=True)
class Judged:
    """How a classifier did on some data: matrices of points and runs, and the score and label of each run."""

    data: str
    points: Matrix
    runs: Matrix
    scores: tuple[float, ...]
    labels: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Learned:
    """One classifier: its model and how it did. `note` says what is doubtful about it."""

    entry: Entry
    model: Model
    judged: tuple[Judged, ...]
    note: str = ""

    def on(self, data: str) -> Judged | None:
        return next((item for item in self.judged if item.data == data), None)


HEADS = ("", "classifier", "data", "of", "TP", "FP", "TN", "FN", "accuracy", "recall", "precision", "F1", "threshold")
LEARNED_FROM = "train (learned from)"


def rows(learned: Sequence[Learned], chosen: Learned | None = None) -> list[tuple[str, ...]]:
    """The cells of the table, under `HEADS`. Data that was learned from says so."""
    return [
        (
            "*" if item is chosen else "",
            item.entry.name,
            data_name(judged),
            kind,
            *_cells(matrix),
            f"{item.model.threshold:.4g}",
        )
        for item in learned
        for judged in item.judged
        for kind, matrix in (("points", judged.points), ("runs", judged.runs))
    ]


def render(lines: Sequence[Sequence[str]], heads: Sequence[str] = HEADS) -> str:
    """Columns as wide as their longest cell."""
    widths = [max(len(line[column]) for line in (heads, *lines)) for column in range(len(heads))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in (heads, *lines)
    )


def plain(learned: Sequence[Learned], chosen: Learned) -> list[dict[str, Any]]:
    """The same as plain data for JSON."""
    return [
        {
            "name": item.entry.name,
            "class": item.entry.cls,
            "parameters": dict(item.entry.parameters),
            "reduction": item.entry.reduction,
            "threshold": item.model.threshold,
            "best": item is chosen,
            "note": item.note,
            "results": [
                {"data": data_name(judged), "points": _plain(judged.points), "runs": _plain(judged.runs)}
                for judged in item.judged
            ],
        }
        for item in learned
    ]


def data_name(judged: Judged) -> str:
    return judged.data.replace(TRAIN, LEARNED_FROM, 1) if judged.data.startswith(TRAIN) else judged.data


def _cells(matrix: Matrix) -> tuple[str, ...]:
    ratios = (matrix.accuracy, matrix.recall, matrix.precision, matrix.f1)
    return (*map(str, matrix), *(f"{ratio:.4f}" for ratio in ratios))


def _plain(matrix: Matrix) -> dict[str, float]:
    ratios = {name: getattr(matrix, name) for name in ("accuracy", "recall", "precision", "f1")}
    return {**matrix._asdict(), **ratios}
