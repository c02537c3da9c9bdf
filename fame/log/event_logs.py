"""Reads logs of events as rows, to be judged: .jsonl and .csv, and what process mining exchanges, XES and OCEL.

XES has the activities alone, in traces whose order within one microsecond is lost. OCEL has when instances start and
end; at level ``mission`` only labelled elements and activities of the mission.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from operator import itemgetter
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from fame.bpmn.model import Definitions
from fame.bpmn.pools import pools_of
from fame.clock import EPOCH, SECOND
from fame.errors import ConfigError
from fame.iso8601 import nanoseconds_between, parse_datetime
from fame.log.elements import UNKNOWN, element_info
from fame.log.mission_level import PART
from fame.log.ocel import RECORDING
from fame.log.reading import PART_MESSAGE, rows_of
from fame.properties.vocabulary import is_of_pool
from fame.robot.events import ENDED
from fame.text import open_file

EventRow = Mapping[str, Any]
XES, OCEL = ".xes", ".ocel.json"
EVENT_LOGS: Sequence[str] = (".jsonl", ".csv", XES, OCEL)
COLUMNS: Mapping[str, str] = {
    "robot": "org:resource", "element": "concept:name", "transition": "lifecycle:transition", "time": "time:timestamp",
}  # fmt: skip
"""Keys of ``--columns``, and what each is called in an XES of another tool unless it says otherwise."""
_OF_ENGINE = frozenset(("start", "enter", "leave", "take", "cancel", "fail", "end"))
_WHAT = {"start": "enter", "complete": "leave", "abort": "cancel", "ate_abort": "cancel", "fail": "fail"}


@dataclass(frozen=True, slots=True)
class RecordedEvents:
    """The events of a run: robot, instance, element, what, detail, and time (ns).

    processes  robot -> id of its process
    complete   whether nothing could come any more, as the log says; else whether no instance was running at the end
    partly     robots of which the log does not have everything
    lacks      (element, what): what such a log does not say, as text; empty if it has such events
    reordered  the same rows in the other order where they are at one time and the log has no order of them
    has_order  whether `rows` or `reordered` have these of one time in the order of the run
    cancelled  (robot, instance) that ended cancelled, where rows do not say it
    """

    rows: Sequence[EventRow]
    processes: Mapping[str, str]
    complete: bool
    partly: frozenset[str] = frozenset()
    lacks: Callable[[str, str], str] = lambda element, what: ""
    reordered: Sequence[EventRow] = ()
    has_order: Callable[[Sequence[EventRow]], bool] = lambda rows: True
    cancelled: frozenset[tuple[str, str]] = frozenset()


def read_event_log(path: Path, model: Definitions, columns: Mapping[str, str]) -> RecordedEvents:
    """Return the events in a file of a mission with this model. `columns`: names in an XES of another tool.

    Raises ConfigError.
    """
    if path.name.lower().endswith((XES, OCEL)):
        try:
            if columns:
                return _read_foreign_xes(path, model, columns)
            return (_read_xes if path.suffix.lower() == XES else _read_ocel)(path, model)
        except OSError as error:
            raise ConfigError(f"cannot be read: {error.strerror}", file=str(path)) from None
        except (ValueError, LookupError, TypeError, AttributeError, RecursionError, ElementTree.ParseError):
            mapped = "; --columns maps the names of another one" if path.suffix.lower() == XES and not columns else ""
            raise ConfigError(f"is not a log as fame log convert writes it{mapped}", file=str(path)) from None
    with rows_of(path) as found:
        rows = [
            {**row, "robot": row.get("robot", ""), "time": round(float(row["time"]) * SECOND)}
            for row in found
            if row.get("robot") or row["what"] == ENDED
        ]
        running: set[tuple[Any, Any]] = set()
        for row in rows:
            if row["what"] in ("start", "end"):
                (running.add if row["what"] == "start" else running.discard)((row["robot"], row["instance"]))
    processes = _processes(rows)
    late = {str(row["robot"]): "" for row in rows if row["what"] in _OF_ENGINE and row["robot"] not in processes}
    complete = _is_complete(rows, bool(rows) and not running)
    return RecordedEvents(rows, {**_by_pool(model, late), **processes}, complete, frozenset(late))


def _is_complete(rows: Iterable[EventRow], otherwise: bool) -> bool:
    """Whether nothing could come any more, as the end of the run says; `otherwise` without one."""
    return next((row["detail"] == "complete" for row in rows if row["what"] == ENDED), otherwise)


def _processes(rows: Iterable[EventRow]) -> dict[str, str]:
    return {str(row["robot"]): str(row["element"]) for row in rows if row["what"] == "start"}


def _by_pool(model: Definitions, robots: Iterable[str]) -> dict[str, str]:
    """The processes (ids) of robots, by the names of their pools, where a log does not say them."""
    pools = pools_of(model)
    return {
        robot: pool.process.id
        for robot in robots
        for pool in pools
        if (is_of_pool(robot, pool.name) if pool.multi_instance else robot == pool.name)
    }


def _traces(rows: Iterable[EventRow]) -> int:
    return len({(row["robot"], row["instance"]) for row in rows})


def _row(time: str, robot: str, instance: str, element: str, what: str, detail: Any = None) -> dict[str, Any]:
    date = parse_datetime(time)
    return {"time": date, "robot": robot, "instance": instance, "element": element, "what": what, "detail": detail}


def _timed(rows: Sequence[dict[str, Any]]) -> Sequence[EventRow]:
    """Rows with dates, in order, with times (ns): since 1970, or since the first one if that is long after it."""
    rows = sorted(rows, key=itemgetter("time"))
    first: datetime = rows[0]["time"] if rows and rows[0]["time"].year > EPOCH.year else EPOCH
    return [{**row, "time": nanoseconds_between(first, row["time"])} for row in rows]


# ---- XES ---------------------------------------------------------------------------------------------------------


def _read_xes(path: Path, model: Definitions) -> RecordedEvents:
    traces: list[list[dict[str, Any]]] = []
    processes, partly, cancelled, complete = dict[str, str](), set[str](), set[tuple[str, str]](), True
    ids = {name: one.id for one in model.processes for name in (one.id, " ".join(one.name.split()))}
    root = ElementTree.parse(path).getroot()
    if (part := _values(root).get(PART)) is not None:
        raise ConfigError(PART_MESSAGE.format(part), file=str(path))
    ends = root.findall(f"{{*}}string[@key='{ENDED}']")
    traces += [[_row(_values(one)["time:timestamp"], "", "", "", ENDED, one.get("value"))] for one in ends]
    for trace in root.findall("{*}trace"):
        values = _values(trace)
        robot, _, instance = values["concept:name"].rpartition("/")
        if "incomplete" in values:
            partly.add(robot)
            processes = {**_by_pool(model, [robot]), **processes}
        else:
            processes[robot] = ids.get(values["process"], values["process"])
        complete &= values["status"] != "running"
        cancelled |= {(robot, instance)} if values["status"] == "cancelled" else set()
        traces.append([])
        for event in map(_values, trace.findall("{*}event")):
            what = "fail" if "error" in event else _WHAT[event["lifecycle:transition"]]
            place = robot, instance, event["element"], what, event.get("error")
            traces[-1].append(_row(event["time:timestamp"], *place))
    forth, back = (_timed([row for rows in some for row in rows]) for some in (traces, traces[::-1]))

    def has_order(rows: Sequence[EventRow]) -> bool:
        return _traces(rows) < 2 or len(rows) == 2  # of more, neither all that two traces may have done

    return RecordedEvents(
        forth,
        processes,
        _is_complete(forth, complete),
        frozenset(partly),
        _lacks_of_xes(model),
        back,
        has_order,
        cancelled=frozenset(cancelled),
    )


def _lacks_of_xes(model: Definitions) -> Callable[[str, str], str]:
    """What no XES says: it has activities alone."""
    elements = element_info([model])

    def lacks(element: str, what: str) -> str:
        if what in ("start", "end"):
            return "when instances start and end"
        return "" if elements.get(element, UNKNOWN).activity else f"what happens at {element}, which is no activity"

    return lacks


def _read_foreign_xes(path: Path, model: Definitions, columns: Mapping[str, str]) -> RecordedEvents:
    """The events of another tool's log. An event without transition is an execution of its own: it starts and ends.

    How its run ended is not known. Raises ConfigError for one whose events have no robots or elements of the model.
    """
    named = {**COLUMNS, **columns}
    places = {name: one.id for process in model.processes for one in process.body.walk()
              for name in (one.id, one.name) if name}  # fmt: skip
    rows, partly = list[dict[str, Any]](), set[str]()
    for number, trace in enumerate(ElementTree.parse(path).getroot().findall("{*}trace")):
        values, under_way = _values(trace), Counter[str]()
        for event in map(_values, trace.findall("{*}event")):
            robot, said = (event.get(named[key]) or values.get(named[key], "") for key in ("robot", "element"))
            what = _WHAT.get(event.get(named["transition"], "complete").lower(), "")
            if not (robot and said in places and what):
                partly |= {robot} if said not in places else set()  # under another name, perhaps
                continue
            place = robot, str(number), places[said]
            if what == "leave" and not under_way[said]:
                rows.append(_row(event[named["time"]], *place, "enter"))
            else:
                under_way[said] += 1 if what == "enter" else -1
            rows.append(_row(event[named["time"]], *place, what))
    if not rows:
        text = f"{named['robot']!r} names no robot, or {named['element']!r} no element of {model.file}: see --columns"
        raise ConfigError(text, file=str(path))
    processes = _by_pool(model, dict.fromkeys(row["robot"] for row in rows))
    return RecordedEvents(
        _timed(rows), processes, False, frozenset(partly), lacks=_lacks_of_xes(model), reordered=_timed(rows[::-1]),
        has_order=lambda rows: _traces(rows) < 2,
    )  # fmt: skip


def _values(parent: ElementTree.Element) -> dict[str, str]:
    return {key: child.get("value", "") for child in parent if (key := child.get("key")) is not None}


# ---- OCEL --------------------------------------------------------------------------------------------------------


def _read_ocel(path: Path, model: Definitions) -> RecordedEvents:
    with open_file(path) as stream:
        data = json.load(stream)
    starts, ends, partly = list[dict[str, Any]](), list[dict[str, Any]](), set[str]()
    recorded = (each for one in data["objects"] if one["type"] == RECORDING for each in one["attributes"])
    for each in recorded:
        if each["name"] == PART:
            raise ConfigError(PART_MESSAGE.format(each["value"]), file=str(path))
        if each["name"] == ENDED:
            ends.append(_row(each["time"], "", "", "", ENDED, each["value"]))
    instances = [each for each in data["objects"] if each["type"] == "instance"]
    for one in instances:
        robot, _, number = one["id"].removeprefix("instance:").rpartition("/")
        said = {each["name"]: each for each in one["attributes"]}
        process = said["process"]["value"] if "process" in said else ""
        partly |= set() if process else {robot}
        if process:
            starts.append(_row(said["process"]["time"], robot, number, process, "start"))
        if "status" in said:
            ends.append(_row(said["status"]["time"], robot, number, process, "end", said["status"]["value"]))
    rows = list(_ocel_events(data["events"]))
    info = element_info([model])
    seen = {row["element"] for row in rows}

    def lacks(element: str, what: str) -> str:
        found = info.get(element, UNKNOWN)
        known = what in ("start", "end") or found.activity or found.name or element in seen
        return "" if known else f"what happens at {element}, which has no label"

    complete = all(any(each["name"] == "status" for each in one["attributes"]) for one in instances)
    complete = _is_complete(ends, complete)

    def has_order(rows: Sequence[EventRow]) -> bool:
        return _traces(rows) < 2 or not any(row["what"] in ("start", "end") for row in rows)

    processes = {**_by_pool(model, partly), **_processes(starts)}
    return RecordedEvents(
        _timed([*starts, *rows, *ends]), processes, complete, frozenset(partly), lacks, has_order=has_order
    )


def _ocel_events(events: Iterable[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Its events at elements; one that completes at once has the event ``complete`` alone."""
    under_way = Counter[tuple[str, str]]()
    for event in events:
        values = {each["name"]: each["value"] for each in event["attributes"]}
        if "lifecycle" not in values:
            continue
        (instance,) = (each["objectId"] for each in event["relationships"] if each["qualifier"] == "instance")
        robot, _, number = instance.removeprefix("instance:").rpartition("/")
        element, what = values["element"], _WHAT[values["lifecycle"]]
        if what == "leave" and not under_way[instance, element]:
            yield _row(event["time"], robot, number, element, "enter")
        elif what in ("enter", "leave", "cancel", "fail"):
            under_way[instance, element] += 1 if what == "enter" else -1
        yield _row(event["time"], robot, number, element, what, values.get("error"))
