"""Names that are nearly right: properties that mean something if spelt otherwise, pools that no ROS robot can be."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator

from fame.bpmn.model import Definitions, Element, SubProcess
from fame.bpmn.pools import pools_of
from fame.bpmn.topics import topics_of
from fame.check.findings import Finding
from fame.check.scope import Subject, Unit
from fame.errors import ModelError

_ROS_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_OF_TOPICS = ("type", "payload", "queue", "scope")
_OF_PROCESSES = ("instances", "optional", "semantics", "topics")


def name_findings(subject: Subject) -> Iterator[Finding]:
    """Of the pools, processes, events and tasks."""
    yield from _pools(subject.definitions)
    for unit in subject.units:
        yield from _misspelt(unit, unit.process, _OF_PROCESSES)
        for node in unit.process.body.walk():
            if isinstance(node, SubProcess) and node.triggered_by_event:
                yield from _misspelt(unit, node, ("resume",))
            elif any(True for _ in topics_of(node)):
                yield from _misspelt(unit, node, _OF_TOPICS)


def _misspelt(unit: Unit, element: Element, known: tuple[str, ...]) -> Iterator[Finding]:
    """Properties that nobody reads, and that differ in a letter or two from those that are read."""
    for name in element.properties:
        similar = difflib.get_close_matches(name.lower(), known, 1, 0.8)
        if similar and name not in known:
            text = f"its property {name!r} has no effect: did you mean {similar[0]!r}?"
            yield unit.finding("warning", text, element)


def _pools(definitions: Definitions) -> Iterator[Finding]:
    """Pools whose name cannot be a namespace. In simulation any name will do."""
    try:
        pools = pools_of(definitions) if definitions.participants else []
    except ModelError:  # which is told as an error
        return
    for pool in pools:
        if not _ROS_NAME.fullmatch(pool.name):
            right = "letters, digits and _ would be right, not beginning with a digit"
            text = f"ROS 2 refuses the namespace /{pool.name}: {right}"
            element = next(one for one in definitions.participants if one.label == pool.name)
            yield Finding("warning", text, definitions.file, element.line, element.id)
