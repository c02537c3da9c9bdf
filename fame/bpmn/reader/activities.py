"""Reads tasks and call activities, and the loop characteristics of activities."""

from __future__ import annotations

from typing import Any, Literal

from fame.bpmn.model import (
    NOBODY,
    Assignment,
    CallActivity,
    Expression,
    Human,
    IoMapping,
    MultiInstance,
    StandardLoop,
    Task,
    TaskKind,
    Topic,
)
from fame.bpmn.reader.context import Context, boolean_attribute, whole_number
from fame.bpmn.reader.dialects import read_extensions
from fame.bpmn.reader.dialects.extensions import Property, take_topic_properties
from fame.bpmn.reader.dialects.forms import form_js
from fame.bpmn.reader.events import TopicSource, message_keys, note_keys, read_topic
from fame.bpmn.reader.expressions import code_of, condition_of, mapping_source, variable_name, variable_or_expression
from fame.bpmn.reader.flow_nodes import NodeReader
from fame.bpmn.reader.xml import Node, child, children, line_of, local_id, local_name, resolve, text_of

_NO_RULES = "business rules are not executed: decide with a gateway or a script task"


def read_activity(node: NodeReader) -> dict[str, Any]:
    """Read the common parts of activities, as arguments for their dataclasses."""
    for name in ("startQuantity", "completionQuantity"):
        if node.get(name).strip() not in ("", "1"):
            text = f"{name}={node.get(name)!r} has no effect: each token starts it once and leaves as one token"
            node.context.note(node.element, text, "warning")
    io, moves = node.extensions.mapping(), node.associations
    if moves.assigned_in or moves.assigned_out:
        io = io or IoMapping()
        io = IoMapping(io.inputs + moves.assigned_in, io.outputs + moves.assigned_out, io.all_in, io.all_out)
    return {
        **node.common,
        "default": node.get("default"),
        "io": io,
        "loop": _loop(node),
        "for_compensation": node.flag("isForCompensation"),
        "refused": node.extensions.refused,
        "properties": node.extensions.remaining(),
    }


def read_task(node: NodeReader, kind: TaskKind) -> Task:
    extensions = node.extensions
    if kind == "business_rule" and not extensions.operation and not extensions.script:
        extensions.refused = extensions.refused or _NO_RULES
    topic, operation = None, extensions.operation
    keys: tuple[tuple[str, Expression], ...] = ()
    if kind == "send" or kind == "receive":
        topic, keys = _message(node, kind)
    elif kind == "service" or kind == "business_rule":
        topic = _service(node)
        operation = (topic.name if topic is not None else "") or operation or _operation(node)
    return Task(
        kind=kind,
        script=_script(node) or extensions.script,
        topic=topic,
        operation=operation,
        keys=keys,
        result_variable=extensions.result,
        instantiate=node.flag("instantiate"),
        human=_human(node) if kind in ("user", "manual") else NOBODY,
        **read_activity(node),
    )


def _human(node: NodeReader) -> Human:
    """Who may complete a task, and its form: its own, or one in the file that it is linked to."""
    extensions = node.extensions
    form, linked = extensions.form, extensions.linked.removeprefix("camunda-forms:bpmn:")
    holder = node.context.find_in_file(node.element, linked) if linked and not form else None
    if holder is not None and local_name(holder) == "userTaskForm":
        linked = ""
        try:
            form = form_js(text_of(holder))
        except ValueError as error:
            node.context.note(holder, f"the form cannot be read: {error}", "warning")
    return Human(
        users=tuple(extensions.users), groups=tuple(extensions.groups), form=form, linked=linked if not form else ""
    )


def _script(node: NodeReader) -> Expression | None:
    holders = node.parts.get("script")
    return code_of(node.context, holders[0], node.get("scriptFormat")) if holders else None


def _message(
    node: NodeReader, kind: Literal["send", "receive"]
) -> tuple[Topic | None, tuple[tuple[str, Expression], ...]]:
    """The topic of a send or receive task, None if it has neither a message nor topic properties; correlation keys."""
    topic_properties = take_topic_properties(node.context, node.element, node.extensions)
    if not node.get("messageRef") and not (topic_properties.type or topic_properties.payload):
        return None, ()
    if kind == "send":
        note_keys(node.context, node.element, topic_properties.keys)
        return read_topic(TopicSource(node, "throw"), node.element, "message", topic_properties), ()
    takes, node.extensions.outputs = tuple(node.extensions.outputs), []
    if node.extensions.inputs:  # it has its own scope: copy the received values out of it
        leaving = (Assignment(one.target, Expression(one.target, "python", one.source.line)) for one in takes)
        node.extensions.outputs = list(leaving)
    topic = read_topic(TopicSource(node, "catch", takes), node.element, "message", topic_properties)
    return topic, message_keys(node, node.get("messageRef")) + topic_properties.keys


def _service(node: NodeReader) -> Topic | None:
    """The ROS service or action of a service task, from properties or from elements of the web modeler."""
    service, action = node.extensions.take("service"), node.extensions.take("action")
    if service is not None and action is not None:
        node.fault("has both properties service and action: expected one of them")
    called = service or action
    if called is None and not node.extensions.service:
        return None
    topic_properties = take_topic_properties(
        node.context, node.element, node.extensions, "srv" if action is None else "action"
    )
    name = called.value.strip() if called is not None else node.extensions.operation
    return Topic(
        name=name,
        type=topic_properties.type,
        payload=topic_properties.payload,
        private=topic_properties.private,
        qos=topic_properties.qos,
    )


def _operation(node: NodeReader) -> str:
    """The operation of a service task as in the standard: by `operationRef` or `implementation`."""
    for interface in node.context.roots.values() if node.get("operationRef") else ():
        operations = {one.get("id", ""): one for one in children(interface, "operation")}
        operation = resolve(operations, node.get("operationRef"))
        if operation is not None:
            return operation.get("name", "").strip() or operation.get("id", "")
    implementation = node.get("implementation").strip()
    return "" if implementation.startswith("##") else implementation


def read_call(node: NodeReader) -> CallActivity:
    """Read a call activity. The called element is a name, or an expression that gives one."""
    called = node.extensions.called or local_id(node.element, "calledElement")
    root = node.context.root(called)
    if root is not None and local_name(root).startswith("global"):
        node.extensions.refused = f"it calls the <{local_name(root)}> {called}: make it a process with that task in it"
    expression = mapping_source(called, line_of(node.element)) if called else None
    computed = expression is not None and expression.language in ("juel", "feel", "template")
    return CallActivity(
        called="" if computed else called,
        called_expression=expression if computed else None,
        **read_activity(node),
    )


# ---- loops -----------------------------------------------------------------------------------------------------------


def _loop(node: NodeReader) -> MultiInstance | StandardLoop | None:
    if "multiInstanceLoopCharacteristics" in node.parts:
        return _multi_instance(node, node.parts["multiInstanceLoopCharacteristics"][0])
    if "standardLoopCharacteristics" not in node.parts:
        return None
    loop = node.parts["standardLoopCharacteristics"][0]
    maximum = loop.get("loopMaximum")
    return StandardLoop(
        condition=_child_expression(node.context, loop, "loopCondition"),
        test_before=boolean_attribute(node.context, loop, "testBefore"),
        maximum=whole_number(node.context, loop, "loopMaximum", maximum, 1) if maximum else 0,
        line=line_of(loop),
    )


def _multi_instance(node: NodeReader, loop: Node) -> MultiInstance:
    """Read a multi-instance loop. The activity may have its output properties, as Camunda Modeler writes them."""
    context, extensions = node.context, read_extensions(node.context, loop)
    collection_property, element_property = (
        extensions.take(name) or node.extensions.take(name) for name in ("outputCollection", "outputElement")
    )
    collection = variable_or_expression(context, loop, extensions.collection) if extensions.collection.strip() else None
    if collection is None:
        reference = child(loop, "loopDataInputRef")
        name = _referenced_variable(context, loop, text_of(reference)) if reference is not None else ""
        collection = variable_or_expression(context, loop, name) if name else None
    output = child(loop, "loopDataOutputRef")
    output_collection = _text(collection_property, extensions.output_collection)
    if output is not None and not output_collection:
        output_collection = _referenced_variable(context, loop, text_of(output))
    element = _text(element_property, extensions.output_element) or _item_variable(loop, "outputDataItem")
    if loop.get("behavior", "All") != "All":
        text = f"behavior={loop.get('behavior')!r} has no effect: no event is thrown per instance"
        context.note(loop, text, "warning")
    return MultiInstance(
        sequential=boolean_attribute(context, loop, "isSequential"),
        cardinality=_child_expression(context, loop, "loopCardinality"),
        collection=collection,
        element_variable=extensions.element_variable.strip() or _item_variable(loop, "inputDataItem"),
        completion=_child_expression(context, loop, "completionCondition"),
        output_collection=output_collection,
        output_element=variable_or_expression(context, loop, element) if element else None,
        line=line_of(loop),
    )


def _text(given: Property | None, otherwise: str) -> str:
    return (given.value if given is not None else otherwise).strip()


def _item_variable(loop: Node, name: str) -> str:
    item = child(loop, name)
    return variable_name(item) if item is not None else ""


def _child_expression(context: Context, element: Node, name: str) -> Expression | None:
    holder = child(element, name)
    read = code_of if name == "loopCardinality" else condition_of
    return read(context, holder) if holder is not None else None


def _referenced_variable(context: Context, loop: Node, reference: str) -> str:
    """The variable that a data reference stands for: the only one of the data object, else the name of the object.

    Data inputs and outputs of the activity are followed to the associated data object.
    """
    reference = reference.strip()
    activity = loop.getparent()
    for association in activity if activity is not None else ():
        ends = [text_of(one).strip() for one in association if local_name(one) in ("sourceRef", "targetRef")]
        if reference in ends and len(ends) == 2:
            reference = ends[1 - ends.index(reference)]
            break
    data = context.find_in_file(loop, reference)
    if data is None:
        return reference
    names = [inner.get("name", "") for inner in data.iter() if inner.tag.endswith(("}property", "}parameter"))]
    return names[0] if len(names) == 1 else variable_name(data)
