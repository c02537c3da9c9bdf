"""Properties that are drawn: text annotations ``property NAME: SENTENCE``, and deadlines.

The extension property ``deadline`` = ``PT5S`` (or ``camunda:dueDate``) of an activity, event or process says that it is
left (completed, failed or cancelled) within 5 s after it was entered, each time; suspensions do not stop the clock. It
becomes a sentence like any other: about the gateway, if an event-based gateway waits for the event; about each call of
a process.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace

from fame.bpmn.library import Library, identity
from fame.bpmn.model import (
    Artifact,
    Body,
    CallActivity,
    CompensateDefinition,
    Definitions,
    Element,
    Event,
    Gateway,
    LinkDefinition,
    Process,
)
from fame.bpmn.pools import Pool
from fame.clock import EPOCH
from fame.errors import ConfigError, ModelError
from fame.iso8601 import add, nanoseconds_between, parse_duration
from fame.properties.conditions import subjects
from fame.properties.grammar import STARTS, parse, quoted
from fame.properties.sentence import Location, Property

KEY = "deadline"
_ANNOTATION = re.compile(r"property (?P<name>[^:]+?) ?: ?(?P<sentence>.+)", re.IGNORECASE)
_MEANT = re.compile(r"propert(y|ies)\b", re.IGNORECASE)
_MILLISECOND = 1_000_000


def drawn_properties(definitions: Definitions, library: Library, cast: Mapping[str, Pool]) -> Iterator[Property]:
    """Yield the annotations and the deadlines of a mission and of what it calls.

    A deadline is named ``deadline_ID`` (of several robots ``deadline_ROBOT_ID``); an empty one, as a template leaves
    it, is ignored. Raises ConfigError for a wrong sentence and a second annotation of a name, ModelError for a deadline
    that is no duration above 0 or where nothing waits, and for a called process that is not found.
    """
    roles = {pool.name if pool.multi_instance else robot: pool for robot, pool in cast.items()}
    closures = {robot: library.closure(definitions, pool.process) for robot, pool in roles.items()}
    homes = {identity(home): home for home in (definitions, *(home for each in closures.values() for home, _ in each))}
    names: dict[str, Property] = {}
    for home in homes.values():
        for annotation in home.artifacts:
            if (made := annotated(annotation, home.file)) is not None:
                if made.name in names:
                    first = names[made.name].place
                    raise made.error(f"a second property of this name: the first one is at {first.file}:{first.line}")
                names[made.name] = made
    yield from names.values()
    taken = set(names)
    for robot, pool in roles.items():
        for home, process in closures[robot]:
            for file, element, id in _timed(home, process, library, root=process is pool.process):
                yield _deadline(robot, element, id, file, _name(robot, element, id, taken))
    for participant in definitions.participants:
        if _deadline_text(participant):
            raise _pointless(participant, "this is a pool", definitions.file)


def draws_properties(definitions: Definitions, library: Library) -> bool:
    """Return whether a mission, or what it calls, has annotations or deadlines. Raises ModelError
    as `drawn_properties`.

    A file without a pool has none of its own if it names other robots: then they are those of missions that call it.
    """
    if not definitions.participants and _names_callers(definitions):
        return False
    homes = [home for process in definitions.processes for home, _ in library.closure(definitions, process)]
    return any(
        KEY in element.properties or (isinstance(element, Artifact) and _MEANT.match(element.name.strip()))
        for home in (definitions, *homes)
        for element in home.elements()
    )


def _names_callers(definitions: Definitions) -> bool:
    """Whether the annotations of a file without pools name robots that it does not have alone."""
    own, named = {process.name or process.id for process in definitions.processes}, set[str]()
    for annotation in definitions.artifacts:
        with suppress(ConfigError):
            if (made := annotated(annotation, definitions.file)) is not None:
                words = [event.robot for event in made.occurrences]
                words += [one for value in subjects(made) for one in (value.subject, value.other) if one is not None]
                named.update(word.text for word in words)
    return len(own) != 1 or not named <= own


def annotated(annotation: Artifact, file: str) -> Property | None:
    """Return the property that a text annotation says; None for another text. Raises ConfigError for a wrong sentence.

    A text whose name has spaces, which may be prose with a colon, is a property if the rest is a sentence.
    """
    found = _ANNOTATION.fullmatch(" ".join(annotation.name.split()))
    if annotation.kind != "annotation" or found is None:
        return None
    try:
        made = parse(found["sentence"], Location(file, annotation.line), found["name"])
    except ConfigError:
        if " " in found["name"]:
            return None
        raise
    return replace(made, about=annotation.about)


def seems_property(annotation: Artifact, file: str) -> bool:
    """Return whether a text annotation begins like a property and is not read as one."""
    try:
        unread = annotated(annotation, file) is None
    except ConfigError:
        return False
    return annotation.kind == "annotation" and unread and _MEANT.match(annotation.name.strip()) is not None


# ---- deadlines -------------------------------------------------------------------------------------------------------


def _timed(home: Definitions, process: Process, library: Library, *, root: bool) -> Iterator[tuple[str, Element, str]]:
    """The elements of a process with a deadline, and the processes that it calls; each after its file.

    The id is that of the element that is entered and left; empty: the instance of the process. Raises ModelError for a
    deadline where nothing waits.
    """
    if root and _deadline_text(process):
        yield home.file, process, ""
    for body in process.body.bodies():
        for node in body.nodes:
            if isinstance(node, CallActivity) and node.called and not node.refused:
                its, called = library.find(home, node)
                if _deadline_text(called):
                    yield its.file, called, node.id
            if _deadline_text(node):
                yield from ((home.file, node, id) for id in _entered(body, node, home.file))
        for flow in body.flows:
            if _deadline_text(flow):
                raise _pointless(flow, "a token takes a flow at once", home.file)


def _deadline_text(element: Element) -> str:
    return element.properties.get(KEY, "").strip()


def _entered(body: Body, node: Element, file: str) -> list[str]:
    """The ids of the elements whose time counts for the deadline of a node: gateways that wait for it, or itself."""
    sources = [flow.source for flow in body.flows if flow.target == node.id]
    gateways = [
        one.id
        for one in body.nodes
        if isinstance(one, Gateway) and one.kind == "event" and not one.all_events and one.id in sources
    ]
    starting = {one.id for one in body.nodes if isinstance(one, Gateway) and one.instantiate}
    if isinstance(node, Event):
        catches = node.place == "catch" and not node.defined(LinkDefinition)
        handlers = node.throws and any(one.wait for one in node.defined(CompensateDefinition))
        waits = handlers or (catches and starting.isdisjoint(gateways))
    else:
        waits = not isinstance(node, Gateway) or (node.kind == "event" and not node.instantiate)
    if not waits:
        _duration(node, file)
        raise _pointless(node, "it is left in the instant in which it is entered", file)
    return [*gateways, *([node.id] if len(sources) > len(gateways) or not gateways else [])]


def _pointless(element: Element, why: str, file: str) -> ModelError:
    text = f"a deadline says nothing here, as {why}; expected it at an activity, a process, or an event that waits"
    return ModelError.at(element, text, file=file)


def _name(robot: str, element: Element, id: str, taken: set[str]) -> str:
    """A name for a deadline that no other property has."""
    names = [f"{KEY}_{element.id}", f"{KEY}_{robot}_{element.id}", f"{KEY}_{robot}_{element.id}_{id}"]
    names += [f"{names[-1]}_{number}" for number in range(2, len(taken) + 3)]
    found = next(name for name in names if name not in taken)
    taken.add(found)
    return found


def _duration(element: Element, file: str) -> int:
    """The deadline of an element in ns. Raises ModelError for one that is no duration above 0."""
    text = _deadline_text(element)
    try:
        bound = nanoseconds_between(EPOCH, add(EPOCH, parse_duration(text)))
    except (ValueError, OverflowError):
        bound = 0
    if bound < _MILLISECOND:
        raise ModelError.at(element, f"expected a duration as deadline, as in PT5S, got {text!r}", file=file)
    return bound


def _deadline(robot: str, element: Element, id: str, file: str, name: str) -> Property:
    what = f" {quoted(id)}" if id else ""
    robot = robot if re.fullmatch(r"[^\W\d]\w*", robot) and robot not in STARTS else quoted(robot)
    milliseconds = _duration(element, file) // _MILLISECOND
    sentence = f"after {robot} starts{what}, {robot} ends{what} within {milliseconds} ms"
    return parse(sentence, Location(file, element.line), name)
