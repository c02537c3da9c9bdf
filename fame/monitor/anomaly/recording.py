"""Recordings: joint states over time, cut into runs of the task, and their CSV files.

A file has a header as `CollectNode` writes it: ``stamp`` (s), ``run``, one column per joint, ``label``; stamp and run
may be missing. Published data have no header: the learning file names the columns, and `segmentation` finds the runs.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fame.errors import ConfigError
from fame.monitor.anomaly.segmentation import number_runs, separators
from fame.monitor.arrays import Floats, Whole
from fame.monitor.tables import LABEL, RUN, STAMP, Table, read_table

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


_FORMAT = "%.10g"


def read_csv(path: str | Path, inputs: Sequence[int] | None = None, output: int | None = None) -> Recording:
    """Read a recording.

    `inputs` and `output` are 0-based columns; by default those that the header names, or all but the last and the last.
    All-zero separator rows are left out, and noted in `notes`. Raises ConfigError for anything that is not a table of
    finite numbers.
    """
    path = Path(path)
    table = read_table(path)
    inputs, output = _columns(table, path, inputs, output)
    values, labels = table.cells[:, inputs], _labels(table, output, path)
    _reject_gaps(table, [*inputs, *(table.names.index(name) for name in (STAMP, RUN) if name in table.names)], path)
    stamps = table.cells[:, table.names.index(STAMP)] if STAMP in table.names else None
    if RUN in table.names:
        given = table.cells[:, table.names.index(RUN)]
        kept = ~separators(values)
        runs = np.cumsum(np.diff(given[kept], prepend=given[kept][:1]) != 0).astype(np.int64)
    else:
        kept, runs = number_runs(values, labels)
    names = tuple(table.names[column] if table.names else f"joint_{column + 1}" for column in inputs)
    times = None if stamps is None else stamps[kept]
    return Recording(names, values[kept], labels[kept], runs, times, str(path), _notes(path, table, kept))


def write_csv(path: str | Path, recording: Recording) -> None:
    """Write a recording with a header; times to the nanosecond."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8", newline="") as stream:
        rows = csv.writer(stream, lineterminator="\n")
        rows.writerow([*([STAMP] if recording.stamps is not None else []), RUN, *recording.joints, LABEL])
        for index, values in enumerate(recording.values):
            stamp = [] if recording.stamps is None else [f"{recording.stamps[index]:.9f}"]
            cells = [_FORMAT % value for value in values]
            rows.writerow([*stamp, int(recording.runs[index]), *cells, int(recording.labels[index])])


def merge(paths: Sequence[str | Path]) -> Recording:
    """Labelled files as one recording. Raises ConfigError if they are not of the same joints."""
    recordings = [read_csv(path) for path in paths]
    require_same_joints(recordings)
    return join(recordings)


def require_same_joints(recordings: Sequence[Recording]) -> None:
    """Raises ConfigError if two have different joints; names made up for a headerless file fit any."""
    for first, other in combinations(recordings, 2):
        if not _same(other.joints, first.joints):
            raise ConfigError(
                f"has the {len(other.joints)} joints {', '.join(other.joints)}; expected the {len(first.joints)} of "
                f"{first.source} ({', '.join(first.joints)})",
                file=other.source,
            )


def _same(some: Sequence[str], others: Sequence[str]) -> bool:
    """Whether there are as many, and all of the same name, unless one of them was made up."""
    made_up = re.compile(r"joint_\d+").fullmatch
    return len(some) == len(others) and all(
        one == other or made_up(one) or made_up(other) for one, other in zip(some, others, strict=True)
    )


def _notes(path: Path, table: Table, kept: NDArray[np.bool_]) -> tuple[str, ...]:
    """Describe the separator rows that were left out."""
    apart = np.flatnonzero(~kept)
    if not len(apart):
        return ()
    lines = ", ".join(str(row + table.first) for row in apart[:5].tolist()) + (" ..." if len(apart) > 5 else "")
    return (f"{path}: left out {len(apart)} all-zero rows away from home (line {lines})",)


def _columns(
    table: Table, path: Path, inputs: Sequence[int] | None, output: int | None
) -> tuple[list[int], int | None]:
    """Which columns are joints, which is the label."""
    width = table.cells.shape[1]
    if inputs is None:
        special = {STAMP, RUN, LABEL}
        inputs = [index for index in range(width) if table.names and table.names[index] not in special]
        inputs = inputs or list(range(width - 1))
        output = table.names.index(LABEL) if LABEL in table.names else None if table.names else width - 1
    elif table.names and LABEL in table.names and RUN in table.names:
        # The learning file counts the joints' columns, as in headerless files; stamp and run stand before them.
        before = sum(name in (STAMP, RUN) for name in table.names)
        inputs, output = [index + before for index in inputs], None if output is None else output + before
    wrong = [index for index in (*inputs, *([] if output is None else [output])) if not 0 <= index < width]
    if wrong or not inputs:
        text = f"has {width} columns; column {wrong[0]} (counted from 0) is not there" if wrong else "has no joints"
        raise ConfigError(text, file=str(path))
    return list(inputs), output


def _labels(table: Table, output: int | None, path: Path) -> Whole:
    if output is None:
        return np.ones(len(table.cells), dtype=np.int64)
    column = table.cells[:, output]
    wrong = np.flatnonzero(~np.isin(column, (1, -1)))
    if len(wrong):
        line = int(wrong[0]) + table.first
        text = f"expected the label 1 (benign) or -1 (anomalous) in column {output}, got {column[wrong[0]]:g}"
        raise ConfigError(text, file=str(path), line=line)
    return column.astype(np.int64)


def _reject_gaps(table: Table, inputs: Sequence[int], path: Path) -> None:
    bad = np.flatnonzero(~np.isfinite(table.cells[:, inputs]).all(axis=1))
    if len(bad):
        more = f" ({len(bad)} such rows)" if len(bad) > 1 else ""
        raise ConfigError(
            f"expected a finite number for every joint, stamp and run, got another value{more}", file=str(path),
            line=int(bad[0]) + table.first,
        )  # fmt: skip
