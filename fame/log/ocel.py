"""Converts recordings to object-centric event logs: OCEL 2.0 as JSON (https://www.ocel-standard.org).

Objects are robots, process instances, signals (each message of a signal) and goals (each goal that a token sent to an
action). Events are the executions of activities and events, by their labels; what is sent and caught; and goals:

=====================  =================================================================================
type of event          related objects
=====================  =================================================================================
label of an element    the robot, the instance; attribute ``lifecycle`` is start, complete, abort or fail
``signal sent``        the signal, its robot (sender); attribute ``topic``
``signal received``    the signal, the robot and the instance whose token waited for it
``goal sent``,         the goal, the robot, the instance; attribute ``action``
``goal ended``
=====================  =================================================================================

At level ``mission`` the events are those of the activities and labelled elements in the files of the missions, without
those in called files; an element that completes at once is one event. Signals are those of the topics that elements
there name, without sensors and motors. Level ``all`` has every element and every message of the recording.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, BinaryIO, Literal

from fame.bpmn.model import Definitions
from fame.clock import EPOCH, date_at
from fame.errors import ConfigError
from fame.iso8601 import parse_datetime
from fame.log.channels import EVENTS, WAITING
from fame.log.elements import ElementInfo, element_info
from fame.log.recording import RecordedMessage, Recording
from fame.middleware.interface import ENGINE

OcelLevel = Literal["mission", "all"]

_LIFECYCLE = {"enter": "start", "leave": "complete", "cancel": "abort", "fail": "fail"}
_SENT, _RECEIVED, _GOAL_SENT, _GOAL_ENDED = "signal sent", "signal received", "goal sent", "goal ended"
_OBJECT_TYPES: Mapping[str, Mapping[str, str]] = {
    "robot": {},
    "instance": {"process": "string", "status": "string"},
    "signal": {"topic": "string", "type": "string"},
    "goal": {"action": "string"},
}
_ELEMENT = {"element": "string", "kind": "string", "lifecycle": "string", "error": "string"}
_EVENT_TYPES: Mapping[str, Mapping[str, str]] = {
    _SENT: {"topic": "string"},
    _RECEIVED: {"topic": "string"},
    _GOAL_SENT: {"action": "string"},
    _GOAL_ENDED: {"action": "string"},
}


def write_ocel(recording: Recording, models: Sequence[Definitions], level: OcelLevel, stream: BinaryIO) -> None:
    """Write a recording with its models to `stream`. Raises ConfigError at level mission without the missions."""
    elements = element_info(models)
    drawn = _Drawn(recording, models) if level == "mission" else None
    log = _Log(parse_datetime(recording.metadata["epoch"]) if "epoch" in recording.metadata else EPOCH)
    signals = {topic.name: topic.type for topic in recording.topics.values() if topic.encoding == "cdr"}
    caught = _Catching()
    for message in recording.messages((EVENTS, WAITING, *signals)):
        if message.topic == EVENTS:
            _add_events(log, message, elements, drawn)
        elif message.topic == WAITING:
            _add_waiting(log, message, caught)
        elif drawn is None or drawn.has_signal(message):
            _add_signal(log, message, signals[message.topic], caught)
    text = json.dumps(log.to_json(), ensure_ascii=False, separators=(",", ":"))
    stream.write(text.encode("utf-8", "backslashreplace"))


class _Drawn:
    """What level mission has: `elements` (ids), and messages of `topics` unless a robot's own part sent them."""

    def __init__(self, recording: Recording, models: Sequence[Definitions]) -> None:
        named = {run.models[0] for runs in recording.runs.values() for run in runs if run.models}
        missions = [model for model in models if model.file in (named or {next(iter(recording.models), "")})]
        if not missions:
            raise ConfigError("lacks the model of its mission: select --level all", file=str(recording.file))
        self._robots = frozenset(recording.robots)
        found = element_info(missions)
        self.elements = {
            id for id, info in found.items() if info.activity or (info.name and info.tag != "sequenceFlow")
        }
        nodes = [node for file in missions for process in file.processes for node in process.body.walk()]
        names = {topic.qualified for node in nodes for topic, _ in node.topics()}
        self._topics = {name.replace("~", f"/{robot}", 1) for name in names for robot in self._robots}

    def has_signal(self, message: RecordedMessage) -> bool:
        own = message.topic.split("/")[1] in self._robots
        return message.topic in self._topics and (not own or message.node.endswith(f"/{ENGINE}"))


@dataclass(slots=True)
class _Log:
    """The log so far. `epoch` is the date of time 0."""

    epoch: datetime
    events: list[dict[str, Any]] = field(default_factory=list)
    objects: dict[str, dict[str, Any]] = field(default_factory=dict)
    labels: dict[str, None] = field(default_factory=dict)

    def date(self, time: int) -> str:
        """A time of the recording (ns) as date."""
        return date_at(self.epoch, time).isoformat(timespec="microseconds").replace("+00:00", "Z")

    def event(self, kind: str, time: int, attributes: Mapping[str, str], related: Mapping[str, str]) -> None:
        """Add an event. `related`: id of an object -> its role."""
        if kind not in _EVENT_TYPES:
            self.labels.setdefault(kind)
        self.events.append(
            {
                "id": f"e{len(self.events) + 1}",
                "type": kind,
                "time": self.date(time),
                "attributes": [{"name": name, "value": value} for name, value in attributes.items()],
                "relationships": [{"objectId": id, "qualifier": role} for id, role in related.items()],
            }
        )

    def object(self, id: str, kind: str, time: int, attributes: Mapping[str, str], **related: str) -> str:
        """Add an object unless it is known, and new values of its attributes. Returns its id."""
        known = self.objects.get(id)
        if known is None:
            relationships = [{"objectId": other, "qualifier": role} for role, other in related.items()]
            known = {"id": id, "type": kind, "attributes": [], "relationships": relationships}
            self.objects[id] = known
        date = self.date(time)
        known["attributes"] += [{"name": name, "time": date, "value": value} for name, value in attributes.items()]
        return id

    def robot(self, name: str, time: int) -> str:
        return self.object(f"robot:{name}", "robot", time, {})

    def instance(self, robot: str, number: int, time: int, attributes: Mapping[str, str]) -> str:
        """The object of a process instance."""
        return self.object(f"instance:{robot}/{number}", "instance", time, attributes, robot=self.robot(robot, time))

    def to_json(self) -> dict[str, Any]:
        types = {**_EVENT_TYPES, **dict.fromkeys(self.labels, _ELEMENT)}
        return {
            "objectTypes": [_type(name, attributes) for name, attributes in _OBJECT_TYPES.items()],
            "eventTypes": [_type(name, attributes) for name, attributes in types.items()],
            "objects": list(self.objects.values()),
            "events": self.events,
        }


def _type(name: str, attributes: Mapping[str, str]) -> dict[str, Any]:
    return {"name": name, "attributes": [{"name": each, "type": kind} for each, kind in attributes.items()]}


@dataclass(slots=True)
class _Catching:
    """Tokens that wait for topics, and signals of the present instant that they may have caught."""

    tokens: dict[tuple[str, str], dict[str, Any]] = field(default_factory=dict)  # (robot, key) -> token
    signals: list[tuple[int, str, str]] = field(default_factory=list)  # time, topic, object


def _add_events(log: _Log, message: RecordedMessage, elements: Mapping[str, ElementInfo], drawn: _Drawn | None) -> None:
    data = message.json()
    robot = data["robot"]
    for group in data["events"]:
        marks = group["marks"]
        for number, (element, what, *detail) in enumerate(marks):
            if what == "start" or what == "end":
                changed = {"process": element} if what == "start" else {"status": str(detail[0])}
                log.instance(robot, group["instance"], message.time, changed)
            elif what in _LIFECYCLE and (drawn is None or element in drawn.elements):
                if drawn is not None and what == "enter" and marks[number + 1 : number + 2] == [[element, "leave"]]:
                    continue  # it completes at once
                info = elements.get(element)
                instance = log.instance(robot, group["instance"], message.time, {})
                related = {f"robot:{robot}": "robot", instance: "instance"}
                attributes = {
                    "element": element,
                    "kind": info.tag if info is not None else "",
                    "lifecycle": _LIFECYCLE[what],
                    **({"error": str(detail[0])} if what == "fail" and detail else {}),
                }
                name = (info.name if info is not None else "") or element
                log.event(name if name not in _EVENT_TYPES else element, message.time, attributes, related)


def _add_signal(log: _Log, message: RecordedMessage, type: str, caught: _Catching) -> None:
    number = sum(id.startswith(f"signal:{message.topic}#") for _, _, id in caught.signals)
    id = f"signal:{message.topic}#{message.time}" + (f"-{number}" if number else "")
    log.object(id, "signal", message.time, {"topic": message.topic, "type": type})
    sender = message.node.split("/")[1] if message.node.count("/") > 1 else ""
    related = {id: "signal"} | ({log.robot(sender, message.time): "sender"} if sender else {})
    log.event(_SENT, message.time, {"topic": message.topic}, related)
    caught.signals = [each for each in caught.signals if each[0] == message.time]
    caught.signals.append((message.time, message.topic, id))


def _add_waiting(log: _Log, message: RecordedMessage, caught: _Catching) -> None:
    """Tokens that are gone have caught what was sent at this instant on their topics; goals are sent and end."""
    data = message.json()
    robot = data["robot"]
    for key in data["gone"]:
        token = caught.tokens.pop((robot, key), None)
        if token is None:
            continue
        for time, topic, id in caught.signals:
            if time == message.time and topic in token.get("topics", ()):
                log.event(_RECEIVED, time, {"topic": topic}, {id: "signal", **_place(log, robot, token, time)})
        if "action" in token:
            _add_goal(log, _GOAL_ENDED, robot, token, message.time)
    for token in data["tokens"]:
        before = caught.tokens.get((robot, token["key"]))
        caught.tokens[robot, token["key"]] = token
        if "action" in token and "action" not in (before or {}):
            _add_goal(log, _GOAL_SENT, robot, token, message.time)


def _add_goal(log: _Log, what: str, robot: str, token: Mapping[str, Any], time: int) -> None:
    id = log.object(f"goal:{robot}/{token['key']}", "goal", time, {} if what == _GOAL_ENDED else _action(token))
    log.event(what, time, _action(token), {id: "goal", **_place(log, robot, token, time)})


def _action(token: Mapping[str, Any]) -> dict[str, str]:
    return {"action": str(token["action"])}


def _place(log: _Log, robot: str, token: Mapping[str, Any], time: int) -> dict[str, str]:
    """The robot and the instance of a token."""
    return {log.robot(robot, time): "robot", log.instance(robot, token["instance"], time, {}): "instance"}
