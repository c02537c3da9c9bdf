"""The disk below an engine's state: the few operations of a directory that the journal needs, and those of the system.

What is written survives the death of the process at once. It survives the loss of power only after `File.sync`, and a
new, renamed or removed name only after `Disk.sync_directory`. Operations raise OSError.
"""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, Protocol


class File(Protocol):
    """A file that is open for writing at its end."""

    def write(self, data: bytes) -> None:
        """Append all of the data."""

    def truncate(self, size: int) -> None:
        """Cut the file at this size (bytes)."""

    def sync(self) -> None:
        """Wait until the content is on the disk."""

    def close(self) -> None: ...


class Lock(Protocol):
    """A file that one process holds. `last_seen`: when the one before was last known to be at work (s since 1970)."""

    last_seen: float

    def touch(self) -> None:
        """Record that this process is at work. Raises FileNotFoundError if the file is not there any more."""

    def close(self) -> None: ...


class Disk(Protocol):
    """The files of a machine."""

    def make_directory(self, path: Path) -> None:
        """Make a directory, and those above it, if it does not exist: for its owner alone."""

    def lock(self, path: Path) -> Lock:
        """Lock a file, made if it does not exist. Raises BlockingIOError, with its owner as text, if it is locked."""

    def names(self, path: Path) -> Sequence[str]:
        """Return the names in a directory."""

    def read(self, path: Path) -> BinaryIO:
        """Open a file for reading."""

    def write(self, path: Path, *, new: bool) -> File:
        """Open a file for writing at its end; a `new` one is empty, whatever was there."""

    def rename(self, path: Path, to: Path) -> None: ...

    def remove(self, path: Path) -> None:
        """Remove a file, if it exists."""

    def sync_directory(self, path: Path) -> None:
        """Wait until the names in a directory are on the disk."""


class SystemDisk:
    """The files of this machine."""

    def make_directory(self, path: Path) -> None:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)

    def lock(self, path: Path) -> Lock:
        return _SystemLock(path)

    def names(self, path: Path) -> Sequence[str]:
        return os.listdir(path)

    def read(self, path: Path) -> BinaryIO:
        return path.open("rb")

    def write(self, path: Path, *, new: bool) -> File:
        return _SystemFile(path, os.O_CREAT | os.O_TRUNC if new else 0)

    def rename(self, path: Path, to: Path) -> None:
        path.rename(to)

    def remove(self, path: Path) -> None:
        path.unlink(missing_ok=True)

    def sync_directory(self, path: Path) -> None:
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


class _SystemFile:
    def __init__(self, path: Path, flags: int) -> None:
        self._file = os.open(path, flags | os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC, 0o600)

    def write(self, data: bytes) -> None:
        if os.write(self._file, data) < len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def truncate(self, size: int) -> None:
        os.ftruncate(self._file, size)

    def sync(self) -> None:
        os.fdatasync(self._file)

    def close(self) -> None:
        os.close(self._file)


class _SystemLock:
    last_seen: float

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            owner = os.read(self._file, 32).decode(errors="replace").strip()
            os.close(self._file)
            raise BlockingIOError(errno.EAGAIN, owner) from None
        self._path, self.last_seen = path, os.fstat(self._file).st_mtime
        try:
            os.ftruncate(self._file, 0)
            os.write(self._file, str(os.getpid()).encode())
        except OSError:
            os.close(self._file)
            raise

    def touch(self) -> None:
        with suppress(OSError):
            os.utime(self._file)
        try:
            there = os.path.samestat(os.fstat(self._file), self._path.stat())
        except OSError:
            there = False
        if not there:  # what is written to the open files is lost with this process
            raise FileNotFoundError(errno.ENOENT, f"{self._path.parent} was removed or replaced; make it again")

    def close(self) -> None:
        os.close(self._file)


SYSTEM = SystemDisk()
"""The disk of this machine."""
