"""Rows into InfluxDB by its line protocol, in batches; nothing is lost while the server is away.

Every line goes to a spool file first. A thread sends what stands there in batches, and remembers in a second file how
far it got, so that a killed process continues there. A server that is unreachable, or answers 5xx, is asked again
after a while. Lines that it refuses (4xx) go to a third file, since sending them again would not help. A line that is
sent twice is stored once: a point is known by its measurement and time.
"""

from __future__ import annotations

import http.client
import os
import threading
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable
from pathlib import Path

from fame.errors import ConfigError
from fame.monitor.pipeline.rows import Row, cells_of, columns_of

BATCH = 5000
"""Lines sent at a time."""

_BYTES = 1 << 20
_TIMEOUT = 5.0


class Influx:
    """Writes rows to ``http://host:8086/database``. `spool` is the path without ending of its files."""

    sent: int
    rows: int

    def __init__(
        self, url: str, spool: Path, measurement: str, report: Callable[[str], object], pause: float = 1.0
    ) -> None:
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
        self.sent, self.rows, self._unreachable, self._database_exists = 0, 0, False, False
        self._pending: list[str] = []
        self._wake, self._ending = threading.Event(), False
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def put(self, row: Row) -> None:
        """One more row."""
        fields = ",".join(
            f"{_escape(name)}={value!r}" for name, value in zip(columns_of(row), cells_of(row), strict=True)
        )
        self._pending.append(f"{self._measurement} {fields},run={row.run}i {round(row.stamp * 1e9)}\n")
        self.rows += 1

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
        if left:
            self._report(f"{left} bytes wait in {self._lines}: recording to the same database again sends them")
        else:
            self._done.unlink(missing_ok=True)  # first: killed in between, lines are sent twice, never skipped
            self._lines.unlink(missing_ok=True)

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
        """The next whole lines that were not sent yet."""
        with self._lines.open("rb") as stream:
            stream.seek(self._offset())
            data = stream.read(_BYTES)
        lines = data[: data.rfind(b"\n") + 1].splitlines(keepends=True)
        return b"".join(lines[:BATCH])

    def _send(self, batch: bytes) -> bool:
        """Whether it is out of the way: stored, or refused for good."""
        try:
            if not self._database_exists:
                self._post(
                    self._query_url, urllib.parse.urlencode({"q": f'CREATE DATABASE "{self._database}"'}).encode()
                )
                self._database_exists = True
            self._post(self._write_url, batch)
            self.sent += batch.count(b"\n")
        except urllib.error.HTTPError as error:
            if error.code >= 500:
                return self._report_unreachable(f"HTTP {error.code}")
            with self._refused.open("ab") as stream:
                stream.write(batch)
            self._report(f"the server refuses {batch.count(10)} lines (HTTP {error.code}); kept in {self._refused}")
        except (OSError, http.client.HTTPException) as error:
            return self._report_unreachable(str(getattr(error, "reason", error)) or type(error).__name__)
        if self._unreachable:
            self._unreachable = False
            self._report("the server is there again; what waited on disk is sent")
        part = self._done.with_suffix(".part")
        part.write_text(str(self._offset() + len(batch)))
        part.replace(self._done)
        return True

    def _report_unreachable(self, reason: str) -> bool:
        if not self._unreachable:
            self._unreachable = True
            self._report(f"the server cannot be reached ({reason}); rows wait on disk in {self._lines}")
        return False

    def _post(self, url: str, data: bytes) -> None:
        request = urllib.request.Request(url, data=data, method="POST")
        with urllib.request.urlopen(request, timeout=_TIMEOUT) as answer:
            answer.read()


def _is_host(parts: urllib.parse.SplitResult) -> bool:
    """Whether it names a host, and a port if any, and nothing that would have to be kept secret."""
    try:
        return bool(parts.hostname) and parts.port != 0 and "@" not in parts.netloc
    except ValueError:  # of the port
        return False


def _truncate_partial_line(lines: Path) -> None:
    """Cut off a partial last line, which a killed writer left: another line would be appended to it."""
    data = lines.read_bytes()
    os.truncate(lines, data.rfind(b"\n") + 1)


def _escape(text: str) -> str:
    """A name in the line protocol, which ends at a line break whatever stands before it."""
    return " ".join(text.splitlines()).replace("\\", "\\\\").replace(",", "\\,").replace(" ", "\\ ").replace("=", "\\=")
