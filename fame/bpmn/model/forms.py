"""What a person fills in at a task, and who that person may be."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from typing import Any, Literal

from fame.dataclasses import dataclass
from fame.text import suggestion

FieldKind = Literal[
    "text", "textarea", "number", "integer", "checkbox", "select", "radio", "date", "time", "datetime", "value",
    "note", "other",
]  # fmt: skip
"""``value``: a number, text or list of unknown type. ``note`` is only shown; ``other`` is what FAME does not draw."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FormField:
    """A field of a form. `key` names the variable that it sets, or with dots a part of it; `label` is what people see.

    `least` and `most` limit a number, or the characters of a text; `options` are values with their labels.
    """

    key: str = ""
    label: str = ""
    kind: FieldKind = "text"
    required: bool = False
    least: float | None = None
    most: float | None = None
    pattern: str = ""
    options: tuple[tuple[Any, str], ...] = ()
    default: Any = None


_PLAIN = (bool, int, float, str, list, dict, type(None))
"""Values of people; an exploration gives others, which are unknown."""


def unfit_value(form: Sequence[FormField], values: Mapping[str, Any]) -> str:
    """Return what is wrong with the first value that has no field in a form or does not fit it; empty if all fit.

    A field without a value is passed over, and so are patterns, which are of JavaScript, and the forms of dates.
    """
    for field in form:
        for value in given(values, field.key):
            expected = _expected(field, value) if isinstance(value, _PLAIN) else ""
            if expected:
                return f"{field.key}: expected {expected}, got {value!r}"
    return _without_field(form, [name for name, value in values.items() if isinstance(value, _PLAIN)])


def _without_field(form: Sequence[FormField], names: Iterable[str]) -> str:
    """Say which name is no field; beside fields that FAME does not know (``other``), only if it is like a known one."""
    keys = [field.key for field in form if field.key]
    known = {*keys, *(key.partition(".")[0] for key in keys)}
    for name in names if keys else ():
        if name not in known and (is_whole(form) or get_close_matches(name, keys)):
            return f"the form has no field {name!r}; {suggestion(name, keys)}"
    return ""


def is_whole(form: Sequence[FormField]) -> bool:
    """Return whether a form asks for something, and all its fields are known: then it refuses what has no field."""
    return any(field.key for field in form) and all(field.kind != "other" for field in form)


def given(values: Mapping[str, Any], key: str) -> list[Any]:
    """Return the value of `key`, where dots lead to a part of a value, as a list of one; empty without such a value."""
    if key in values:
        return [values[key]]
    first, _, rest = key.partition(".")
    inner = values.get(first)
    return given(inner, rest) if rest and isinstance(inner, Mapping) else []


def _expected(field: FormField, value: Any) -> str:
    """What a field expects, if this is not it. A field for text takes what can be written."""
    if value is None or (value == "" and field.kind in ("text", "textarea")):
        return "a value" if field.required else ""
    options = [each for each, _ in field.options if isinstance(each, bool) == isinstance(value, bool)]  # 1 is not true
    if field.kind in ("select", "radio") and field.options and value not in options:
        return f"one of {', '.join(str(each) for each, _ in field.options)}"
    if field.kind == "checkbox" and not isinstance(value, bool):
        return "true or false"
    least, most = -math.inf if field.least is None else field.least, math.inf if field.most is None else field.most
    if field.kind in ("number", "integer"):
        known = isinstance(value, int | float) and not isinstance(value, bool) and -math.inf < value < math.inf
        if not (known and least <= value <= most and (field.kind == "number" or value == int(value))):
            return f"a {'whole ' * (field.kind == 'integer')}number{_bounds(least, most)}"
    if field.kind in ("text", "textarea") and isinstance(value, str) and not least <= len(value) <= most:
        return f"a text with a length{_bounds(least, most)}"
    return ""


def _bounds(least: float, most: float) -> str:
    low, high = (f"{bound:.15g}" if math.isfinite(bound) else "" for bound in (least, most))
    if low and high:
        return f" from {low} to {high}"
    return f" of {low} or more" if low else f" of {high} or less" if high else ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Human:
    """What a user or manual task says of people: who may complete it (empty: anybody), and its form.

    `linked` is the id of a form that is in no file of the model.
    """

    users: tuple[str, ...] = ()
    groups: tuple[str, ...] = ()
    form: tuple[FormField, ...] = ()
    linked: str = ""


NOBODY = Human()
"""What a task says that says nothing of people."""
