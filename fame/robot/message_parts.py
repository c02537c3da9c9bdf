"""Messages taken apart quickly: the numbers, texts and arrays in them, and how JSON is made of these.

A robot gives away thousands of messages a second while it is recorded. To make JSON of one takes ten times as long as
to read its fields: so that is done elsewhere, by whoever has the parts (`fame.robot.change_text`).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import Any

from fame.middleware import typesystem
from fame.middleware.definitions import Field
from fame.middleware.messages import Message
from fame.robot.change_text import Layout, MessageParts, name_text

LONG = 64
"""Items of an array in a message, above which it is cut: such a message is not taken apart."""

Read = Callable[[Message], MessageParts | None]


def _fields(type: str) -> Sequence[Field]:
    return typesystem.definition(type).fields


@cache
def has_lists(type: str) -> bool:
    """Whether a type of messages has sequences or long arrays anywhere."""
    fields = _fields(type)
    return not fields or any(
        field.shape == "sequence" or field.size > LONG or (field.is_message and has_lists(field.base))
        for field in fields
    )


@cache
def reader(type: str) -> Read:
    """The function that takes the messages of a type apart.

    It returns None if the type has sequences or long arrays, or if something in a message has another class.
    """
    leaves = () if has_lists(type) else tuple(_leaves(type, ""))
    if not leaves or any(field.shape != "single" and field.base not in _ARRAYS for _, field in leaves):
        return lambda message: None
    get = _getter(type, leaves)
    last: Message | None = None  # several scopes often have the same message
    parts: MessageParts | None = None

    def read(message: Message) -> MessageParts | None:
        nonlocal last, parts
        if message is not last:
            try:
                last, parts = message, get(message)
            except (AttributeError, struct.error):  # a number where a message belongs; a text where a number belongs
                parts = None
        return parts

    return read


def _getter(type: str, leaves: Sequence[tuple[str, Field]]) -> Read:
    """The function that reads all fields of a type. Compiled, it is ten times as fast as an `attrgetter`."""
    codes, numbers, others, checks = "<", list[str](), list[str](), list[str]()
    places: list[tuple[int, str]] = []
    names: dict[str, Any] = {}
    for place, (path, field) in enumerate(leaves):
        value, kind = f"v{place}", f"k{place}"
        if field.shape != "single":
            import numpy

            names[kind] = numpy.dtype(field.base)
            checks.append(f"({value} := m.{path}).dtype is {kind} and {value}.size == {field.size}")
            others.append(f"{value}.tobytes(), ")
            places.append((place, f"<{field.size}{_ARRAYS[field.base]}"))
        elif field.base in _CLASSES:
            names[kind] = _CLASSES[field.base]
            checks.append(f"({value} := m.{path}).__class__ is {kind}")
            others.append(f"{value}, ")
            places.append((place, ""))
        else:
            numbers.append(f"m.{path}")
            codes += _NUMBERS.get(field.base, "q")
    layout: Layout = _template(type), codes, tuple(places)
    names |= {"layout": layout, "pack": struct.Struct(codes).pack}
    parts = f"layout, pack({', '.join(numbers)}), ({''.join(others)})"
    function: Read = eval(f"lambda m: ({parts}) if {' and '.join(checks) or True} else None", names)
    return function


def _leaves(type: str, path: str) -> Iterator[tuple[str, Field]]:
    """The path of every primitive and array, and its field."""
    for field in _fields(type):
        here = path + field.attribute
        if field.shape == "single" and field.is_message:
            yield from _leaves(field.base, f"{here}.")
        else:
            yield here, field


def _template(type: str) -> str:
    """The JSON of a type, with a place for every part."""
    return "{" + ",".join(f"{name_text(field.attribute)}:{_place(field)}" for field in _fields(type)) + "}"


def _place(field: Field) -> str:
    if field.shape == "single" and field.is_message:
        return _template(field.base)
    return "%s" if field.shape != "single" or field.base in _CLASSES else "%r"


_NUMBERS = {"float32": "d", "float64": "d", "uint64": "Q"}
"""The codes of `struct` for numbers as Python has them; for other ones it is ``q``."""
_CLASSES: dict[str, type[Any]] = {"string": str, "wstring": str, "bool": bool}
"""The classes of what is no number."""
_ARRAYS = {"float32": "f", "float64": "d"} | {
    f"{sign}int{8 * 2**power}": code
    for sign, codes in (("", "bhiq"), ("u", "BHIQ"))
    for power, code in enumerate(codes)
}
"""The codes of `struct` for the items of arrays."""
