"""Logs with one line per event: JSON Lines and CSV."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import StringIO
from typing import Any, BinaryIO

from fame.clock import SECOND
from fame.engine.program import Mark
from fame.engine.state import Trail
from fame.log.elements import UNKNOWN, ElementInfo
from fame.robot.events import Event, Observer

COLUMNS: tuple[str, ...] = ("time", "robot", "instance", "scope", "element", "name", "kind", "what", "detail")
"""Columns of a table, and keys of a JSON line (which leaves out empty ones)."""

_to_json = json.JSONEncoder(ensure_ascii=False, default=str).encode


def seconds(time: int) -> str:
    """Nanoseconds as seconds, exactly.

    >>> seconds(12_500_000_000), seconds(1), seconds(0)
    ('12.5', '0.000000001', '0.0')
    """
    whole, rest = divmod(time, SECOND)
    return f"{whole}." + (f"{rest:09d}".rstrip("0") or "0")


class _Lines(Observer):
    """Writes one line per event, joined from three parts that are formatted once for many lines.

    `when` formats time (ns) and robot, `where` is a format for instance and scope, `what` formats a mark. The usual
    marks of all elements are formatted in advance.
    """

    def __init__(
        self,
        stream: BinaryIO,
        elements: Mapping[str, ElementInfo],
        when: Callable[[int, str], str],
        where: str,
        what: Callable[[Mark, ElementInfo], str],
    ) -> None:
        self._stream, self._elements, self._when, self._where, self._what = stream, elements, when, encoded(where), what
        self._known = {mark: encoded(what(mark, name)) for id, name in elements.items() for mark in usual(id, name)}
        self._now: tuple[tuple[int, str], bytes] = ((-1, ""), b"")

    def __call__(self, event: Event) -> None:
        start = self._at(event.time, event.robot) % (event.instance, event.scope)
        self._stream.write(start + self._find(event[4:]))

    def trail(self, time: int, robot: str, trail: Trail) -> None:
        """Write everything that happened at one instant."""
        start_of, known = self._at(time, robot), self._known
        lines: list[bytes] = []
        for scope, marks in trail:
            start = start_of % (scope.instance.key, scope.key)
            try:
                lines += start, start.join([known[mark] for mark in marks])
            except KeyError:
                known.update((mark, self._find(mark)) for mark in marks if mark not in known)
                lines += start, start.join([known[mark] for mark in marks])
        self._stream.write(b"".join(lines))

    def _at(self, time: int, robot: str) -> bytes:
        """The formatted time and robot, followed by the format for instance and scope."""
        if self._now[0] != (time, robot):
            self._now = (time, robot), encoded(self._when(time, robot)).replace(b"%", b"%%") + self._where
        return self._now[1]

    def _find(self, mark: Mark) -> bytes:
        return encoded(self._what(mark, self._elements.get(mark[0], UNKNOWN)))


def usual(id: str, name: ElementInfo) -> Iterator[Mark]:
    """Yield the marks of an element in a run without errors."""
    for what in ("take",) if name.tag == "sequenceFlow" else ("enter", "leave"):
        yield id, what, None


def encoded(text: str) -> bytes:
    return text.encode("utf-8", "backslashreplace")


@contextmanager
def jsonl(stream: BinaryIO, elements: Mapping[str, ElementInfo]) -> Iterator[Observer]:
    """An observer that writes JSON Lines to `stream`."""

    def members(keys: Sequence[str], values: Sequence[Any]) -> str:
        present = {key: value for key, value in zip(keys, values, strict=True) if value not in ("", None)}
        return _to_json(present)[1:-1]

    def when(time: int, robot: str) -> str:
        # The time is put in as text: a float would lose nanoseconds.
        return f'{{"time": {seconds(time)}, ' + (f'"robot": {_to_json(robot)}, ' if robot else "")

    def what(mark: Mark, name: ElementInfo) -> str:
        return f"{members(COLUMNS[4:], _cells(mark, name))}}}\n"

    yield _Lines(stream, elements, when, '"instance": %d, "scope": %d, ', what)


@contextmanager
def table(stream: BinaryIO, elements: Mapping[str, ElementInfo]) -> Iterator[Observer]:
    """An observer that writes CSV to `stream`."""

    def row(cells: Sequence[Any], end: str) -> str:
        text = StringIO()
        csv.writer(text, lineterminator="\n").writerow(cells)
        return text.getvalue()[:-1] + end

    stream.write(row(COLUMNS, "\n").encode())

    def when(time: int, robot: str) -> str:
        return row((seconds(time), robot), ",")

    yield _Lines(stream, elements, when, "%d,%d,", lambda mark, name: row(_row_cells(mark, name), "\n"))


def _cells(mark: Mark, name: ElementInfo) -> tuple[Any, ...]:
    """The columns from the element on."""
    return mark[0], name.name, name.tag, *mark[1:]


def _row_cells(mark: Mark, name: ElementInfo) -> tuple[Any, ...]:
    """The same for a table: a verdict is JSON text."""
    *cells, detail = _cells(mark, name)
    return *cells, _to_json(detail) if isinstance(detail, dict) else detail
