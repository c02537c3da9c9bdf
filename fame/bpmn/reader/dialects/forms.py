"""Reads forms: Camunda 7's ``formData``, and the JSON of form-js, which Camunda Modeler draws."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from fame.bpmn.model import FieldKind, FormField
from fame.bpmn.reader.xml import Node, local_name

_FORM_DATA: Mapping[str, FieldKind] = {
    "string": "text", "long": "integer", "double": "number", "boolean": "checkbox", "date": "date", "enum": "select",
}  # fmt: skip
_FORM_JS: Mapping[str, FieldKind] = {
    "textfield": "text", "textarea": "textarea", "number": "number", "checkbox": "checkbox", "select": "select",
    "radio": "radio", "text": "note",
}  # fmt: skip
_DATES: Mapping[str, FieldKind] = {"date": "date", "time": "time", "datetime": "datetime"}
_LAYOUT = {"spacer", "separator", "button", "image"}
"""Components of form-js without a value."""


def form_data(node: Node) -> Iterator[FormField]:
    """Yield the fields of a ``camunda:formData``."""
    for one in node:
        if local_name(one) != "formField" or not one.get("id"):
            continue
        limits = {
            each.get("name", ""): each.get("config", "") for each in one.iter() if local_name(each) == "constraint"
        }
        values = [each for each in one if local_name(each) == "value"]
        kind = _FORM_DATA.get(one.get("type", ""), "value")
        low, high = ("minlength", "maxlength") if kind == "text" else ("min", "max")
        yield FormField(
            key=one.get("id", ""),
            label=one.get("label", "") or one.get("id", ""),
            kind=kind,
            required="required" in limits,
            least=_number(limits.get(low)),
            most=_number(limits.get(high)),
            options=tuple((each.get("id", ""), each.get("name", "") or each.get("id", "")) for each in values),
            default=_default(kind, one.get("defaultValue")),
        )


def form_js(text: str) -> tuple[FormField, ...]:
    """Return the fields of a form of form-js. Raises ValueError for what is no such form."""
    found = json.loads(text)
    if not isinstance(found, dict) or not isinstance(found.get("components"), list):
        raise ValueError('expected {"components": [...]}')
    return tuple(_components(found["components"], ""))


def _components(components: list[Any], path: str) -> Iterator[FormField]:
    for one in components:
        if not isinstance(one, dict) or one.get("type") in _LAYOUT:
            continue
        if one.get("type") == "group" and isinstance(one.get("components"), list):
            yield from _components(one["components"], f"{path}{one['path']}." if one.get("path") else path)
        else:
            yield _component(one, path)


def _component(one: Mapping[str, Any], path: str) -> FormField:
    type, limits = str(one.get("type", "")), one.get("validate")
    limits = limits if isinstance(limits, dict) else {}
    label = str(one.get("label") or one.get("dateLabel") or one.get("timeLabel") or one.get("key") or "")
    kind = _DATES.get(str(one.get("subtype", ""))) if type == "datetime" else _FORM_JS.get(type)
    options = tuple(_options(one.get("values")))
    if kind == "note":
        return FormField(kind="note", label=str(one.get("text", "")).strip("#* \n"))
    if kind is None or (kind in ("select", "radio") and not options):
        return FormField(kind="other", label=f"{label or type}: FAME does not draw fields of type {type}")
    if kind == "number" and one.get("decimalDigits") == 0:
        kind = "integer"
    low, high = ("minLength", "maxLength") if kind in ("text", "textarea") else ("min", "max")
    return FormField(
        key=f"{path}{one.get('key', '')}",
        label=label,
        kind=kind,
        required=limits.get("required") is True,
        least=_number(limits.get(low)),
        most=_number(limits.get(high)),
        pattern=str(limits.get("pattern", "")),
        options=options,
        default=one.get("defaultValue"),
    )


def _options(values: Any) -> Iterator[tuple[Any, str]]:
    for one in values if isinstance(values, list) else ():
        if isinstance(one, dict) and "value" in one:
            yield one["value"], str(one.get("label", one["value"]))


def _default(kind: FieldKind, text: str | None) -> Any:
    """The default of a ``formField``; None if it is missing, or an expression."""
    if not text or "{" in text:
        return None
    if kind == "checkbox":
        return text.strip() == "true"
    return _number(text) if kind in ("integer", "number") else text


def _number(value: Any) -> float | None:
    try:
        return None if value in (None, "") or isinstance(value, bool) else float(value)
    except (TypeError, ValueError):  # an expression
        return None
