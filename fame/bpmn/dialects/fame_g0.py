"""The oldest models of the original FaMe: an input parameter named like the topic, a list of type and payload."""

from __future__ import annotations

from fame.bpmn.context import is_type
from fame.bpmn.dialects.extensions import Extensions


def apply(found: Extensions) -> None:
    """Turns such a parameter, on a signal event, into topic, type and payload. Others stay what they are."""
    for name, items in found.lists.items():
        if items and len(items) <= 2 and is_type(items[0].value):
            found.topic, found.type, found.original = name, items[0].value, True
            if len(items) == 2:
                found.payload = items[1]
            found.inputs = [one for one in found.inputs if one.target != name]
            return
