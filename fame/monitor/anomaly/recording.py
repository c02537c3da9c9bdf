"""Recordings: joint states over time, cut into runs of the task, and their CSV files.

A file has a header as `CollectNode` writes it: ``stamp`` (s), ``run``, one column per joint, ``label``; stamp and run
may be missing. Published data have no header: the learning file names the columns, and the runs are found by motion.

Two rules of motion divide recorded data. *Home*: the arm leaves a home posture and comes back; the boundary is the
point nearest to home between approaching and leaving it. *Dwell*: the arm follows a loop and rests at its corner; the
boundary is the middle of the rest. A block of points follows the first rule if it is ever at home.

Live, `RunSegmenter` has three rules. *signal*: messages mark begin and end. *home*: as above; the boundary is known as
soon as the arm is on its way again, so the points since then move over to the new run. *count*: a fixed number of
points.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations, pairwise
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fame.dataclasses import dataclass, replace
from fame.errors import ConfigError
from fame.monitor.arrays import Floats, Whole
from fame.monitor.data_files import stamp_text
from fame.monitor.tables import LABEL, RUN, STAMP, Table, read_table
from fame.text import writing

NEAR = 0.5
"""Distance from home (rad, over all joints) that counts as being there."""

JUMP = 0.1
"""A step of a joint (rad) that no motion explains: ten times the largest between two samples of the MH5."""

STILL = 2e-4
"""A joint that moves less between two points (rad) rests: ten steps of the MH5's coarsest encoder."""

CORNER = 3e-3
"""How near (rad) a rest is to where the loop began to count as the same corner."""

_SHORTEST_REST = 3
_SHORTEST_LOOP = 20


def separators(values: Floats) -> NDArray[np.bool_]:
    """Rows that only separate: all zero, while the arm is elsewhere in the row after (in the last row: before)."""
    zero: NDArray[np.bool_] = (values == 0).all(axis=1)
    if len(values) < 2:
        return zero
    following = np.vstack([values[1:], values[-2:-1]])
    return np.asarray(zero & (np.abs(following).max(axis=1) > JUMP))


def blocks(values: Floats, labels: Whole, apart: NDArray[np.bool_], joins: Whole | None = None) -> list[slice]:
    """Stretches that nothing interrupts: neither a separator (`apart`), nor another label, a jump, or another file."""
    jump = np.abs(np.diff(values, axis=0)).max(axis=1) > JUMP
    cut = jump | (np.diff(labels) != 0) | apart[1:] | apart[:-1]
    if joins is not None:
        cut[joins - 1] = True
    bounds = [0, *(np.flatnonzero(cut) + 1).tolist(), len(values)]
    stretches = (slice(first, last) for first, last in pairwise(bounds))
    return [stretch for stretch in stretches if not apart[stretch].any()]


def number_runs(values: Floats, labels: Whole, joins: Whole | None = None) -> tuple[NDArray[np.bool_], Whole]:
    """Return which rows are points of a run, and the number of the run of each of those; files begin at `joins`."""
    apart = separators(values)
    numbers: list[Whole] = []
    count = 0
    for block in blocks(values, labels, apart, joins):
        bounds = boundaries(values[block])
        lengths = np.diff([*bounds, block.stop - block.start])
        numbers.append(np.repeat(np.arange(count, count + len(bounds), dtype=np.int64), lengths))
        count += len(bounds)
    return ~apart, np.concatenate(numbers) if numbers else np.zeros(0, dtype=np.int64)


def boundaries(values: Floats) -> list[int]:
    """Return the first row of each run in one block, by the rule that fits it."""
    at_home = (np.linalg.norm(values, axis=1) < NEAR).any()
    return home_boundaries(values) if at_home else dwell_boundaries(values)


def home_boundaries(values: Floats) -> list[int]:
    """Return the first row of each run that leaves home (all joints 0) and comes back."""
    distance = np.linalg.norm(values, axis=1)
    near = distance < NEAR
    comes = np.flatnonzero(near[1:] & ~near[:-1]) + 1
    leaves = np.flatnonzero(~near[1:] & near[:-1]) + 1
    found = [0]
    for first in comes:
        later = leaves[leaves > first]
        if len(later):  # without, the arm stays at home: what follows belongs to the last run
            found.append(int(first + np.argmin(distance[first : later[0]])))
    return found


def dwell_boundaries(values: Floats) -> list[int]:
    """Return the first row of each loop that begins and ends at rest on the same corner."""
    step = np.abs(np.diff(values, axis=0, prepend=values[:1])).max(axis=1)
    resting = np.flatnonzero((step < STILL) & (np.abs(values - values[0]).max(axis=1) < CORNER))
    rests = np.split(resting, np.flatnonzero(np.diff(resting) > 1) + 1)
    rests = [rest for rest in rests if len(rest) >= _SHORTEST_REST and rest[0] >= _SHORTEST_LOOP]
    if rests and rests[-1][-1] >= len(values) - _SHORTEST_LOOP:
        rests.pop()  # the rest that ends the last loop
    return [0, *(int(rest[0] + rest[-1]) // 2 for rest in rests)]


Rule = Literal["signal", "home", "count"]

RISE = 5e-4
"""How much farther from home (rad) than at its nearest the arm is on its way again: ten steps of
the MH5's coarsest encoder."""

WHOLE = 0.8
"""A run with less than this part of the nominal points was cut off."""


class RunSegmenter:
    """Finds with each point whether a run has begun, and how many points ago."""

    rule: Rule
    cycle: int

    def __init__(self, rule: Rule, cycle: int = 0) -> None:
        self.rule, self.cycle = rule, cycle
        self._count = 0
        self._left = False
        self._nearest, self._since = math.inf, 0

    def feed(self, values: Sequence[float]) -> int | None:
        """Take a point. None: the run continues. A number: a run began that many points ago, this one included."""
        self._count += 1
        if self.rule == "count" and self._count > self.cycle > 0:
            self._count = 1
            return 1
        return self._home(math.sqrt(sum(value * value for value in values))) if self.rule == "home" else None

    @property
    def undecided(self) -> bool:
        """Whether the last points may turn out to belong to a new run."""
        return self._left and self._since > 1

    def _home(self, distance: float) -> int | None:
        if distance >= NEAR:
            self._left, self._nearest, self._since = True, math.inf, 0
        elif self._left:
            self._since += 1
            if distance < self._nearest:
                self._nearest, self._since = distance, 1
            elif distance > self._nearest + RISE:
                self._left = False
                return self._since
        return None


BENIGN, ANOMALOUS = 1, -1


@dataclass(frozen=True, slots=True)
class Recording:
    """Points, one per row, of many runs that motion divides, without gaps.

    A `LabelledRun` (`fame.monitor.data_files`) is one run of any signals, with gaps that count; both are
    read by `read_table`.

    joints  names of the columns
    values  (points, joints): rad, or whatever field was recorded
    labels  (points,): +1 benign, -1 anomalous
    runs    (points,): the number of the run that a point belongs to; ascending, from 0 on, without gaps
    stamps  (points,): s, or None if the file has none
    source  the file, for messages
    notes   what was odd about the file and what was done about it, a line each
    labelled  whether the file has labels; without, all points count as benign
    """

    joints: tuple[str, ...]
    values: Floats
    labels: Whole
    runs: Whole
    stamps: Floats | None = None
    source: str = ""
    notes: tuple[str, ...] = ()
    labelled: bool = True

    def __len__(self) -> int:
        return len(self.values)

    @property
    def count(self) -> int:
        """How many runs there are."""
        return int(self.runs[-1]) + 1 if len(self.runs) else 0

    def slices(self) -> list[slice]:
        bounds = [0, *(np.flatnonzero(np.diff(self.runs)) + 1).tolist(), len(self.runs)]
        return [slice(first, last) for first, last in pairwise(bounds)] if len(self.runs) else []

    def run_labels(self) -> list[int]:
        return [int(self.labels[rows.start]) for rows in self.slices()]

    def __iter__(self) -> Iterator[Recording]:
        """Each run as a recording of its own."""
        for rows in self.slices():
            yield self.rows(rows)

    def rows(self, chosen: slice | NDArray[np.bool_]) -> Recording:
        """Return some of the points, runs numbered anew."""
        numbers = self.runs[chosen]
        renumbered = np.cumsum(np.diff(numbers, prepend=numbers[:1]) != 0).astype(np.int64)
        stamps = None if self.stamps is None else self.stamps[chosen]
        return replace(self, values=self.values[chosen], labels=self.labels[chosen], runs=renumbered, stamps=stamps)

    def select(self, numbers: Sequence[int]) -> Recording:
        """Return some of the runs, in their order."""
        return self.rows(np.isin(self.runs, numbers))


def join(recordings: Sequence[Recording]) -> Recording:
    """Join recordings of the same number of joints, one after another; stamps are kept if all have them."""
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
        labelled=all(item.labelled for item in recordings),
    )


def of_runs(runs: Sequence[Floats], label: int, joints: Sequence[str], source: str = "") -> Recording:
    """Return a recording made of runs, each an array (points, joints)."""
    lengths = [len(run) for run in runs]
    return Recording(
        joints=tuple(joints),
        values=np.vstack(runs),
        labels=np.full(sum(lengths), label, dtype=np.int64),
        runs=np.repeat(np.arange(len(runs), dtype=np.int64), lengths),
        source=source,
    )


_FORMAT = "%.10g"
_STEADY = 0.2
"""How much steps between stamps usually differ, relative."""


def read_csv(path: str | Path, inputs: Sequence[int] | None = None, output: int | None = None) -> Recording:
    """Read a recording.

    `inputs` and `output` are 0-based columns; by default those that the header names, or all but the last and the last.
    All-zero separator rows are left out, and noted in `notes`. Raises ConfigError for anything that is not a table of
    finite numbers.
    """
    path = Path(path)
    table = read_table(path)
    inputs, output = _columns(table, path, inputs, output)
    _reject_times(table, inputs, path)
    values, labels = table.cells[:, inputs], _labels(table, output, path)
    _reject_gaps(table, [*inputs, *(table.names.index(name) for name in (STAMP, RUN) if name in table.names)], path)
    stamps = table.cells[:, table.names.index(STAMP)] if STAMP in table.names else None
    if RUN in table.names:
        given = table.cells[:, table.names.index(RUN)]
        begins = np.diff(given, prepend=given[:1]) != 0
        begins[table.joins] = True
        kept = ~separators(values)
        runs = np.unique(np.cumsum(begins)[kept], return_inverse=True)[1].astype(np.int64)
    else:
        kept, runs = number_runs(values, labels, table.joins)
    names = tuple(table.names[column] if table.names else f"joint_{column + 1}" for column in inputs)
    times = None if stamps is None else stamps[kept]
    notes = _notes(path, table, kept)
    return Recording(names, values[kept], labels[kept], runs, times, str(path), notes, output is not None)


def write_csv(path: str | Path, recording: Recording) -> None:
    """Write a recording with a header; times to the nanosecond."""
    with writing(path) as part, part.open("w", encoding="utf-8", newline="") as stream:
        rows = csv.writer(stream, lineterminator="\n")
        rows.writerow([*([STAMP] if recording.stamps is not None else []), RUN, *recording.joints, LABEL])
        for index, values in enumerate(recording.values):
            stamp = [] if recording.stamps is None else [stamp_text(recording.stamps[index])]
            cells = [_FORMAT % value for value in values]
            rows.writerow([*stamp, int(recording.runs[index]), *cells, int(recording.labels[index])])


def merge(paths: Sequence[str | Path]) -> Recording:
    """Read labelled files as one recording. Raises ConfigError if they are not of the same joints."""
    recordings = [read_csv(path) for path in paths]
    require_same_joints(recordings)
    return join(recordings)


def require_same_joints(recordings: Sequence[Recording]) -> None:
    """Raise ConfigError if two have different joints; names made up for a headerless file fit any."""
    for first, other in combinations(recordings, 2):
        if not _same(other.joints, first.joints):
            raise ConfigError(
                f"has the {len(other.joints)} joints {', '.join(other.joints)}; expected the {len(first.joints)} of "
                f"{first.source} ({', '.join(first.joints)})",
                file=other.source,
            )


def in_joint_order(recording: Recording, joints: Sequence[str]) -> Recording:
    """Return the recording with the joints of a model, in their order; names made up for a headerless file fit any.

    Raises ConfigError for other joints.
    """
    names = recording.joints
    if len(set(names)) == len(names) and set(names) == set(joints):
        order = [names.index(joint) for joint in joints]
        return replace(recording, joints=tuple(joints), values=recording.values[:, order])
    if _same(names, joints):
        return recording
    text = f"has {len(names)} joints ({', '.join(names)}); the model has {len(joints)}: {', '.join(joints)}"
    raise ConfigError(text, file=recording.source)


made_up: Callable[[str], object] = re.compile(r"joint_\d+").fullmatch
"""Whether a name was made up for a column of a headerless file."""


def _same(some: Sequence[str], others: Sequence[str]) -> bool:
    """Whether there are as many, and all of the same name, unless one of them was made up."""
    return len(some) == len(others) and all(
        one == other or made_up(one) or made_up(other) for one, other in zip(some, others, strict=True)
    )


def _notes(path: Path, table: Table, kept: NDArray[np.bool_]) -> tuple[str, ...]:
    """Describe the separator rows that were left out."""
    apart = np.flatnonzero(~kept)
    if not len(apart):
        return ()
    lines = ", ".join(str(table.lines[row]) for row in apart[:5].tolist()) + (" ..." if len(apart) > 5 else "")
    return (f"{path}: left out {len(apart)} all-zero rows away from home (line {lines})",)


def _columns(
    table: Table, path: Path, inputs: Sequence[int] | None, output: int | None
) -> tuple[list[int], int | None]:
    """Return which columns are joints, which is the label."""
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


_TIMES = ("time", "times", "timestamp", "timestamps", "t", "sec", "secs", "seconds", "nanosec", "nsec")
"""Names of columns that hold times, in lower case."""


def _reject_times(table: Table, inputs: Sequence[int], path: Path) -> None:
    """Raise ConfigError for a column of times, numbers of runs or labels among the joints. A column without a name is
    one if it grows steadily from row to row, which no joint of a repeated task does."""
    special = (STAMP, RUN, LABEL)
    for column in inputs:
        name = table.names[column] if table.names else ""
        if name in special:
            joints = [index for index, other in enumerate(table.names) if other not in special]
            text = f"column {column} (counted from 0) is {name!r}, not a joint; the joints are the columns {joints}"
        elif name.lower() in _TIMES and not (name in ("t", "T") and STAMP in table.names):  # a joint: S L U R B T
            text = f"column {column} (counted from 0), {name!r}, holds times, not a joint: "
            text += "call it 'stamp' (s), or leave it out"
        elif not name and _grows_steadily(table.cells[:, column]):
            text = f"column {column} (counted from 0) grows steadily from row to row, as times do, not a joint: "
            text += "leave it out, or add a line of names, such as stamp,joint_1,label"
        else:
            continue
        raise ConfigError(text, file=str(path))


def _grows_steadily(values: Floats) -> bool:
    """Return whether values grow from each row to the next, most of the steps by about the same."""
    steps = np.diff(values)
    if len(steps) < 2 or not (steps > 0).all():
        return False
    usual = float(np.median(steps))
    return bool(np.median(np.abs(steps - usual)) <= _STEADY * usual)


def _labels(table: Table, output: int | None, path: Path) -> Whole:
    if output is None:
        return np.ones(len(table.cells), dtype=np.int64)
    column = table.cells[:, output]
    wrong = np.flatnonzero(~np.isin(column, (1, -1)))
    if len(wrong):
        line = table.lines[int(wrong[0])]
        text = f"expected the label 1 (benign) or -1 (anomalous) in column {output}, got {column[wrong[0]]:g}"
        raise ConfigError(text, file=str(path), line=line)
    return column.astype(np.int64)


def _reject_gaps(table: Table, inputs: Sequence[int], path: Path) -> None:
    bad = np.flatnonzero(~np.isfinite(table.cells[:, inputs]).all(axis=1))
    if len(bad):
        more = f" ({len(bad)} such rows)" if len(bad) > 1 else ""
        raise ConfigError(
            f"expected a finite number for every joint, stamp and run, got another value{more}", file=str(path),
            line=table.lines[int(bad[0])],
        )  # fmt: skip
