"""Opens log files and writes the events of a run to them."""

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
from fame.log.elements import ElementInfo, element_info
from fame.log.lines import jsonl, table
from fame.log.recorder import About, LogTopics, Recorder, recording_to
from fame.log.recording_file import RecordingFile
from fame.robot.events import Event, Observer
from fame.rooms import XES, load
from fame.text import writing, wrong_ending

_BUFFER = 1 << 16
"""Bytes written at a time."""

RECORDING = ".mcap"

_Form: TypeAlias = Callable[[BinaryIO, Mapping[str, ElementInfo]], AbstractContextManager[Observer]]
"""Creates an observer that writes events to a stream in one format."""


def _xes(stream: BinaryIO, elements: Mapping[str, ElementInfo]) -> AbstractContextManager[Observer]:
    form: _Form = load(XES)
    return form(stream, elements)


_FORMS: Mapping[str, _Form] = {
    ".jsonl": jsonl,
    ".csv": table,
    ".xes": _xes,
}
OCEL, OCEL_RECORDING = ".ocel.json", "recording"
"""Its suffix, and the type of the object that says how the run ended and what the log lacks of it."""
CONVERTED = (*_FORMS, OCEL)
"""The forms of events that a recording can be converted to, by suffix."""


@contextmanager
def logging_to(
    path: str | Path,
    files: Iterable[Definitions],
    about: About | None = None,
    *,
    topics: LogTopics = "signals",
) -> Iterator[Observer]:
    """An observer that writes events to the log `path`. `files` are the models of the run.

    A recording (``.mcap``) also gets what it says `about` itself, and the messages of `topics`.

    An existing file is overwritten by the first event, or when the block ends without an error. A run that is refused
    leaves it unchanged. Raises ConfigError for an unknown suffix, for a file that another log is being written to, and
    for a file that cannot be written, also while events are written.
    """
    path = Path(path)
    is_new = not path.exists()
    suffix = path.suffix.lower()
    form = _FORMS.get(suffix)
    if form is None and suffix != RECORDING:
        raise ConfigError(wrong_ending(path.name, (*_FORMS, RECORDING)), file=str(path))
    with ExitStack() as stack:
        file = stack.enter_context(_opened(path))
        log: _Log | Recorder
        if form is None:
            opened = stack.enter_context(ExitStack())  # closed after the recording is finished
            log = stack.enter_context(
                recording_to(
                    lambda: RecordingFile(opened.enter_context(_emptied(file))), files, about or About(), topics
                )
            )
        else:
            chosen = form
            log = _Log(lambda: stack.enter_context(_written(file, chosen, files)))
        try:
            yield log
        except BaseException:
            if is_new and not log.begun:
                path.unlink(missing_ok=True)
            raise
        log.begin()


@contextmanager
def new_file(path: Path) -> Iterator[Callable[[], BinaryIO]]:
    """Return a function that opens a file for overwriting and returns its stream.

    The file is locked at once; if it is new and the function was never called, it is deleted in the end. Raises
    ConfigError as `logging_to`.
    """
    is_new, streams = not path.exists(), list[BinaryIO]()
    with ExitStack() as stack:
        file = stack.enter_context(_opened(path))

        def begin() -> BinaryIO:
            if not streams:
                streams.append(stack.enter_context(_emptied(file)))
            return streams[0]

        try:
            yield begin
        finally:
            if is_new and not streams:
                path.unlink(missing_ok=True)


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """Yield the name of a file that takes the place of `path` if the block ends without an error (`fame.text.writing`).

    `path` is locked meanwhile. Raises ConfigError as `logging_to`.
    """
    is_new = not path.exists()
    with _opened(path):
        try:
            with writing(path) as part:
                yield part
        except BaseException:
            if is_new:
                path.unlink(missing_ok=True)
            raise


class _Log(Observer):
    """An observer that opens its file at the first event."""

    def __init__(self, make: Callable[[], Observer]) -> None:
        self._make = make
        self._write: Observer | None = None

    @property
    def begun(self) -> bool:
        """Whether the file is being written."""
        return self._write is not None

    def begin(self) -> Observer:
        """Start writing, and return the observer."""
        if self._write is None:
            self._write = self._make()
        return self._write

    def __call__(self, event: Event) -> None:
        self.begin()(event)

    def trail(self, time: int, robot: str, trail: Trail) -> None:
        """Write everything that happened at one instant."""
        self.begin().trail(time, robot, trail)


@contextmanager
def _written(file: _File, form: _Form, files: Iterable[Definitions]) -> Iterator[Observer]:
    with _emptied(file) as stream, form(stream, element_info(files)) as write:
        yield write


def _emptied(file: _File) -> BufferedWriter:
    """A stream that overwrites a file."""
    if S_ISREG(os.fstat(file.fileno()).st_mode):  # no device
        file.truncate(0)
        file.seek(0)  # what has an index counts from here
    return BufferedWriter(file, _BUFFER)


class _File(FileIO):
    """A file whose write errors name the file."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except OSError as error:
            raise ConfigError(f"cannot be written: {error.strerror}", file=str(self.name)) from None


def _opened(path: Path) -> _File:
    """Open a file for appending, with its folders, and lock it."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = _File(path, "ab", opener=lambda name, flags: os.open(name, flags, 0o644))  # no others write
    except FileExistsError:
        raise ConfigError(f"cannot be written: {path.parent} is not a folder", file=str(path)) from None
    except OSError as error:
        raise ConfigError(f"cannot be written: {error.strerror}", file=str(path)) from None
    if S_ISREG(os.fstat(file.fileno()).st_mode):
        _claim(file)
    return file


def _claim(file: _File) -> None:
    """Lock the file until it is closed, where the system has locks. Raises ConfigError if it is locked already."""
    if sys.platform == "win32":
        return
    from fcntl import LOCK_EX, LOCK_NB, flock

    try:
        flock(file, LOCK_EX | LOCK_NB)
    except BlockingIOError:
        file.close()
        text = "is already being written, by another run or by another log of this run"
        raise ConfigError(text, file=str(file.name)) from None
    except OSError:  # a file system without locks
        pass
