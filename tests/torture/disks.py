"""A disk that loses power: what was not synced is torn or gone; what was synced may rot; it may be full or read-only.

`Disk` is that of one machine. A process that is killed leaves the disk as it wrote it. `lose_power` leaves of each file
what was synced, and of what was written since any part up to its end; of the names in a directory those that were
synced, each later change of a name made or not. With a `fuse` the power goes in the middle of an operation.
"""

from __future__ import annotations

import errno
import io
import os
import random
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import BinaryIO


class PowerLoss(BaseException):
    """Ends the process whose machine has lost its power."""


class Node:
    """The content of a file: what was written, and how much of it is on the disk for sure."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.synced = b""


class Disk:
    """The files of a machine: see `fame.robot.disk.Disk`. `wall_time` stamps the locks."""

    def __init__(self, seed: str, wall_time: Callable[[], float]) -> None:
        self._random, self._wall_time = random.Random(seed), wall_time
        self._files: dict[Path, Node] = {}
        self._synced: dict[Path, Node] = {}  # the names that are on the disk for sure
        self._owners: dict[Path, object] = {}
        self._seen: dict[Path, float] = {}
        self._removed = False
        self.trouble = 0  # errno of every write from now on
        self.room: int | None = None  # bytes that are left
        self.fuse: int | None = None  # operations until the power goes
        self.begun: dict[Node, int] = {}  # the sizes of files when what syncs them now began

    # ---- faults ------------------------------------------------------------------------------------------------------

    def lose_power(self) -> None:
        """Keep what was synced, and any part of the rest."""
        chance = self._random
        names = dict(self._synced)
        for path in sorted(self._files.keys() ^ names.keys()):  # hashes differ between processes
            if chance.random() < 0.5:  # the change of this name was made
                if path in self._files:
                    names[path] = self._files[path]
                else:
                    del names[path]
        for path in sorted(self._files.keys() & names.keys()):
            if self._files[path] is not names[path] and chance.random() < 0.5:
                names[path] = self._files[path]
        for node in names.values():
            node.data = bytearray(_torn(node, chance))
            node.synced = bytes(node.data)
        self._files, self._synced = names, dict(names)
        self.fuse = None
        self.release()

    def release(self) -> None:
        """The process ends: its locks are free."""
        self._owners.clear()

    def flip(self) -> bool:
        """Flip bits in one of the files, half the time so that digits stay digits. Returns whether there was a file."""
        files = [node for path, node in self._files.items() if node.data and path.name != "lock"]
        if not files:
            return False
        data = self._random.choice(files).data
        digits = [place for place, byte in enumerate(data) if byte in b"01234567"] * (self._random.random() < 0.5)
        for _ in range(self._random.randint(1, 4)):
            data[self._random.choice(digits or range(len(data)))] ^= 1 << self._random.randrange(3 if digits else 8)
        return True

    def erase(self) -> None:
        """The directory is lost."""
        self._files, self._synced, self._seen, self._owners = {}, {}, {}, {}

    @property
    def removed(self) -> bool:
        """Whether nothing was written since the directory was removed."""
        return self._removed and not any(path.name.removeprefix("journal-").isdecimal() for path in self._files)

    def remove_all(self) -> None:
        """The directory is removed below a process, until `trouble` is 0: then somebody has made it again."""
        self.erase()
        self.trouble, self._removed = errno.ENOENT, True

    def certain(self) -> Disk:
        """What is left of it for sure, should the power go now."""
        disk = Disk("", self._wall_time)
        for path, node in self._synced.items():
            disk._files[path] = kept = Node()
            kept.data = bytearray(node.synced)
        return disk

    def sizes(self) -> dict[Node, int]:
        """How much of each file is written, synced or not (bytes)."""
        return {node: len(node.data) for node in self._files.values()}

    @property
    def content(self) -> dict[Path, bytes]:
        """What its files have."""
        return {path: bytes(node.data) for path, node in self._files.items()}

    # ---- operations --------------------------------------------------------------------------------------------------

    def make_directory(self, path: Path) -> None:
        self._operate()

    def lock(self, path: Path) -> Lock:
        if path in self._owners:
            raise BlockingIOError(errno.EAGAIN, "1")
        if path not in self._files:
            self._operate()
            self._files[path] = self._synced[path] = Node()
        return Lock(self, path)

    def names(self, path: Path) -> Sequence[str]:
        return sorted(found.name for found in self._files if found.parent == path)

    def read(self, path: Path) -> BinaryIO:
        return io.BytesIO(bytes(self._found(path).data))

    def write(self, path: Path, *, new: bool) -> File:
        self._operate()
        if new:
            self._files[path] = Node()
        return File(self, self._found(path))

    def rename(self, path: Path, to: Path) -> None:
        self._operate()
        self._files[to] = self._files.pop(path)

    def remove(self, path: Path) -> None:
        self._operate()
        self._files.pop(path, None)

    def sync_directory(self, path: Path) -> None:
        self._operate()
        self._synced = dict(self._files)

    def _found(self, path: Path) -> Node:
        try:
            return self._files[path]
        except KeyError:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT)) from None

    def _operate(self) -> None:
        """An operation that writes: the disk may refuse it, or the power goes."""
        if self.fuse is not None:
            self.fuse -= 1
            if self.fuse < 0:
                raise PowerLoss
        if self.trouble:
            raise OSError(self.trouble, os.strerror(self.trouble))


class File:
    """An open file: see `fame.robot.disk.File`."""

    def __init__(self, disk: Disk, node: Node) -> None:
        self._disk, self._node = disk, node

    def write(self, data: bytes) -> None:
        self._disk._operate()
        room = self._disk.room
        if room is not None and len(data) > room:
            self._node.data += data[:room]
            self._disk.room = 0
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if room is not None:
            self._disk.room = room - len(data)
        self._node.data += data

    def truncate(self, size: int) -> None:
        self._disk._operate()
        del self._node.data[size:]

    def sync(self) -> None:
        self._disk._operate()
        data = bytes(self._node.data)
        self._node.synced = data[: max(self._disk.begun.get(self._node, len(data)), len(self._node.synced))]

    def close(self) -> None:
        pass


class Lock:
    """A lock file: see `fame.robot.disk.Lock`."""

    def __init__(self, disk: Disk, path: Path) -> None:
        self._disk, self._path, self._node = disk, path, disk._files[path]
        self.last_seen = disk._seen.get(path, disk._wall_time())
        disk._owners[path] = self

    def touch(self) -> None:
        if self._disk._files.get(self._path) is not self._node:
            raise FileNotFoundError(errno.ENOENT, "the directory was removed")
        if not self._disk.trouble:
            self._disk._seen[self._path] = self._disk._wall_time()

    def close(self) -> None:
        if self._disk._owners.get(self._path) is self:
            del self._disk._owners[self._path]


def _torn(node: Node, chance: random.Random) -> bytes:
    """What is left of a file: what was synced, and a part of what was written since, perhaps with garbage behind."""
    data, synced = bytes(node.data), node.synced
    if not data.startswith(synced):  # it was cut and written again
        return chance.choice((data, synced))
    end = chance.randint(len(synced), len(data))
    if chance.random() < 0.3:  # blocks are not written in their order: what is missing reads as zeros
        hole = chance.randint(len(synced), end)
        width = min(end - hole, chance.randint(1, 500))
        return data[:hole] + bytes(width) + data[hole + width : end]
    rest = bytes(chance.randrange(256) for _ in range(min(len(data) - end, 20))) if chance.random() < 0.3 else b""
    return data[:end] + rest
