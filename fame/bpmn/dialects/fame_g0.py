"""The oldest models of the original FaMe: an input parameter named like the topic, a list of type and payload."""

from __future__ import annotations

from fame.bpmn.context import Context, is_type
from fame.bpmn.dialects.extensions import Extensions
from fame.bpmn.xml import CAMUNDA, Node, text_of

LIST, _VALUE = f"{{{CAMUNDA}}}list", f"{{{CAMUNDA}}}value"


def is_message(node: Node) -> bool:
    """Whether it is the list of such a parameter."""
    first = node.find(_VALUE) if node.tag == LIST else None
    return first is not None and is_type(text_of(first))


def apply(context: Context, node: Node, found: Extensions) -> None:
    """Turns such a parameter, on a signal event, into topic, type and payload. Others stay what they are."""
    for name, items in found.lists.items():
        if items and len(items) <= 2 and is_type(items[0].value):
            found.topic, found.type = name, items[0].value
            if len(items) == 2:
                found.payload = items[1]
            context.quirk(node, f"topic, type and payload are those of the input parameter {name!r}")
            found.inputs = [one for one in found.inputs if one.target != name]
            return
