"""Topics and their ends: which elements and scripts publish, throw, catch or receive what.

Public topics (``/done``) are shared by the whole collaboration; those of a robot (``~/odom``) belong to each process
that starts by itself, with all that it calls.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence

from fame.bpmn.model import Expression, FlowNode, Topic
from fame.check.scope import CheckedProcess, CheckScope, Finding, Fix, Level
from fame.check.service_topics import served_topics, service_places
from fame.dataclasses import dataclass
from fame.engine.data import match, match_prefix, unfilled, variable_name
from fame.errors import MessageError
from fame.middleware import messages
from fame.scripting import script_effects


@dataclass(frozen=True, slots=True)
class TopicEndpoint:
    """An element that publishes or subscribes to a topic. `topic` is None for a script, `line` that of the text.

    `label`: the name that the topic is made of, empty if it is written literally.
    `tries`: the script may catch the error of a wrong type.
    """

    process: CheckedProcess
    node: FlowNode
    name: str
    type: str | None
    throws: bool
    line: int
    topic: Topic | None = None
    payload: Expression | None = None
    tries: bool = False
    label: str = ""

    def finding(self, level: Level, text: str, fix: Fix | None = None) -> Finding:
        return self.process.finding(level, text, self.node, self.line, fix)


Topics = Mapping[str, list[TopicEndpoint]]
"""Endpoints by the qualified name of their topic, in the order of first use."""


def by_topic(processes: Iterable[CheckedProcess]) -> Topics:
    """Return the topics of events and tasks, and those that scripts name literally."""
    return _by_name(end for process in processes for end in endpoints_of(process))


def select_topics(
    processes: Iterable[CheckedProcess], ends: Mapping[CheckedProcess, Sequence[TopicEndpoint]], *, private: bool
) -> Topics:
    """Return the public topics of some processes, or those of the robot itself."""
    return _by_name(end for process in processes for end in ends[process] if end.name.startswith("~/") == private)


def _by_name(ends: Iterable[TopicEndpoint]) -> Topics:
    named: dict[str, list[TopicEndpoint]] = {}
    for end in ends:
        named.setdefault(end.name, []).append(end)
    return named


def endpoints_of(process: CheckedProcess) -> Iterator[TopicEndpoint]:
    for node in process.nodes():
        yield from _drawn(process, node)
        yield from _scripted(process, node)
    for place in service_places(process):
        for one in place.topics or ():
            yield TopicEndpoint(process, place.node, one.name, one.type, one.throws, place.node.line)


def _drawn(process: CheckedProcess, node: FlowNode) -> Iterator[TopicEndpoint]:
    for topic, throws in node.topics():
        sent = topic.payload if throws else None
        yield TopicEndpoint(
            process, node, topic.qualified, topic.type, throws, node.line, topic, sent, label=topic.label
        )


def _scripted(process: CheckedProcess, node: FlowNode) -> Iterator[TopicEndpoint]:
    script = node.script
    tries = script is not None and script.language == "javascript" and re.search(r"\btry\b", script.text) is not None
    for topic in script_effects(node).topics:
        if topic.direction not in ("call", "act"):
            throws = topic.direction == "publish"
            name, type = topic.qualified, topic.full_type
            yield TopicEndpoint(process, node, name, type, throws, topic.line, tries=tries, label=topic.label)


def public_topics(team: Sequence[CheckScope]) -> Topics:
    """Return the topics between the robots of a mission, without those of their drivers."""
    pools = [pool for one in team for pool in one.definitions.participants]
    robots = {pool.label.casefold() for pool in pools}
    return {
        name: ends
        for name, ends in by_topic(process for one in team for process in one.processes).items()
        if not name.startswith("~/") and not (_space(name) in robots and name.count("/") > 1)
    }


def _space(name: str) -> str:
    """The namespace of a topic, without the number of a robot of a multi-instance pool."""
    return re.sub(r"_\d+$", "", name.split("/")[1].casefold())


def level_of(team: Sequence[CheckScope]) -> Level:
    """Return the level of a topic without publisher or subscriber: a warning where the file is complete, else a note.

    A file is not complete if a pool is a black box, if the topics of a monitoring service are not known, or if it is
    part of a mission whose other files may be missing.
    """
    pools = [pool for one in team for pool in one.definitions.participants]
    monitored = any(served_topics(root) is None for one in team for root in one.roots)
    return (
        "warning" if len(team) == 1 < len(pools) and all(pool.process for pool in pools) and not monitored else "note"
    )


# ---- types and fields ------------------------------------------------------------------------------------------------


def types_of(scope: CheckScope) -> Mapping[str, str]:
    """Return the declared type of each topic, by qualified name."""
    declared = {name: declared_type(ends) for name, ends in by_topic(scope.processes).items()}
    return {name: type for name, type in declared.items() if type is not None}


def declared_type(ends: Iterable[TopicEndpoint]) -> str | None:
    """Return the first type that an endpoint declares, None if none does."""
    return next((end.type for end in ends if end.type is not None), None)


def fields_taken(names: Sequence[str], topic: Topic, type: str) -> tuple[str, ...]:
    """Return the variables of a data object that a caught message sets; all of them if the type is unknown."""
    return tuple(message_fields(names, topic, type)) if _is_known(type) else tuple(names)


def message_fields(names: Sequence[str], topic: Topic, type: str) -> Mapping[str, str]:
    """Return the field of each variable, such as ``pose.position.x``; empty if the type is unknown."""
    paths = match(names, variable_name(topic.name), messages.create(type)) if _is_known(type) else {}
    return {name: ".".join(path) for name, path in paths.items()}


def _is_known(type: str) -> bool:
    if not type:
        return False
    try:
        messages.fields(type)
    except MessageError:
        return False
    return True


def taken_by_prefix(process: CheckedProcess, node: FlowNode, topic: Topic, type: str) -> Mapping[str, str]:
    """Variables that a caught message sets because their names start like a field: name -> field."""
    if topic.takes or node.data_outputs or not _is_known(type):
        return {}
    paths = match_prefix(unfilled(process.bpmn), "", messages.create(type))
    return {name: ".".join(path) for name, path in paths.items()}
