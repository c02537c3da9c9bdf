"""Files that the events of a run are written to."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from io import BufferedWriter, FileIO
from pathlib import Path
from stat import S_ISREG
from typing import Any, BinaryIO, TypeAlias

from fame.bpmn.model import Definitions
from fame.engine.state import Trail
from fame.errors import ConfigError
from fame.log.lines import jsonl, table
from fame.log.naming import Named, names
from fame.log.xes import xes
from fame.robot.events import Event, Observer, trail_handler

_BUFFER = 1 << 16
"""Bytes that are written at a time."""

_Form: TypeAlias = Callable[[BinaryIO, Mapping[str, Named]], AbstractContextManager[Observer]]
"""Writes events in one form to a stream, with what elements are called."""

_FORMS: Mapping[str, _Form] = {
    ".jsonl": jsonl,
    ".csv": table,
    ".xes": xes,
}


@contextmanager
def logging_to(path: str | Path, files: Iterable[Definitions]) -> Iterator[Observer]:
    """A function that writes an event to the log `path`. `files` are the models that name its elements.

    What stood in the file is gone when the first event comes, or when the block ends as it should: a run that is
    refused leaves it as it was. Raises ConfigError for an ending that is no log's, for a file that another run (or
    another log of this one) writes, and for one that cannot be written, also later on.
    """
    path = Path(path)
    is_new = not path.exists()
    form = _FORMS.get(path.suffix.lower())
    if form is None:
        raise ConfigError(f"found the ending {path.suffix!r}; {', '.join(_FORMS)} would be right", file=str(path))
    with ExitStack() as stack:
        file = stack.enter_context(_opened(path))
        log = _Log(lambda: stack.enter_context(_written(file, form, files)))
        try:
            yield log
        except BaseException:
            if is_new and not log.begun:
                path.unlink(missing_ok=True)
            raise
        log.begin()


class _Log:
    """An observer that is made when the first event comes."""

    def __init__(self, make: Callable[[], Observer]) -> None:
        self._make = make
        self._write: Observer | None = None

    @property
    def begun(self) -> bool:
        """Whether an event came."""
        return self._write is not None

    def begin(self) -> Observer:
        """The observer, made if it was not yet."""
        if self._write is None:
            self._write = self._make()
            self._trail = trail_handler(self._write)
        return self._write

    def __call__(self, event: Event) -> None:
        self.begin()(event)

    def trail(self, time: int, robot: str, trail: Trail) -> None:
        """What happened at one instant."""
        self.begin()
        self._trail(time, robot, trail)


@contextmanager
def _written(file: _File, form: _Form, files: Iterable[Definitions]) -> Iterator[Observer]:
    """What writes to a file in place of what stood in it."""
    if S_ISREG(os.fstat(file.fileno()).st_mode):
        file.truncate(0)
    with BufferedWriter(file, _BUFFER) as stream, form(stream, names(files)) as write:
        yield write


class _File(FileIO):
    """A file that says which one it is when it cannot be written."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except OSError as error:
            raise ConfigError(f"cannot be written: {error.strerror}", file=str(self.name)) from None


def _opened(path: Path) -> _File:
    """The file, kept from other runs as long as it is open, with what stands in it."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = _File(path, "ab")
    except FileExistsError:
        raise ConfigError(f"cannot be written: {path.parent} is no folder", file=str(path)) from None
    except OSError as error:
        raise ConfigError(f"cannot be written: {error.strerror}", file=str(path)) from None
    if S_ISREG(os.fstat(file.fileno()).st_mode):
        _claim(file)
    return file


def _claim(file: _File) -> None:
    """Keep others from the file as long as it is open, where there are locks. Raises ConfigError if it is taken."""
    if sys.platform == "win32":
        return
    from fcntl import LOCK_EX, LOCK_NB, flock

    try:
        flock(file, LOCK_EX | LOCK_NB)
    except BlockingIOError:
        file.close()
        text = "is written already, by another run or as another log of this one"
        raise ConfigError(text, file=str(file.name)) from None
    except OSError:  # a file system without locks
        pass
