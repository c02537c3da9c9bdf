"""The original FaMe: its oldest models (G0) and its web modeler (G2)."""

from __future__ import annotations

from fame.bpmn.reader.context import Context, is_message_type
from fame.bpmn.reader.dialects.extensions import QOS_CHOICES, QOS_DURATIONS, Extensions, Property, qos_policy
from fame.bpmn.reader.expressions import flow_mapping
from fame.bpmn.reader.xml import CAMUNDA, Node, line_of, local_name, text_of

LIST, _VALUE = f"{{{CAMUNDA}}}list", f"{{{CAMUNDA}}}value"


def is_message_list(node: Node) -> bool:
    """Return whether an element is a list of message type and payload, the form of the oldest models."""
    first = node.find(_VALUE) if node.tag == LIST else None
    return first is not None and is_message_type(text_of(first))


def apply_message_list(context: Context, node: Node, extensions: Extensions) -> None:
    """Read a parameter with such a list, named like the topic, as topic, type and payload of a signal event."""
    for name, items in extensions.lists.items():
        if items and len(items) <= 2 and is_message_type(items[0].value):
            extensions.topic, extensions.type = name, items[0].value
            if len(items) == 2:
                extensions.payload = items[1]
            context.quirk(node, f"topic, type and payload are those of the input parameter {name!r}")
            extensions.inputs = [one for one in extensions.inputs if one.target != name]
            return


ROS, DATA, QOS, CALL = "http://ros", "http://data", "http://qos", "http://callActivity"
NAMESPACES: tuple[str, ...] = (ROS, DATA, QOS, CALL)

_POLICIES = {name.replace("_", "") for name in (*QOS_CHOICES, "depth", *QOS_DURATIONS)}


def element(context: Context, node: Node, extensions: Extensions) -> None:
    """Read an extension element of the web modeler. Other attributes (``selection``, ``is_output``) are ignored."""
    name = local_name(node)
    if name == "message":
        extensions.type = node.get("type", "")
    elif name == "payload":
        extensions.payload = _payload(context, node)
    elif name == "service":
        extensions.operation, extensions.type = node.get("name", "").strip(), node.get("type", "")
        extensions.service = True
    elif name == "policy":
        for key, value in node.attrib.items():
            if str(key).replace("_", "").lower() not in _POLICIES or not str(value).strip():
                continue
            meant = qos_policy(context, node, str(key), str(value))
            extensions.qos.update([meant] if meant is not None else ())
            if meant is not None and meant[1] != str(value):
                context.quirk(node, f"quality of service {key!s}={value!s} is {' '.join(meant)}")
    elif name == "parameters":
        named = [(_name(context, one), one) for one in node]
        extensions.values += [(name, Property(one.get("value", ""), line_of(one))) for name, one in named if name]
    elif name == "process":
        extensions.called = node.get("process", "").strip()


def _name(context: Context, node: Node) -> str:
    given = node.get("name", "").strip()
    name = given.removesuffix(":").strip()
    if name != given:
        context.quirk(node, f"the parameter {given!r} is {name!r}")
    return name


def _payload(context: Context, node: Node) -> Property | None:
    if node.get("data") is not None:
        return Property(node.get("data", ""), line_of(node))
    given = [(_name(context, one), one.get("value", "")) for one in node if one.get("value", "").strip()]
    return Property(flow_mapping(given), line_of(node)) if given else None
