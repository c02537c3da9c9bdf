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

Read = Callable[[Message], MessageParts]


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
def reader(type: str) -> Read | None:
    """The function that takes the messages of a type apart; None if the type has sequences or long arrays.

    It raises AttributeError or struct.error if something in a message has another class.
    """
    leaves = () if has_lists(type) else tuple(_leaves(type, ""))
    if not leaves or any(field.shape != "single" and field.base not in _ARRAYS for _, field in leaves):
        return None
    return _getter(type, leaves)


_READ = """
last = parts = None
def read(m):
    global last, parts  # several scopes often have the same message
    if m is not last:
        if not ({checks}):
            raise AttributeError("a value of another class")
        parts = layout, pack({numbers}), ({others})
        last = m
    return parts
"""


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
    source = _READ.format(checks=" and ".join(checks) or True, numbers=", ".join(numbers), others="".join(others))
    exec(source, names)
    read: Read = names["read"]
    return read


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
