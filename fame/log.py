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
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TextIO

from fame.bpmn.model import Activity, Definitions, Element, Gateway, SubProcess, Task
from fame.bpmn.model import Event as BpmnEvent
from fame.clock import SECOND
from fame.errors import ConfigError
from fame.xes import xes

if TYPE_CHECKING:
    from fame.node import Event

COLUMNS = ("time", "robot", "instance", "scope", "element", "name", "kind", "what", "detail")
"""Of a table, and the keys of a JSON line (where those without a value are left out)."""

Write = Callable[["Event"], object]
"""Takes one event."""


class Named(NamedTuple):
    """What a log says of an element: its name on one line, its BPMN tag, and whether it is an activity."""

    name: str
    kind: str
    activity: bool


UNNAMED = Named("", "", False)


@contextmanager
def logging_to(path: str | Path, files: Iterable[Definitions]) -> Iterator[Write]:
    """A function that writes an event to the log `path`. `files` are the models that name its elements.

    Raises ConfigError for an ending that is no log's, and for a file that cannot be written.
    """
    path = Path(path)
    form = _FORMS.get(path.suffix.lower())
    if form is None:
        raise ConfigError(f"found the ending {path.suffix!r}; {', '.join(_FORMS)} would be right", file=str(path))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        stream = path.open("w", encoding="utf-8", errors="backslashreplace", newline="")
    except OSError as error:
        raise ConfigError(f"cannot be written: {error.strerror}", file=str(path)) from None
    with stream, form(stream, names(files)) as write:
        yield write


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


def _cells(event: Event, named: Mapping[str, Named]) -> tuple[Any, ...]:
    """What the columns hold for an event, but for its time."""
    name, tag, _ = named.get(event.element, UNNAMED)
    return event.robot, event.instance, event.scope, event.element, name, tag, event.what, event.detail


@contextmanager
def _jsonl(stream: TextIO, named: Mapping[str, Named]) -> Iterator[Write]:
    def write(event: Event) -> None:
        cells = zip(COLUMNS[1:], _cells(event, named), strict=True)
        present = {name: value for name, value in cells if value not in ("", None)}
        # The time is put in as text: a float would lose nanoseconds.
        stream.write(f'{{"time": {seconds(event.time)}, {json.dumps(present, ensure_ascii=False, default=str)[1:]}\n')

    yield write


@contextmanager
def _csv(stream: TextIO, named: Mapping[str, Named]) -> Iterator[Write]:
    rows = csv.writer(stream, lineterminator="\n")
    rows.writerow(COLUMNS)
    yield lambda event: rows.writerow((seconds(event.time), *_cells(event, named)))


_FORMS: Mapping[str, Callable[[TextIO, Mapping[str, Named]], AbstractContextManager[Write]]] = {
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
