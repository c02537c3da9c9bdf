"""Reads forms: Camunda 7's ``formData``, and the JSON of form-js, which Camunda Modeler draws."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from fame.bpmn.model import FieldKind, FormField
from fame.bpmn.reader.xml import Node, local_name
from fame.text import suggestion

_FORM_DATA: Mapping[str, FieldKind] = {
    "string": "text", "long": "integer", "double": "number", "boolean": "checkbox", "date": "date", "enum": "select",
}  # fmt: skip
_MEANT = {"int": "long", "integer": "long", "number": "double", "float": "double", "text": "string"}
"""Types of other tools that people write in a ``formField``."""
_FORM_JS: Mapping[str, FieldKind] = {
    "textfield": "text", "textarea": "textarea", "number": "number", "checkbox": "checkbox", "select": "select",
    "radio": "radio", "text": "note",
}  # fmt: skip
_DATES: Mapping[str, FieldKind] = {"date": "date", "time": "time", "datetime": "datetime"}
_LAYOUT = {"spacer", "separator", "button", "image"}
"""Components of form-js without a value."""


def form_data(node: Node, warn: Callable[[str], object]) -> Iterator[FormField]:
    """Yield the fields of a ``camunda:formData``; `warn` gets what is wrong with them."""
    for element in node:
        if local_name(element) != "formField" or not element.get("id"):
            continue
        limits = {
            each.get("name", ""): each.get("config", "") for each in element.iter() if local_name(each) == "constraint"
        }
        values = [each for each in element if local_name(each) == "value"]
        kind = _FORM_DATA.get(type := element.get("type", "").strip(), "value")
        if kind == "value":
            hint = suggestion(_MEANT.get(type.lower(), type), _FORM_DATA)
            warn(f"its form field {element.get('id')} is of type {type!r}: any answer is accepted; {hint}")
        low, high = ("minlength", "maxlength") if kind == "text" else ("min", "max")
        yield FormField(
            key=element.get("id", ""),
            label=element.get("label", "") or element.get("id", ""),
            kind=kind,
            required="required" in limits,
            least=_number(limits.get(low)),
            most=_number(limits.get(high)),
            options=tuple((each.get("id", ""), each.get("name", "") or each.get("id", "")) for each in values),
            default=_default(kind, element.get("defaultValue")),
        )


def form_js(text: str) -> tuple[FormField, ...]:
    """Return the fields of a form of form-js. Raises ValueError for what is no such form."""
    form = json.loads(text)
    if not isinstance(form, dict) or not isinstance(form.get("components"), list):
        raise ValueError('expected {"components": [...]}')
    return tuple(_components(form["components"], ""))


def _components(components: list[Any], path: str) -> Iterator[FormField]:
    for component in components:
        if not isinstance(component, dict) or component.get("type") in _LAYOUT:
            continue
        if component.get("type") == "group" and isinstance(component.get("components"), list):
            inner = f"{path}{component['path']}." if component.get("path") else path
            yield from _components(component["components"], inner)
        else:
            yield _component(component, path)


def _component(component: Mapping[str, Any], path: str) -> FormField:
    type, limits = str(component.get("type", "")), component.get("validate")
    limits = limits if isinstance(limits, dict) else {}
    labels = map(component.get, ("label", "dateLabel", "timeLabel", "key"))
    label = str(next(filter(None, labels), ""))
    kind = _DATES.get(str(component.get("subtype", ""))) if type == "datetime" else _FORM_JS.get(type)
    options = tuple(_options(component.get("values")))
    if kind == "note":
        return FormField(kind="note", label=str(component.get("text", "")).strip("#* \n"))
    if kind is None or (kind in ("select", "radio") and not options):
        return FormField(kind="other", label=f"{label or type}: FAME does not draw fields of type {type}")
    if kind == "number" and component.get("decimalDigits") == 0:
        kind = "integer"
    low, high = ("minLength", "maxLength") if kind in ("text", "textarea") else ("min", "max")
    return FormField(
        key=f"{path}{component.get('key', '')}",
        label=label,
        kind=kind,
        required=limits.get("required") is True,
        least=_number(limits.get(low)),
        most=_number(limits.get(high)),
        pattern=str(limits.get("pattern", "")),
        options=options,
        default=component.get("defaultValue"),
    )


def _options(values: Any) -> Iterator[tuple[Any, str]]:
    for option in values if isinstance(values, list) else ():
        if isinstance(option, dict) and "value" in option:
            yield option["value"], str(option.get("label", option["value"]))


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
