"""Converts recordings to object-centric event logs: OCEL 2.0 as JSON (https://www.ocel-standard.org).

Objects are robots, process instances, signals (each message of a signal), goals (each goal that a token sent to an
action) and properties with their verdicts. Events are the executions of activities and events, by their labels; what is
sent and caught; and goals:

=====================  =================================================================================
type of event          related objects
=====================  =================================================================================
label of an element    the robot, the instance; attribute ``lifecycle`` is start, complete, abort or fail
``signal sent``        the signal, its robot (sender); attribute ``topic``
``signal received``    the signal, the robot and the instance of the token that took it
``goal sent``,         the goal, the robot, the instance; attribute ``action``
``goal ended``
=====================  =================================================================================

Further objects are what variables name: with ``parcel=parcel_id`` each value of the variable ``parcel_id``, text or a
number, is an object of type ``parcel``. An event is related to the value that its scope has at the end of that instant.

At level ``mission`` the events are those of the activities and labelled elements in the files of the missions, without
those in called files; an element that completes at once is one event. Signals are those of the topics that elements
there name, without sensors and motors. Level ``all`` has every element and every message of the recording.

The log of a recording that was cut off has an object of the type ``recording``, whose attribute ``part`` says so.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import datetime
from itertools import groupby
from operator import attrgetter
from typing import Any, BinaryIO

from fame.bpmn.model import Definitions
from fame.clock import EPOCH, date_at
from fame.dataclasses import dataclass, field
from fame.errors import ConfigError
from fame.iso8601 import parse_datetime
from fame.log.channels import EVENTS, KEY, VARIABLES, WAITING
from fame.log.elements import ElementInfo, element_info
from fame.log.reading import PART
from fame.log.recording import RecordedMessage, Recording
from fame.log.team_state import TeamState
from fame.log.writing import OCEL_RECORDING
from fame.mining.mission_level import MissionLevel
from fame.mining.signals import Signals
from fame.robot.events import ENDED
from fame.text import suggestion

ObjectVariables = Mapping[str, str]
"""Type of objects -> the variable whose values name them."""

_LIFECYCLE = {"enter": "start", "leave": "complete", "cancel": "abort", "fail": "fail"}
_SENT, _RECEIVED, _GOAL_SENT, _GOAL_ENDED = "signal sent", "signal received", "goal sent", "goal ended"
_OBJECT_TYPES: Mapping[str, Mapping[str, str]] = {
    "robot": {},
    "instance": {"process": "string", "status": "string"},
    "signal": {"topic": "string", "type": "string"},
    "goal": {"action": "string"},
    OCEL_RECORDING: {PART: "string", ENDED: "string"},
    "property": {"sentence": "string", "verdict": "string", "slack": "float", "text": "string"},
}
_ELEMENT = {"element": "string", "kind": "string", "lifecycle": "string", "error": "string"}
_EVENT_TYPES: Mapping[str, Mapping[str, str]] = {
    _SENT: {"topic": "string"},
    _RECEIVED: {"topic": "string"},
    _GOAL_SENT: {"action": "string"},
    _GOAL_ENDED: {"action": "string"},
}


class CaseNumbers:
    """Numbers of instances by which these stay apart when a robot numbers them anew: in another mission, as of merged
    recordings. They are those of the engine as long as they grow."""

    def __init__(self) -> None:
        self._numbers: dict[tuple[str, int], int] = {}
        self._last: dict[str, int] = {}

    def number(self, robot: str, instance: int, what: str = "") -> int:
        """Return the number of an instance, to which something (the mark `what`) happens."""
        if what == "start":
            last = self._last.get(robot, 0)
            self._last[robot] = self._numbers[robot, instance] = instance if instance > last else last + 1
        return self._numbers.get((robot, instance), instance)


def write_ocel(
    recording: Recording,
    models: Sequence[Definitions],
    mission: MissionLevel | None,
    named: ObjectVariables,
    stream: BinaryIO,
) -> None:
    """Write a recording with its models to `stream`; all of it without `mission`. `named`: type -> variable.

    Raises ConfigError for a type that each log has, and for a variable that the recording does not have.
    """
    signals = {topic.name: topic.type for topic in recording.topics.values() if topic.encoding == "cdr"}
    epoch = parse_datetime(recording.metadata["epoch"]) if "epoch" in recording.metadata else EPOCH
    log, elements = _Log(epoch, _Variables(named, str(recording.file))), element_info(models)
    caught = _Catching(Signals(models))
    messages = recording.messages((KEY, EVENTS, VARIABLES, WAITING, *signals))
    for _, group in groupby(messages, attrgetter("time")):
        instant = list(group)
        log.variables.begin(instant)
        caught.begin()
        for message in instant:
            if message.topic == EVENTS:
                _add_events(log, message, elements, mission, caught)
            elif message.topic == WAITING:
                _add_waiting(log, message, caught)
            elif message.topic in signals and (mission is None or mission.has_signal(message)):
                _add_signal(log, message, signals[message.topic], caught)
        caught.say(log)
        log.variables.end(instant)
    log.variables.check()
    for verdict in recording.verdicts:
        _add_verdict(log, verdict, recording.end)
    if recording.lack:
        log.object(OCEL_RECORDING, OCEL_RECORDING, recording.end, {PART: recording.lack})
    if ended := recording.ended:
        log.object(OCEL_RECORDING, OCEL_RECORDING, ended.time, {ENDED: ended.detail})
    text = json.dumps(log.to_json(), ensure_ascii=False, separators=(",", ":"))
    stream.write(text.encode("utf-8", "backslashreplace"))


class _Variables:
    """The variables of a team, and the objects that they name: `named` is type -> variable."""

    def __init__(self, named: ObjectVariables, file: str) -> None:
        for kind in named:
            if kind in _OBJECT_TYPES:
                raise ConfigError(f"--object {kind}={named[kind]}: each log has objects of type {kind!r} already")
        self.named, self._file = named, file
        self._team = TeamState(0)
        self._known, self._found = set[str](), set[str]()  # variables; types of which there is an object

    def begin(self, instant: Sequence[RecordedMessage]) -> None:
        """Take the values that variables have at the end of an instant; scopes that end are there until `end`."""
        for message in instant if self.named else ():
            if message.topic == KEY:  # after a gap, too
                self._team = TeamState.from_key(message.time, message.json())
                scopes = (scope for robot in self._team.robots.values() for scope in robot.scopes.values())
                self._known.update(name for scope in scopes for name in scope.values)
            elif message.topic == EVENTS:
                self._team.apply(message.time, EVENTS, message.json())
            elif message.topic == VARIABLES:
                self._change(message, gone=False)

    def end(self, instant: Sequence[RecordedMessage]) -> None:
        for message in instant if self.named else ():
            if message.topic == VARIABLES:
                self._change(message, gone=True)

    def _change(self, message: RecordedMessage, *, gone: bool) -> None:
        data = message.json()
        changes = [each for each in data["changes"] if bool(each.get("gone")) is gone]
        self._known.update(name for each in changes for name in each.get("set", ()))
        self._team.apply(message.time, VARIABLES, {**data, "changes": changes})

    def of(self, robot: str, place: Mapping[str, Any]) -> dict[str, str]:
        """Type -> value, of the variables that are seen at a place: an event or a token."""
        state = self._team.robots.get(robot)
        if state is None or not self.named:
            return {}
        values, found = state.visible(place["scope"]), {}
        for kind, variable in self.named.items():
            value = values.get(variable)
            if isinstance(value, str | int | float):
                found[kind] = str(value)
                self._found.add(kind)
        return found

    def check(self) -> None:
        """Raises ConfigError for a variable that named nothing."""
        for kind, variable in self.named.items():
            if variable not in self._known:
                raise ConfigError(f"has no variable {variable!r}: {suggestion(variable, self._known)}", file=self._file)
            if kind not in self._found:
                raise ConfigError(f"the variable {variable!r} is never text or a number at an event", file=self._file)


@dataclass(slots=True)
class _Log:
    """The log so far. `epoch` is the date of time 0."""

    epoch: datetime
    variables: _Variables
    events: list[dict[str, Any]] = field(default_factory=list)
    objects: dict[str, dict[str, Any]] = field(default_factory=dict)
    labels: dict[str, None] = field(default_factory=dict)
    cases: CaseNumbers = field(default_factory=CaseNumbers)

    def date(self, time: int) -> str:
        """Return a time of the recording (ns) as date."""
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

    def object(self, id: str, kind: str, time: int, attributes: Mapping[str, Any], **related: str) -> str:
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

    def named(self, robot: str, place: Mapping[str, Any], time: int) -> dict[str, str]:
        """Return the objects that variables name at a place: id -> type."""
        found = self.variables.of(robot, place).items()
        return {self.object(f"{kind}:{value}", kind, time, {}): kind for kind, value in found}

    def instance(self, robot: str, number: int, time: int, attributes: Mapping[str, str]) -> str:
        """Return the object of a process instance."""
        number = self.cases.number(robot, number, "start" if "process" in attributes else "")
        return self.object(f"instance:{robot}/{number}", "instance", time, attributes, robot=self.robot(robot, time))

    def to_json(self) -> dict[str, Any]:
        types = {**_EVENT_TYPES, **dict.fromkeys(self.labels, _ELEMENT)}
        return {
            "objectTypes": [_type(name, {}) for name in self.variables.named]
            + [_type(name, attributes) for name, attributes in _OBJECT_TYPES.items()],
            "eventTypes": [_type(name, attributes) for name, attributes in types.items()],
            "objects": list(self.objects.values()),
            "events": self.events,
        }


def _type(name: str, attributes: Mapping[str, str]) -> dict[str, Any]:
    return {"name": name, "attributes": [{"name": each, "type": kind} for each, kind in attributes.items()]}


@dataclass(slots=True)
class _Catching:
    """Tokens that wait, and the signals of the present instant."""

    taken: Signals
    tokens: dict[tuple[str, str], dict[str, Any]] = field(default_factory=dict)  # (robot, key) -> token
    signals: list[tuple[str, str]] = field(default_factory=list)  # topic, object
    pending: dict[str, tuple[str, RecordedMessage]] = field(default_factory=dict)  # object -> sender: not yet an event

    def begin(self) -> None:
        self.signals.clear()
        self.taken.begin()

    def say(self, log: _Log, robot: str = "", topic: str = "", object: str = "") -> None:
        """Add the events of signals that were sent: all, one object, or the first of a robot on a topic."""
        found = [
            id for id, (sender, each) in self.pending.items() if not topic or (sender, each.topic) == (robot, topic)
        ]
        for id in [object] if object else found[: 1 if topic else None]:
            if id in self.pending:
                sender, message = self.pending.pop(id)
                related = {id: "signal"} | ({log.robot(sender, message.time): "sender"} if sender else {})
                log.event(_SENT, message.time, {"topic": message.topic}, related)

    def receive(self, log: _Log, topic: str, object: str, time: int, place: Mapping[str, str]) -> None:
        self.say(log, object=object)
        log.event(_RECEIVED, time, {"topic": topic}, {object: "signal", **place})


def _add_events(
    log: _Log,
    message: RecordedMessage,
    elements: Mapping[str, ElementInfo],
    mission: MissionLevel | None,
    caught: _Catching,
) -> None:
    data = message.json()
    robot = data["robot"]
    for each in data.get("opens", ()):
        caught.taken.opens(robot, each["scope"], each.get("parent"))
    for group in data["events"]:
        marks = group["marks"]
        for number, (element, what, *detail) in enumerate(marks):
            if what == "start" or what == "end":
                changed = {"process": element} if what == "start" else {"status": str(detail[0])}
                log.instance(robot, group["instance"], message.time, changed)
            at_once = marks[number + 1 : number + 2] == [[element, "leave"]]
            if what == "enter" and not at_once:
                caught.taken.enter(robot, group["scope"], element)
            elif what == "leave":
                _add_topics(log, caught, robot, group, element, message.time)
            if what in _LIFECYCLE and (mission is None or element in mission.elements):
                if mission is not None and what == "enter" and at_once:
                    continue  # it completes at once
                info = elements.get(element)
                instance = log.instance(robot, group["instance"], message.time, {})
                related = {f"robot:{robot}": "robot", instance: "instance"}
                related |= log.named(robot, group, message.time)
                attributes = {
                    "element": element,
                    "kind": info.tag if info is not None else "",
                    "lifecycle": _LIFECYCLE[what],
                    **({"error": str(detail[0])} if what == "fail" and detail else {}),
                }
                name = (info.name if info is not None else "") or element
                log.event(name if name not in _EVENT_TYPES else element, message.time, attributes, related)


def _add_topics(log: _Log, caught: _Catching, robot: str, group: Mapping[str, Any], element: str, time: int) -> None:
    """What a token has thrown or caught at an element that it leaves."""
    for topic in caught.taken.throws(robot, element):
        caught.say(log, robot, topic)
    found = caught.taken.taken_by(robot, group["scope"], element)
    if found is not None:
        caught.receive(log, *found, time, _place(log, robot, group, time))


def _add_verdict(log: _Log, judgement: Mapping[str, Any], time: int) -> None:
    values = {key: judgement[key] for key in _OBJECT_TYPES["property"] if judgement[key] not in (None, "")}
    id = log.object(f"property:{judgement['property']}", "property", time, values)
    robots = [log.robot(robot, time) for robot in judgement["robots"]]
    log.objects[id]["relationships"] = [{"objectId": robot, "qualifier": "robot"} for robot in robots]


def _add_signal(log: _Log, message: RecordedMessage, type: str, caught: _Catching) -> None:
    number = sum(topic == message.topic for topic, _ in caught.signals)
    id = f"signal:{message.topic}#{message.time}" + (f"-{number}" if number else "")
    log.object(id, "signal", message.time, {"topic": message.topic, "type": type})
    caught.signals.append((message.topic, id))
    caught.taken.add(message.topic, id)
    sender = message.node.split("/")[1] if message.node.count("/") > 1 else ""
    caught.pending[id] = sender, message
    if not caught.taken.is_thrown(sender, message.topic):
        caught.say(log, object=id)


def _add_waiting(log: _Log, message: RecordedMessage, caught: _Catching) -> None:
    """Scripts that are gone have caught what was sent at this instant on their topics; goals are sent and end."""
    data = message.json()
    robot = data["robot"]
    for key in data["gone"]:
        token = caught.tokens.pop((robot, key), None)
        if token is None:
            continue
        for topic, id in () if caught.taken.catches(token["element"]) else caught.signals:
            if topic in token.get("topics", ()):
                caught.receive(log, topic, id, message.time, _place(log, robot, token, message.time))
        if "action" in token:
            _add_goal(log, _GOAL_ENDED, robot, token, message.time)
    for token in data["tokens"]:
        before = caught.tokens.get((robot, token["key"]))
        caught.tokens[robot, token["key"]] = token
        if "action" in token and "action" not in (before or {}):
            _add_goal(log, _GOAL_SENT, robot, token, message.time)


def _add_goal(log: _Log, what: str, robot: str, token: Mapping[str, Any], time: int) -> None:
    case = log.cases.number(robot, token["instance"], "")
    apart = "" if case == token["instance"] else f"{case}/"  # of another mission, whose tokens have the same keys
    id = log.object(f"goal:{robot}/{apart}{token['key']}", "goal", time, {} if what == _GOAL_ENDED else _action(token))
    log.event(what, time, _action(token), {id: "goal", **_place(log, robot, token, time)})


def _action(token: Mapping[str, Any]) -> dict[str, str]:
    return {"action": str(token["action"])}


def _place(log: _Log, robot: str, token: Mapping[str, Any], time: int) -> dict[str, str]:
    """The robot and the instance of a token, and what its variables name."""
    place = {log.robot(robot, time): "robot", log.instance(robot, token["instance"], time, {}): "instance"}
    return place | log.named(robot, token, time)
