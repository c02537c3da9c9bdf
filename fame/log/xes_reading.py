"""Reads XES (IEEE 1849) as rows: logs that FAME wrote, and those of other tools, whose names somebody maps.

XES has the activities alone, in traces whose order within one microsecond is lost. A file is parsed as it is read, and
keeps nothing but one trace; it may be packed by gzip.
"""

from __future__ import annotations

import gzip
import zlib
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from fame.bpmn.library import Library
from fame.bpmn.model import Activity, Definitions
from fame.bpmn.pools import Pool, expected_robots, matches, pools_of
from fame.errors import ConfigError
from fame.log.elements import UNKNOWN, element_info
from fame.log.reading import PART, PART_MESSAGE
from fame.log.recorded_events import (
    WHAT,
    EventRow,
    RecordedEvents,
    count_instances,
    dated,
    is_complete,
    processes_by_pool,
    timed,
)
from fame.robot.events import ENDED
from fame.text import open_file

XES: Sequence[str] = (".xes", ".xes.gz")
COLUMNS: Mapping[str, str] = {
    "robot": "org:resource", "element": "concept:name", "transition": "lifecycle:transition", "time": "time:timestamp",
}  # fmt: skip
"""Keys of ``--columns``, and what each is called in an XES of another tool unless it says otherwise."""
OF_TRACE = "case:"
"""Before a name of `COLUMNS`: that of the trace, as in pm4py. Without it, the event's counts, else the trace's."""
_PACKED = 100_000_000
"""The largest size (bytes) of what gzip has packed: a file of 100 kB may claim 100 MB."""
_NO_STEP = frozenset(("schedule", "assign", "reassign", "suspend", "resume", "withdraw", "autoskip", "manualskip"))
"""Transitions of the standard life cycle that neither start nor end an execution."""
_SHOWN = 12
XesValues = dict[str, str]


def is_xes(path: Path) -> bool:
    return path.name.lower().endswith(tuple(XES))


class _Traces:
    """Takes the traces out of the XML of a log; what is nested in their attributes is left out.

    log  key, value and inner values of each attribute of the log; complete when all traces were read
    """

    def __init__(self, path: Path) -> None:
        self._path, self._depth = path, 0
        self.log: list[tuple[str, str, XesValues]] = []
        self._done: list[tuple[XesValues, list[XesValues]]] = []
        self._trace: XesValues | None = None
        self._events: list[XesValues] = []
        self._inner: XesValues | None = None

    def __iter__(self) -> Iterator[tuple[XesValues, list[XesValues]]]:
        """The values of each trace, and of its events. Raises ConfigError, OSError, ParseError."""
        parser, size = ElementTree.XMLParser(target=self), 0
        packed = self._path.suffix.lower() == ".gz"
        with open_file(self._path) as raw, gzip.open(raw) if packed else nullcontext(raw) as stream:
            try:
                while chunk := stream.read(1 << 16):
                    size += len(chunk)
                    if packed and size > _PACKED:
                        raise ConfigError(f"has more than {_PACKED // 1_000_000} MB: unpack it", file=str(self._path))
                    parser.feed(chunk)
                    yield from self._done
                    self._done.clear()
            except (gzip.BadGzipFile, EOFError, zlib.error):
                raise ConfigError("is damaged, or not packed by gzip", file=str(self._path)) from None
        parser.close()
        yield from self._done

    def start(self, tag: str, attributes: Mapping[str, str]) -> None:
        self._depth += 1
        name = tag.rpartition("}")[2]
        if self._depth == 2:
            self._trace, self._events, self._inner = ({} if name == "trace" else None), [], {}
            if self._trace is None and "key" in attributes:
                self.log.append((attributes["key"], attributes.get("value", ""), self._inner))
        elif self._depth == 3 and self._trace is not None:
            self._inner = None
            if name == "event":
                self._inner = {}
                self._events.append(self._inner)
            else:
                _put(self._trace, name, attributes)
        elif self._depth == (3 if self._trace is None else 4) and self._inner is not None:
            _put(self._inner, name, attributes)

    def end(self, tag: str) -> None:
        self._depth -= 1
        if self._depth == 1 and self._trace is not None:
            self._done.append((self._trace, self._events))

    def close(self) -> None:
        """End of the file, for the parser."""


def _put(values: XesValues, tag: str, attributes: Mapping[str, str]) -> None:
    value = attributes.get("value", "")
    if "key" in attributes and not (tag == "float" and value.lower() == "nan"):  # pm4py's for "has none"
        values[attributes["key"]] = value


def read_xes(path: Path, model: Definitions) -> RecordedEvents:
    """Return the events of a log that FAME wrote. Raises ConfigError, and LookupError or ValueError for another one."""
    traces: list[list[dict[str, Any]]] = []
    processes, partly, cancelled, complete = dict[str, str](), set[str](), set[tuple[str, str]](), True
    ids = {name: one.id for one in model.processes for name in (one.id, " ".join(one.name.split()))}
    file = _Traces(path)
    for values, events in file:
        robot, _, instance = values["concept:name"].rpartition("/")
        if "incomplete" in values:
            partly.add(robot)
            processes = {**processes_by_pool(model, [robot]), **processes}
        else:
            processes[robot] = ids.get(values["process"], values["process"])
        complete &= values["status"] != "running"
        cancelled |= {(robot, instance)} if values["status"] == "cancelled" else set()
        traces.append([])
        for event in events:
            what = "fail" if "error" in event else WHAT[event["lifecycle:transition"]]
            place = robot, instance, event["element"], what, event.get("error")
            traces[-1].append(dated(event["time:timestamp"], *place))
    if part := [value for key, value, _ in file.log if key == PART]:
        raise ConfigError(PART_MESSAGE.format(part[0]), file=str(path))
    ends = [dated(inner["time:timestamp"], "", "", "", ENDED, value) for key, value, inner in file.log if key == ENDED]
    forth, back = _both_orders([*traces, ends])
    return RecordedEvents(
        forth,
        processes,
        is_complete(forth, complete),
        frozenset(partly),
        _lacks(model),
        back,
        lambda rows: count_instances(rows) < 2 or len(rows) == 2,  # of more, neither all that two traces may have done
        cancelled=frozenset(cancelled),
    )


def _both_orders(traces: Sequence[Sequence[dict[str, Any]]]) -> Iterator[Sequence[EventRow]]:
    """The rows of all traces: what two did at one time is in the order of the traces, and the other way round."""
    return (timed([row for rows in some for row in rows]) for some in (traces, traces[::-1]))


def _lacks(model: Definitions) -> Callable[[str, str], str]:
    """What no XES says: it has activities alone."""
    elements = element_info([home for pool in pools_of(model) for home, _ in Library().closure(model, pool.process)])

    def lacks(element: str, what: str) -> str:
        if what in ("start", "end"):
            return "when instances start and end"
        return "" if elements.get(element, UNKNOWN).activity else f"what happens at {element}, which is no activity"

    return lacks


# ---- of another tool ---------------------------------------------------------------------------------------------


def read_foreign_xes(path: Path, model: Definitions, columns: Mapping[str, str]) -> RecordedEvents:
    """Return the events of another tool's log. An event without transition is a whole execution.

    How its run ended is not known. A robot is there in part if an event's activity or transition is not known. Raises
    ConfigError for a log without these names, or without robots and activities of the model; ParseError, OSError.
    """
    reader = _ForeignReader(model, columns)
    for number, (trace, events) in enumerate(_Traces(path)):
        under_way = Counter[str]()
        reader.rows.append([])
        for event in events:
            try:
                reader.take(str(number), event, trace, under_way)
            except ValueError as error:
                where = trace.get("concept:name", str(number + 1))
                raise ConfigError(f"trace {where!r}: {error}; see --columns", file=str(path)) from None
    if wrong := reader.wrong_names(columns):
        raise ConfigError(f"{wrong}; see --columns", file=str(path))
    forth, back = _both_orders(reader.rows)
    return RecordedEvents(
        forth,
        processes_by_pool(model, reader.robots),
        False,
        frozenset(robot for robot, pool in reader.robots.items() if pool in reader.doubtful),
        _lacks(model),
        back,
        lambda rows: count_instances(rows) < 2,
    )


class _ForeignReader:
    """Makes rows of another tool's events.

    rows      those of each trace
    robots    robot -> name of its pool
    doubtful  pools with events that are not understood
    """

    def __init__(self, model: Definitions, columns: Mapping[str, str]) -> None:
        self._named, self._model = {**COLUMNS, **columns}, model
        self._pools = pools_of(model)
        self._activities = {pool.name: _activities(model, pool) for pool in self._pools}
        self.rows: list[list[dict[str, Any]]] = []
        self.robots: dict[str, str] = {}
        self.doubtful: set[str] = set()
        self._names: set[str] = set()
        self._values: dict[str, dict[str, None]] = {key: {} for key in COLUMNS}

    def take(self, trace: str, event: XesValues, of_trace: XesValues, under_way: Counter[str]) -> None:
        """Take the next event of a trace, with the executions `under_way` in it. Raises ValueError for its time."""
        self._names.update(event, (OF_TRACE + name for name in of_trace))
        said = {key: _value(name, event, of_trace) for key, name in self._named.items()}
        for key in ("robot", "element"):
            self._values[key][said[key]] = None
        pool, activity = self._pool(said["robot"]), _line(said["element"])
        if pool is None:  # perhaps a robot under another name
            self.doubtful |= {name for name, known in self._activities.items() if known.get(activity)}
            return
        robot, transition = pool.name + said["robot"][len(pool.name) :], said["transition"].lower() or "complete"
        self.robots[robot] = pool.name
        elements, what = self._activities[pool.name].get(activity), WHAT.get(transition)
        if elements is None or len(elements) > 1 or not (what or transition in _NO_STEP):
            self.doubtful.add(pool.name)
        elif elements and what:
            (element,) = elements
            if not said["time"]:
                raise ValueError(f"an event has no {self._named['time']!r} (time); it has {_listed(event)}")
            alone = what != "enter" and not under_way[element]  # the end of an execution whose start is not logged
            under_way[element] += 1 if what == "enter" else -1 + alone
            marks = ["enter", what] if alone else [what]
            self.rows[-1] += [dated(said["time"], robot, trace, element, mark) for mark in marks]

    def _pool(self, robot: str) -> Pool | None:
        """The pool of the robot of this name; without a name, that of the only robot."""
        if not robot and len(self._pools) == 1 and not self._pools[0].multi_instance:
            return self._pools[0]
        return next((pool for pool in self._pools if matches(robot, pool)), None)

    def wrong_names(self, columns: Collection[str]) -> str:
        """Return what is wrong with the names, as text: one that no event has, or with values that the model lacks."""
        there = self._names | {name.removeprefix(OF_TRACE) for name in self._names}
        for key, name in self._named.items():
            if name not in there and key in columns:
                return f"no event has {name!r} ({key}); there are {_listed(self._names)}"
        if any(self.rows):
            return ""
        key, kind, expected = "robot", "robot", [expected_robots(pool) for pool in self._pools]
        if self.robots:
            known = [self._activities[pool] for pool in self.robots.values()]
            key, kind, expected = "element", "activity", [name for one in known for name, ids in one.items() if ids]
        found = (
            f"it has {_listed(self._values[key])}" if any(self._values[key]) else f"there are {_listed(self._names)}"
        )
        return f"{self._named[key]!r} names no {kind} of {self._model.file} ({_listed(expected)}): {found}"


def _activities(model: Definitions, pool: Pool) -> dict[str, set[str]]:
    """Id or label -> the activities of a pool and of what it calls; none for a label of other elements alone."""
    by_name: dict[str, set[str]] = {}
    for _, process in Library().closure(model, pool.process):
        for node in process.body.walk():
            for name in filter(None, (node.id, _line(node.name))):
                by_name.setdefault(name, set()).update({node.id} if isinstance(node, Activity) else ())
    return by_name


def _line(text: str) -> str:
    return " ".join(text.split())


def _value(name: str, event: XesValues, trace: XesValues) -> str:
    if name.startswith(OF_TRACE):
        return trace.get(name.removeprefix(OF_TRACE), "")
    return event.get(name) or trace.get(name, "")


def _listed(names: Iterable[str]) -> str:
    """The first of several names, as text."""
    known = sorted(name for name in {*names} if name and not name.startswith("@@"))  # those are pm4py's own
    return ", ".join(known[:_SHOWN]) + (f" and {len(known) - _SHOWN} others" if len(known) > _SHOWN else "") or "none"


def names_of(path: Path) -> str:
    """Return the names of the values in the first trace of a log, as text. Raises as `_Traces`."""
    trace, events = next(iter(_Traces(path)), ({}, []))
    return _listed({*(name for event in events for name in event), *(OF_TRACE + name for name in trace)})
