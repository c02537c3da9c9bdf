"""Properties that are drawn: text annotations ``property NAME: SENTENCE``, and deadlines.

The extension property ``deadline`` = ``PT5S`` (or ``camunda:dueDate``) of an activity, event or process says that it is
left (completed, failed or cancelled) within 5 s after it was entered, each time; suspensions do not stop the clock. It
becomes a sentence like any other.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions, Element, Process
from fame.bpmn.pools import Pool
from fame.clock import EPOCH
from fame.errors import ModelError
from fame.iso8601 import add, nanoseconds_between, parse_duration
from fame.properties.grammar import parse
from fame.properties.sentence import Location, Property

KEY = "deadline"
_ANNOTATION = re.compile(r"property (?P<name>\w+): (?P<sentence>.+)")
_MILLISECOND = 1_000_000


def drawn_properties(definitions: Definitions, library: Library, cast: Mapping[str, Pool]) -> Iterator[Property]:
    """The annotations of a mission, and the deadlines in it and in what it calls.

    A deadline is named ``deadline_ID`` (of several robots ``deadline_ROBOT_ID``); an empty one, as a template leaves
    it, is ignored. Raises ConfigError for a wrong sentence, ModelError for a deadline that is no duration above 0, and
    for a called process that is not found.
    """
    for one in definitions.artifacts:
        found = _ANNOTATION.fullmatch(" ".join(one.name.split())) if one.kind == "annotation" else None
        if found is not None:
            made = parse(found["sentence"], Location(definitions.file, one.line), found["name"])
            yield replace(made, about=one.about)
    roles = {pool.name if pool.multi_instance else robot: pool for robot, pool in cast.items()}
    seen: set[str] = set()
    for robot, pool in roles.items():
        for home, process in library.closure(definitions, pool.process):
            for element in (process, *process.body.walk()):
                if not element.properties.get(KEY, "").strip() or (
                    isinstance(element, Process) and process is not pool.process
                ):
                    continue
                name = f"deadline_{element.id}" if element.id not in seen else f"deadline_{robot}_{element.id}"
                seen.add(element.id)
                yield _deadline(robot, element, home.file, name)


def _deadline(robot: str, element: Element, file: str, name: str) -> Property:
    text = element.properties[KEY].strip()
    try:
        bound = nanoseconds_between(EPOCH, add(EPOCH, parse_duration(text)))
    except (ValueError, OverflowError):
        bound = 0
    if bound < _MILLISECOND:
        raise ModelError.at(element, f"expected a duration as deadline, as in PT5S, got {text!r}", file=file)
    what = "" if isinstance(element, Process) else f' "{element.id}"'
    sentence = f"after {robot} starts{what}, {robot} ends{what} within {bound // _MILLISECOND} ms"
    return parse(sentence, Location(file, element.line), name)
