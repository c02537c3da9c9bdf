"""Slips: a decimal comma, an arrow to a data object that should come from it, a sleep that holds the robot up."""

from __future__ import annotations

import re
from collections.abc import Iterator

from fame.bpmn.model import Activity, CallActivity, DataObject, Task
from fame.check.findings import Finding
from fame.check.scope import Subject, Unit
from fame.check.texts import texts_of

_COMMA = re.compile(r"[-+]?\d+,\d+")
_COMPUTED = re.compile(r"[$#]\{|^\s*=")
_BLOCKS = re.compile(r"\btime\.sleep\s*\(")


def slip_findings(subject: Subject) -> Iterator[Finding]:
    """Of the data objects and scripts of every process."""
    for unit in subject.units:
        used = {id for node in unit.process.body.walk() for id in node.data_inputs}
        for body in unit.bodies():
            objects = {item.id: item for item in body.data_objects}
            for item in body.data_objects:
                yield from _commas(unit, item)
            for node in body.nodes:
                if isinstance(node, Activity):
                    for id in node.data_outputs:
                        if id in objects and id not in used:
                            yield from _reversed(unit, node, objects[id])
                if isinstance(node, Task) and node.script is not None and _BLOCKS.search(node.script.text):
                    text = "time.sleep holds up all that the robot does: await sleep(...)"
                    yield unit.finding("warning", text, node, node.script.line)


def _commas(unit: Unit, item: DataObject) -> Iterator[Finding]:
    for name, expression in item.values:
        text = expression.text.strip()
        if _COMMA.fullmatch(text):
            right = text.replace(",", ".")
            yield unit.finding("warning", f"{name} is the text {text!r}: the number is {right}", item)


def _reversed(unit: Unit, activity: Activity, item: DataObject) -> Iterator[Finding]:
    """Constants that are set when the activity has ended that reads them, and by nothing before."""
    values = ((name, value) for name, value in item.values if value.text.strip() and value.language != "feel")
    constants = {name for name, value in values if not _COMPUTED.search(value.text)}
    late = sorted(constants & _read(unit, activity))
    if late:
        text = (
            f"sets {', '.join(late)} when {activity.label} has ended, which reads it: an arrow from it sets it before"
        )
        yield unit.finding("warning", text, item)


def _read(unit: Unit, activity: Activity) -> set[str]:
    """What an activity reads, or the process that it calls and that shares its variables."""
    if isinstance(activity, CallActivity):
        callee = next((callee for call, callee in unit.calls if call is activity), None)
        bodies = callee.bodies() if callee is not None and activity.io is None else ()
        return {name for body in bodies for text in texts_of(body) for name in text.reads}
    return {name for text in texts_of(unit.process.body) if text.element is activity for name in text.reads}
