"""Output of the commands: JSON objects, tables, colours, and the progress line.

What matters in a line is coloured where the terminal can do it; NO_COLOR (https://no-color.org) switches colours off.
"""

from __future__ import annotations

import io
import json
import os
import re
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, TextIO

from fame.errors import FameError
from fame.text import printable, table as table

if TYPE_CHECKING:
    from fame.scenario import Progress


_RED, _GREEN, _YELLOW, _CYAN = 31, 32, 33, 36
_WORDS = {
    "error": _RED, "warning": _YELLOW, "note": _CYAN,
    "completed": _GREEN, "failed": _RED, "timeout": _YELLOW, "interrupted": _YELLOW,
}  # fmt: skip
_WORD = re.compile(rf"(?:^|(?<=: ))({'|'.join(_WORDS)})(?=: )")
"""A word that says how it is stands at the beginning of a line, or behind a place, and has a colon behind it."""


def coloured(text: str, stream: TextIO) -> str:
    """Return the text, each line printable, with the first such word of each in its colour, if the stream is a
    terminal that has colours."""
    lines = map(printable, text.split("\n"))
    return "\n".join(map(_painted, lines) if _has_colours(stream) else lines)


def _painted(line: str) -> str:
    return _WORD.sub(lambda found: f"\x1b[1;{_WORDS[found[1]]}m{found[1]}\x1b[0m", line, count=1)


def _has_colours(stream: TextIO) -> bool:
    return stream.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


_WIPE = "\r\x1b[2K"
_TICK = 1.0  # s between two looks at whether a line has stood for long
EVERY = 30.0
"""Seconds between two lines of progress where there is no terminal."""
_UNITS = (("h", 3600), ("min", 60))


named: dict[str, Any] = {}
"""What each object of ``--json`` says besides: the project of the command, if there is one."""


def print_json(value: Mapping[str, Any]) -> None:
    """The one object on stdout that ``--json`` promises."""
    print(json.dumps({**value, **named}, indent=2))  # in ASCII: no locale can spoil it


def error_object(error: FameError, cause: BaseException, status: str = "error") -> dict[str, Any]:
    """Return an error as JSON: the class of its cause, its line of text, and where it is as far as it knows."""
    where = ("file", "line", "element", "robot", "code", "type", "field")
    known = {name: value for name in where if (value := getattr(error, name, None))}
    return {"status": status, "error": {"class": type(cause).__name__, "text": str(error), **known}}


def table_within(width: int, heads: Sequence[str], rows: Sequence[Sequence[str | int]], spare: Sequence[str]) -> str:
    """Return a table without the first of the columns that can be spared, as many as it takes to
    be narrower than `width`."""
    for left_out in range(len(spare) + 1):
        kept = [column for column, head in enumerate(heads) if head not in spare[:left_out]]
        text = table([heads[column] for column in kept], [[row[column] for column in kept] for row in rows])
        if max(map(len, text.splitlines())) < width:
            break
    return text


class Notes:
    """Lines for people on stderr, from a process that goes on whatever becomes of them.

    A full disk or a closed pipe never raises: lines that could not be written are counted in `lost`, and the next one
    that can be written says so.
    """

    def __init__(self) -> None:
        self.lost: int = 0

    def __call__(self, text: str) -> None:
        """Write a line: printable, and at once."""
        gap = f"\n({self.lost} lines before this one could not be written)\n" if self.lost else ""
        try:
            _write_at_once(f"{gap}{coloured(printable(text), sys.stderr)}\n")
        except (OSError, ValueError):  # ValueError: it is closed
            self.lost += 1
        else:
            self.lost = 0


def _write_at_once(text: str) -> None:
    """Past the buffer of stderr, which would keep what it could not write and fail again at exit. Raises OSError."""
    raw = getattr(getattr(sys.stderr, "buffer", None), "raw", None)
    if raw is None:
        print(text, end="", file=sys.stderr, flush=True)
        return
    data = text.encode(sys.stderr.encoding, errors="backslashreplace")
    if raw.write(data) != len(data):
        raise OSError("not written as a whole")


note: Notes = Notes()
"""Messages of commands that run until they are interrupted."""


def _show(stream: TextIO, text: str) -> None:
    """Write what a run goes on without: its terminal may be gone."""
    with suppress(OSError, ValueError):
        stream.write(text)
        stream.flush()


class _Lossy(io.RawIOBase):
    """A file that drops what it cannot write."""

    def __init__(self, raw: Any) -> None:
        super().__init__()
        self._raw = raw

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return int(self._raw.fileno())

    def isatty(self) -> bool:
        return bool(self._raw.isatty())

    def write(self, data: Any) -> int:
        with suppress(OSError, ValueError):
            self._raw.write(data)
        return len(data)


def survive_stdout() -> None:
    """From now on, drop what cannot be written to stdout: an engine outlives the terminal that started it."""
    raw = getattr(getattr(sys.stdout, "buffer", None), "raw", None)
    if raw is not None and not isinstance(raw, _Lossy):
        buffer = io.BufferedWriter(_Lossy(raw))
        sys.stdout = io.TextIOWrapper(buffer, sys.stdout.encoding, sys.stdout.errors, line_buffering=True)


class ProgressLine:
    """What a command is at: on a terminal a line that is overwritten, elsewhere a line every half minute.

    It shows for how long its text is unchanged, on a terminal from two seconds on.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._text, self._since = stream, "", time.monotonic()
        self._draws = stream.isatty()
        self._begun: tuple[float, float] | None = None
        self._over = threading.Event()
        self._clock = threading.Thread(target=self._count, daemon=True)
        self._clock.start()

    def show(self, progress: Progress) -> None:
        self.write(progress_text(progress))

    def count_frames(self, drawn: int, frames: int) -> None:
        """Show the progress of an animation."""
        text = f"drawing the film: frame {drawn} of {frames}" + (", writing it" if drawn == frames else "")
        self.write(text, drawn / frames)

    def write(self, text: str, done: float | None = None) -> None:
        """Show the current activity and, where the share of the work that is `done` is known, the time that is left."""
        self._since = time.monotonic()
        self._text = text + (self._left(done) if done is not None else "")
        if self._draws:
            self._write(self._text)

    def close(self) -> None:
        """Erase the line."""
        self._over.set()
        self._clock.join()
        if self._draws:
            self._write("")

    def _left(self, done: float) -> str:
        """The time that is left if the rest is as fast as what was done since the first share that was given."""
        if self._begun is None or done < self._begun[1]:  # other work
            self._begun = (self._since, done)
        seconds, share = self._since - self._begun[0], done - self._begun[1]
        if seconds < 2 or share <= 0 or done >= 1:
            return ""
        left = seconds * (1 - done) / share
        unit, length = next(((unit, length) for unit, length in _UNITS if left >= 1.5 * length), ("s", 1))
        return f", about {max(1, round(left / length))} {unit} left"

    def _count(self) -> None:
        while not self._over.wait(_TICK if self._draws else EVERY):
            seconds = int(time.monotonic() - self._since)
            if seconds > (1 if self._draws else EVERY):
                self._write(f"for {seconds} s at:   {self._text.strip() or 'the start'}")
            elif not self._draws and self._text:
                self._write(self._text)

    def _write(self, text: str) -> None:
        import shutil

        width = shutil.get_terminal_size().columns - 1
        _show(self._stream, _WIPE + text[:width] if self._draws else f"{text}\n")


@contextmanager
def progress_line(stream: TextIO, *, wanted: bool = True) -> Iterator[ProgressLine | None]:
    """Show what a command is at while the block runs; None if that is not wanted."""
    if not wanted:
        yield None
        return
    line = ProgressLine(stream)
    try:
        yield line
    finally:
        line.close()


def progress_text(progress: Progress) -> str:
    """Show the progress of a run: simulated time and the activity of each robot."""
    robots = "   ".join(f"{name}: {text}" for name, text in progress.robots.items() if text)
    return f"{progress.simulated:7.1f} s   {robots}"


class LiveTable:
    """Several lines on a terminal, redrawn in place; other output goes above them.

    Without a terminal nothing is drawn; without a stream there is no output at all.
    """

    def __init__(self, stream: TextIO | None) -> None:
        self._stream, self._drawn = stream, ""
        self._draws = stream is not None and stream.isatty()

    def show(self, text: str) -> None:
        """Draw it in place of what was drawn last."""
        if self._draws and self._stream is not None:
            import shutil

            size = shutil.get_terminal_size()
            lines = [line[: size.columns - 1] for line in text.splitlines()[: size.lines - 1]]
            self._wipe()
            self._drawn = "".join(f"{line}\n" for line in lines)
            _show(self._stream, self._drawn)

    def write(self, line: str) -> None:
        """Print a line above the table."""
        if self._stream is not None:
            drawn = self._drawn
            self._wipe()
            self._drawn = drawn
            _show(self._stream, f"{printable(line)}\n{drawn}")

    def _wipe(self) -> None:
        if self._drawn and self._stream is not None:
            _show(self._stream, f"\x1b[{self._drawn.count(chr(10))}A\r\x1b[J")
            self._drawn = ""


@contextmanager
def live_table(stream: TextIO, *, wanted: bool = True) -> Iterator[LiveTable]:
    """A table that changes while the block lasts, and is gone then."""
    live = LiveTable(stream if wanted else None)
    try:
        yield live
    finally:
        live.show("")
