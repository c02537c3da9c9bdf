"""Destinations of a recording: CSV files, bags, and InfluxDB.

A row is a message: its stamp, the number of the run, and a cell per channel of the inputs of its topic. Columns are
named by input, and by channel where it has several: ``Effort0``, ``Efforts.elbow_joint``, ``Efforts.3``.

*CSV.* The cells of the other topics of a row are empty. Whole lines are written, so a killed process leaves a file that
is complete up to its last line. The header needs the channels of every topic: rows wait in memory until each topic has
had a message, or for `PATIENCE`; a topic that was silent until then has no columns, which is reported. The trigger of
runs has one always.

*Bags* hold whole messages: a folder as `ros2 bag` writes it, or one MCAP file.

*InfluxDB* is written by its line protocol, in batches. Every line goes to a spool file first. A thread sends the lines
of this file, and stores in a second file how far it got, so that a restarted process continues there. A server
that is unreachable, or answers 5xx, is tried again later. Lines that it refuses (4xx) go to a third file, since sending
them again would not help. A line that is sent twice is stored once: a point is identified by measurement and time.
"""

from __future__ import annotations

import csv
import http.client
import io
import os
import shutil
import tempfile
import threading
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from fame.clock import SECOND
from fame.errors import ConfigError
from fame.middleware import codec
from fame.monitor.data_files import ELEMENT, stamp_text
from fame.monitor.pipeline.configuration import Port
from fame.monitor.pipeline.elements import ElementFollower
from fame.monitor.pipeline.input_node import ThrottledReport
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


class RowsStored(NamedTuple):
    """How many rows an output has, and what it lacks: how many rows are `missing`, and why."""

    rows: int
    missing: int
    reasons: tuple[str, ...] = ()

    @property
    def whole(self) -> bool:
        return not self.missing and not self.reasons


def columns_of(row: Row) -> list[str]:
    found: list[str] = []
    for port, value, names in zip(row.ports, row.values, row.names, strict=True):
        if value.__class__ is float:
            found.append(port.name)
        else:
            count = value.size
            found += names if len(names) == count else [f"{port.name}.{index}" for index in range(count)]
    return found


def cells_of(row: Row) -> list[float]:
    """Return the values, flat."""
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

    `append` continues a file that has the same columns; `follower` knows the active element of the mission, which the
    last column then has; `now` gives the time (s), since the stamps of two topics may be of two clocks. The `trigger`
    of runs has a column before it has a message.
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
        follower: ElementFollower | None = None,
        trigger: Port | None = None,
    ) -> None:
        self._follower = follower
        self._known = (
            {trigger.topic: [trigger.name]}
            if trigger is not None and [trigger] == [port for port in ports if port.topic == trigger.topic]
            else {}
        )
        self.path, self.rows, self._report, self._now, self._since = path, 0, report, now, 0.0
        self._topics = list(dict.fromkeys(port.topic for port in ports))
        self._waiting: list[Row] | None = []
        self._places: dict[str, tuple[list[str], str]] = {}  # topic -> its columns, and the format of a line
        self._lines: list[str] = []
        self._taken, self._silent = 0, list[str]()  # rows, and topics without columns
        self.first_run, self._header = 0, ""
        if append and path.exists():
            self._header, self.first_run = _recover(path)
        elif path.exists() and path.stat().st_size:
            raise ConfigError("exists already; use --append to continue it", file=str(path))
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)

    def put(self, row: Row) -> None:
        """Write a row. Raises ConfigError if the file to continue has other columns."""
        self._taken += 1
        if self._waiting is None:
            self._write(row)
            return
        if not self._waiting:
            self._since = self._now()
        self._waiting.append(row)
        spoken = {*self._known, *(each.ports[0].topic for each in self._waiting)}
        if len(spoken) == len(self._topics) or self._now() - self._since > PATIENCE:
            self._begin()

    @property
    def stored(self) -> RowsStored:
        """What the file has of the rows, to be asked once it is closed."""
        return RowsStored(
            self.rows, self._taken - self.rows, tuple(f"{topic} has no columns" for topic in self._silent)
        )

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
        """Write the rest. A file that nothing was written to is removed: nobody takes it for a recording."""
        try:
            if self._waiting:
                self._begin()
            self.flush()
        finally:
            if not os.fstat(self._file).st_size:
                self.path.unlink(missing_ok=True)
            os.close(self._file)

    def _begin(self) -> None:
        waiting, self._waiting = self._waiting or [], None
        first = {**self._known, **{row.ports[0].topic: columns_of(row) for row in reversed(waiting)}}
        of_topics = {topic: first[topic] for topic in self._topics if topic in first}
        for topic in self._topics:
            if topic not in of_topics:
                self._silent.append(topic)
                self._report(f"silent column {topic}", f"{topic}: silent for {PATIENCE:g} s; it has no columns")
        element = [ELEMENT] if self._follower is not None else []
        header = _header([*(name for names in of_topics.values() for name in names), *element])
        if self._header and self._header != header:
            text = f"has the columns {self._header.strip()}; now there are {header.strip()}"
            raise ConfigError(text, file=str(self.path))
        if not self._header:
            self._lines.append(header)
        before, total = 0, sum(map(len, of_topics.values()))
        end = "\n" if self._follower is None else ",%s\n"
        for topic, names in of_topics.items():
            after = total - before - len(names)
            line = "%s,%d" + "," * before + ",%.16g" * len(names) + "," * after + end
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
        element = [self._follower.element_at(row.stamp)] if self._follower is not None else []
        self._lines.append(line % (stamp_text(row.stamp), row.run + self.first_run, *cells, *element))
        self.rows += 1


def _header(columns: Iterable[str]) -> str:
    """Return the first line. A name with a comma is quoted, one with a line break gets spaces instead."""
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow([STAMP, RUN, *(" ".join(name.splitlines()) for name in columns)])
    return line.getvalue()


def _recover(path: Path) -> tuple[str, int]:
    """Return the header and the number of the next run of a file to go on with; a torn last line is cut off."""
    data, begins = path.read_bytes(), f"{STAMP},{RUN},".encode()
    if data[: len(begins)] != begins[: len(data)]:
        raise ConfigError("was not recorded by fame monitor record", file=str(path), line=1)
    whole = data.rfind(b"\n") + 1
    if whole != len(data):
        os.truncate(path, whole)
    lines = data[:whole].decode("utf-8", "replace").splitlines(keepends=True)
    if not lines:
        return "", 0
    last = lines[-1].split(",") if len(lines) > 1 else []
    return lines[0], int(last[1]) + 1 if len(last) > 1 and last[1].isdecimal() else 0


BATCH = 5000
"""Lines sent at a time."""

_BYTES = 1 << 20
_TIMEOUT = 5.0


class BagWriter:
    """Writes messages to a folder as `ros2 bag` does, or to a file if its name ends in ``.mcap``.

    Raises ConfigError if it exists already.
    """

    path: Path
    count: int

    def __init__(self, path: Path, ports: Sequence[Port], topics: Sequence[str]) -> None:
        """`topics` are the full names, one per port."""
        from rosbags.rosbag2 import StoragePlugin, Writer

        if path.exists():
            raise ConfigError("exists already", file=str(path))
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path, self.count = path, 0
        self._folder = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}.")) if path.suffix else None
        target = self._folder / "bag" if self._folder is not None else path
        self._writer = Writer(target, version=9, storage_plugin=StoragePlugin.MCAP)
        self._writer.open()
        types = dict(zip(topics, (port.type for port in ports), strict=True))
        self._connections = {
            topic: self._writer.add_connection(topic, type, typestore=codec.typestore(type))
            for topic, type in types.items()
        }

    def put(self, topic: str, stamp: float, message: Any) -> None:
        """Write a message at its time (s)."""
        self._writer.write(self._connections[topic], round(stamp * SECOND), codec.serialize(message))
        self.count += 1

    @property
    def stored(self) -> RowsStored:
        """What the bag has: each message."""
        return RowsStored(self.count, 0)

    def close(self) -> None:
        """Finish the bag; one without messages is removed."""
        self._writer.close()
        if self._folder is not None:
            (made,) = (self._folder / "bag").glob("*.mcap")
            if self.count:
                made.replace(self.path)
            shutil.rmtree(self._folder)
        elif not self.count:
            shutil.rmtree(self.path)


_NO_DATE = 10 * 365.25 * 86400
"""Stamps (s) that are less count from the beginning of something, not from 1970."""


class Influx:
    """Writes rows to ``http://host:8086/database``. `spool` is the path without ending of its files.

    Of the lines, also those that an earlier process left, `sent` were taken and `refused` not; once it is closed,
    `waiting` are on disk. A stamp before 1980 is no date, but counts from `origin` (ns): messages without a stamp have
    the time since the recording began.
    """

    sent: int
    refused: int
    waiting: int

    def __init__(
        self, url: str, spool: Path, measurement: str, report: Callable[[str], object], *,
        pause: float = 1.0, origin: int = 0,
    ) -> None:  # fmt: skip
        self._origin = origin
        parts = urllib.parse.urlsplit(url)
        database = parts.path.strip("/")
        if parts.scheme not in ("http", "https") or not _is_host(parts) or not database or "/" in database:
            raise ConfigError(f"expected http://host:8086/database, got {url!r}", element="output")
        query = urllib.parse.urlencode({"db": database, "precision": "ns"})
        self._write_url = f"{parts.scheme}://{parts.netloc}/write?{query}"
        self._query_url = f"{parts.scheme}://{parts.netloc}/query"
        self._database, self._report, self._pause = database, report, pause
        self._measurement = _escape(measurement)
        spool.parent.mkdir(parents=True, exist_ok=True)
        self._lines, self._done, self._refused = (spool.with_suffix(end) for end in (".lines", ".sent", ".refused"))
        self._spool = self._lines.open("ab", buffering=0)
        _truncate_partial_line(self._lines)
        self.sent = self.refused = self.waiting = self._told = 0
        self._unreachable = self._database_exists = False
        self._pending: list[str] = []
        self._wake, self._ending = threading.Event(), False
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def put(self, row: Row) -> None:
        fields = ",".join(
            f"{_escape(name)}={value!r}" for name, value in zip(columns_of(row), cells_of(row), strict=True)
        )
        time = round(row.stamp * 1e9) + (self._origin if row.stamp < _NO_DATE else 0)
        self._pending.append(f"{self._measurement} {fields},run={row.run}i {time}\n")

    def flush(self) -> None:
        """Put what is complete on disk, and let it be sent."""
        if self._pending:
            data = "".join(self._pending).encode()
            self._pending.clear()
            while data:
                data = data[self._spool.write(data) :]
            self._wake.set()

    def close(self, timeout: float = _TIMEOUT) -> None:
        """Send the rest for so long (s); what cannot be sent waits on disk, which is reported."""
        self.flush()
        self._ending = True
        self._wake.set()
        self._thread.join(timeout)
        self._spool.close()
        left = self._lines.stat().st_size - self._offset()
        with self._lines.open("rb") as stream:
            stream.seek(self._offset())
            self.waiting = sum(line.endswith(b"\n") for line in stream)
        if self.refused > self._told:
            self._report(f"the server has refused {self.refused} lines in all; kept in {self._refused}")
        if left:
            self._report(f"{left} bytes wait in {self._lines}: recording to the same database again sends them")
        else:
            self._done.unlink(missing_ok=True)  # first: killed in between, lines are sent twice, never skipped
            self._lines.unlink(missing_ok=True)

    @property
    def stored(self) -> RowsStored:
        """What the database has of the rows, to be asked once it is closed."""
        found = ((self.refused, "refused by the server"), (self.waiting, "waiting on disk"))
        return RowsStored(
            self.sent, self.refused + self.waiting, tuple(f"{count} are {what}" for count, what in found if count)
        )

    # ---- the thread --------------------------------------------------------------------------------------------------

    def _work(self) -> None:
        while True:
            self._wake.wait(None if not self._ending else 0)
            self._wake.clear()
            while batch := self._next():
                if not self._send(batch):
                    if self._ending:
                        return
                    threading.Event().wait(self._pause)
            if self._ending:
                return

    def _offset(self) -> int:
        try:
            return int(self._done.read_text())
        except (OSError, ValueError):
            return 0

    def _next(self) -> bytes:
        """Return the next whole lines that were not sent yet."""
        with self._lines.open("rb") as stream:
            stream.seek(self._offset())
            data = stream.read(_BYTES)
        lines = data[: data.rfind(b"\n") + 1].splitlines(keepends=True)
        return b"".join(lines[:BATCH])

    def _send(self, batch: bytes) -> bool:
        """Send lines. Returns whether they are out of the way: stored, or refused for good."""
        try:
            if not self._database_exists:
                self._post(
                    self._query_url, urllib.parse.urlencode({"q": f'CREATE DATABASE "{self._database}"'}).encode()
                )
                self._database_exists = True
            self._post(self._write_url, batch)
            self.sent += batch.count(b"\n")
        except urllib.error.HTTPError as error:
            error.close()
            if error.code >= 500:
                return self._report_unreachable(f"HTTP {error.code}")
            with self._refused.open("ab") as stream:
                stream.write(batch)
            if not self.refused:
                self._told = batch.count(10)
                self._report(f"the server refuses {self._told} lines (HTTP {error.code}); kept in {self._refused}")
            self.refused += batch.count(10)
        except (OSError, http.client.HTTPException) as error:
            return self._report_unreachable(str(getattr(error, "reason", error)) or type(error).__name__)
        if self._unreachable:
            self._unreachable = False
            self._report("the server is available again; rows stored on disk are sent")
        part = self._done.with_suffix(".part")
        part.write_text(str(self._offset() + len(batch)))
        part.replace(self._done)
        return True

    def _report_unreachable(self, reason: str) -> bool:
        if not self._unreachable:
            self._unreachable = True
            self._report(f"the server cannot be reached ({reason}); rows are stored on disk in {self._lines}")
        return False

    def _post(self, url: str, data: bytes) -> None:
        request = urllib.request.Request(url, data=data, method="POST")
        with urllib.request.urlopen(request, timeout=_TIMEOUT) as answer:
            answer.read()


def _is_host(parts: urllib.parse.SplitResult) -> bool:
    """Return whether an address names a host, perhaps a port, and nothing that would have to be kept secret."""
    try:
        return bool(parts.hostname) and parts.port != 0 and "@" not in parts.netloc
    except ValueError:  # of the port
        return False


def _truncate_partial_line(lines: Path) -> None:
    """Cut off a partial last line, which a killed writer left: another line would be appended to it."""
    data = lines.read_bytes()
    os.truncate(lines, data.rfind(b"\n") + 1)


def _escape(text: str) -> str:
    """Escape a name for the line protocol, which ends at any line break."""
    return " ".join(text.splitlines()).replace("\\", "\\\\").replace(",", "\\,").replace(" ", "\\ ").replace("=", "\\=")
