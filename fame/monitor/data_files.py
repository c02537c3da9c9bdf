"""Files of recorded data: CSV tables, the runs that `fame monitor record` wrote, and bags of ROS 1 and 2.

Runs need a column ``stamp`` (s). A column ``run`` divides a file into runs, and every file begins a new one, as does a
repeated header, where files were written one after another. In a recorded table a cell may be empty: a row holds the
message of one topic. Cells are separated by a semicolon, tab, comma or |; a decimal comma needs another separator than
the comma. Stamps may be dates of ISO 8601 or as 31.01.2026 12:00:00. A bag is a folder of rosbag2 in either storage, a
single MCAP file, also a recording of FAME, or a rosbag1.
"""

from __future__ import annotations

import codecs
import csv
import hashlib
import json
import re
from collections.abc import Collection, Generator, Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from heapq import merge
from itertools import chain
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fame.clock import EPOCH, date_text
from fame.errors import ConfigError
from fame.imports import require
from fame.iso8601 import parse_datetime
from fame.middleware.interface import resolve
from fame.middleware.typesystem import STRING
from fame.monitor.arrays import Floats, Whole
from fame.monitor.pipeline.join import Join, joined_table
from fame.monitor.pipeline.processor import ActiveElements, Samples
from fame.robot.robot_state import EVENTS, EVENTS_TOPIC, VARIABLES, WAITING, RobotState
from fame.text import open_file

if TYPE_CHECKING:
    from fame.log import Recording

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""What stamps may be counted in, in s."""
STAMP, RUN, LABEL, ELEMENT = "stamp", "run", "label", "element"


class CsvTable(NamedTuple):
    """A CSV file: `names` is empty without a header, `cells` (rows, columns), `lines` has the line of each row. The
    column of `elements` (rows,), texts, is not among the cells. `in_seconds`: its stamps are s without doubt, since
    they were dates, or `fame monitor record` wrote them."""

    names: tuple[str, ...]
    cells: Floats
    lines: Sequence[int]
    elements: tuple[str, ...] = ()
    in_seconds: bool = False

    @property
    def joins(self) -> Whole:
        """The rows after a repeated header: files were written one after another."""
        return np.flatnonzero(np.diff(np.asarray(self.lines)) > 1) + 1


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
    of topics with rates of their own are joined by time; columns to `exclude` are not read."""

    stamp: str = STAMP
    run: str = RUN
    element: str = ELEMENT
    unit: str = ""
    join: Join | None = None
    exclude: tuple[str, ...] = ()

    @property
    def unwanted(self) -> tuple[str, ...]:
        """The columns that are no channels."""
        return (self.stamp, self.run, self.element, LABEL, "", *self.exclude)


_USUAL = Special()


def read_runs(
    paths: Sequence[str | Path], columns: Sequence[str] = (), special: Special = _USUAL, *, undisturbed: bool = False
) -> list[Samples]:
    """Read the samples of every run that has some, as `read_labelled_runs`. Raises ConfigError."""
    runs = read_labelled_runs(paths, columns, special, undisturbed=undisturbed)
    return [run.samples for run in runs if len(run.samples)]


def read_labelled_runs(
    paths: Sequence[str | Path], columns: Sequence[str] = (), special: Special = _USUAL, *, undisturbed: bool = False
) -> list[LabelledRun]:
    """Read every run of recorded files with its labels: values (n, columns), stamps (s), names of the columns.

    `columns` are by default those of the first file but `special` ones and label. Rows that lack one are left out.
    `undisturbed` runs must not have an anomalous sample. Raises ConfigError.
    """
    if not paths:
        raise ConfigError("no files to read; expected Files: [runs.csv]", element="Files")
    runs: list[LabelledRun] = []
    found: tuple[str, ...] = ()  # the columns of the first file, if none were asked for
    for path in map(Path, paths):
        if is_bag(path):
            text = "is a bag, expected --config CONFIG.yaml, whose Inputs name topics and fields, or a CSV file"
            text += f": fame monitor record CONFIG.yaml --bag {path} -o runs.csv makes one"
            raise ConfigError(text, file=str(path))
        if path.suffix == ".parquet":
            read = _read_parquet(path, special, columns)
        else:
            wanted = {*special[:2], LABEL, *columns} if columns else None
            read = read_table(
                path, recorded=True, stamp=special.stamp, element=special.element, wanted=wanted, skip=special.exclude
            )
        names, cells, lines, elements, _ = read
        channels = tuple(name for name in names if name not in special.unwanted)
        if found and (more := sorted(set(channels) - set(found))):
            text = f"has columns that the first file lacks, {', '.join(more)}: say which to use (Columns)"
            raise ConfigError(text, file=str(path), line=1)
        if not columns:
            columns = found = channels
        if not columns:
            raise ConfigError(f"has no columns but {', '.join(names)}: nothing to learn from", file=str(path))
        if special.element != ELEMENT and not elements:
            raise ConfigError(f"has no column {special.element!r}", file=str(path), line=1)
        for name in (special.stamp, *columns, *([special.run] if special.run != RUN else [])):
            if name not in names:
                raise ConfigError(f"has no column {name!r}; it has {', '.join(names)}", file=str(path), line=1)
        values = cells[:, [names.index(name) for name in columns]]
        stamps = _in_seconds(read, special, path)
        whole = np.isfinite(values).all(axis=1) & np.isfinite(stamps)
        others = [place for place, name in enumerate(names) if name in channels and name not in columns]
        torn = ~whole & (np.isfinite(values).any(axis=1) | ~np.isfinite(cells[:, others]).any(axis=1))
        numbers = cells[:, names.index(special.run)] if special.run in names else np.zeros(len(cells))
        labels = _labels(cells[:, names.index(LABEL)] if LABEL in names else np.full(len(cells), np.nan), path, lines)
        if not whole.any() and special.join is None:
            rates = ": topics with rates of their own need Join: {Rate, Tolerance, Fill}" if torn.any() else ""
            raise ConfigError(f"has no row with all of {', '.join(columns)}{rates}", file=str(path))
        others_begin = np.flatnonzero(np.diff(np.nan_to_num(numbers)) != 0) + 1
        for rows in np.split(np.arange(len(values)), np.union1d(others_begin, read.joins)):
            if special.join is not None:
                names_of = [elements[row] for row in rows] if elements else []
                runs.append(_joined(special.join, stamps[rows], values[rows], labels[rows], names_of, columns, path))
                continue
            kept = rows[whole[rows]]
            _refuse_backward(stamps, kept, path, lines)
            known = stamps[rows][np.isfinite(stamps[rows])]
            changes = _changes(stamps[kept], [elements[row] for row in kept]) if elements else ()
            samples = Samples(values[kept], stamps[kept], tuple(columns), changes)
            runs.append(LabelledRun(
                samples, np.where(labels[kept] == -1, -1, 1), str(path), len(rows) - len(kept),
                float(np.ptp(known)) if len(known) else 0.0, bool(labels[rows].any()),
                len(kept) / max(1, len(kept) + int(torn[rows].sum())),
                lacking=_lacking(values[rows], torn[rows], columns, [lines[row] for row in rows[torn[rows]][:1]]),
            ))  # fmt: skip
    for number, run in enumerate(runs if undisturbed else ()):
        if (run.labels == -1).any():
            text = f"expected undisturbed runs (label 1), got label -1 in run {number}"
            raise ConfigError(text, file=run.file)
    return runs


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


def _lacking(values: Floats, torn: Any, columns: Sequence[str], first: Sequence[int]) -> str:
    """Say what the `torn` rows of a run lack, in which columns, and in which line first."""
    if not torn.any():
        return ""
    lost = values[torn]
    kinds = (("an empty cell", np.isnan(lost)), ("inf", np.isinf(lost)))
    what = " or ".join(text for text, there in kinds if there.any())
    names = [name for name, column in zip(columns, lost.T, strict=True) if not np.isfinite(column).all()]
    where = f" in {', '.join(names)}" if names else ""
    return f"{len(lost)} of {len(values)} rows have {what or 'no stamp'}{where} (line {first[0]} first)"


def _changes(stamps: Floats, elements: Sequence[str]) -> ActiveElements:
    """Return the stamps at which another element was active, and which (empty: not known); none without any name."""
    begins = [row for row, name in enumerate(elements) if row == 0 or name != elements[row - 1]]
    return tuple((float(stamps[row]), elements[row]) for row in begins) if any(elements) else ()


_TELLING = 10
"""Steps that tell a unit, at least."""
_DAYS = (30_000.0, 60_000.0)
"""Stamps that a spreadsheet writes for the years 1982 to 2064."""


def _in_seconds(read: CsvTable, special: Special, path: Path) -> Floats:
    """Return the stamps in s. Raises ConfigError for those that are of another unit than is said."""
    stamps = read.cells[:, read.names.index(special.stamp)]
    unit = TIME_UNITS.get(special.unit, 1.0)
    if read.in_seconds and unit != 1:
        raise ConfigError(f"the times are no numbers of {special.unit}: they are s, or dates", file=str(path), line=2)
    stamps = stamps if unit == 1 else stamps * unit
    _refuse_other_units(stamps, path, doubtful=not read.in_seconds and not special.unit)
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


def read_table(
    path: Path, *, recorded: bool = False, stamp: str = STAMP, element: str = "", wanted: Collection[str] | None = None,
    skip: Collection[str] = (),
) -> CsvTable:  # fmt: skip
    """Read the numbers of a CSV file; in the column `stamp`, dates too, and in that of the `element` texts.

    A `recorded` table is one of `fame monitor record`: it has a header, empty cells are NaN, and a partial last line,
    which a killed writer leaves, is dropped. A repeated header, as in concatenated files, is no row. Texts in columns
    that are not `wanted` (default: all but those to `skip`) are read as 0: all that counts is that something is there.
    Raises ConfigError with the line.
    """
    text = _text(path)
    lines = text.splitlines()
    if lines and not lines[0].strip():
        raise ConfigError("is a blank line; expected a header or numbers", file=str(path), line=1)
    separator = _separator(lines[0], path) if lines else ","
    head = _row(lines[0], path, 1, separator) if lines else []
    header = not all(_is_number(cell.replace(",", ".")) for cell in head)
    names = tuple(name.strip() for name in head) if header else ()
    if recorded and (not names or any(map(_is_number, names))):
        raise ConfigError("has no header; expected stamp,effort_0,...", file=str(path), line=1)
    twice = [name for name in names if name and names.count(name) > 1]
    if twice:
        raise ConfigError(f"has several columns {twice[0]!r}; expected unique names", file=str(path), line=1)
    if recorded and names[:2] == (STAMP, RUN) and not text.endswith("\n"):
        lines.pop()
    while lines and not lines[-1].strip():
        lines.pop()
    numbers: Sequence[int] = range(2 if header else 1, len(lines) + 1)
    if header and lines.count(lines[0]) > 1:
        numbers = [number for number in numbers if lines[number - 1] != lines[0]]
    if not numbers:
        raise ConfigError("has no rows of numbers", file=str(path))
    rows = [lines[number - 1] for number in numbers]
    elements = list[str]()
    if element in names:
        place, width = names.index(element), len(names)
        for index, (number, line) in enumerate(zip(numbers, rows, strict=True)):
            row = _row(line, path, number, separator)
            if len(row) != width:
                raise ConfigError(f"expected {width} cells, got {len(row)}", file=str(path), line=number)
            elements.append(row.pop(place).strip())
            rows[index] = separator.join(row)
        del head[place]
        names = (*names[:place], *names[place + 1 :])
    apart = {name for name in names if name in skip or (wanted is not None and name not in wanted)}
    cells = _numbers(rows, numbers, head, path, recorded, separator, stamp, apart)
    sure = _written_in_seconds(rows[0], separator, names, stamp)
    return CsvTable(names, cells, numbers, tuple(elements), sure)


def _written_in_seconds(line: str, separator: str, names: Sequence[str], stamp: str) -> bool:
    """Return whether the first stamp is a date, or one of `fame monitor record`, which writes ns as decimals."""
    cells = list[str]()
    with suppress(csv.Error):  # a field that is too long is refused as a number
        cells = next(csv.reader([line], delimiter=separator), [])
    cell = cells[names.index(stamp)] if stamp in names and len(cells) == len(names) else ""
    return _is_date(cell) or (tuple(names[:2]) == (STAMP, RUN) and bool(re.fullmatch(r"-?\d+\.\d{9}", cell)))


def _read_parquet(path: Path, special: Special, wanted: Sequence[str] = ()) -> CsvTable:
    """Read the numbers of a Parquet file; dates in s since 1970. Raises ConfigError, UnavailableError."""
    require("pandas", "pyarrow")
    import pandas as pd

    try:
        frame = pd.read_parquet(path)
        elements = (
            tuple(frame.pop(special.element).astype(object).fillna("").astype(str)) if special.element in frame else ()
        )
        special_names = [special.stamp, special.run, LABEL, *wanted]
        for name in frame.columns:
            if name in special.exclude or (wanted and name not in special_names and frame[name].dtype == object):
                del frame[name]
        dated = frame.select_dtypes(include=["datetime", "datetimetz"]).columns
        for name in dated:
            frame[name] = (frame[name].dt.tz_localize(None) - pd.Timestamp(0)) / pd.Timedelta(seconds=1)
        names = tuple(map(str, frame.columns))
        lines = range(1, len(frame) + 1)
        return CsvTable(names, frame.to_numpy(dtype=np.float64), lines, elements, special.stamp in dated)
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(f"is not a Parquet table of numbers: {error}", file=str(path)) from None


def _text(path: Path) -> str:
    try:
        with open_file(path) as stream:
            data = stream.read()
        wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        text = data.decode("utf-16" if wide else "utf-8-sig")
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", file=str(path)) from None
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ConfigError("is not UTF-8 text: save it as UTF-8", file=str(path), line=line) from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _separator(line: str, path: Path) -> str:
    """Return what parts the cells of the first line; a comma beside another one is a decimal comma."""
    return next((sign for sign in ";\t,|" if len(_row(line, path, 1, sign)) > 1), ",")


def _numbers(
    lines: Sequence[str],
    numbers: Sequence[int],
    head: Sequence[str],
    path: Path,
    gaps: bool,
    separator: str,
    stamp: str,
    apart: Collection[str],
) -> Floats:
    """Parse rows at once, or cell by cell where some are empty or wrong, or dates."""
    width = len(head)
    comma = separator != "," and any("," in line for line in lines)
    mixed = comma and any("." in line for line in lines)  # a point may then part thousands, or be in a date
    if not mixed:
        with suppress(ValueError):
            plain = [line.replace(",", ".") for line in lines] if comma else lines
            cells = np.loadtxt(plain, delimiter=separator, ndmin=2, comments=None)
            if cells.shape == (len(lines), width):
                return np.asarray(cells)
    rows: list[list[float]] = []
    for number, line in zip(numbers, lines, strict=True):
        row = _row(line, path, number, separator)
        if len(row) != width:
            hint = "; a decimal comma needs another separator, such as ;" if separator == "," and row else ""
            got = f"{len(row)}{hint}" if row else "a blank line"
            raise ConfigError(f"expected {width} cells, got {got}", file=str(path), line=number)
        if {cell.strip() for cell in row} & {name.strip() for name in head if name.strip() and not _is_number(name)}:
            text = f"is another header than the first one ({', '.join(head)}): these are tables of other columns"
            raise ConfigError(text, file=str(path), line=number)
        rows.append([])
        for name, cell in zip(head, row, strict=True):
            try:
                value = _number(cell, date=name.strip() == stamp, comma=comma) if cell.strip() or not gaps else np.nan
                rows[-1].append(value)
            except ValueError:
                if name.strip() in apart:
                    rows[-1].append(0.0)
                    continue
                right = "a number (s) or a date such as 2026-01-31T12:00:00.5" if name.strip() == stamp else "a number"
                where = f" in column {name.strip()!r}" if not _is_number(name) else ""
                if _is_date(cell):
                    where += f", a date only in the column of the times (--time-column {name.strip()!r})"
                elif comma and "." in cell:
                    where += " without a point, since decimals have a comma"
                raise ConfigError(f"expected {right}{where}, got {cell!r}", file=str(path), line=number) from None
    return np.array(rows, dtype=np.float64)


_GERMAN = re.compile(r"(\d\d)\.(\d\d)\.(\d{4})[ T](.+)")


def _number(cell: str, *, date: bool, comma: bool) -> float:
    """Read a number, or where a `date` may stand also one as above, in s since 1970. Raises ValueError.

    Where decimals have a `comma`, a number must not have a point: 1.500 may be meant as 1500.
    """
    number = cell.replace(",", ".") if comma else cell
    if not date or _is_number(number):
        if comma and "." in cell:
            raise ValueError(cell)
        return float(number)
    moment = _moment(number)
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _moment(text: str) -> datetime:
    return datetime.fromisoformat(_GERMAN.sub(r"\3-\2-\1 \4", text.strip()))


def _is_date(text: str) -> bool:
    with suppress(ValueError):
        return not _is_number(text) and bool(_moment(text))
    return False


def _row(line: str, path: Path, number: int, separator: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error as error:
        raise ConfigError(f"is not a row of a table: {error}", file=str(path), line=number) from None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


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
