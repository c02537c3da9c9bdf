"""Tables of numbers: CSV files and Parquet.

Cells of a CSV file are separated by a semicolon, tab, comma or |; a decimal comma needs another separator than the
comma. Stamps may be dates of ISO 8601 or as 31.01.2026 12:00:00; true is 1, and false 0, in a column without other
numbers. In a recorded table a cell may be empty: a row holds the message of one topic. What is not a number is reported
with its line and column, never read as something else.
"""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Collection, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fame.errors import ConfigError
from fame.imports import require
from fame.monitor.arrays import Floats, Whole
from fame.text import open_file

STAMP, RUN, LABEL = "stamp", "run", "label"
_WORDS = {"true": 1.0, "false": 0.0}


class Table(NamedTuple):
    """A file: `names` is empty without a header, `cells` (rows, columns), `lines` has the line of each row. The
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


def read_table(
    path: Path, *, recorded: bool = False, stamp: str = STAMP, element: str = "", wanted: Collection[str] | None = None,
    skip: Collection[str] = (),
) -> Table:  # fmt: skip
    """Read the numbers of a CSV file; in the column `stamp`, dates too, and in that of the `element` texts.

    A `recorded` table is one of `fame monitor record`: it has a header, empty cells are NaN, and a partial last line,
    which a killed writer leaves, is dropped. A repeated header, as in concatenated files, is no row. Texts in columns
    that are not `wanted` (default: all but those to `skip`) are read as 0: all that counts is that something is there.
    Raises ConfigError with the line.
    """
    text = _text(path)
    lines = text.splitlines()
    if not lines:
        raise ConfigError("is empty", file=str(path))
    if not lines[0].strip():
        raise ConfigError("is a blank line; expected a header or numbers", file=str(path), line=1)
    separator = _separator(lines[0], path)
    head = _row(lines[0], path, 1, separator)
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
    if header and lines and lines.count(lines[0]) > 1:
        numbers = [number for number in numbers if lines[number - 1] != lines[0]]
    if not numbers:
        raise ConfigError("has no rows of numbers", file=str(path))
    rows = [lines[number - 1] for number in numbers]
    elements = list[str]()
    if element in names:
        place = names.index(element)
        elements, rows = _without_column(place, rows, numbers, len(names), path, separator)
        del head[place]
        names = (*names[:place], *names[place + 1 :])
    apart = {name for name in names if name in skip or (wanted is not None and name not in wanted)}
    comma = separator != "," and any("," in line for line in rows)
    cells = _numbers(rows, numbers, _Cells(path, head, separator, recorded, comma, stamp, apart))
    sure = _written_in_seconds(rows[0], separator, names, stamp)
    return Table(names, cells, numbers, tuple(elements), sure)


_BLOCK = re.compile(r"\s*([A-Za-z]\w*)[ \t]*\n[ \t]*[-+.\d]+[ \t]+[-+.\d]")
"""The begin of a file of blocks."""


def read_blocks(path: Path) -> tuple[Table, list[str]] | None:
    """Read a file of blocks of numbers, each behind a line with its class, as the robot failures of UCI are: a table of
    channels by number, in whose lines each block stands apart, and the class of each row; None for another file.

    Raises ConfigError with the line.
    """
    text = _text(path)
    if not _BLOCK.match(text):
        return None
    rows, lines, classes, name = list[list[float]](), list[int](), list[str](), ""
    for number, line in enumerate(text.splitlines(), start=1):
        cells = line.split()
        if len(cells) == 1 and not _is_number(cells[0]):
            name = cells[0]
        elif cells:
            if not all(map(_is_number, cells)) or len(cells) != len(rows[0] if rows else cells):
                wanted = f"{len(rows[0]) if rows else 'some'} numbers, or the class of the next block"
                raise ConfigError(f"expected {wanted}, got {line.strip()[:60]!r}", file=str(path), line=number)
            rows.append([*map(float, cells)])
            lines.append(number)
            classes.append(name)
    return Table(tuple(f"channel_{n}" for n in range(len(rows[0]))), np.array(rows), lines), classes


def _without_column(
    place: int, lines: Sequence[str], numbers: Sequence[int], width: int, path: Path, separator: str
) -> tuple[list[str], list[str]]:
    """Return the texts of a column, and the rows without it."""
    texts, rows = list[str](), list[str]()
    for number, line in zip(numbers, lines, strict=True):
        row = _row(line, path, number, separator)
        if len(row) != width:
            raise ConfigError(f"expected {width} cells, got {len(row)}", file=str(path), line=number)
        texts.append(row.pop(place).strip())
        rows.append(separator.join(row))
    return texts, rows


def _written_in_seconds(line: str, separator: str, names: Sequence[str], stamp: str) -> bool:
    """Return whether the first stamp is a date, or one of `fame monitor record`, which writes ns as decimals."""
    cells = list[str]()
    with suppress(csv.Error):  # a field that is too long is refused as a number
        cells = next(csv.reader([line], delimiter=separator), [])
    cell = cells[names.index(stamp)] if stamp in names and len(cells) == len(names) else ""
    return _is_date(cell) or (tuple(names[:2]) == (STAMP, RUN) and bool(re.fullmatch(r"-?\d+\.\d{9}", cell)))


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


class _Cells(NamedTuple):
    """How the cells of a file are read.

    gaps   whether cells may be empty, NaN then
    comma  whether decimals have a comma
    stamp  the name of the column where dates may be
    apart  columns whose texts are read as 0: all that counts is that something is there
    """

    path: Path
    head: Sequence[str]
    separator: str
    gaps: bool
    comma: bool
    stamp: str
    apart: Collection[str]

    def row(self, line: str, number: int) -> list[float]:
        """Read a row cell by cell. Raises ConfigError with what is wrong, and where."""
        cells = _row(line, self.path, number, self.separator)
        if len(cells) != len(self.head):
            hint = "; a decimal comma needs another separator, such as ;" if self.separator == "," and cells else ""
            got = f"{len(cells)}{hint}" if cells else "a blank line"
            raise self._error(f"expected {len(self.head)} cells, got {got}", number)
        names = {name.strip() for name in self.head if name.strip() and not _is_number(name)}
        if {cell.strip() for cell in cells} & names:
            text = f"is another header than the first one ({', '.join(self.head)}): these are tables of other columns"
            raise self._error(text, number)
        return [self._cell(name.strip(), cell, number) for name, cell in zip(self.head, cells, strict=True)]

    def _cell(self, name: str, cell: str, number: int) -> float:
        if self.gaps and not cell.strip():
            return np.nan
        try:
            return _number(cell, date=name == self.stamp, comma=self.comma)
        except ValueError:
            if name not in (self.stamp, RUN, LABEL) and (word := cell.strip().lower()) in _WORDS:
                return _WORDS[word]
            if name in self.apart:
                return 0.0
            right = "a number (s) or a date such as 2026-01-31T12:00:00.5" if name == self.stamp else "a number"
            where = f" in column {name!r}" if not _is_number(name) else ""
            if _is_date(cell):
                where += f", a date only in the column of the times (--time-column {name!r})"
            elif self.comma and "." in cell:
                where += " without a point, since decimals have a comma"
            raise self._error(f"expected {right}{where}, got {cell!r}", number) from None

    def refuse_mixed(self, cells: Floats, lines: Sequence[str], numbers: Sequence[int]) -> None:
        """Raise ConfigError for a word of `_WORDS` in a column that also has other numbers than 0 and 1."""
        mixed = [not np.isin(column[~np.isnan(column)], (0.0, 1.0)).all() for column in cells.T]
        for number, line in zip(numbers, lines, strict=True) if any(mixed) else ():
            if any(word in line.lower() for word in _WORDS):
                for name, cell, is_mixed in zip(
                    self.head, _row(line, self.path, number, self.separator), mixed, strict=True
                ):
                    if is_mixed and cell.strip().lower() in _WORDS and name.strip() not in self.apart:
                        raise self._error(f"expected a number in column {name.strip()!r}, got {cell!r}", number)

    def _error(self, text: str, number: int) -> ConfigError:
        return ConfigError(text, file=str(self.path), line=number)


def _numbers(lines: Sequence[str], numbers: Sequence[int], to: _Cells) -> Floats:
    """Parse rows at once, or cell by cell where some are empty or wrong, or dates."""
    if not (to.comma and any("." in line for line in lines)):  # else a point may part thousands, or be in a date
        with suppress(ValueError):  # said below, with its place
            plain = [line.replace(",", ".") for line in lines] if to.comma else lines
            cells = np.loadtxt(plain, delimiter=to.separator, ndmin=2, comments=None)
            if cells.shape == (len(lines), len(to.head)):
                return np.asarray(cells)
    cells = np.array([to.row(line, number) for number, line in zip(numbers, lines, strict=True)], dtype=np.float64)
    to.refuse_mixed(cells, lines, numbers)
    return cells


_GERMAN = re.compile(r"(\d\d)\.(\d\d)\.(\d{4})[ T](.+)")


def _number(cell: str, *, date: bool, comma: bool) -> float:
    """Read a number, or where a `date` may stand also one as above, in s since 1970. Raises ValueError.

    Where decimals have a `comma`, a number must not have a point: 1.500 may be meant as 1500.
    """
    number = cell.replace(",", ".") if comma else cell
    if not date or _is_number(number):
        if comma and "." in cell:
            raise ValueError(cell)
        return _float(number)
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


def _float(text: str) -> float:
    """Read a number as other tools do, without the underscores of Python (1_0). Raises ValueError."""
    if "_" in text or not text.strip().isascii():
        raise ValueError(text)
    return float(text)


def _is_number(text: str) -> bool:
    try:
        _float(text)
    except ValueError:
        return False
    return True


def read_parquet(
    path: Path, *, stamp: str = STAMP, element: str = "", wanted: Collection[str] | None = None,
    skip: Collection[str] = (),
) -> Table:  # fmt: skip
    """Read the numbers of a Parquet file, as `read_table`; dates in s since 1970. Raises ConfigError,
    UnavailableError."""
    require("pandas", "pyarrow")
    import pandas as pd

    try:
        frame = pd.read_parquet(path)
        elements = tuple(frame.pop(element).astype(object).fillna("").astype(str)) if element in frame else ()
        for name in frame.columns:
            text = frame[name].dtype == object and wanted is not None and name not in wanted
            if text:
                del frame[name]
            elif name in skip:
                frame[name] = 0.0  # the column is known, its texts are not
        dated = frame.select_dtypes(include=["datetime", "datetimetz"]).columns
        for name in dated:
            frame[name] = (frame[name].dt.tz_localize(None) - pd.Timestamp(0)) / pd.Timedelta(seconds=1)
        names = tuple(map(str, frame.columns))
        lines = range(1, len(frame) + 1)
        return Table(names, frame.to_numpy(dtype=np.float64), lines, elements, stamp in dated)
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(f"is not a Parquet table of numbers: {error}", file=str(path)) from None
