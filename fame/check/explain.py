"""Explain how a model from another tool was read, one reading per line.

::

    form       which tool's extension elements the file has
    topic      what an event or task throws, catches or asks: topic, type, payload, where its fields go
    data       the variables of a data object
    parameter  the variables that fame run --set can give other values, with their defaults
    call       where a called process was found
    script     the language of a script, condition or other text, as far as that is not Python
    quirk      a habit of the tool that wrote the file, on which the model relies
    semantics  what semantics=original changes
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

from fame.bpmn.library import Library
from fame.bpmn.model import DataObject, Definitions, Element, Expression
from fame.bpmn.reader.dialects import dialects_of
from fame.bpmn.reader.expressions import has_placeholders
from fame.bpmn.reader.xml import children, parse
from fame.bpmn.topics import EMPTY_TYPE
from fame.check.endpoints import (
    TopicEndpoint,
    by_topic,
    declared_type,
    message_fields,
    taken_by_prefix,
)
from fame.check.expressions import expressions_in
from fame.check.guidelines import suspending
from fame.check.scope import CheckedProcess, CheckScope, find_scope
from fame.check.variables import parameters
from fame.dataclasses import dataclass
from fame.engine.data import variable_name
from fame.middleware import messages
from fame.scripting import script_effects
from fame.text import ros_name

ReadingKind = Literal["form", "topic", "data", "parameter", "call", "script", "quirk", "semantics"]
KINDS: tuple[ReadingKind, ...] = ("form", "topic", "data", "parameter", "call", "script", "quirk", "semantics")

_LANGUAGES = {"javascript": "JavaScript", "juel": "Camunda 7, ${...}", "feel": "FEEL", "template": "text with ${...}"}


@dataclass(frozen=True, slots=True)
class ReadingDetail:
    """One detail of how the file was read. `line` is 1-based, 0 unknown; `element` is an id, empty for the file."""

    kind: ReadingKind
    text: str
    file: str = ""
    line: int = 0
    element: str = ""

    def __str__(self) -> str:
        """One line: ``mission.bpmn:12: topic: Event_1: catches /done, std_msgs/msg/Bool, into done``."""
        place = ":".join(part for part in (self.file, str(self.line or "")) if part)
        return ": ".join(part for part in (place, self.kind, self.element, self.text) if part)


def readings(definitions: Definitions, *, library: Library | None = None) -> list[ReadingDetail]:
    """Return all readings of a file and of the processes that it calls, by file and line."""
    about = find_scope(definitions, library or Library())
    homes = {process.file: process.definitions for process in about.processes} or {definitions.file: definitions}
    details = [reading for home in homes.values() for reading in (*_forms(home), *_notes(home))]
    types = {name: declared_type(ends) or EMPTY_TYPE for name, ends in by_topic(about.processes).items()}
    for ends in by_topic(about.processes).values():
        details += (_at(end.process, "topic", _topic(end, types[end.name]), end.node, end.line) for end in ends)
    for process in about.processes:
        details += (
            *_services(process),
            *_data(process),
            *_parameters(process, about, library or Library()),
            *_calls(process, about),
            *_texts(process),
            *_semantics(process),
        )
        details += (_at(process, "quirk", text, node, line) for text, node, line in _quirks(process, types))
    order = {file: place for place, file in enumerate(homes)}
    return sorted(dict.fromkeys(details), key=lambda one: (order[one.file], one.line, KINDS.index(one.kind)))


def _at(process: CheckedProcess, kind: ReadingKind, text: str, element: Element, line: int = 0) -> ReadingDetail:
    return ReadingDetail(kind, text, process.file, line or element.line, element.id)


def _forms(home: Definitions) -> Iterator[ReadingDetail]:
    forms = dialects_of(parse(home.source, home.file))
    yield ReadingDetail("form", f"has {', '.join(forms)}" if forms else "has no extension elements", home.file)


def _notes(home: Definitions) -> Iterator[ReadingDetail]:
    for note in home.notes:
        if note.quirk:
            yield ReadingDetail("quirk", note.text, home.file, note.line, note.element)


# ---- topics ----------------------------------------------------------------------------------------------------------


def _topic(end: TopicEndpoint, type: str) -> str:
    name = end.name if ros_name(end.label) == end.label else f"{end.name} ({end.label!r})"
    if end.topic is None:
        return f"its script {'publishes' if end.throws else 'subscribes to'} {name}, {type}"
    origin = "" if end.type else " (not declared)" if type == EMPTY_TYPE else " (declared elsewhere)"
    head = f"{'throws' if end.throws else 'catches'} {name}, {type}{origin}"
    if end.throws:
        sent = f"payload {_shown(end.payload)}" if end.payload is not None else "a message of default values"
        return f"{head}, {sent}"
    keys = [f", correlates {name} = {source.text}" for name, source in end.node.keys_of(end.topic)]
    return f"{head}, {_where_to(end, type)}{''.join(keys)}"


def _where_to(end: TopicEndpoint, type: str) -> str:
    """The variables that receive the fields of a caught message."""
    topic, node = end.topic, end.node
    assert topic is not None
    if topic.takes:
        return ", ".join(f"{one.target} = {one.source.text}" for one in topic.takes)
    names = [name for item in _objects(end.process) if item.id in node.data_outputs for name in item.names]
    if names:
        taken = message_fields(names, topic, type)
        return ", ".join(f"{name} = {field}" for name, field in taken.items()) or f"nothing for {', '.join(names)}"
    loose = taken_by_prefix(end.process, node, topic, type)
    return ", ".join([f"into {variable_name(topic.name)}", *(f"{name} = {field}" for name, field in loose.items())])


def _services(process: CheckedProcess) -> Iterator[ReadingDetail]:
    for node in process.nodes():
        if node.service is not None:
            payload, type = node.service.payload, node.service.type
            sent = f"request {_shown(payload)}" if payload is not None else "a request of default values"
            kind = "action" if messages.is_action(type or "") else "service"
            text = f"calls the {kind} {node.service.name}, {type or 'no type'}, {sent}"
            yield _at(process, "topic", text, node)
        for used in script_effects(node).topics:
            if used.direction == "call":
                text = f"its script calls the service {used.name}, {used.type or 'no type'}"
                yield _at(process, "topic", text, node, used.line)


# ---- data, calls, texts ----------------------------------------------------------------------------------------------


def _objects(process: CheckedProcess) -> Iterator[DataObject]:
    for body in process.bodies():
        yield from body.data_objects


def _parameters(process: CheckedProcess, about: CheckScope, library: Library) -> Iterator[ReadingDetail]:
    """The variables of a robot's process that `fame run --set` can set."""
    if process in about.roots and not about.missing:
        known = parameters(process.definitions, process.bpmn, library)
        given = [f"{name} = {default}" if default else name for name, default in known.items()]
        if given:
            yield _at(process, "parameter", f"can be set: {', '.join(given)}", process.bpmn)


def _data(process: CheckedProcess) -> Iterator[ReadingDetail]:
    for item in _objects(process):
        held = [f"{name} = {value.text}" if value.text else name for name, value in item.values]
        yield _at(process, "data", f"holds {', '.join(held)}" if held else "holds no variables", item)


def _calls(process: CheckedProcess, about: CheckScope) -> Iterator[ReadingDetail]:
    missing = {error.element: error.text for error in about.missing if error.file == process.file}
    for call, callee in process.calls:
        if callee is None:
            text = f"calls nothing: {missing.get(call.id, 'the process was not found')}"
        elif callee.definitions is not process.definitions:
            text = f"calls process {callee.bpmn.id} of {callee.file}"
        elif callee.bpmn.id in _drawn(process.definitions):
            text = f"calls process {callee.bpmn.id} of this file"
        else:
            text = f"calls process {callee.bpmn.id}, which is embedded in it"
        if callee is not None and call.called != callee.bpmn.id:
            text += f", the only one of {call.called}.bpmn"
        yield _at(process, "call", text, call)


def _drawn(home: Definitions) -> set[str | None]:
    """The ids of the processes in the file itself, not embedded in a call activity."""
    return {one.get("id") for one in children(parse(home.source, home.file), "process")}


def _texts(process: CheckedProcess) -> Iterator[ReadingDetail]:
    for body in process.bodies():
        for text in expressions_in(body):
            language = _LANGUAGES.get(text.expression.language)
            literal = text.expression.language == "template" and not has_placeholders(text.expression.text)
            if language is not None and text.use != "payload" and not literal:
                yield _at(process, "script", f"{text.use} in {language}{_first(text.expression)}", text.element,
                          text.expression.line)  # fmt: skip


def _first(expression: Expression) -> str:
    return f": {expression.text}" if "\n" not in expression.text and len(expression.text) <= 80 else ""


def _shown(payload: Expression | None) -> str:
    return " ".join(payload.text.split()) if payload is not None else ""


# ---- semantics=original ----------------------------------------------------------------------------------------------


def _semantics(process: CheckedProcess) -> Iterator[ReadingDetail]:
    for node in suspending(process.bpmn):
        if process.bpmn.semantics == "original":
            text = "suspends its scope, which resumes afterwards (semantics=original)"
        else:
            text = "ends its scope; with semantics=original the scope is suspended and resumes afterwards"
        yield _at(process, "semantics", text, node)


# ---- habits of other tools -------------------------------------------------------------------------------------------


Quirk = tuple[str, Element, int]
"""Text, element and line (0: that of the element)."""


def _quirks(process: CheckedProcess, types: Mapping[str, str]) -> Iterator[Quirk]:
    """The habits in one process. `types`: the types of topics by qualified name."""
    for node in process.nodes():
        for topic, throws in node.topics():
            taken = {} if throws else taken_by_prefix(process, node, topic, types.get(topic.qualified, ""))
            for name, field in taken.items():
                yield (
                    f"fills {name} with field {field} because the names are alike: no data object is connected",
                    node,
                    0,
                )
    for body in process.bodies():
        for used in expressions_in(body):
            calls, line = used.effects.calls, used.expression.line
            if calls is None:
                continue
            if used.use == "script" and not calls.next:
                yield "never calls next()", used.element, line
            if calls.node:
                yield "uses node for ros_node", used.element, line
            if used.use == "condition" and not calls.next:
                yield "returns its value, without next()", used.element, line
