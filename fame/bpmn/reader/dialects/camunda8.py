"""Camunda 8 (``http://camunda.org/schema/zeebe/1.0``): properties, mappings, jobs."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Set

from fame.bpmn.model import Assignment, Expression
from fame.bpmn.reader.context import Context
from fame.bpmn.reader.dialects.camunda7 import PEOPLE, add_people
from fame.bpmn.reader.dialects.extensions import PATH, WORD, Extensions, Property
from fame.bpmn.reader.expressions import mapping_source
from fame.bpmn.reader.xml import Node, line_of, local_name

_KEY = re.compile(rf"=\s*({PATH})|[$#]{{\s*({PATH})\s*}}")
_CONSTANT = re.compile(r"-?\d+(\.\d+)?|true|false|null")
IGNORED: Set[str] = {
    "userTask", "taskSchedule", "priorityDefinition",
    "executionListeners", "taskListeners", "linkedResources",
}  # fmt: skip
"""Elements without effect in FAME; each gets a note."""


def element(context: Context, node: Node, extensions: Extensions) -> None:
    name = local_name(node)
    read = _ELEMENTS.get(name)
    if read is not None:
        read(context, node, extensions)
    elif name in IGNORED:
        context.note(node, f"zeebe:{name} has no effect")


def attribute(context: Context, node: Node, name: str, value: str, extensions: Extensions) -> None:
    """Ignore an attribute: those of Camunda 8 (``modelerTemplate`` ...) have no effect in FAME."""


def _properties(context: Context, node: Node, extensions: Extensions) -> None:
    for child in node:
        if child.get("name", "").strip():
            extensions.put(context, child, child.get("name", "").strip(), child.get("value", ""))


def _headers(context: Context, node: Node, extensions: Extensions) -> None:
    for child in node:
        if child.get("key", "").strip():
            text = Property(child.get("value", ""), line_of(child))
            extensions.properties.setdefault(child.get("key", "").strip(), text)


def _io_mapping(context: Context, node: Node, extensions: Extensions) -> None:
    for child in node:
        source, target = child.get("source", ""), child.get("target", "").strip()
        if not target:
            context.fault(child, f"a zeebe:{local_name(child)} has no target: give the variable that it sets")
            continue
        inwards, expression = local_name(child) == "input", mapping_source(source, line_of(child))
        _assign(extensions.inputs if inwards else extensions.outputs, target, expression, inwards)


def _assign(into: list[Assignment], target: str, source: Expression, inwards: bool) -> None:
    """Add an assignment. The target ``order.id`` is a field of a new variable (inwards), or of its current value."""
    name, *path = target.split(".")
    known = {one.target for one in into}
    read = known & set(WORD.findall(source.text)) if source.language == "feel" else set()
    in_order = bool(read)
    if path:
        joins = bool(into) and into[-1].target == name and into[-1].source.language == "feel" and name not in read
        before = _inside(into[-1].source) if joins else name if name in known or not inwards else "null"
        in_order = into.pop().in_order or in_order if joins else in_order or name in known
        source = Expression(f"context put({before}, {json.dumps(path)}, {_inside(source)})", "feel", source.line)
    into.append(Assignment(name, source, in_order))


def _inside(source: Expression) -> str:
    """A source as a part of an expression in FEEL: also one that ends with a comment, and a constant."""
    if source.language != "feel":
        return source.text if _CONSTANT.fullmatch(source.text) else json.dumps(source.text, ensure_ascii=False)
    return f"({source.text}\n)" if "//" in source.text else f"({source.text})"


def _task(context: Context, node: Node, extensions: Extensions) -> None:
    extensions.operation = node.get("type", "").strip()
    if extensions.operation.startswith("io.camunda"):
        extensions.refused = f"it runs the connector {extensions.operation}; name a registered operation"


def _called(context: Context, node: Node, extensions: Extensions) -> None:
    extensions.called, extensions.own_scope = node.get("processId", "").strip(), True
    extensions.all_in = node.get("propagateAllParentVariables", "true") != "false"
    extensions.all_out = node.get("propagateAllChildVariables", "true") != "false"


def _decision(context: Context, node: Node, extensions: Extensions) -> None:
    decision = node.get("decisionId", "")
    extensions.refused = f"it asks the DMN decision {decision}; decide with a gateway or a script task"


def _loop(context: Context, node: Node, extensions: Extensions) -> None:
    extensions.collection, extensions.element_variable = node.get("inputCollection", ""), node.get("inputElement", "")
    extensions.output_collection = node.get("outputCollection", "")
    extensions.output_element = node.get("outputElement", "")


def _ad_hoc(context: Context, node: Node, extensions: Extensions) -> None:
    extensions.active = node.get("activeElementsCollection", "")
    for name in ("outputCollection", "outputElement"):
        if node.get(name):
            context.note(node, f"{name} of zeebe:adHoc has no effect", "warning")


def _script(context: Context, node: Node, extensions: Extensions) -> None:
    extensions.script = Expression(node.get("expression", "").strip().removeprefix("=").strip(), "feel", line_of(node))
    extensions.result = node.get("resultVariable", "").strip()


def _subscription(context: Context, node: Node, extensions: Extensions) -> None:
    key = node.get("correlationKey", "").strip()
    match = _KEY.fullmatch(key)
    if match is not None and (match[1] or match[2]) not in ("true", "false", "null"):
        extensions.key = Expression(match[1] or match[2], "feel", line_of(node))
    elif key:
        right = "a variable of the process or a field of one, as =order_id; set a variable to what is computed"
        extensions.refused = f"the correlationKey of its message is {key!r}: expected {right}"


def _form(context: Context, node: Node, extensions: Extensions) -> None:
    extensions.linked = (node.get("formKey") or node.get("formId") or node.get("externalReference") or "").strip()


def _assignment(context: Context, node: Node, extensions: Extensions) -> None:
    for name in PEOPLE:
        add_people(context, node, extensions, name, node.get(name, ""))


def _embedded_form(context: Context, node: Node, extensions: Extensions) -> None:
    """Nothing: the task that is linked to a form reads it."""


_ELEMENTS: Mapping[str, Callable[[Context, Node, Extensions], None]] = {
    "properties": _properties,
    "taskHeaders": _headers,
    "ioMapping": _io_mapping,
    "taskDefinition": _task,
    "formDefinition": _form,
    "userTaskForm": _embedded_form,
    "assignmentDefinition": _assignment,
    "calledElement": _called,
    "calledDecision": _decision,
    "loopCharacteristics": _loop,
    "adHoc": _ad_hoc,
    "script": _script,
    "subscription": _subscription,
}
