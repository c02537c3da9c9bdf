"""Rows of a recording, and the CSV file that they go to.

A row is a message: its stamp, the number of the run, and a cell per channel of the inputs of its topic; the cells of
other topics are empty, since nothing was said there. Columns are named by input, and by channel where it has several:
``Effort0``, ``Efforts.elbow_joint``, ``Efforts.3``.

Rows are written in whole lines, so that a file is whole up to its last line whenever the process is killed. The header
needs the channels of every topic: rows wait in memory until each has had a message, or for `PATIENCE`; a topic that was
silent until then has no columns, which is reported.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from fame.errors import ConfigError
from fame.monitor.pipeline.configuration import Port
from fame.monitor.silence import ThrottledReport
from fame.monitor.tables import RUN, STAMP

PATIENCE = 10.0
"""How long (s) a topic may be silent before the header is written without it."""


class Row(NamedTuple):
    """One message: the inputs of its topic, their values, the names of their channels."""

    stamp: float
    run: int
    ports: Sequence[Port]
    values: Sequence[Any]
    names: Sequence[tuple[str, ...]]


def columns_of(row: Row) -> list[str]:
    """The names of its columns."""
    found: list[str] = []
    for port, value, names in zip(row.ports, row.values, row.names, strict=True):
        if value.__class__ is float:
            found.append(port.name)
        else:
            count = value.size
            found += names if len(names) == count else [f"{port.name}.{index}" for index in range(count)]
    return found


def cells_of(row: Row) -> list[float]:
    """The values, flat."""
    if len(row.values) == 1 and row.values[0].__class__ is not float:
        return list(row.values[0].ravel().tolist())
    cells: list[float] = []
    for value in row.values:
        if value.__class__ is float:
            cells.append(value)
        else:
            cells += value.ravel().tolist()
    return cells


class CsvFile:
    """Writes rows to a file.

    `append` continues a file that has the same columns; `now` gives the time (s), since the stamps of two topics may be
    of two clocks.
    """

    path: Path
    rows: int
    first_run: int

    def __init__(
        self,
        path: Path,
        ports: Sequence[Port],
        report: ThrottledReport,
        now: Callable[[], float],
        *,
        append: bool = False,
    ) -> None:
        self.path, self.rows, self._report, self._now, self._since = path, 0, report, now, 0.0
        self._topics = list(dict.fromkeys(port.topic for port in ports))
        self._waiting: list[Row] | None = []
        self._places: dict[str, tuple[list[str], str]] = {}  # topic -> its columns, and the format of a line
        self._lines: list[str] = []
        self.first_run, self._header = 0, ""
        if append and path.exists():
            self._header, self.first_run = _recover(path)
        elif path.exists():
            raise ConfigError("exists already; --append goes on with it", file=str(path))
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)

    def put(self, row: Row) -> None:
        """Write a row. Raises ConfigError if the file to continue has other columns."""
        if self._waiting is None:
            self._write(row)
            return
        if not self._waiting:
            self._since = self._now()
        self._waiting.append(row)
        spoken = {each.ports[0].topic for each in self._waiting}
        if len(spoken) == len(self._topics) or self._now() - self._since > PATIENCE:
            self._begin()

    def flush(self) -> None:
        """Write what is complete, in whole lines."""
        if self._lines:
            data = "".join(self._lines).encode()
            self._lines.clear()
            try:
                while data:
                    data = data[os.write(self._file, data) :]
            except OSError as error:
                raise ConfigError(f"cannot be written: {error.strerror}", file=str(self.path)) from None

    def close(self) -> None:
        """Write the rest."""
        if self._waiting:
            self._begin()
        self.flush()
        os.close(self._file)

    def _begin(self) -> None:
        waiting, self._waiting = self._waiting or [], None
        first = {row.ports[0].topic: columns_of(row) for row in reversed(waiting)}
        of_topics = {topic: first[topic] for topic in self._topics if topic in first}
        for topic in self._topics:
            if topic not in of_topics:
                self._report(f"silent column {topic}", f"{topic}: silent for {PATIENCE:g} s; it has no columns")
        header = _header(name for names in of_topics.values() for name in names)
        if self._header and self._header != header:
            text = f"has the columns {self._header.strip()}; now there are {header.strip()}"
            raise ConfigError(text, file=str(self.path))
        if not self._header:
            self._lines.append(header)
        before, total = 0, sum(map(len, of_topics.values()))
        for topic, names in of_topics.items():
            after = total - before - len(names)
            line = "%.9f,%d" + "," * before + ",%.16g" * len(names) + "," * after + "\n"
            self._places[topic] = (names, line)
            before += len(names)
        for row in waiting:
            self._write(row)

    def _write(self, row: Row) -> None:
        topic = row.ports[0].topic
        names, line = self._places.get(topic, ([], ""))
        cells = cells_of(row)
        if len(cells) != len(names):
            self._report(f"columns {topic}", f"{topic}: left out: {len(cells)} values for {len(names)} columns")
            return
        self._lines.append(line % (row.stamp, row.run + self.first_run, *cells))
        self.rows += 1


def _header(columns: Iterable[str]) -> str:
    """The first line. A name with a comma is quoted, one with a line break gets spaces instead."""
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow([STAMP, RUN, *(" ".join(name.splitlines()) for name in columns)])
    return line.getvalue()


def _recover(path: Path) -> tuple[str, int]:
    """The header and the number of the next run of a file to go on with; a torn last line is cut off."""
    data, begins = path.read_bytes(), f"{STAMP},{RUN},".encode()
    if data[: len(begins)] != begins[: len(data)]:
        raise ConfigError("was not recorded by fame record", file=str(path), line=1)
    whole = data.rfind(b"\n") + 1
    if whole != len(data):
        os.truncate(path, whole)
    lines = data[:whole].decode("utf-8", "replace").splitlines(keepends=True)
    if not lines:
        return "", 0
    last = lines[-1].split(",") if len(lines) > 1 else []
    return lines[0], int(last[1]) + 1 if len(last) > 1 and last[1].isdecimal() else 0
