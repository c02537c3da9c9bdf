"""Checks of single elements: pools, properties and data objects."""

from __future__ import annotations

import difflib
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Set
from dataclasses import replace

from fame.bpmn.extension_properties import ANY, PROCESSES, PROPERTIES
from fame.bpmn.linked_forms import form_of
from fame.bpmn.model import Activity, CallActivity, DataObject, Definitions, Element, Task
from fame.bpmn.pools import pools_of
from fame.check.expressions import expressions_in
from fame.check.literals import properties_of
from fame.check.scope import CheckedProcess, CheckScope, Finding, Fix, of_error
from fame.check.variables import sets_something
from fame.errors import ModelError
from fame.properties.diagram import seems_property
from fame.text import NAMES, is_ros_name

# ---- the reader's notes, pools ---------------------------------------------------------------------------------------


def check_reader_notes(scope: CheckScope) -> Iterator[Finding]:
    """Report the reader's notes about each file; a note that occurs several times is reported once, with its number."""
    for home in scope.files.values():
        counts = Counter(note.text for note in home.notes if note.level == "note")
        for note in home.notes:
            if note.level == "warning":
                yield Finding("warning", note.text, home.file, note.line, note.element)
            elif note.level == "note" and note.text in counts:
                more = counts.pop(note.text) - 1
                text = f"{note.text}, here and in {more} more place{'s' * (more > 1)}" if more else note.text
                yield Finding("note", text, home.file, note.line, note.element)


def check_pools(scope: CheckScope) -> Iterator[Finding]:
    """Find pools that no robot can play; a file without executable processes is a library and needs none."""
    definitions = scope.definitions
    pools = definitions.participants
    while pools or not definitions.processes or any(process.executable for process in definitions.processes):
        try:
            pools_of(replace(definitions, participants=pools))
        except ModelError as error:
            yield of_error(error)
            remaining = tuple(pool for pool in pools if pool.id != error.element)
            if len(remaining) < len(pools):
                pools = remaining
                continue
        return


def check_library(scope: CheckScope) -> Iterator[Finding]:
    """Say which called processes are FAME's own, and which are not the only ones: perhaps others were meant."""
    yield from scope.doubtful
    if scope.supplied:
        names = ", ".join(sorted(scope.supplied))
        yield Finding("note", f"FAME's own library supplies {names}", scope.definitions.file)


def check_annotations(scope: CheckScope) -> Iterator[Finding]:
    """Find text annotations that seem to be properties and are not read as such."""
    for home in scope.files.values():
        for artifact in home.artifacts:
            if seems_property(artifact, home.file):
                text = "is not read as a property, and not judged: expected property NAME: SENTENCE"
                yield Finding("warning", text, home.file, artifact.line, artifact.id)


def check_forms(scope: CheckScope) -> Iterator[Finding]:
    """Find linked forms that are missing or cannot be read."""
    for process in scope.processes:
        for node in process.nodes():
            form = form_of(process.definitions, node.human) if isinstance(node, Task) and node.human.linked else ()
            if [field.kind for field in form] == ["other"]:
                text = f"any answer is accepted: {form[0].label[0].lower()}{form[0].label[1:].rstrip('.')}"
                yield process.finding("warning", text, node)


# ---- names of properties and pools -----------------------------------------------------------------------------------


def check_names(scope: CheckScope) -> Iterator[Finding]:
    """Check the names of pools and of properties."""
    yield from _namespaces(scope.definitions)
    for process in scope.processes:
        yield from _misspelt(process, process.bpmn, {*PROPERTIES[ANY], *PROPERTIES[PROCESSES]})
        for node in process.nodes():
            yield from _misspelt(process, node, set(properties_of(node)))


def _misspelt(process: CheckedProcess, element: Element, known: Set[str]) -> Iterator[Finding]:
    """Properties that have a meaning at other elements only, and names similar to known ones."""
    for name, value in element.properties.items():
        places = [place for place, names in PROPERTIES.items() if name in names]
        if places and name not in known:
            text = f"its property {name!r} has no effect here: it is for {' and '.join(places).lower()}"
            yield process.finding("warning", text, element)
            continue
        swapped = [each for each in known if sorted(each) == sorted(name.lower())]  # tpye
        similar = swapped or difflib.get_close_matches(name.lower(), known, 1, 0.8)
        if similar and name not in known:
            text = f"its property {name!r} has no effect: did you mean {similar[0]!r}?"
            fix = Fix(f"rename it to {similar[0]}", element.id, "property", value, similar[0], name)
            yield process.finding("warning", text, element, fix=fix)


def _namespaces(definitions: Definitions) -> Iterator[Finding]:
    """Pools whose name is not a valid namespace; simulations accept any name."""
    try:
        pools = pools_of(definitions) if definitions.participants else []
    except ModelError:  # reported as an error
        return
    for pool in pools:
        if not is_ros_name(f"/{pool.name}"):
            text = f"/{pool.name} is not a valid ROS 2 namespace: expected {NAMES}"
            element = next(one for one in definitions.participants if one.label == pool.name)
            yield Finding("warning", text, definitions.file, element.line, element.id)


# ---- data objects ----------------------------------------------------------------------------------------------------


_COMMA = re.compile(r"[-+]?\d+,\d+")
_COMPUTED = re.compile(r"[$#]\{|^\s*=")


def check_data_objects(scope: CheckScope) -> Iterator[Finding]:
    """Check the values of data objects and their associations."""
    for process in scope.processes:
        yield from _idle_data(process)
        used = {id for node in process.nodes() for id in node.data_inputs}
        for body in process.bodies():
            objects = {item.id: item for item in body.data_objects}
            for item in body.data_objects:
                yield from _commas(process, item)
            for node in body.nodes:
                if isinstance(node, Activity):
                    yield from _overwritten(process, node, objects)
                    for id in node.data_outputs:
                        if id in objects and id not in used:
                            yield from _reversed(process, node, objects[id])


def _commas(process: CheckedProcess, item: DataObject) -> Iterator[Finding]:
    for name, expression in item.values:
        text = expression.text.strip()
        if _COMMA.fullmatch(text):
            right = text.replace(",", ".")
            yield process.finding("warning", f"{name}: expected the number {right}, got the text {text!r}", item)


def _overwritten(process: CheckedProcess, task: Activity, objects: Mapping[str, DataObject]) -> Iterator[Finding]:
    """Answers of a form that a constant of a data object replaces as soon as they are given."""
    fields = {field.key for field in task.human.form} if isinstance(task, Task) else set()
    for item in (objects[id] for id in task.data_outputs if fields and id in objects):
        for name, value in item.values:
            if name in fields and value.text.strip() and not _COMPUTED.search(value.text):
                text = f"its value {value.text.strip()} of {name} replaces the answer of {task.display_name}"
                text += ": leave it empty"
                yield process.finding("warning", text, item)


def _reversed(process: CheckedProcess, activity: Activity, item: DataObject) -> Iterator[Finding]:
    """Constants that are set only after the activity that reads them."""
    values = ((name, value) for name, value in item.values if value.text.strip() and value.language != "feel")
    constants = {name for name, value in values if not _COMPUTED.search(value.text)}
    late = sorted(constants & _read(process, activity))
    if late:
        activity_name, names = activity.display_name, ", ".join(late)
        text = f"sets {names} after {activity_name} has ended, but {activity_name} reads it"
        text += f": draw the arrow from the data object to {activity_name}"
        yield process.finding("warning", text, item)


def _read(process: CheckedProcess, activity: Activity) -> set[str]:
    """The variables that an activity reads, or the process that it calls without a mapping."""
    if isinstance(activity, CallActivity):
        callee = process.called_by(activity)
        bodies = callee.bodies() if callee is not None and activity.io is None else ()
        return {name for body in bodies for text in expressions_in(body) for name in text.reads}
    return {name for text in expressions_in(process.bpmn.body) if text.element is activity for name in text.reads}


# ---- data objects without effect -------------------------------------------------------------------------------------


def _idle_data(process: CheckedProcess) -> Iterator[Finding]:
    used = {id for node in process.nodes() for id in (*node.data_inputs, *node.data_outputs)}
    for body in process.bodies():
        for item in body.data_objects:
            values = [name for name, expression in item.values if sets_something(name, expression)]
            if values and item.id not in used:
                text = f"is connected to no element, so nothing ever sets {', '.join(values)}"
                yield process.finding("warning", text, item)
