"""Writes the events of a run to a file, for people, tables and process mining; reads back where a run went.

The ending of the file decides its form:

.jsonl  one JSON object per event and line
.csv    the same as a table
.xes    IEEE 1849, one trace per process instance (`fame.xes`)

Times are simulated, in seconds, with every digit that counts. Nothing depends on the wall clock, so equal runs give
equal bytes. Events are written as they come, and the file is whole when the block ends, however it ends.
"""

from __future__ import annotations

import csv
import json
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from io import BufferedWriter, FileIO, StringIO
from pathlib import Path
from stat import S_ISREG
from typing import Any, BinaryIO, NamedTuple, TextIO, TypeAlias

from fame.bpmn.model import Activity, Definitions, Element, Gateway, SubProcess, Task
from fame.bpmn.model import Event as BpmnEvent
from fame.clock import SECOND
from fame.engine.state import Mark, Trail
from fame.errors import ConfigError
from fame.observation import Event, Observer, by_trails
from fame.xes import xes

COLUMNS = ("time", "robot", "instance", "scope", "element", "name", "kind", "what", "detail")
"""Of a table, and the keys of a JSON line (where those without a value are left out)."""


_BUFFER = 1 << 16
"""Bytes that are written at a time."""


class Named(NamedTuple):
    """What a log says of an element: its name on one line, its BPMN tag, and whether it is an activity."""

    name: str
    kind: str
    activity: bool


UNNAMED = Named("", "", False)

_Form: TypeAlias = Callable[[BinaryIO, Mapping[str, Named]], AbstractContextManager[Observer]]
"""Writes events in one form to a stream, with what elements are called."""


@contextmanager
def logging_to(path: str | Path, files: Iterable[Definitions]) -> Iterator[Observer]:
    """A function that writes an event to the log `path`. `files` are the models that name its elements.

    What stood in the file is gone when the first event comes, or when the block ends as it should: a run that is
    refused leaves it as it was. Raises ConfigError for an ending that is no log's, for a file that another run (or
    another log of this one) writes, and for one that cannot be written, also later on.
    """
    path = Path(path)
    form = _FORMS.get(path.suffix.lower())
    if form is None:
        raise ConfigError(f"found the ending {path.suffix!r}; {', '.join(_FORMS)} would be right", file=str(path))
    with ExitStack() as stack:
        file = stack.enter_context(_opened(path))
        log = _Log(lambda: stack.enter_context(_written(file, form, files)))
        yield log
        log.begin()


class _Log:
    """An observer that is made when the first event comes."""

    def __init__(self, make: Callable[[], Observer]) -> None:
        self._make = make
        self._write: Observer | None = None

    def begin(self) -> Observer:
        """The observer, made if it was not yet."""
        if self._write is None:
            self._write = self._make()
            self._trail = by_trails(self._write)
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


# ---- names -----------------------------------------------------------------------------------------------------------


def names(files: Iterable[Definitions]) -> dict[str, Named]:
    """What to call every process, flow node and sequence flow, by id; of equal ids the first counts."""
    found: dict[str, Named] = {}
    for process in (process for file in files for process in file.processes):
        inner = (node.body for node in process.body.walk() if isinstance(node, SubProcess))
        parts = [part for body in (process.body, *inner) for part in (*body.nodes, *body.flows)]
        for element in (process, *parts):
            found.setdefault(
                element.id, Named(" ".join(element.name.split()), kind(element), isinstance(element, Activity))
            )
    return found


def kind(element: Element) -> str:
    """What an element is, by its BPMN tag: ``callActivity``, ``startEvent`` ..."""
    match element:
        case Task(kind=which):
            return {"plain": "task", "business_rule": "businessRuleTask"}.get(which, f"{which}Task")
        case BpmnEvent(place="catch" | "throw" as place):
            return f"intermediate{place.title()}Event"
        case BpmnEvent(place=place):
            return f"{place}Event"
        case Gateway(kind=which):
            return {"event": "eventBasedGateway"}.get(which, f"{which}Gateway")
        case SubProcess(kind=which):
            return {"transaction": "transaction", "adhoc": "adHocSubProcess"}.get(which, "subProcess")
    tag = type(element).__name__
    return tag[0].lower() + tag[1:]


# ---- writing ---------------------------------------------------------------------------------------------------------


def seconds(time: int) -> str:
    """Nanoseconds as seconds, exactly.

    >>> seconds(12_500_000_000), seconds(1), seconds(0)
    ('12.5', '0.000000001', '0.0')
    """
    whole, rest = divmod(time, SECOND)
    return f"{whole}." + (f"{rest:09d}".rstrip("0") or "0")


class _Lines:
    """Writes a line for each event, joined from words for when, where and what that were found once for many lines.

    `when` gives those for a time (ns) and robot, `where` is a format for instance and scope, `what` gives those for a
    mark. The last are found at the beginning, as far as it is known what will happen.
    """

    def __init__(
        self,
        stream: BinaryIO,
        named: Mapping[str, Named],
        when: Callable[[int, str], str],
        where: str,
        what: Callable[[Mark, Named], str],
    ) -> None:
        self._stream, self._named, self._when, self._where, self._what = stream, named, when, encoded(where), what
        self._known = {mark: encoded(what(mark, name)) for id, name in named.items() for mark in usual(id, name)}
        self._now: tuple[tuple[int, str], bytes] = ((-1, ""), b"")

    def __call__(self, event: Event) -> None:
        start = self._at(event.time, event.robot) % (event.instance, event.scope)
        self._stream.write(start + self._find(event[4:]))

    def trail(self, time: int, robot: str, trail: Trail) -> None:
        """What happened at one instant."""
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
        """The words for when and who, and the format for where."""
        if self._now[0] != (time, robot):
            self._now = (time, robot), encoded(self._when(time, robot)).replace(b"%", b"%%") + self._where
        return self._now[1]

    def _find(self, mark: Mark) -> bytes:
        """The words for a mark."""
        return encoded(self._what(mark, self._named.get(mark[0], UNNAMED)))


def usual(id: str, name: Named) -> Iterator[Mark]:
    """What is going to happen at an element if all goes well."""
    for what in ("take",) if name.kind == "sequenceFlow" else ("enter", "leave"):
        yield id, what, None


def encoded(text: str) -> bytes:
    """As it stands in a file."""
    return text.encode("utf-8", "backslashreplace")


@contextmanager
def _jsonl(stream: BinaryIO, named: Mapping[str, Named]) -> Iterator[Observer]:
    def members(keys: Sequence[str], values: Sequence[Any]) -> str:
        present = {key: value for key, value in zip(keys, values, strict=True) if value not in ("", None)}
        return _to_json(present)[1:-1]

    def when(time: int, robot: str) -> str:
        # The time is put in as text: a float would lose nanoseconds.
        return f'{{"time": {seconds(time)}, ' + (f'"robot": {_to_json(robot)}, ' if robot else "")

    def what(mark: Mark, name: Named) -> str:
        return f"{members(COLUMNS[4:], _cells(mark, name))}}}\n"

    yield _Lines(stream, named, when, '"instance": %d, "scope": %d, ', what)


@contextmanager
def _csv(stream: BinaryIO, named: Mapping[str, Named]) -> Iterator[Observer]:
    def row(cells: Sequence[Any], end: str) -> str:
        text = StringIO()
        csv.writer(text, lineterminator=end).writerow(cells)
        return text.getvalue()

    stream.write(row(COLUMNS, "\n").encode())

    def when(time: int, robot: str) -> str:
        return row((seconds(time), robot), ",")

    yield _Lines(stream, named, when, "%d,%d,", lambda mark, name: row(_cells(mark, name), "\n"))


def _cells(mark: Mark, name: Named) -> tuple[Any, ...]:
    """What the columns from the element on hold."""
    return mark[0], name.name, name.kind, *mark[1:]


_to_json = json.JSONEncoder(ensure_ascii=False, default=str).encode


_FORMS: Mapping[str, _Form] = {
    ".jsonl": _jsonl,
    ".csv": _csv,
    ".xes": xes,
}


# ---- reading ---------------------------------------------------------------------------------------------------------


def visits(path: str | Path) -> Counter[str]:
    """How often a token came to each element and took each flow, from a .jsonl or .csv log.

    Raises ConfigError if the file is no such log.
    """
    path = Path(path)
    rows = _ROWS.get(path.suffix.lower())
    if rows is None:
        raise ConfigError(f"found the ending {path.suffix!r}; {' or '.join(_ROWS)} would be right", file=str(path))
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            return Counter(row["element"] for row in rows(stream) if row["what"] in ("enter", "take"))
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", file=str(path)) from None
    except (ValueError, LookupError, TypeError, AttributeError, csv.Error):
        raise ConfigError("is no log of a run, as fame run --log writes it", file=str(path)) from None


_ROWS: Mapping[str, Callable[[TextIO], Iterable[Mapping[str, Any]]]] = {
    ".jsonl": lambda stream: map(json.loads, stream),
    ".csv": csv.DictReader,
}
