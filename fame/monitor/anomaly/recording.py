"""A recording: joint states over time, cut into runs of the task."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Whole: TypeAlias = NDArray[np.int64]

BENIGN, ANOMALOUS = 1, -1


@dataclass(frozen=True, slots=True)
class Recording:
    """Points, one per row.

    joints  names of the columns
    values  (points, joints): rad, or whatever field was recorded
    labels  (points,): +1 benign, -1 anomalous
    runs    (points,): the number of the run that a point belongs to; ascending, from 0 on, without gaps
    stamps  (points,): s, or None if the file has none
    source  the file, for messages
    notes   what was odd about the file and what was done about it, a line each
    """

    joints: tuple[str, ...]
    values: Floats
    labels: Whole
    runs: Whole
    stamps: Floats | None = None
    source: str = ""
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.values)

    @property
    def count(self) -> int:
        """How many runs there are."""
        return int(self.runs[-1]) + 1 if len(self.runs) else 0

    def slices(self) -> list[slice]:
        """The rows of each run."""
        bounds = [0, *(np.flatnonzero(np.diff(self.runs)) + 1).tolist(), len(self.runs)]
        return [slice(first, last) for first, last in pairwise(bounds)] if len(self.runs) else []

    def run_labels(self) -> list[int]:
        """The label of each run."""
        return [int(self.labels[rows.start]) for rows in self.slices()]

    def __iter__(self) -> Iterator[Recording]:
        """Each run as a recording of its own."""
        for rows in self.slices():
            yield self.rows(rows)

    def rows(self, chosen: slice | NDArray[np.bool_]) -> Recording:
        """Some of the points, runs numbered anew."""
        numbers = self.runs[chosen]
        renumbered = np.cumsum(np.diff(numbers, prepend=numbers[:1]) != 0).astype(np.int64)
        stamps = None if self.stamps is None else self.stamps[chosen]
        return replace(self, values=self.values[chosen], labels=self.labels[chosen], runs=renumbered, stamps=stamps)

    def select(self, numbers: Sequence[int]) -> Recording:
        """Some of the runs, in their order."""
        return self.rows(np.isin(self.runs, numbers))


def join(recordings: Sequence[Recording]) -> Recording:
    """One after another. All must have the same number of joints; stamps are kept if all have them."""
    offsets = np.cumsum([0, *(item.count for item in recordings)])
    stamps = [item.stamps for item in recordings]
    return Recording(
        joints=recordings[0].joints,
        values=np.vstack([item.values for item in recordings]),
        labels=np.concatenate([item.labels for item in recordings]),
        runs=np.concatenate([item.runs + offset for item, offset in zip(recordings, offsets, strict=False)]),
        stamps=None if any(item is None for item in stamps) else np.concatenate([s for s in stamps if s is not None]),
        source=", ".join(dict.fromkeys(item.source for item in recordings)),
        notes=tuple(note for item in recordings for note in item.notes),
    )


def of_runs(runs: Sequence[Floats], label: int, joints: Sequence[str], source: str = "") -> Recording:
    """A recording made of runs, each an array (points, joints)."""
    lengths = [len(run) for run in runs]
    return Recording(
        joints=tuple(joints),
        values=np.vstack(runs),
        labels=np.full(sum(lengths), label, dtype=np.int64),
        runs=np.repeat(np.arange(len(runs), dtype=np.int64), lengths),
        source=source,
    )
