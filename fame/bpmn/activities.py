"""Tasks and call activities, and the loops around activities."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from fame.bpmn.context import Context, boolean, find, whole
from fame.bpmn.data import Moves
from fame.bpmn.dialects import extensions_of
from fame.bpmn.dialects.extensions import Extensions, TopicProperties, topic_properties
from fame.bpmn.events import Source, Surroundings, read_topic
from fame.bpmn.expressions import body, mapped, variable
from fame.bpmn.model import (
    Assignment,
    CallActivity,
    Expression,
    IoMapping,
    MultiInstance,
    StandardLoop,
    Task,
    TaskKind,
    Topic,
)
from fame.bpmn.xml import BPMN, Node, Parts, child, line_of, local, text_of

TASKS: Mapping[str, TaskKind] = {
    "task": "plain",
    "userTask": "user",
    "manualTask": "manual",
    "scriptTask": "script",
    "serviceTask": "service",
    "sendTask": "send",
    "receiveTask": "receive",
    "businessRuleTask": "business_rule",
}
_NO_RULES = "business rules are not executed: decide with a gateway or a script task"


def read_activity(context: Context, element: Node, parts: Parts, found: Extensions, moves: Moves) -> dict[str, Any]:
    """What all activities have in common, as arguments of their dataclasses."""
    io = found.mapping()
    if moves.assigned_in or moves.assigned_out:
        io = io or IoMapping()
        io = IoMapping(io.inputs + moves.assigned_in, io.outputs + moves.assigned_out, io.all_in, io.all_out)
    return {
        "default": element.get("default", ""),
        "io": io,
        "loop": read_loop(context, element, parts, found),
        "for_compensation": boolean(context, element, "isForCompensation"),
        "refused": found.refused,
    }


def read_task(
    context: Context,
    around: Surroundings,
    element: Node,
    parts: Parts,
    found: Extensions,
    moves: Moves,
    common: dict[str, Any],
    kind: TaskKind,
) -> Task:
    """A task of any kind. `common` is what flow nodes have in common."""
    if kind == "business_rule" and not found.operation and not found.script:
        found.refused = found.refused or _NO_RULES
    topic, operation = None, found.operation
    if kind in ("send", "receive"):
        topic = _message_topic(context, around, element, found, kind, common["id"])
    elif kind in ("service", "business_rule"):
        topic = _service(context, element, found)
        operation = (topic.name if topic is not None else "") or operation or _operation(context, element)
    return Task(
        kind=kind,
        script=_script(context, element, parts) or found.script,
        topic=topic,
        payload=topic.payload if topic is not None else None,
        operation=operation,
        result_variable=found.result,
        instantiate=boolean(context, element, "instantiate"),
        properties=found.rest(),
        **common,
        **read_activity(context, element, parts, found, moves),
    )


def _script(context: Context, element: Node, parts: Parts) -> Expression | None:
    holders = parts.get("script")
    return body(context, holders[0], element.get("scriptFormat")) if holders else None


def _message_topic(
    context: Context, around: Surroundings, element: Node, found: Extensions, kind: TaskKind, id: str
) -> Topic | None:
    """Of a send or receive task that says anything of a message."""
    say = topic_properties(context, element, found)
    if not element.get("messageRef") and not (say.type or say.payload):
        return None
    takes: tuple[Assignment, ...] = ()
    if kind == "receive":
        takes, found.outputs = tuple(found.outputs), []
    source = Source(around, element, id, "throw" if kind == "send" else "catch", found, takes)
    return read_topic(context, source, element, "message", say)


def _service(context: Context, element: Node, found: Extensions) -> Topic | None:
    """The ROS service that a service task calls: by the elements of FaMe's web modeler, or property ``service``."""
    named = found.take("service")
    if named is None and not found.service:
        return None
    say: TopicProperties = topic_properties(context, element, found, "srv")
    name = named.value.strip() if named is not None else found.operation
    return Topic(name=name, type=say.type, payload=say.payload, private=say.private, qos=say.qos)


def _operation(context: Context, element: Node) -> str:
    """By the standard: the name of the operation referred to, or what `implementation` names."""
    reference = element.get("operationRef")
    for interface in context.roots.values():
        if reference and interface.tag == f"{{{BPMN}}}interface":
            operations = {one.get("id", ""): one for one in interface.iterchildren(f"{{{BPMN}}}operation")}
            operation = find(operations, reference)
            if operation is not None:
                return operation.get("name", "").strip() or operation.get("id", "")
    implementation = element.get("implementation", "").strip()
    return "" if implementation.startswith("##") else implementation


def read_call(
    context: Context, element: Node, parts: Parts, found: Extensions, moves: Moves, common: dict[str, Any]
) -> CallActivity:
    """A call activity: what it calls stays a name, or an expression that gives one."""
    called = found.called or element.get("calledElement", "").strip()
    seen = mapped(called, line_of(element)) if called else None
    computed = seen is not None and seen.language in ("juel", "feel", "template")
    if not computed and ":" in called and not re.search(r"[/\\]", called):
        prefix, _, name = called.partition(":")
        called = name if prefix in element.nsmap else called
    return CallActivity(
        called="" if computed else called,
        called_expression=seen if computed else None,
        properties=found.rest(),
        **common,
        **read_activity(context, element, parts, found, moves),
    )


# ---- loops -----------------------------------------------------------------------------------------------------------


def read_loop(context: Context, element: Node, parts: Parts, found: Extensions) -> MultiInstance | StandardLoop | None:
    """The loop characteristics of an activity."""
    if "multiInstanceLoopCharacteristics" in parts:
        return _multi_instance(context, parts["multiInstanceLoopCharacteristics"][0], parts)
    if "standardLoopCharacteristics" not in parts:
        return None
    loop = parts["standardLoopCharacteristics"][0]
    maximum = loop.get("loopMaximum")
    return StandardLoop(
        condition=_inner(context, loop, "loopCondition"),
        test_before=boolean(context, loop, "testBefore"),
        maximum=whole(context, loop, "loopMaximum", maximum, 1) if maximum else 0,
        line=line_of(loop),
    )


def _multi_instance(context: Context, loop: Node, parts: Parts) -> MultiInstance:
    said = extensions_of(context, loop)
    collection = variable(context, loop, said.collection) if said.collection.strip() else None
    if collection is None:
        reference = child(loop, "loopDataInputRef")
        name = _variable_of(loop, text_of(reference)) if reference is not None else ""
        collection = variable(context, loop, name) if name else None
    output = child(loop, "loopDataOutputRef")
    output_collection = said.output_collection.strip()
    if output is not None and not output_collection:
        output_collection = _variable_of(loop, text_of(output))
    element = said.output_element.strip() or _item_name(loop, "outputDataItem")
    if loop.get("behavior", "All") != "All":
        text = f"behavior={loop.get('behavior')!r} has no effect: no event is thrown per instance"
        context.note(loop, text, "warning")
    cardinality = _inner(context, loop, "loopCardinality")
    if cardinality is None and collection is None:
        raise context.error(loop, "the multi-instance activity has neither a collection nor a cardinality")
    return MultiInstance(
        sequential=boolean(context, loop, "isSequential"),
        cardinality=cardinality,
        collection=collection,
        element_variable=said.element_variable.strip() or _item_name(loop, "inputDataItem"),
        completion=_inner(context, loop, "completionCondition"),
        output_collection=output_collection,
        output_element=variable(context, loop, element) if element else None,
        line=line_of(loop),
    )


def _item_name(loop: Node, name: str) -> str:
    item = child(loop, name)
    return item.get("name", "").strip() if item is not None else ""


def _inner(context: Context, element: Node, name: str) -> Expression | None:
    holder = child(element, name)
    return body(context, holder) if holder is not None else None


def _variable_of(loop: Node, reference: str) -> str:
    """The variable that a reference to data means: that of a data object with just one, else its name.

    A data input or output of the activity is followed to the data object that fills it.
    """
    reference = reference.strip()
    root = loop.getroottree().getroot()
    activity = loop.getparent()
    for association in activity if activity is not None else ():
        ends = [text_of(one).strip() for one in association if local(one) in ("sourceRef", "targetRef")]
        if reference in ends and len(ends) == 2:
            reference = ends[1 - ends.index(reference)]
            break
    for one in root.iter():
        if one.get("id") == reference:
            names = [inner.get("name", "") for inner in one.iter() if inner.tag.endswith(("}property", "}parameter"))]
            return names[0] if len(names) == 1 else one.get("name", "").strip() or reference
    return reference
