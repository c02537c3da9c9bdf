"""What a person fills in at a task, and who that person may be."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

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
