"""Reads logs of events as rows, to be judged: .jsonl and .csv, and what process mining exchanges, XES and OCEL.

OCEL has when instances start and end; at level ``mission`` only labelled elements and activities of the mission.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from operator import itemgetter
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from fame.bpmn.model import Definitions
from fame.clock import SECOND
from fame.errors import ConfigError
from fame.iso8601 import parse_datetime
from fame.log.elements import UNKNOWN, element_info
from fame.log.reading import PART, PART_MESSAGE, rows_of
from fame.log.recorded_events import (
    WHAT,
    EventRow,
    RecordedEvents,
    count_instances,
    dated,
    is_complete,
    processes_by_pool,
    processes_of,
    timed,
)
from fame.log.writing import OCEL, OCEL_RECORDING
from fame.log.xes_reading import XES, is_xes, names_of, read_foreign_xes, read_xes
from fame.robot.events import ENDED
from fame.text import open_file, wrong_ending

EVENT_LOGS: Sequence[str] = (".jsonl", ".csv", *XES, OCEL)
_OF_ENGINE = frozenset(("start", "enter", "leave", "take", "cancel", "fail", "end"))


def read_event_log(path: Path, model: Definitions, columns: Mapping[str, str]) -> RecordedEvents:
    """Return the events in a file of a mission with this model. `columns`: names in an XES of another tool.

    Raises ConfigError.
    """
    if not path.name.lower().endswith((".mcap", *EVENT_LOGS)):
        text = f"{wrong_ending(path.name, ('.mcap', *EVENT_LOGS))}; or a bag of ROS 2"
        raise ConfigError(text, file=str(path))
    if is_xes(path) or path.name.lower().endswith(OCEL):
        try:
            if columns:
                return read_foreign_xes(path, model, columns)
            return (read_xes if is_xes(path) else _read_ocel)(path, model)
        except OSError as error:
            raise ConfigError(f"cannot be read: {error.strerror}", file=str(path)) from None
        except (ValueError, LookupError, TypeError, AttributeError, RecursionError, ElementTree.ParseError) as error:
            mapped = ""
            if is_xes(path) and not isinstance(error, ElementTree.ParseError):
                mapped = f"; --columns maps the names of another one, which has {names_of(path)}"
            raise ConfigError(f"is not a log as fame log convert writes it{mapped}", file=str(path)) from None
    with rows_of(path) as found:
        rows = [
            {**row, "robot": row.get("robot", ""), "time": round(float(row["time"]) * SECOND)}
            for row in found
            if row.get("robot") or row["what"] == ENDED
        ]
        rows.sort(key=itemgetter("time"))  # of several robots, as they may be one after another
        running: set[tuple[Any, Any]] = set()
        for row in rows:
            if row["what"] in ("start", "end"):
                (running.add if row["what"] == "start" else running.discard)((row["robot"], row["instance"]))
    processes = processes_of(rows)
    late = {str(row["robot"]): "" for row in rows if row["what"] in _OF_ENGINE and row["robot"] not in processes}
    complete = is_complete(rows, bool(rows) and not running)
    return RecordedEvents(rows, {**processes_by_pool(model, late), **processes}, complete, frozenset(late))


def _read_ocel(path: Path, model: Definitions) -> RecordedEvents:
    with open_file(path) as stream:
        data = json.load(stream)
    starts, ends, partly = list[dict[str, Any]](), list[dict[str, Any]](), set[str]()
    recorded = (each for one in data["objects"] if one["type"] == OCEL_RECORDING for each in one["attributes"])
    for entry in recorded:
        if entry["name"] == PART:
            raise ConfigError(PART_MESSAGE.format(entry["value"]), file=str(path))
        if entry["name"] == ENDED:
            ends.append(dated(entry["time"], "", "", "", ENDED, entry["value"]))
    instances = [each for each in data["objects"] if each["type"] == "instance"]
    for instance in instances:
        robot, _, number = instance["id"].removeprefix("instance:").rpartition("/")
        said = {each["name"]: each for each in instance["attributes"]}
        process = said["process"]["value"] if "process" in said else ""
        partly |= set() if process else {robot}
        if process:
            starts.append(dated(said["process"]["time"], robot, number, process, "start"))
        if "status" in said:
            ends.append(dated(said["status"]["time"], robot, number, process, "end", said["status"]["value"]))
    again = [id for id, count in Counter(each["id"] for each in data["events"]).items() if count > 1]
    if again:
        raise ConfigError(f"has several events {again[0]!r}: expected unique ids", file=str(path))
    rows = list(_ocel_events(data["events"]))
    info = element_info([model])
    seen = {row["element"] for row in rows}

    def lacks(element: str, what: str) -> str:
        named = info.get(element, UNKNOWN)
        known = what in ("start", "end") or named.activity or named.name or element in seen
        return "" if known else f"what happens at {element}, which has no label"

    complete = all(any(each["name"] == "status" for each in one["attributes"]) for one in instances)
    complete = is_complete(ends, complete)

    def has_order(rows: Sequence[EventRow]) -> bool:
        return count_instances(rows) < 2 or not any(row["what"] in ("start", "end") for row in rows)

    processes = {**processes_by_pool(model, partly), **processes_of(starts)}
    return RecordedEvents(
        timed([*starts, *rows, *ends]), processes, complete, frozenset(partly), lacks, has_order=has_order
    )


def _moment(event: Mapping[str, Any]) -> tuple[datetime, int]:
    """When an event was; of one instant FAME counts them by their ids."""
    return parse_datetime(event["time"]), int(event["id"][1:]) if re.fullmatch(r"e\d+", event["id"]) else 0


def _ocel_events(events: Iterable[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Its events at elements; one that completes at once has the event ``complete`` alone."""
    under_way = Counter[tuple[str, str]]()
    for event in sorted(events, key=_moment):
        values = {each["name"]: each["value"] for each in event["attributes"]}
        if "lifecycle" not in values:
            continue
        (instance,) = (each["objectId"] for each in event["relationships"] if each["qualifier"] == "instance")
        robot, _, number = instance.removeprefix("instance:").rpartition("/")
        element, what = values["element"], WHAT[values["lifecycle"]]
        if what == "leave" and not under_way[instance, element]:
            yield dated(event["time"], robot, number, element, "enter")
        elif what in ("enter", "leave", "cancel", "fail"):
            under_way[instance, element] += 1 if what == "enter" else -1
        yield dated(event["time"], robot, number, element, what, values.get("error"))
