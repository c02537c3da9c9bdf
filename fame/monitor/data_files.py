"""Files of recorded data: runs in tables, as `fame monitor record` writes them, and bags of ROS 1 and 2.

Runs need a column ``stamp`` (s). A column ``run`` divides a file into runs, and every file begins a new one, as does a
repeated header, where files were written one after another. A bag is a folder of rosbag2 in either storage, a single
MCAP file, also a recording of FAME, or a rosbag1.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Collection, Generator, Iterator, Mapping, Sequence
from heapq import merge
from itertools import chain
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fame.clock import EPOCH, date_text
from fame.errors import ConfigError
from fame.iso8601 import parse_datetime
from fame.middleware.interface import resolve
from fame.middleware.typesystem import STRING
from fame.monitor.arrays import Floats, Whole
from fame.monitor.pipeline.join import Join, joined_table
from fame.monitor.pipeline.processor import ActiveElements, Samples
from fame.monitor.pipeline.run_trigger import RunTrigger, begins_within, no_run, spans_of
from fame.monitor.tables import LABEL, RUN, STAMP, Table, read_blocks, read_parquet, read_table
from fame.robot.robot_state import EVENTS, EVENTS_TOPIC, VARIABLES, WAITING, RobotState
from fame.text import open_file

if TYPE_CHECKING:
    from fame.log import Recording

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""What stamps may be counted in, in s."""
ELEMENT = "element"


class LabelledRun(NamedTuple):
    """A run with a label per sample, -1 anomalous or 1 benign; all 1 if it has no labels (`labelled`): its file has no
    such column, or its cells there are empty.

    `gaps` rows with an empty cell were left out of it; with them it lasted `seconds` (-1: as long as its samples). The
    others are the share `seen` of its rows, of which those of other topics do not count. `lacking` says what the rows
    that do count lack, and where; `notes` what else was left out.
    """

    samples: Samples
    labels: Whole
    file: str
    gaps: int = 0
    seconds: float = -1.0
    labelled: bool = False
    seen: float = 1.0
    notes: tuple[str, ...] = ()
    lacking: str = ""

    @property
    def known(self) -> float:
        """The share of the run of which its samples tell: of its rows, and of its time."""
        if not len(self.samples):
            return 0.0
        if not self.gaps and not self.notes:
            return 1.0
        steps = np.diff(self.samples.stamps)
        usual = float(np.median(steps)) if len(steps) else 0.0
        lasted = float(steps[steps <= 2 * usual].sum())
        return min(self.seen, lasted / self.seconds if self.seconds - lasted > 2 * usual else 1.0)


class Special(NamedTuple):
    """The names of the columns that are no channels: of the stamps (dates, or numbers in a unit of `TIME_UNITS`, empty:
    s unless that is doubtful), the numbers of the runs, and the active element of the mission. With `join`, channels
    of topics with rates of their own are joined by time; columns to `exclude` are not read.

    With a `rate` (Hz) rows follow each other at it, whatever times they have. Of each file are read the rows from
    `start` to `end` (s since its first row). Rows in which the column `anomaly` is not 0 are anomalous; of a file of
    blocks, those that are not of the class `benign`. A `trigger` tells when runs begin and end within one of the file.
    """

    stamp: str = STAMP
    run: str = RUN
    element: str = ELEMENT
    unit: str = ""
    join: Join | None = None
    exclude: tuple[str, ...] = ()
    rate: float = 0.0
    start: float = 0.0
    end: float = math.inf
    anomaly: str = ""
    benign: str = ""
    trigger: RunTrigger | None = None

    @property
    def unwanted(self) -> tuple[str, ...]:
        """The columns that are no channels."""
        return (self.stamp, self.run, self.element, LABEL, "", self.anomaly, self.trigger_column, *self.exclude)

    @property
    def trigger_column(self) -> str:
        """The column of the trigger; empty without one."""
        return self.trigger.column if self.trigger is not None else ""


_USUAL = Special()


def read_runs(paths: Sequence[str | Path], columns: Sequence[str] = (), special: Special = _USUAL) -> list[Samples]:
    """Read the samples of every run that has some, as `read_labelled_runs`. Raises ConfigError."""
    return [run.samples for run in read_labelled_runs(paths, columns, special) if len(run.samples)]


def read_labelled_runs(
    paths: Sequence[str | Path], columns: Sequence[str] = (), special: Special = _USUAL, *, undisturbed: bool = False
) -> list[LabelledRun]:
    """Read every run of recorded files with its labels: values (n, columns), stamps (s), names of the columns.

    `columns` are by default those of the first file but `special` ones and label. Rows that lack one are left out.
    `undisturbed` runs must not have an anomalous sample, but for blocks of another class than the benign one
    (`is_other_class`). Raises ConfigError.
    """
    if not paths:
        raise ConfigError("no files to read; expected Files: [runs.csv]", element="Files")
    runs, known = list[LabelledRun](), dict[str, None]()
    of_first: tuple[str, ...] = ()  # the columns of the first file, if none were asked for
    for path in map(Path, paths):
        table = _read_file(path, columns, special)
        known |= dict.fromkeys((*table.names, *([special.element] if table.elements else [])))
        if undisturbed:
            check_blocks(path, special.benign)
        channels = tuple(name for name in table.names if name not in special.unwanted)
        if of_first and (more := sorted(set(channels) - set(of_first))):
            text = f"has columns that the first file lacks, {', '.join(more)}: say which to use (Columns)"
            raise ConfigError(text, file=str(path), line=1)
        if not columns:
            columns = of_first = channels
        _check_columns(table, columns, special, path)
        runs += _runs_of(table, columns, channels, special, path, undisturbed)
    if undisturbed:
        _check_excluded(special, known, runs)
        _check_undisturbed(special, runs)
    return runs


def is_other_class(run: LabelledRun, special: Special) -> bool:
    """Return whether a run is a block of another class than the benign one: it counts as a run, and does not train."""
    return bool(special.benign and (run.labels == -1).any())


def run_names(number: int, run: LabelledRun) -> set[str]:
    """Return what a run can be excluded by: its number, or the name of its file."""
    return {f"run {number}", Path(run.file).name}


def _check_excluded(special: Special, known: Collection[str], runs: Sequence[LabelledRun]) -> None:
    """Raise ConfigError for a name to exclude that is neither a column nor a file. Training adds runs that somebody
    labelled, and then looks for numbers of runs."""
    files = {Path(run.file).name for run in runs}
    for name in special.exclude:
        if name not in known and name not in files and not re.fullmatch(r"run \d+", name):
            text = f"has no column or run {name!r} (--exclude); it has {', '.join(known)}, and {len(runs)} runs"
            raise ConfigError(f"{text} from 'run 0' on", file=runs[0].file if runs else "", element="Training.exclude")


def _check_undisturbed(special: Special, runs: Sequence[LabelledRun]) -> None:
    """Raise ConfigError for a run with an anomalous sample, unless it is excluded."""
    for number, run in enumerate(runs):
        if (run.labels == -1).any() and not special.benign and not run_names(number, run) & set(special.exclude):
            got = f"column {special.anomaly!r} is not 0" if special.anomaly else "got label -1"
            text = f"expected undisturbed runs{'' if special.anomaly else ' (label 1)'}, {got} in run {number}"
            raise ConfigError(f"{text}: leave it out (--exclude 'run {number}')", file=run.file)


def check_blocks(path: Path, benign: str) -> None:
    """Raise ConfigError for a file that has no blocks, of which one class was said to be `benign` (empty: none)."""
    if benign and (path.suffix == ".parquet" or is_bag(path) or read_blocks(path) is None):
        text = f"is no file of blocks, each behind a line with its class: none is of the class {benign!r} (--benign)"
        raise ConfigError(text, file=str(path))


def _read_file(path: Path, columns: Sequence[str], special: Special) -> Table:
    """Read a table. Raises ConfigError, also for a bag."""
    if is_bag(path):
        text = "is a bag, expected --config CONFIG.yaml, whose Inputs name topics and fields, or a CSV file"
        text += f": fame monitor record CONFIG.yaml --bag {path} -o runs.csv makes one"
        raise ConfigError(text, file=str(path))
    wanted = {special.stamp, special.run, LABEL, special.anomaly, special.trigger_column, *columns} if columns else None
    skip = (*special.exclude, *([special.stamp] if special.rate else []))
    if path.suffix == ".parquet":
        table = read_parquet(path, stamp=special.stamp, element=special.element, wanted=wanted, skip=skip)
    elif blocks := read_blocks(path):
        table = _labelled_blocks(*blocks, special, path)
    else:
        table = read_table(path, recorded=True, stamp=special.stamp, element=special.element, wanted=wanted, skip=skip)
    return _as_asked(table, special, path)


def _labelled_blocks(table: Table, classes: Sequence[str], special: Special, path: Path) -> Table:
    """Add the labels of blocks. Raises ConfigError if it is not said which ones are benign, or at which rate."""
    known = ", ".join(dict.fromkeys(classes))
    if special.benign not in classes:
        text = f"has runs of the classes {known}: say by --benign which ones are undisturbed"
        raise ConfigError(f"{text}; got {special.benign!r}" if special.benign else text, file=str(path))
    labels = [1.0 if name == special.benign else -1.0 for name in classes]
    return table._replace(names=(*table.names, LABEL), cells=np.column_stack((table.cells, labels)))


def _as_asked(table: Table, special: Special, path: Path) -> Table:
    """Give the rows stamps at a rate and labels by another column, and keep those between start and end, if that is
    asked for. Raises ConfigError."""
    names, cells, _, _, sure = table
    added: dict[str, Floats] = {}
    if special.rate:
        added[special.stamp], sure = np.arange(len(cells)) / special.rate, True
    if special.anomaly:
        if special.anomaly not in names:
            text = f"has no column {special.anomaly!r} (--anomaly-column); it has {', '.join(names)}"
            raise ConfigError(text, file=str(path), line=1)
        marks = cells[:, names.index(special.anomaly)]
        added[LABEL] = np.where(np.isnan(marks), np.nan, np.where(marks == 0, 1.0, -1.0))
    kept = [place for place, name in enumerate(names) if name not in added]
    names = (*(names[place] for place in kept), *added)
    cells = np.column_stack((cells[:, kept], *added.values()))
    rows = np.arange(len(cells))
    if (special.start or special.end < math.inf) and special.stamp in names:
        stamps = cells[:, names.index(special.stamp)] * TIME_UNITS.get(special.unit, 1.0)
        since = stamps - stamps[np.isfinite(stamps)][:1]
        rows = np.flatnonzero((since >= special.start) & (since < special.end))
        if not len(rows):
            text = f"has no row from {special.start:g} to {special.end:g} s since its first one (--start, --end)"
            raise ConfigError(text, file=str(path))
    elements = tuple(table.elements[int(row)] for row in rows) if table.elements else ()
    return Table(names, cells[rows], [table.lines[int(row)] for row in rows], elements, sure)


def _check_columns(table: Table, columns: Sequence[str], special: Special, path: Path) -> None:
    """Raise ConfigError if a file lacks a column."""
    names = ", ".join(table.names)
    if not columns:
        raise ConfigError(f"has no columns but {names}: nothing to learn from", file=str(path))
    if special.element != ELEMENT and not table.elements:
        raise ConfigError(f"has no column {special.element!r}", file=str(path), line=1)
    for name in (special.stamp, *columns, *([special.run] if special.run != RUN else []), special.trigger_column):
        if name and name not in table.names:
            rate = "; without times, --rate says how many rows come in a second" if name == special.stamp else ""
            raise ConfigError(f"has no column {name!r}; it has {names}{rate}", file=str(path), line=1)


def _runs_of(
    table: Table, columns: Sequence[str], channels: Sequence[str], special: Special, path: Path, undisturbed: bool
) -> Iterator[LabelledRun]:
    """Yield the runs of a file. Raises ConfigError."""
    names, cells, lines, elements, _ = table
    values = cells[:, [names.index(name) for name in columns]]
    stamps = _in_seconds(table, special, path)
    whole = np.isfinite(values).all(axis=1) & np.isfinite(stamps)
    # A row that lacks a value lost it, unless it is the message of a topic that only has channels of others.
    others = [
        place for place, name in enumerate(names) if name in (*channels, special.trigger_column) and name not in columns
    ]
    torn = ~whole & (np.isfinite(values).any(axis=1) | ~np.isfinite(cells[:, others]).any(axis=1))
    numbers = cells[:, names.index(special.run)] if special.run in names else np.zeros(len(cells))
    labels = _labels(cells[:, names.index(LABEL)] if LABEL in names else np.full(len(cells), np.nan), path, lines)
    if not whole.any() and special.join is None:
        rates = ": topics with rates of their own need Join: {Rate, Tolerance, Fill}" if torn.any() else ""
        raise ConfigError(f"has no row with all of {', '.join(columns)}{rates}", file=str(path))
    others_begin = np.flatnonzero(np.diff(np.nan_to_num(numbers)) != 0) + 1
    parts = [(rows, "") for rows in np.split(np.arange(len(values)), np.union1d(others_begin, table.joins))]
    if special.trigger is not None:
        signal = cells[:, names.index(special.trigger.column)]
        parts = _triggered(special.trigger, stamps, signal, [rows for rows, _ in parts], path, undisturbed)
    for rows, note in parts:
        notes = (note,) if note else ()
        if special.join is not None:
            names_of = [elements[row] for row in rows] if elements else []
            joined = _joined(special.join, stamps[rows], values[rows], labels[rows], names_of, columns, path)
            yield joined._replace(notes=notes)
            continue
        kept = rows[whole[rows]]
        _refuse_backward(stamps, kept, path, lines)
        again = 1 + np.flatnonzero(np.diff(stamps[kept]) == 0)  # as live: a row that is repeated says nothing new
        torn[kept[again]] = (values[kept[again]] != values[kept[again - 1]]).any(axis=1)
        if 10 * int(torn[kept].sum()) > len(kept):
            text = (
                f"has many rows with the stamp of the row before, {stamps[kept[again[0]]]:.12g} first: expected stamps"
            )
            raise ConfigError(f"{text} that grow, or how many rows come in a second (--rate)", file=str(path))
        kept = np.delete(kept, again)
        known = stamps[rows][np.isfinite(stamps[rows])]
        changes = _changes(stamps[kept], [elements[row] for row in kept]) if elements else ()
        yield LabelledRun(
            Samples(values[kept], stamps[kept], tuple(columns), changes),
            np.where(labels[kept] == -1, -1, 1),
            str(path),
            gaps=len(rows) - len(kept),
            seconds=float(np.ptp(known)) if len(known) else 0.0,
            labelled=bool(labels[rows].any()),
            seen=len(kept) / max(1, len(kept) + int(torn[rows].sum())),
            notes=notes,
            lacking=_lacking(
                values[rows], stamps[rows], torn[rows], columns, [lines[row] for row in rows[torn[rows]][:1]]
            ),
        )


def _triggered(
    trigger: RunTrigger, stamps: Floats, values: Floats, parts: Sequence[Whole], path: Path, undisturbed: bool
) -> list[tuple[Whole, str]]:
    """Return the rows of each run by its trigger, of the parts of a file, each with a note; the note of the first says
    how many rows lie outside of every run.

    Of `undisturbed` runs, the one that goes on when the file ends has no rows, unless the file is one run. Of a file
    without a run, the result is a run without rows; where `undisturbed` runs are wanted, it raises ConfigError.
    """
    found = list[tuple[Whole, str]]()
    for rows in parts:
        known = rows[np.isfinite(stamps[rows])]
        spans = spans_of(trigger, stamps[known], values[known])
        found += [(known[(stamps[known] >= begin) & (stamps[known] < end)], "") for begin, end in spans]
        if undisturbed and spans and spans[-1][1] == np.inf and (trigger.ends or len(spans) > 1):
            why = "" if trigger.ends else ", since nothing else says when it ends (Run: Ends)"
            found[-1] = known[:0], f"the last run of {path.name} is left out: the file ends before it does{why}"
    if undisturbed and not found:
        raise ConfigError(no_run(trigger, values), file=str(path), element="Run")
    if not undisturbed:
        outside = len(values) - sum(len(rows) for rows, _ in found)
        text = f"{outside} of {len(values)} rows lie outside of every run" if found else no_run(trigger, values)
        text += "; a run was under way when the file began" if begins_within(trigger, values) else ""
        found[:1] = [(found[0][0] if found else np.zeros(0, np.int64), f"{text}: not judged")]
    return found


def _joined(
    join: Join, stamps: Floats, cells: Floats, labels: Whole, elements: Sequence[str], columns: Sequence[str],
    path: Path,
) -> LabelledRun:  # fmt: skip
    """Join the rows of a run by time; a row has label and element of the one before it. Raises ConfigError."""
    order = np.argsort(stamps, kind="stable")
    order = order[np.isfinite(stamps[order])]
    if len(fall := np.flatnonzero(np.diff(stamps[np.isfinite(stamps)]) < -join.tolerance)):
        text = f"expected stamps that grow within a run but for {join.tolerance:g} s (Join: Tolerance), got a fall"
        raise ConfigError(f"{text} behind {stamps[np.isfinite(stamps)][fall[0]]:.12g}", file=str(path))
    times, rows = joined_table(stamps[order], cells[order], join)
    if not len(times):
        return LabelledRun(Samples(rows, times, tuple(columns)), np.zeros(0, np.int64), str(path))
    whole = np.isfinite(rows).all(axis=1)
    before = order[np.maximum(np.searchsorted(stamps[order], times + 1e-9, side="right") - 1, 0)]
    changes = _changes(stamps[order], [elements[row] for row in order]) if elements else ()
    samples = Samples(rows[whole], times[whole], tuple(columns), changes)
    lost = int((~whole).sum())
    lacking = [name for name, column in zip(columns, rows.T, strict=True) if not np.isfinite(column).all()]
    text = f"{lost} of {len(times)} rows have no partner in time ({', '.join(lacking)})" if lost else ""
    return LabelledRun(
        samples, np.where(labels[before][whole] == -1, -1, 1), str(path), lost, float(np.ptp(times)),
        bool(labels.any()), float(whole.mean()), lacking=text,
    )  # fmt: skip


def _lacking(values: Floats, stamps: Floats, torn: Any, columns: Sequence[str], first: Sequence[int]) -> str:
    """Say what the `torn` rows of a run lack, in which columns, and in which line first."""
    if not torn.any():
        return ""
    lost = values[torn]
    finite, timed = np.isfinite(lost).all(axis=1), np.isfinite(stamps[torn])
    kinds = (
        ("an empty cell", np.isnan(lost)), ("inf", np.isinf(lost)), ("no stamp", finite & ~timed),
        ("the stamp of the row before", finite & timed),
    )  # fmt: skip
    what = " or ".join(text for text, there in kinds if there.any())
    names = [name for name, column in zip(columns, lost.T, strict=True) if not np.isfinite(column).all()]
    where = f" in {', '.join(names)}" if names else ""
    return f"{len(lost)} of {len(values)} rows have {what}{where} (line {first[0]} first)"


def _changes(stamps: Floats, elements: Sequence[str]) -> ActiveElements:
    """Return the stamps at which another element was active, and which (empty: not known); none without any name."""
    begins = [row for row, name in enumerate(elements) if row == 0 or name != elements[row - 1]]
    return tuple((float(stamps[row]), elements[row]) for row in begins) if any(elements) else ()


_TELLING = 10
"""Steps that tell a unit, at least."""
_DAYS = (30_000.0, 60_000.0)
"""Stamps that a spreadsheet writes for the years 1982 to 2064."""


def _in_seconds(table: Table, special: Special, path: Path) -> Floats:
    """Return the stamps in s. Raises ConfigError for those that are of another unit than is said."""
    stamps = table.cells[:, table.names.index(special.stamp)]
    unit = TIME_UNITS.get(special.unit, 1.0)
    if table.in_seconds and unit != 1:
        raise ConfigError(f"the times are no numbers of {special.unit}: they are s, or dates", file=str(path), line=2)
    stamps = stamps if unit == 1 else stamps * unit
    _refuse_other_units(stamps, path, doubtful=not table.in_seconds and not special.unit)
    return stamps


def _refuse_other_units(stamps: Floats, path: Path, *, doubtful: bool) -> None:
    """Raise ConfigError for stamps that are not s: days of a spreadsheet, ms or ns since 1970, and, if they are
    `doubtful`, whole numbers with steps of 2 or more, as ms since the start."""
    known = stamps[np.isfinite(stamps)]
    if not len(known):
        return
    latest, steps = float(known.max()), np.diff(np.unique(known))
    got = ""
    if latest > 1e11:
        got = f"{latest:.6g}, as ms, us or ns since 1970 are: say so by --time-unit (TimeUnit)"
    elif len(steps) and np.median(steps) < 1.25e-5 and _DAYS[0] < known.min() and latest < _DAYS[1]:
        got = f"{latest:.10g}, as the days of a spreadsheet are: format the column as dates or multiply it by 86400"
    elif doubtful and len(steps) >= _TELLING and np.median(steps) >= 2 and (known == np.floor(known)).all():
        got = (
            f"whole numbers {np.median(steps):g} apart, a rate of {1 / np.median(steps):.3g} Hz: "
            "say by --time-unit (TimeUnit) whether they are ms, us, ns, or really s"
        )
    if got:
        text = f"expected s in column {STAMP!r}, got {got}"
        raise ConfigError(text, file=str(path), line=2)


def _refuse_backward(stamps: Floats, rows: Whole, path: Path, lines: Sequence[int]) -> None:
    """Raise ConfigError where the stamps of the rows of a run fall: a clock that jumped, runs without a column that
    divides them, or another order. Sorted, they would be a motion that never was."""
    falls = np.flatnonzero(np.diff(stamps[rows]) < 0)
    if len(falls):
        before, row = (int(each) for each in rows[falls[0] : falls[0] + 2])
        got = f"got {stamps[row]:.12g} after {stamps[before]:.12g}"
        text = f"expected stamps that grow within a run, {got}: sort the rows, or begin another run here ({RUN})"
        raise ConfigError(text, file=str(path), line=lines[row])


def _labels(column: Floats, path: Path, lines: Sequence[int]) -> Whole:
    """Read labels; that of an empty cell is 0."""
    wrong = np.flatnonzero(np.isfinite(column) & ~np.isin(column, (1, -1)))
    if len(wrong):
        text = f"expected the label 1 (benign) or -1 (anomalous), got {column[wrong[0]]:g}"
        raise ConfigError(text, file=str(path), line=lines[int(wrong[0])])
    return np.asarray(np.where(np.isfinite(column), column, 0), dtype=np.int64)


def stamp_text(stamp: float) -> str:
    """Write a stamp (s) to the nanosecond; since 1970 to the microsecond, which is what a number of seconds tells."""
    return f"{stamp:.9f}" if abs(stamp) < 1e6 else f"{stamp:.6f}000"


def hash_files(paths: Sequence[str | Path]) -> str:
    """Return the SHA-256 of the content of files, and of those in folders, in order. Raises ConfigError."""
    digest = hashlib.sha256()
    every = (sorted(path.iterdir()) if path.is_dir() else [path] for path in map(Path, paths))
    for path in chain.from_iterable(every):
        try:
            with open_file(path) as stream:
                digest.update(hashlib.file_digest(stream, "sha256").digest())
        except OSError as error:
            raise ConfigError(f"cannot be read: {error.strerror}", file=str(path)) from None
    return digest.hexdigest()


def rate_of(runs: Sequence[Samples]) -> float:
    """Return the usual rate (Hz) of the samples. Raises ConfigError if stamps do not grow."""
    steps = np.concatenate([np.diff(run.stamps) for run in runs]) if runs else np.zeros(0)
    usual = float(np.median(steps)) if len(steps) else 0.0
    if not usual > 0:
        raise ConfigError("the stamps do not grow: expected samples at a rate")
    return 1 / usual


def read_bag(path: str | Path, topics: Mapping[str, str]) -> Generator[tuple[float, str, Any]]:
    """Yield every message of some topics (full name -> type), in the order of recording: time (s), topic, message.

    Raises ConfigError for a file that is neither a bag nor a recording of FAME, lacks a topic, or has it with another
    type.
    """
    from fame.log.bag_reader import open_bag

    if _is_recording(Path(path)):
        yield from _read_recording(path, topics)
        return
    with open_bag(Path(path)) as reader:
        _require_topics(topics, {name: topic.type for name, topic in reader.topics.items()}, str(path))
        for time, name, message in reader.messages(topics):
            yield time * 1e-9, name, message


def is_bag(path: Path) -> bool:
    """Return whether `read_bag` reads a file or folder, not `read_runs`."""
    return path.is_dir() or path.suffix in (".mcap", ".bag", ".db3") or _is_recording(path)


def _is_recording(path: Path) -> bool:
    """Return whether a file is MCAP that FAME wrote: without a profile, as a bag of others may be, and of this
    library."""
    try:
        with open_file(path) as stream:
            head = stream.read(30)  # magic, kind and length of the header, length of its profile, its library
    except OSError:
        return False
    return head.startswith(b"\x89MCAP0\r\n\x01") and head[17:21] == bytes(4) and head[25:] == b"fame "


def incomplete(path: Path) -> list[str]:
    """Return what a recording of FAME lacks; nothing for other files, of which none is read in part."""
    if not _is_recording(path):
        return []
    from fame.log import Recording

    with Recording(path) as recording:
        return list(recording.warnings)


def failed_missions(path: Path) -> list[str]:
    """Return the robots whose mission failed in a recording of FAME; none for other files."""
    if not _is_recording(path):
        return []
    from fame.log import Recording

    with Recording(path) as recording:
        robots = recording.state(recording.end).robots
    return sorted(name for name, state in robots.items() if state.ended.get("failed"))


def _read_recording(path: str | Path, topics: Mapping[str, str]) -> Iterator[tuple[float, str, Any]]:
    """Yield messages of a recording of FAME: ``bpmn_events``, and with ``--log-topics`` other topics of robots."""
    from fame.log import Recording
    from fame.middleware import codec

    with Recording(path) as recording:
        sent = {name: topic.type for name, topic in recording.topics.items() if topic.encoding == "cdr"}
        doing = {resolve(EVENTS_TOPIC, robot): robot for robot in recording.robots if topics.keys() - sent}
        _require_topics(topics, dict.fromkeys(doing, STRING) | sent, str(path))
        for type in {topics[topic] for topic in topics if topic in sent}:
            recording.typestore(type)
        own = {robot: topic for topic, robot in doing.items() if topic in topics and topic not in sent}
        read = ((one.time, one.topic, codec.deserialize(one.data, topics[one.topic])) for one in
                recording.messages(topics.keys() - set(own.values())))  # fmt: skip
        begin = parse_datetime(recording.metadata.get("epoch", date_text(EPOCH))).timestamp()
        for time, topic, message in merge(read, _batches(recording, own), key=itemgetter(0)):
            yield begin + time * 1e-9, topic, message


def _batches(recording: Recording, robots: Mapping[str, str]) -> Iterator[tuple[int, str, Any]]:
    """Yield what happens in some robots (name -> topic), as they publish it live: time (ns), topic, message."""
    from fame.middleware import messages

    epoch = recording.metadata.get("epoch", date_text(EPOCH))

    def batch(robot: str, time: int, changes: list[Any], **more: Any) -> tuple[int, str, Any]:
        numbers[robot] += 1
        content = {"robot": robot, "batch": numbers[robot], "epoch": epoch, "time": time, "changes": changes, **more}
        return time, robots[robot], messages.create(STRING, json.dumps(content))

    first, numbers = recording.state(recording.start).robots if robots else {}, dict.fromkeys(robots, 0)
    for robot in robots:
        yield batch(robot, recording.start, [], key=first.get(robot, RobotState()).to_key())
    for one in recording.messages((EVENTS, VARIABLES, WAITING), recording.start + 1) if robots else ():
        change = recording.decode(one)
        name = str(change.get("robot"))
        if name in robots:
            yield batch(name, one.time, [[one.topic.removeprefix("/fame/"), one.time, change]])


def _require_topics(topics: Mapping[str, str], recorded: Mapping[str, str], file: str) -> None:
    for topic, type in topics.items():
        if topic not in recorded:
            has = ", ".join(sorted(recorded)) or "none"
            raise ConfigError(f"has no topic {topic}; it has {has}", file=file)
        if recorded[topic] != type:
            raise ConfigError(f"expected {type} on {topic}, got {recorded[topic]}", file=file)
