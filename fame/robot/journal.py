"""An append-only journal of records in a directory: checksums, group commit, bounded growth.

Theory of operation. A directory belongs to one engine at a time (``lock``). Records are lines of the newest *segment*
``journal-N``: a header, the whole state, then one record for each change of it. When the changes have become long, the
state is written to a new segment, which replaces the old one as soon as it is on the disk: growth is bounded.

A line is ``CHECKSUM NUMBER SYNCED JSON``. The checksum (CRC-32) covers the rest of the line and the id of the journal.
``SYNCED`` is the number of the last record that was known to be on the disk when the line was written. Reading stops at
the first line that is incomplete or wrong. Such a line is the torn end of the file after a loss of power, unless a
later line proves that it was on the disk: then the journal is damaged, and is refused.

`append` hands a record to the operating system: it survives the death of the process. `sync` calls back when all
records so far are on the disk, and survive the loss of power. Requests that come while the disk is busy share the next
write (group commit). Without `later` the disk is waited for.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import threading
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO
from uuid import uuid4

import orjson

from fame.errors import ConfigError

FORMAT = 1
"""Version of the format. A journal of another version is refused."""
_PREFIX, _SUFFIX = "journal-", ".tmp"
_LEAST, _TIMES = 1 << 20, 8
"""A segment is replaced when its changes take more than this (bytes), and that many times the size of the state."""
_LONGEST = 1 << 28
"""The longest line that is written and read (bytes)."""
_NUMBERS = 64
"""The numbers of a line are in its first bytes."""

Record = dict[str, Any]
Later = Callable[[Callable[[], object]], object]
"""Has a function called soon, in the thread of the engine."""


@dataclass(frozen=True, slots=True)
class Contents:
    """The content of a segment: its header, and where its undamaged records are. They are read when they are needed.

    number  how many records there are: the state, and its changes
    first   where the state ends (bytes)
    last    where the last record begins (bytes)
    end     where it ends (bytes)
    """

    path: Path
    header: Record
    number: int
    first: int
    last: int
    end: int

    def records(self) -> Iterator[Record]:
        """The state, then its changes, one at a time. Raises ConfigError if the file cannot be read any more."""
        with _opened(self.path) as file:
            file.readline(_LONGEST)
            for _ in range(self.number):
                yield self._next(file)

    def last_record(self) -> Record:
        """The last record. Raises ConfigError if the file cannot be read any more."""
        with _opened(self.path) as file:
            file.seek(self.last)
            return self._next(file)

    def _next(self, file: BinaryIO) -> Record:
        found = _parsed(file.readline(_LONGEST), _seed(str(self.header["journal"])))
        if found is None:
            raise ConfigError("has changed while it was read", file=str(self.path))
        return found


# ---- reading ---------------------------------------------------------------------------------------------------------


def read_segment(path: Path) -> Contents:
    """Find the records of a segment up to its torn end, line by line: a segment may be larger than the memory.

    Raises ConfigError for one that is damaged, foreign or of another version.
    """
    with _opened(path) as file:
        return _read(path, file)


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    try:
        with path.open("rb") as file:
            yield file
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", file=str(path)) from None


def _read(path: Path, file: BinaryIO) -> Contents:
    header, seed = _header(path, file.readline(_LONGEST))
    number, first, last, end = 0, 0, 0, file.tell()
    for line in iter(lambda: file.readline(_LONGEST), b""):
        numbers = _checked(line, seed)
        if numbers is None or numbers[0] != number + 1:
            _refuse_damage(path, file, seed, number + 1, end)
            break
        number, last, end = number + 1, end, end + len(line)
        first = first or end
    if not number:
        raise ConfigError("is damaged: the state at its beginning is missing or wrong", file=str(path))
    return Contents(path, header, number, first, last, end)


def _header(path: Path, line: bytes) -> tuple[Record, int]:
    header = _parsed(line, 0)
    if header is None or "journal" not in header:
        raise ConfigError("is not a journal of a FAME engine, or its first line is damaged", file=str(path))
    if header.get("format") != FORMAT:
        text = f"has format {header.get('format')}; this version of FAME reads format {FORMAT}"
        raise ConfigError(text, file=str(path))
    return header, _seed(str(header["journal"]))


def _refuse_damage(path: Path, file: BinaryIO, seed: int, missing: int, offset: int) -> None:
    """Raise ConfigError if a later line says that the missing record was on the disk."""
    for line in iter(lambda: file.readline(_LONGEST), b""):
        later = _checked(line, seed)
        if later is not None and later[1] >= missing:
            text = f"is damaged at byte {offset}: record {missing} was on the disk and cannot be read any more"
            raise ConfigError(text, file=str(path))


def _checked(line: bytes, seed: int) -> tuple[int, int] | None:
    """Number and synced number of a line; None for one that is incomplete or wrong."""
    if not line.endswith(b"\n") or line[8:9] != b" ":
        return None
    try:
        if int(line[:8], 16) != zlib.crc32(memoryview(line)[9:-1], seed):
            return None
        number, synced = line[9:_NUMBERS].split(b" ", 2)[:2]
        return int(number), int(synced)
    except ValueError:
        return None


def _parsed(line: bytes, seed: int) -> Record | None:
    """The content of a line; None for one that is incomplete or wrong."""
    if _checked(line, seed) is None:
        return None
    try:
        content = json.loads(line[9:].split(b" ", 2)[2])
    except (ValueError, IndexError):
        return None
    return content if isinstance(content, dict) else None


def _line(number: int, synced: int, content: Mapping[str, Any], seed: int) -> bytes:
    text = b"%d %d %s" % (number, synced, _json(content))
    if len(text) + 10 > _LONGEST:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG))
    return b"%08x %s\n" % (zlib.crc32(text, seed), text)


def _json(content: Mapping[str, Any]) -> bytes:
    """The JSON of plain data, in which parts may be encoded already (`orjson.Fragment`)."""
    try:
        return orjson.dumps(content, option=orjson.OPT_SERIALIZE_NUMPY)
    except TypeError:  # integers of more than 64 bits, lone surrogates, subclasses of float
        return json.dumps(content, separators=(",", ":"), default=_fragment).encode()


def _fragment(value: Any) -> Any:
    if isinstance(value, orjson.Fragment):
        return json.loads(orjson.dumps(value))
    raise TypeError(type(value).__name__)


def write_segment(path: Path, header: Mapping[str, Any], state: Mapping[str, Any]) -> None:
    """Write a file that `read_segment` reads, of one state without changes. Raises ConfigError."""
    header = {**header, "format": FORMAT, "journal": uuid4().hex}
    temporary = path.with_name(path.name + _SUFFIX)
    try:
        temporary.write_bytes(_line(0, 0, header, 0) + _line(1, 0, state, _seed(header["journal"])))
        temporary.rename(path)
    except OSError as error:
        raise ConfigError(f"cannot be written: {error.strerror}", file=str(path)) from None


def _seed(journal: str) -> int:
    return zlib.crc32(journal.encode())


# ---- the directory ---------------------------------------------------------------------------------------------------


class StateDirectory:
    """The directory of one engine's state, locked while it is open. Made with mode 0700 if it does not exist.

    last_seen  when the engine before was last known to be at work (s since 1970): see `touch`

    Raises ConfigError if it cannot be used, or if another engine uses it.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path: Path = Path(path)
        try:
            self.path.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._lock = os.open(self.path / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError as error:
            raise self._unusable(error) from None
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            owner = os.read(self._lock, 32).decode(errors="replace").strip()
            os.close(self._lock)
            raise ConfigError(f"is in use by another engine (process {owner})", file=str(path)) from None
        self.last_seen: float = os.fstat(self._lock).st_mtime
        try:
            os.ftruncate(self._lock, 0)
            os.write(self._lock, str(os.getpid()).encode())
        except OSError as error:
            os.close(self._lock)
            raise self._unusable(error) from None

    def _unusable(self, error: OSError) -> ConfigError:
        return ConfigError(f"cannot be used for an engine's state: {error.strerror}", file=str(self.path))

    def touch(self) -> None:
        """Record that the engine is running."""
        with suppress(OSError):
            os.utime(self._lock)

    def segments(self) -> list[Path]:
        """The segments, oldest first."""
        found = [item for item in self.path.glob(f"{_PREFIX}*") if item.name.removeprefix(_PREFIX).isdigit()]
        return sorted(found, key=lambda item: int(item.name.removeprefix(_PREFIX)))

    def read(self) -> Contents | None:
        """Return the newest segment, or None. Raises ConfigError as `read_segment` does."""
        segments = self.segments()
        return read_segment(segments[-1]) if segments else None

    def set_aside(self) -> Path | None:
        """Move an old state into a folder ``old-N`` inside the directory. Returns the folder, None without a state."""
        found = [item for item in self.path.iterdir() if item.name != "lock" and not item.name.startswith("old-")]
        if not found:
            return None
        numbers = [int(item.name[4:]) for item in self.path.glob("old-*") if item.name[4:].isdigit()]
        folder = self.path / f"old-{max(numbers, default=0) + 1}"
        folder.mkdir(mode=0o700)
        for item in found:
            item.rename(folder / item.name)
        sync_directory(self.path)
        return folder

    def write_file(self, name: str, data: bytes) -> None:
        """Write a file as a whole: afterwards it is on the disk, or the old one is unchanged. Raises OSError."""
        temporary = self.path / (name + _SUFFIX)
        with os.fdopen(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o600), "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.rename(self.path / name)
        sync_directory(self.path)

    def close(self) -> None:
        """Release the lock."""
        os.close(self._lock)


def sync_directory(path: Path) -> None:
    """Write the entries of a directory to the disk (`fsync`). Raises OSError."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


# ---- writing ---------------------------------------------------------------------------------------------------------


class Journal:
    """The journal of one engine, open for writing.

    header  what the first line of each segment says, besides its format
    later   as of `Later`: then the disk is written in a thread; without it, `sync` waits for the disk
    failed  called with the error if that thread cannot write the disk

    Methods raise OSError if the disk cannot be written; what was written before stays readable.
    """

    def __init__(self, directory: StateDirectory, header: Mapping[str, Any], later: Later | None = None) -> None:
        self._directory, self._later = directory, later
        self.header: Record = {**header, "format": FORMAT, "journal": uuid4().hex}
        self._seed = _seed(self.header["journal"])
        self._file = -1
        self._number = self._synced = self._end = self._limit = 0
        self._committer: _Committer | None = None
        self.failed: Callable[[OSError], object] = lambda error: None

    @classmethod
    def resume(cls, directory: StateDirectory, found: Contents, later: Later | None = None) -> Journal:
        """Continue after the undamaged lines of the newest segment. Raises OSError."""
        journal = cls(directory, found.header, later)
        journal.header = found.header
        journal._seed = _seed(found.header["journal"])
        journal._file = os.open(found.path, os.O_WRONLY | os.O_CLOEXEC)
        os.ftruncate(journal._file, found.end)
        os.lseek(journal._file, 0, os.SEEK_END)
        os.fsync(journal._file)
        journal._number = journal._synced = found.number
        journal._end = found.end
        journal._limit = max(_LEAST, _TIMES * found.first) + found.first
        journal._begin_commits()
        return journal

    @property
    def is_long(self) -> bool:
        """Whether the changes have become so long that the state should be written (`begin_segment`)."""
        return self._end > self._limit and (self._committer is None or self._committer.idle)

    def begin_segment(self, state: Mapping[str, Any]) -> None:
        """Write a segment that begins with this state, and remove the older ones. Afterwards it is on the disk."""
        old = self._directory.segments()
        number = int(old[-1].name.removeprefix(_PREFIX)) + 1 if old else 1
        head = _line(0, 0, self.header, 0)
        data = head + _line(1, 0, state, self._seed)
        name = f"{_PREFIX}{number:08d}"
        self._directory.write_file(name, data)
        self._close_file()
        self._file = os.open(self._directory.path / name, os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC)
        self._number = self._synced = 1
        self._end, self._limit = len(data), max(_LEAST, _TIMES * len(data)) + len(data)
        self._begin_commits()
        for segment in old:
            segment.unlink()

    def append(self, record: Mapping[str, Any]) -> None:
        """Write a record: it survives the death of this process."""
        synced = self._synced if self._committer is None else max(self._synced, self._committer.synced)
        line = _line(self._number + 1, synced, record, self._seed)
        try:
            written = os.write(self._file, line)
            if written < len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError:
            with suppress(OSError):  # a part of a line is torn anyway
                os.ftruncate(self._file, self._end)
            raise
        self._number += 1
        self._end += len(line)

    def sync(self, then: Callable[[], object]) -> None:
        """Call `then` when all records so far are on the disk."""
        if self._committer is not None:
            self._committer.request(self._number, then)
            return
        self.flush()
        then()

    def flush(self) -> None:
        """Wait until all records so far are on the disk."""
        os.fdatasync(self._file)
        self._synced = self._number

    def close(self) -> None:
        """Write everything to the disk, and close the file."""
        self._close_file()

    def _begin_commits(self) -> None:
        if self._later is not None:
            self._committer = _Committer(self._file, self._later, self._on_failed)

    def _on_failed(self, error: OSError) -> None:
        self.failed(error)

    def _close_file(self) -> None:
        if self._committer is not None:
            self._committer.close()
            self._committer = None
        if self._file >= 0:
            with suppress(OSError):
                os.fdatasync(self._file)
            os.close(self._file)
            self._file = -1


class _Committer:
    """A thread that writes one file to the disk for all who ask meanwhile. `synced`: the last record that is there."""

    def __init__(self, file: int, later: Later, failed: Callable[[OSError], object]) -> None:
        self._file, self._later, self._failed = file, later, failed
        self._changed = threading.Condition()
        self._requests: list[Callable[[], object]] = []
        self._wanted = self.synced = 0
        self._busy = self._closing = False
        self._thread: threading.Thread | None = None

    @property
    def idle(self) -> bool:
        """Whether no callback waits for the disk."""
        with self._changed:
            return not (self._busy or self._requests)

    def request(self, number: int, then: Callable[[], object]) -> None:
        """Call `then` in the engine's thread when the records up to this number are on the disk."""
        with self._changed:
            self._requests.append(then)
            self._wanted = number
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="fame journal", daemon=True)
                self._thread.start()
            self._changed.notify()

    def close(self) -> None:
        """Finish all requests, and end the thread."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join()

    def _work(self) -> None:
        while True:
            with self._changed:
                while not self._requests and not self._closing:
                    self._changed.wait()
                if not self._requests:
                    return
                requests, self._requests, wanted, self._busy = self._requests, [], self._wanted, True
            try:
                os.fdatasync(self._file)
            except OSError as error:
                self._later(partial(self._failed, error))
                return
            with self._changed:
                self.synced, self._busy = wanted, False
            for then in requests:
                self._later(then)
