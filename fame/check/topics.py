"""Topics: one known type each, payloads that fit it, and somebody at the other end.

Public topics (``/done``) are one for the whole collaboration; those of a robot (``~/odom``) are judged for each process
that begins by itself, with all that it calls. Who is at the other end of a robot's own topic is its drivers' affair.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from fame.bpmn.model import Expression, FlowNode, Task, Topic
from fame.bpmn.topics import EMPTY_TYPE, topics_of
from fame.check.findings import Finding, Level
from fame.check.payloads import payload_findings, publish_findings
from fame.check.scope import Subject, Unit
from fame.engine.data import match, match_prefix, unfilled, variable_name
from fame.errors import MessageError, ModelError
from fame.middleware import messages
from fame.monitor.services import SERVICES
from fame.scripting import script_topics

_ROS_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")


@dataclass(frozen=True, slots=True)
class End:
    """An element at a topic, and what it says of it. `topic` is None for a script, `line` that of the text.

    `tries`: a wrong type is an error that the script may catch.
    """

    unit: Unit
    node: FlowNode
    name: str
    type: str | None
    throws: bool
    line: int
    topic: Topic | None = None
    payload: Expression | None = None
    tries: bool = False

    def finding(self, level: Level, text: str) -> Finding:
        """A finding at this end."""
        return self.unit.finding(level, text, self.node, self.line)


Table = Mapping[str, list[End]]
"""Ends by the qualified name of their topic, in the order of first use."""


def topic_findings(subject: Subject, team: Sequence[Subject] = ()) -> Iterator[Finding]:
    """Of every topic and ROS service that the processes name. `team`: all files of the mission, this one among them."""
    yield from fit_findings(subject, team)
    yield from _alone(subject, team or (subject,))


def fit_findings(subject: Subject, team: Sequence[Subject] = (), *, sent: bool = False) -> Iterator[Finding]:
    """The same without who is at the other end: types, and whether what is sent and taken fits them.

    `sent`: the processes run elsewhere, where message types may be known that are not known here.
    """
    units = [unit for one in team or (subject,) for unit in one.units]
    ends = {unit: list(_ends(unit)) for unit in units}
    files = {unit.home.file for unit in subject.units}
    for unit in subject.units:
        yield from _services(unit, sent)
        yield from publish_findings(unit)
    yield from (one for one in _judged(_by_name(units, ends, private=False), sent) if one.file in files)
    for root in subject.roots:
        yield from _judged(_by_name(root.closure(), ends, private=True), sent)


def types_of(subject: Subject) -> Mapping[str, str]:
    """The type of each topic of which somebody says it, by qualified name."""
    said = {name: said_type(ends) for name, ends in table(subject.units).items()}
    return {name: type for name, type in said.items() if type is not None}


def said_type(ends: Iterable[End]) -> str | None:
    """The type that the first end says that says any."""
    return next((end.type for end in ends if end.type is not None), None)


def fields_taken(names: Sequence[str], topic: Topic, type: str) -> tuple[str, ...]:
    """The variables of a data object that a caught message of the type sets; all, if the type is not known."""
    return tuple(message_fields(names, topic, type)) if type and _is_known(type) else tuple(names)


def message_fields(names: Sequence[str], topic: Topic, type: str) -> Mapping[str, str]:
    """The same: variable -> field, ``pose.position.x``; none if the type is not known."""
    found = match(names, variable_name(topic.name), messages.create(type)) if _is_known(type) else {}
    return {name: ".".join(path) for name, path in found.items()}


def _is_known(type: str) -> bool:
    try:
        messages.fields(type)
    except MessageError:
        return False
    return True


def taken_by_prefix(unit: Unit, node: FlowNode, topic: Topic, type: str) -> Mapping[str, str]:
    """Variables that a caught message sets though nothing says so, but that they begin like a field: name -> field."""
    if topic.takes or node.data_outputs or not _is_known(type):
        return {}
    found = match_prefix(unfilled(unit.process), "", messages.create(type))
    return {name: ".".join(path) for name, path in found.items()}


# ---- ends ------------------------------------------------------------------------------------------------------------


def table(units: Iterable[Unit]) -> Table:
    """All topics of some processes: of their events, their tasks, and what scripts name literally."""
    return _sorted(end for unit in units for end in _ends(unit))


def _by_name(units: Iterable[Unit], ends: Mapping[Unit, Sequence[End]], *, private: bool) -> Table:
    """The topics of some processes that are public, or those that are the robot's own."""
    return _sorted(end for unit in units for end in ends[unit] if end.name.startswith("~/") == private)


def _sorted(ends: Iterable[End]) -> Table:
    found: dict[str, list[End]] = {}
    for end in ends:
        found.setdefault(end.name, []).append(end)
    return found


def _ends(unit: Unit) -> Iterator[End]:
    for node in unit.process.body.walk():
        yield from _drawn(unit, node)
        yield from _scripted(unit, node)


def _drawn(unit: Unit, node: FlowNode) -> Iterator[End]:
    for topic, throws in topics_of(node):
        sent = topic.payload or (node.payload if isinstance(node, Task) else None)
        yield End(unit, node, topic.qualified, topic.type, throws, node.line, topic, sent if throws else None)


def _scripted(unit: Unit, node: FlowNode) -> Iterator[End]:
    if not isinstance(node, Task) or node.script is None:
        return
    try:
        named = script_topics(node.script)
    except ModelError:  # the compiler tells
        return
    tries = node.script.language == "javascript" and re.search(r"\btry\b", node.script.text) is not None
    for topic in named:
        if topic.direction != "call":
            name = topic.name if topic.name.startswith(("/", "~/")) else f"~/{topic.name}"
            full = topic.type.replace("/", "/msg/") if topic.type and topic.type.count("/") == 1 else topic.type
            yield End(unit, node, name, full, topic.direction == "publish", topic.line, tries=tries)


# ---- types -----------------------------------------------------------------------------------------------------------


def _judged(topics: Table, sent: bool) -> Iterator[Finding]:
    for name, ends in topics.items():
        type = said_type(ends)
        yield from _names(name, ends)
        yield from _types(name, ends)
        yield from () if sent else _unknown(ends)
        for end in ends:
            if end.payload is not None and type is None:
                text = f"topic {name} has a payload and no type: give one of its events property type"
                yield end.finding("error", text)
            elif end.payload is not None and type is not None:
                yield from payload_findings(end.unit, end.node, end.payload, type)
            elif not end.throws and end.topic is not None:
                yield from _taking(end, end.topic, type)
        drawn = [end for end in ends if end.topic is not None]  # a script may do with what is there when it runs
        if type is None and name.startswith("~/") and drawn and not any(end.throws for end in ends):
            yield drawn[0].finding("warning", f"no event says the type of the robot's topic {name}: it has to be known")


def _names(name: str, ends: Sequence[End]) -> Iterator[Finding]:
    """Whether ROS takes the name of a topic. In simulation any name will do."""
    if not _ROS_NAME.fullmatch(name.removeprefix("~")):
        text = f"ROS 2 refuses the topic {name}: letters, digits and _ would be right, not beginning with a digit"
        yield ends[0].finding("warning", text)


def _types(name: str, ends: Sequence[End]) -> Iterator[Finding]:
    said = [end for end in ends if end.type is not None]
    for end in said:
        if end.type != said[0].type:
            there = f"{said[0].node.id} says {said[0].type}"
            text = f"topic {name} has type {end.type} here, but {there}: a topic has one type"
            yield end.finding("warning" if end.tries else "error", text)


def _unknown(ends: Sequence[End]) -> Iterator[Finding]:
    for end in ends:
        if end.type is not None:
            try:
                messages.fields(end.type)
            except MessageError as error:
                yield end.finding("warning" if end.tries else "error", f"type {error}")


def _taking(end: End, topic: Topic, type: str | None) -> Iterator[Finding]:
    """Whether a caught message has what is to be taken from it."""
    objects = [item for body in end.unit.bodies() for item in body.data_objects if item.id in end.node.data_outputs]
    names = [name for item in objects for name in item.names]
    wanted = ", ".join([item.target for item in topic.takes] or names)
    if wanted and type is None:
        text = f"no event says the type of topic {end.name}, so it carries {EMPTY_TYPE}, which has nothing for {wanted}"
        yield end.finding("warning", text)
    elif type is not None and names and not topic.takes and not fields_taken(names, topic, type):
        fields = ", ".join(messages.fields(type)) or "none"
        text = f"{type} has no field for {wanted}: name them like its fields ({fields}), or <field>_..."
        yield end.finding("warning", text)
    for name, field in taken_by_prefix(end.unit, end.node, topic, type or "").items():
        text = f"fills `{name}` with field {field}, by the name alone: connect the event with the data object"
        yield end.finding("warning", text)


def _services(unit: Unit, sent: bool) -> Iterator[Finding]:
    """The ROS services and actions that service tasks call."""
    for node in unit.process.body.walk():
        service = node.topic if isinstance(node, Task) and node.kind == "service" else None
        if service is not None and service.type:
            try:
                request = messages.goal_type(service.type) or messages.service(service.type)[0]
            except MessageError as error:
                if not sent:
                    yield unit.finding("error", f"type {error}", node)
            else:
                if service.payload is not None:
                    yield from payload_findings(unit, node, service.payload, request)


# ---- who is at the other end -----------------------------------------------------------------------------------------


def _alone(subject: Subject, team: Sequence[Subject]) -> Iterator[Finding]:
    """Signals that only go out, or only come in."""
    public, level = public_topics(team), level_of(team)
    where = (subject.definitions.file or "the file") if len(team) == 1 else f"the {len(team)} files of the mission"
    for name, ends in public.items():
        throws, catches = [end for end in ends if end.throws], [end for end in ends if not end.throws]
        drawn = next((end for end in ends if end.topic is not None and end.unit in subject.units), None)
        if drawn is None or (throws and catches):
            continue
        does, other = ("throws", "catches") if throws else ("waits for", "throws")
        text = f"{does} {name}, which nobody in {where} {other}{_similar(name, ends, public)}"
        yield drawn.finding(level, text)


def public_topics(team: Sequence[Subject]) -> Table:
    """The topics by which the robots of a mission talk to each other: not those of their drivers."""
    pools = [pool for one in team for pool in one.definitions.participants]
    robots = {pool.label.casefold() for pool in pools}
    return {
        name: ends
        for name, ends in table(unit for one in team for unit in one.units).items()
        if not name.startswith("~/") and not (_space(name) in robots and name.count("/") > 1)
    }


def _space(name: str) -> str:
    """The namespace of a topic, without the number of a robot of a multi-instance pool."""
    return re.sub(r"_\d+$", "", name.split("/")[1].casefold())


def level_of(team: Sequence[Subject]) -> Level:
    """How grave it is that a topic lacks one of its ends: a warning where the file tells of all that is said and heard.

    It does not where a pool is a black box, or a monitoring unit is at work, whose topics its configuration names; nor
    if it is a part of a mission, of which others may not have been given.
    """
    pools = [pool for one in team for pool in one.definitions.participants]
    nodes = (node for one in team for unit in one.units for node in unit.process.body.walk())
    monitored = any(isinstance(node, Task) and node.operation in SERVICES for node in nodes)
    return (
        "warning" if len(team) == 1 < len(pools) and all(pool.process for pool in pools) and not monitored else "note"
    )


def _similar(name: str, ends: Sequence[End], topics: Table) -> str:
    """A topic whose other end may be meant: of nearly that name, and likewise with one end only."""
    throws = ends[0].throws
    lonely = {one.casefold(): one for one, its in topics.items() if all(end.throws != throws for end in its)}
    found = difflib.get_close_matches(name.casefold(), sorted(lonely), 1, 0.8)
    return f"; did you mean {lonely[found[0]]}?" if found else ""
