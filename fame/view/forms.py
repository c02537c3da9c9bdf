"""The forms of a page: the fields of a task, and of the message of a topic, fit for JSON."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

from fame.bpmn.linked_forms import form_of
from fame.bpmn.model import Body, DataObject, Definitions, FieldKind, FlowNode, FormField, Task
from fame.errors import MessageError
from fame.middleware import typesystem
from fame.text import read_json

_DEPTH, _MOST = 4, 40
_KINDS: Mapping[str, FieldKind] = {"bool": "checkbox", "boolean": "checkbox", "string": "text", "wstring": "text"}
_UNITS = {
    "geometry_msgs/msg/Twist.linear": "m/s", "geometry_msgs/msg/Twist.angular": "rad/s",
    "geometry_msgs/msg/Point": "m", "geometry_msgs/msg/Point32": "m", "geometry_msgs/msg/Pose2D": "m, rad",
    "geometry_msgs/msg/Wrench.force": "N", "geometry_msgs/msg/Wrench.torque": "N m", "sensor_msgs/msg/Range": "m",
    "sensor_msgs/msg/Temperature": "\N{DEGREE SIGN}C", "sensor_msgs/msg/NavSatFix": "\N{DEGREE SIGN}",
}  # fmt: skip
"""Units of numbers, by type, or type and field (REP 103)."""


def task_fields(node: FlowNode, body: Body | None, file: Definitions) -> list[dict[str, Any]]:
    """Return the form of a user or manual task of a file; without one, the data that it writes;
    empty if nothing is known."""
    if not isinstance(node, Task) or node.kind not in ("user", "manual"):
        return []
    form = form_of(file, node.human)
    if not any(field.key for field in form):
        form = (*form, *_written(node, body.data_objects if body is not None else ()))
    return [field_json(field) for field in form]


def _written(node: Task, data: Sequence[DataObject]) -> Iterator[FormField]:
    """A field for each variable of the data objects that a task writes."""
    for one in data:
        for name, expression in one.values if one.id in node.data_outputs else ():
            value: Any = None
            with suppress(ValueError):
                value = read_json(expression.text)
            kind: FieldKind = (
                "checkbox" if isinstance(value, bool) else "number" if isinstance(value, int | float) else "value"
            )
            yield FormField(key=name, label=name, kind=kind, default=value if kind != "value" else None)


def field_json(field: FormField) -> dict[str, Any]:
    """Return a field as the page takes it; what it does not have is left out."""
    low, high = ("minLength", "maxLength") if field.kind in ("text", "textarea") else ("min", "max")
    found = {
        "key": field.key, "label": field.label, "kind": field.kind, "required": field.required, low: field.least,
        high: field.most, "pattern": field.pattern, "options": [list(option) for option in field.options],
        "value": field.default,
    }  # fmt: skip
    return {name: value for name, value in found.items() if value not in (None, "", [], False)}


def topic_fields(nodes: Iterable[FlowNode]) -> dict[str, list[dict[str, Any]]]:
    """Return the fields of the message of each topic whose type is known, by qualified name."""
    types = {topic.qualified: topic.type for node in nodes for topic, _ in node.topics() if topic.type}
    found = {}
    for name, type in types.items():
        try:
            found[name] = list(_message_fields(type, "", 0))[:_MOST]
        except MessageError:  # a type of a package that is not here
            continue
    return found


def _message_fields(type: str, path: str, depth: int) -> Iterator[dict[str, Any]]:
    """A field for each number, text and list in a message."""
    for field in typesystem.definition(type).fields:
        key, unit = f"{path}{field.name}", _UNITS.get(f"{type}.{field.name}") or _UNITS.get(type, "")
        if field.base == "std_msgs/msg/Header":
            continue
        if field.is_message and field.shape == "single" and depth < _DEPTH:
            for inner in _message_fields(field.base, f"{key}.", depth + 1):
                yield {**({"unit": unit} if unit and inner["kind"] in ("number", "integer") else {}), **inner}
            continue
        kind: FieldKind = "value" if field.is_message or field.shape != "single" else _KINDS.get(field.base, "number")
        if kind == "number" and "int" in field.base:
            kind = "integer"
        yield {"key": key, "label": key, "kind": kind, **({"unit": unit} if unit and kind == "number" else {})}
