"""Habits of other tools on which a model relies, as far as its texts and its data tell; the reader knows the others."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from fame.bpmn.model import Element
from fame.bpmn.topics import topics_of
from fame.check.findings import Finding
from fame.check.scope import Subject, Unit
from fame.check.texts import texts_of
from fame.check.topics import taken_by_prefix
from fame.scripting.javascript.identifiers import words_of

Quirk = tuple[str, Element, int]
"""What it is, where, and the line (0: that of the element)."""


def quirks_of(unit: Unit, types: Mapping[str, str]) -> Iterator[Quirk]:
    """Those of one process. `types` are those of the topics, by qualified name."""
    for node in unit.process.body.walk():
        for topic, throws in topics_of(node):
            taken = {} if throws else taken_by_prefix(unit, node, topic, types.get(topic.qualified, ""))
            for name, field in taken.items():
                yield f"fills {name} with field {field}, which it begins like: no data object is connected", node, 0
    for body in unit.bodies():
        for text in texts_of(body):
            if text.expression.language != "javascript":
                continue
            words, line = words_of(text.expression.text), text.expression.line
            if text.use == "script" and not words.next:
                yield "never calls next()", text.element, line
            if words.node:
                yield "says node for ros_node", text.element, line
            if text.use == "condition" and not words.next:
                yield "answers by its value, without next()", text.element, line


def unfinished_findings(subject: Subject) -> Iterator[Finding]:
    """Scripts in JavaScript that never say next: they fail when they are run."""
    for unit in subject.units:
        for body in unit.bodies():
            for text in texts_of(body):
                expression = text.expression
                if text.use == "script" and expression.language == "javascript" and not words_of(expression.text).next:
                    found = "never calls next(), so it fails when it has run: next() completes a script"
                    yield unit.finding("warning", found, text.element, expression.line)
