"""Reads from the log of a run which elements were visited, and with which outcomes."""

from __future__ import annotations

import csv
import json
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO

from fame.bpmn.draw.style import Outcome
from fame.bpmn.model import Definitions
from fame.errors import ConfigError

_Row = Mapping[str, Any]
_MOVES = frozenset(("start", "enter", "leave", "take", "cancel", "fail", "end"))
"""Marks of the engine; other events of a log come from scripts and robots."""


def visits(path: str | Path) -> Counter[str]:
    """How often a token reached each element and each flow, from a .jsonl or .csv log.

    Raises ConfigError if the file is not such a log.
    """
    with _rows_of(path) as rows:
        return Counter(row["element"] for row in rows if row["what"] in ("enter", "take"))


def outcomes(path: str | Path, definitions: Definitions) -> dict[str, Counter[Outcome]]:
    """How often each element of a model had each outcome, from a .jsonl or .csv log. Flows are completed.

    An execution is waiting if it had not ended when the log ended, and cancelled if its process ended first. Raises
    ConfigError if the file is not such a log, or belongs to another model.
    """
    instances: dict[tuple[str, str], _Instance] = {}
    with _rows_of(path) as rows:
        for row in rows:
            if row["what"] not in _MOVES:
                continue
            key = str(row.get("robot", "")), str(row["instance"])
            instances.setdefault(key, _Instance()).add(str(row["scope"]), row["element"], row["what"])
    _check_same_model(instances.values(), definitions, str(path))
    found: defaultdict[str, Counter[Outcome]] = defaultdict(Counter)
    for instance in instances.values():
        for element, counts in instance.counts.items():
            found[element] += instance.tally(counts)
    return {element: tally for element, tally in found.items() if tally}


@dataclass(slots=True)
class _Instance:
    """Counts of marks by element in one process instance. `own`: elements of the process itself, not of called ones."""

    process: str = ""
    root: str = ""
    ended: bool = False
    counts: defaultdict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))
    own: set[str] = field(default_factory=set)

    def add(self, scope: str, element: str, what: str) -> None:
        if what == "start":
            self.process, self.root = element, scope
        elif what == "end":
            self.ended = True
        else:
            self.counts[element][what] += 1
            if scope == self.root:
                self.own.add(element)

    def tally(self, counts: Counter[str]) -> Counter[Outcome]:
        """The outcomes of one element. An error end event has the marks leave and fail, which count as one failure."""
        under_way = counts["enter"] - counts["leave"] - counts["cancel"] - counts["fail"]
        completed = counts["take"] + counts["leave"] + min(under_way, 0)
        tally: Counter[Outcome] = Counter(
            {"failed": counts["fail"], "cancelled": counts["cancel"], "completed": completed}
        )
        tally["cancelled" if self.ended else "waiting"] += max(under_way, 0)
        return +tally


def _check_same_model(instances: Iterable[_Instance], definitions: Definitions, file: str) -> None:
    """Raise ConfigError if the log has elements that the process does not have, or none that the model has."""
    known = {
        process.id: {part.id for part in (*process.body.nodes, *process.body.flows)}
        for process in definitions.processes
    }
    everything = {part.id for process in definitions.processes for part in process.body.walk()}.union(*known.values())
    seen: set[str] = set()
    for instance in instances:
        seen |= instance.counts.keys()
        strange = sorted(instance.own - known.get(instance.process, instance.own))
        if strange:
            raise ConfigError(
                f"belongs to another model: {instance.process} in {definitions.file} has no element {strange[0]}",
                file=file,
            )
    if seen and not seen & everything:
        raise ConfigError(f"belongs to another model: it mentions no element of {definitions.file}", file=file)


@contextmanager
def _rows_of(path: str | Path) -> Iterator[Iterable[_Row]]:
    """The rows of a log. Raises ConfigError if the file cannot be read, or if the block fails on malformed rows."""
    path = Path(path)
    rows = _ROWS.get(path.suffix.lower())
    if rows is None:
        raise ConfigError(
            f"expected a file name that ends in {' or '.join(_ROWS)}, got {path.suffix!r}", file=str(path)
        )
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            yield rows(stream)
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", file=str(path)) from None
    except (ValueError, LookupError, TypeError, AttributeError, csv.Error):
        raise ConfigError("is not the log of a run, as written by fame run --log", file=str(path)) from None


_ROWS: Mapping[str, Callable[[TextIO], Iterable[_Row]]] = {
    ".jsonl": lambda stream: map(json.loads, stream),
    ".csv": csv.DictReader,
}
