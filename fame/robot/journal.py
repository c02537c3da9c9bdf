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
write (group commit).
"""

from __future__ import annotations

import errno
import json
import os
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO
from uuid import uuid4

import orjson

from fame.dataclasses import dataclass
from fame.errors import ConfigError
from fame.robot.disk import SYSTEM, Disk, File, Lock
from fame.worker import Worker

FORMAT = 1
"""Version of the format. A journal of another version is refused."""
_PREFIX, _SUFFIX = "journal-", ".tmp"
_LEAST, _TIMES = 1 << 20, 8
"""A segment is replaced when its changes take more than this (bytes), and that many times the size of the state."""
_LONGEST = 1 << 28
"""The longest line that is written and read (bytes)."""
_NUMBERS = 64
"""The numbers of a line are in its first bytes."""

JournalRecord = dict[str, Any]


@dataclass(frozen=True, slots=True)
class SegmentContents:
    """The content of a segment: its header, and where its undamaged records are. They are read when they are needed.

    number  how many records there are: the state, and its changes
    first   where the state ends (bytes)
    last    where the last record begins (bytes)
    end     where it ends (bytes)
    """

    path: Path
    header: JournalRecord
    number: int
    first: int
    last: int
    end: int
    disk: Disk = SYSTEM

    def records(self) -> Iterator[JournalRecord]:
        """Yield the state, then its changes, one at a time. Raises ConfigError if the file cannot be read any more."""
        with _opened(self.path, self.disk) as file:
            file.readline(_LONGEST)
            for _ in range(self.number):
                yield self._next(file)

    def last_record(self) -> JournalRecord:
        """Return the last record. Raises ConfigError if the file cannot be read any more."""
        with _opened(self.path, self.disk) as file:
            file.seek(self.last)
            return self._next(file)

    def _next(self, file: BinaryIO) -> JournalRecord:
        record = _parsed(file.readline(_LONGEST), _seed(str(self.header["journal"])))
        if record is None:
            raise ConfigError("has changed while it was read", file=str(self.path))
        return record


# ---- reading ---------------------------------------------------------------------------------------------------------


def read_segment(path: Path, disk: Disk = SYSTEM) -> SegmentContents:
    """Find the records of a segment up to its torn end, line by line: a segment may be larger than the memory.

    Raises ConfigError for one that is damaged, foreign or of another version.
    """
    with _opened(path, disk) as file:
        return _read(path, file, disk)


@contextmanager
def _opened(path: Path, disk: Disk) -> Iterator[BinaryIO]:
    try:
        with disk.read(path) as file:
            yield file
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", file=str(path)) from None


def _read(path: Path, file: BinaryIO, disk: Disk) -> SegmentContents:
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
    return SegmentContents(path, header, number, first, last, end, disk)


def _header(path: Path, line: bytes) -> tuple[JournalRecord, int]:
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


def _parsed(line: bytes, seed: int) -> JournalRecord | None:
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
    return zlib.crc32(journal.encode(errors="surrogatepass"))  # JSON may have lone surrogates


# ---- the directory ---------------------------------------------------------------------------------------------------


class StateDirectory:
    """The directory of one engine's state, locked while it is open. Made with mode 0700 if it does not exist.

    last_seen  when the engine before was last known to be at work (s since 1970): see `touch`

    Raises ConfigError if it cannot be used, or if another engine uses it.
    """

    path: Path
    disk: Disk

    def __init__(self, path: str | os.PathLike[str], disk: Disk = SYSTEM) -> None:
        self.path, self.disk = Path(path), disk
        try:
            disk.make_directory(self.path)
            self._lock = self._locked()
        except BlockingIOError as error:
            raise ConfigError(str(error.strerror), file=str(path)) from None
        except OSError as error:
            text = f"cannot be used for an engine's state: {error.strerror}"
            raise ConfigError(text, file=str(self.path)) from None
        self.last_seen: float = self._lock.last_seen

    def _locked(self) -> Lock:
        try:
            return self.disk.lock(self.path / "lock")
        except BlockingIOError as error:
            raise BlockingIOError(error.errno, f"is in use by another engine (process {error.strerror})") from None

    def touch(self) -> None:
        """Record that the engine is running. Raises FileNotFoundError if the directory was removed or replaced."""
        self._lock.touch()

    def lock_again(self) -> bool:
        """Lock the directory that is there now. Returns whether it is another one than before. Raises OSError."""
        try:
            self.touch()
        except FileNotFoundError as lost:
            try:
                old, self._lock = self._lock, self._locked()
            except FileNotFoundError:
                raise lost from None
            old.close()
            return True
        return False

    def files(self, prefix: str) -> list[Path]:
        """Return the files whose names begin so. Raises OSError."""
        return [self.path / name for name in sorted(self.disk.names(self.path)) if name.startswith(prefix)]

    def segments(self) -> list[Path]:
        """Return the segments, oldest first. Raises OSError."""
        segments = [item for item in self.files(_PREFIX) if item.name.removeprefix(_PREFIX).isdigit()]
        return sorted(segments, key=lambda item: int(item.name.removeprefix(_PREFIX)))

    def read(self) -> SegmentContents | None:
        """Return the newest segment, None without one. Raises ConfigError as `read_segment` does."""
        segments = self.segments()
        return read_segment(segments[-1], self.disk) if segments else None

    def set_aside(self) -> Path | None:
        """Move an old state into a folder ``old-N`` inside the directory. Returns the folder, None without a state."""
        files = [item for item in self.files("") if item.name != "lock" and not item.name.startswith("old-")]
        if not files:
            return None
        numbers = [int(item.name[4:]) for item in self.files("old-") if item.name[4:].isdigit()]
        folder = self.path / f"old-{max(numbers, default=0) + 1}"
        self.disk.make_directory(folder)
        for item in files:
            self.disk.rename(item, folder / item.name)
        self.disk.sync_directory(self.path)
        return folder

    def read_file(self, name: str) -> bytes | None:
        """Return the content of a file, None if the file does not exist. Raises OSError."""
        try:
            with self.disk.read(self.path / name) as file:
                return file.read()
        except FileNotFoundError:
            return None

    def remove_file(self, name: str) -> None:
        """Remove a file, if it exists. Raises OSError."""
        self.disk.remove(self.path / name)

    def write_file(self, name: str, data: bytes) -> None:
        """Write a file as a whole: afterwards it is on the disk, or the old one is unchanged. Raises OSError."""
        temporary = self.path / (name + _SUFFIX)
        with closing(self.disk.write(temporary, new=True)) as file:
            file.write(data)
            file.sync()
        self.disk.rename(temporary, self.path / name)
        self.disk.sync_directory(self.path)

    def close(self) -> None:
        """Release the lock."""
        self._lock.close()


# ---- writing ---------------------------------------------------------------------------------------------------------


class Journal:
    """The journal of one engine, open for writing.

    header  what the first line of each segment says, besides its format
    worker  makes the worker that waits for the disk
    failed  called with the error if that worker cannot write

    Methods raise OSError if the disk cannot be written; what was written before stays readable.
    """

    def __init__(
        self, directory: StateDirectory, header: Mapping[str, Any], worker: Callable[[], Worker] = Worker
    ) -> None:
        self.directory: StateDirectory = directory
        self._worker = worker
        self.header: JournalRecord = {**header, "format": FORMAT, "journal": uuid4().hex}
        self._seed = _seed(self.header["journal"])
        self._file: File | None = None
        self._commits: _Commits | None = None
        self._number = self._synced = self._end = self._limit = 0
        self.failed: Callable[[OSError], object] = lambda error: None

    @classmethod
    def resume(
        cls, directory: StateDirectory, contents: SegmentContents, worker: Callable[[], Worker] = Worker
    ) -> Journal:
        """Continue after the undamaged lines of the newest segment. Raises OSError."""
        journal = cls(directory, contents.header, worker)
        journal.header = contents.header
        journal._seed = _seed(contents.header["journal"])
        file = directory.disk.write(contents.path, new=False)
        journal._open(file, contents.number, contents.end, contents.first)
        file.truncate(contents.end)
        file.sync()
        return journal

    def _open(self, file: File, number: int, end: int, state: int) -> None:
        """Write this file from now on, of which a number of records, and `end` bytes, are on the disk."""
        self._file, self._commits = file, _Commits(file, self._worker(), self._on_failed)
        self._number = self._synced = number
        self._end, self._limit = end, max(_LEAST, _TIMES * state) + state

    @property
    def is_long(self) -> bool:
        """Whether the changes have become so long that the state should be written (`begin_segment`)."""
        return self._end > self._limit and (self._commits is None or self._commits.idle)

    def begin_segment(self, state: Mapping[str, Any]) -> None:
        """Write a segment that begins with this state, and remove the older ones. Afterwards it is on the disk."""
        old = self.directory.segments()
        number = int(old[-1].name.removeprefix(_PREFIX)) + 1 if old else 1
        head = _line(0, 0, self.header, 0)
        data = head + _line(1, 0, state, self._seed)
        name = f"{_PREFIX}{number:08d}"
        self.directory.write_file(name, data)
        self._close_file()
        self._open(self.directory.disk.write(self.directory.path / name, new=False), 1, len(data), len(data))
        for segment in old:
            self.directory.disk.remove(segment)

    def append(self, record: Mapping[str, Any]) -> None:
        """Write a record: it survives the death of this process."""
        file, commits = self._opened()
        line = _line(self._number + 1, max(self._synced, commits.synced), record, self._seed)
        try:
            file.write(line)
        except OSError:
            with suppress(OSError):  # a part of a line is torn anyway
                file.truncate(self._end)
            raise
        self._number += 1
        self._end += len(line)

    def sync(self, then: Callable[[], object]) -> None:
        """Call `then` when all records so far are on the disk."""
        self._opened()[1].request(self._number, then)

    def flush(self) -> None:
        """Wait until all records so far are on the disk."""
        self._opened()[0].sync()
        self._synced = self._number

    def close(self) -> None:
        """Write everything to the disk, and close the file."""
        self._close_file()

    def _opened(self) -> tuple[File, _Commits]:
        if self._file is None or self._commits is None:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        return self._file, self._commits

    def _on_failed(self, error: OSError) -> None:
        self.failed(error)

    def _close_file(self) -> None:
        if self._file is not None and self._commits is not None:
            self._commits.close()
            with suppress(OSError):  # what had to be on the disk was synced before its effect; this is the rest
                self._file.sync()
            self._file.close()
            self._file = self._commits = None


class _Commits:
    """Has a worker write a file to the disk for all who ask meanwhile. `synced`: the last record that is there."""

    def __init__(self, file: File, worker: Worker, failed: Callable[[OSError], object]) -> None:
        self._file, self._worker, self._failed = file, worker, failed
        self._requests: list[Callable[[], object]] = []
        self._wanted = self.synced = 0
        self._busy = False

    @property
    def idle(self) -> bool:
        """Whether nobody waits for the disk."""
        return not (self._busy or self._requests)

    def request(self, number: int, then: Callable[[], object]) -> None:
        """Call `then` when the records up to this number are on the disk."""
        self._requests.append(then)
        self._wanted = number
        if not self._busy:
            self._begin()

    def close(self) -> None:
        """Wait for what is under way. Nobody is called any more: what follows is in another file."""
        self._requests.clear()
        self._worker.close()

    def _begin(self) -> None:
        requests, self._requests, self._busy = self._requests, [], True
        self._worker.call(self._file.sync, partial(self._end, requests, self._wanted))

    def _end(self, requests: list[Callable[[], object]], number: int, _: None, error: Exception | None) -> None:
        if isinstance(error, OSError):
            self._failed(error)  # and stays busy: the state is to be written as a whole, to another file
            return
        if error is not None:
            raise error
        self.synced, self._busy = number, False
        for then in requests:
            then()
        if self._requests and not self._busy:
            self._begin()
