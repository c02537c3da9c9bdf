"""What learning tells: a line per classifier and data, the best one marked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fame.monitor.anomaly.confusion_matrix import Matrix
from fame.monitor.anomaly.learn import TRAIN, Judged, Learned

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
