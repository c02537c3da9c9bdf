"""Reads from the log of a run which elements were visited, and with which outcomes."""

from __future__ import annotations

import csv
import io
import json
import math
import warnings
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Any, TextIO

from fame.bpmn.model import Definitions, ElementOutcome
from fame.clock import SECOND
from fame.dataclasses import dataclass, field
from fame.errors import ConfigError, display_name
from fame.log.elements import element_info
from fame.log.recording import Recording
from fame.robot.events import ENDED
from fame.robot.robot_state import outcomes_of
from fame.text import open_file, suggestion, unreadable, wrong_ending

_Row = Mapping[str, Any]
PART = "part"
"""What the first event of a log is that leaves something out; its detail says what the log has."""
PART_MESSAGE = "has only a part of its run ({}): give the recording that it was converted from"
_MOVES = frozenset(("start", "enter", "leave", "take", "cancel", "fail", "end"))
"""Marks of the engine; other events of a log come from scripts and robots."""


@dataclass(frozen=True, slots=True)
class RunOutcomes:
    """The path of a run: outcomes by element, the robots (of those wanted), its first and last second, and errors.

    `failures`: second, robot, element and error code of each instance that failed, by the error that nothing caught.
    `violations`: second, robot, element and text of each property that an event there, or silence after it, violated.
    `cut`: how the run went on is not known: the log is incomplete, or ends without the end of the run or an instance.
    """

    tallies: dict[str, Counter[ElementOutcome]]
    robots: Sequence[str]
    start: float
    end: float
    failures: Sequence[tuple[float, str, str, str]]
    violations: Sequence[tuple[float, str, str, str]] = ()
    cut: bool = False

    def notes(self, definitions: Definitions) -> list[str]:
        """Return the notes below a drawing: robots of the path, duration, failures."""
        names = element_info([definitions])
        lines = [f"{', '.join(self.robots)}: {self.start:.1f} s to {self.end:.1f} s"] if self.robots else []
        for second, robot, element, code in self.failures:
            info = names.get(element)
            shown = display_name(element, info.name if info is not None else "")
            lines.append(f"{robot} failed at {second:.1f} s: {shown}" + (f": {code}" if code else ""))
        lines += [text for _, _, _, text in self.violations]
        return [*lines, "the recording is incomplete: how the run went on is not known"] if self.cut else lines


def visits(path: str | Path) -> Counter[str]:
    """Return how often a token reached each element and each flow. Deprecated: count the marks of `rows_of`.

    Raises ConfigError if the file is no .jsonl or .csv log, and no recording.
    """
    warnings.warn("count the rows of fame.log.reading.rows_of", DeprecationWarning, stacklevel=2)
    with rows_of(path) as rows:
        return Counter(row["element"] for row in rows if row["what"] in ("enter", "take"))


def outcomes(
    path: str | Path, definitions: Definitions, *, robots: Collection[str] = ()
) -> dict[str, Counter[ElementOutcome]]:
    """Return the outcomes of each element. Deprecated: they are the `tallies` of `run_outcomes`."""
    warnings.warn("use fame.log.reading.run_outcomes(...).tallies", DeprecationWarning, stacklevel=2)
    return run_outcomes(path, definitions, robots=robots).tallies


def run_outcomes(path: str | Path, definitions: Definitions, *, robots: Collection[str] = ()) -> RunOutcomes:
    """Return the path of a run through a model, from a .jsonl or .csv log or a recording. Flows are completed.

    `robots`: of these alone. An execution is waiting if it had not ended when the log ended, and cancelled if its
    process ended first. Raises ConfigError if the file is not such a log, belongs to another model, or lacks a robot.
    """
    instances: dict[tuple[str, str], _Instance] = {}
    seconds: list[float] = []
    violations: list[tuple[float, str, str, str]] = []
    row: _Row = {}
    ended = False
    with rows_of(path) as rows:
        for row in rows:
            ended |= row["what"] == ENDED
            text = str(row.get("detail") or "")
            if row["what"] == "report" and text.startswith("property ") and " is violated: " in text:
                violations.append((float(row["time"]), str(row.get("robot", "")), row["element"], text))
            if row["what"] not in _MOVES:
                continue
            key = str(row.get("robot", "")), str(row["instance"])
            if not robots or key[0] in robots:
                seconds = [*seconds[:1], float(row["time"])]
            instances.setdefault(key, _Instance()).add(
                str(row["scope"]), row["element"], row["what"], float(row["time"]), str(row.get("detail") or "")
            )
    if not row:
        raise ConfigError("is empty: there is no run in it", file=str(path))
    there = sorted({robot for robot, _ in instances})
    for robot in robots:
        if robot not in there:
            raise ConfigError(f"unknown robot {robot!r}; {suggestion(robot, there)}", file=str(path))
    chosen = {key: instance for key, instance in instances.items() if not robots or key[0] in robots}
    _check_same_model(chosen.values(), definitions, str(path))
    tallies: defaultdict[str, Counter[ElementOutcome]] = defaultdict(Counter)
    for instance in chosen.values():
        for element, counts in instance.counts.items():
            tallies[element] += tally(counts, over=instance.ended)
    violations = [one for one in violations if not robots or one[1] in robots]
    for _, _, element, _ in violations:
        if element:
            tallies[element]["violated"] += 1
    failed = [(key[0], instance.failure) for key, instance in chosen.items() if instance.failure is not None]
    return RunOutcomes(
        tallies={element: counts for element, counts in tallies.items() if counts},
        robots=[robot for robot in there if not robots or robot in robots],
        start=seconds[0] if seconds else 0.0,
        end=seconds[-1] if seconds else 0.0,
        failures=[(second, robot, element, code) for robot, (second, element, code) in failed],
        violations=violations,
        cut=bool(damage(Path(path))) or (not ended and not all(instance.ended for instance in chosen.values())),
    )


@dataclass(slots=True)
class _Instance:
    """Counts of marks by element in one process instance. `own`: elements of the process itself, not of called ones."""

    process: str = ""
    root: str = ""
    ended: bool = False
    counts: defaultdict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))
    own: set[str] = field(default_factory=set)
    failing: tuple[float, str, str] | None = None
    failure: tuple[float, str, str] | None = None

    def add(self, scope: str, element: str, what: str, second: float, detail: str) -> None:
        if what != "cancel":  # a token that moves on after an error: it was caught
            self.failing = (second, element, detail) if what == "fail" else self.failing if what == "end" else None
        if what == "start":
            self.process, self.root = element, scope
        elif what == "end":
            self.ended = True
            if detail == "failed":
                self.failure = self.failing or (second, self.process, "")
        else:
            self.counts[element][what] += 1
            if scope == self.root:
                self.own.add(element)


def tally(counts: Mapping[str, int], *, over: bool) -> Counter[ElementOutcome]:
    """Return how often an element had each outcome, from the counts of its marks. `over`: nothing runs any more."""
    active = max(0, counts.get("enter", 0) - sum(counts.get(what, 0) for what in ("leave", "fail", "cancel")))
    completed, failed, cancelled = outcomes_of(counts, active)
    found = Counter[ElementOutcome]({"completed": completed, "failed": failed, "cancelled": cancelled})
    found["cancelled" if over else "waiting"] += active
    return +found


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


def damage(path: Path) -> Sequence[str]:
    """Return what is wrong with a recording that can be read in part; nothing of other logs."""
    if path.suffix.lower() != ".mcap":
        return ()
    with Recording(path) as recording:
        return recording.warnings


@contextmanager
def rows_of(path: str | Path) -> Iterator[Iterable[_Row]]:
    """The rows of a log. Raises ConfigError if the file cannot be read, or if the block fails on malformed rows."""
    path = Path(path)
    if path.suffix.lower() == ".mcap":
        with Recording(path) as recording:
            end = [recording.ended] if recording.ended is not None else []
            yield ({**event._asdict(), "time": event.time / SECOND} for event in chain(recording.events(), end))
        return
    rows = _ROWS.get(path.suffix.lower())
    if rows is None:
        raise ConfigError(wrong_ending(path.name, (*_ROWS, ".mcap")), file=str(path))
    try:
        with open_file(path) as file, io.TextIOWrapper(file, "utf-8", newline="") as stream:
            yield _checked(rows(stream, str(path)), str(path))
    except OSError as error:
        raise ConfigError(unreadable(error), file=str(path)) from None
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError, csv.Error):
        raise ConfigError("is not the log of a run, as written by fame run --log", file=str(path)) from None


_KNOWN = _MOVES | {"log", "report", "answer", "verdict", "epoch", ENDED, PART}


def _checked(rows: Iterable[tuple[int, _Row]], file: str) -> Iterator[_Row]:
    """The rows of a log with their lines, which has to have all that happened: what it leaves out cannot be told from
    what did not. Raises ConfigError, too, for a word or time that no log has, and where the times of a robot fall."""
    latest = dict[Any, float]()
    for line, row in rows:
        what, robot = row["what"], row.get("robot", "")
        if what == PART:
            raise ConfigError(PART_MESSAGE.format(row["detail"]), file=file)
        if what not in _KNOWN:
            raise ConfigError(f"unknown what {what!r}; {suggestion(str(what), sorted(_KNOWN))}", file=file, line=line)
        if not math.isfinite(time := float(row["time"])):
            raise ConfigError(f"the time is {row['time']}: expected seconds", file=file, line=line)
        if what in _MOVES:
            if time < latest.get(robot, time):
                text = f"time {time:g} comes after {latest[robot]:g}: expected the events of a robot in their order"
                raise ConfigError(text, file=file, line=line)
            latest[robot] = time
        yield row


def _cells(stream: TextIO, file: str) -> Iterator[tuple[int, _Row]]:
    """The rows of a table. Raises ConfigError for one that lacks cells, or has more than the header."""
    reader = csv.DictReader(stream)
    for row in reader:
        lacks = sum(cell is None for cell in row.values())
        if lacks or None in row:
            width = len(reader.fieldnames or ())
            text = f"expected {width} cells, got {width - lacks + len(row.get(None) or ())}"
            raise ConfigError(text, file=file, line=reader.line_num)
        yield reader.line_num, row


_ROWS: Mapping[str, Callable[[TextIO, str], Iterable[tuple[int, _Row]]]] = {
    ".jsonl": lambda stream, file: enumerate(map(json.loads, stream), 1),
    ".csv": _cells,
}
