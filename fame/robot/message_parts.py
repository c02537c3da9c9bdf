"""Messages taken apart quickly: the numbers and texts in them, and the JSON around these.

A robot gives away thousands of messages a second while it is recorded. To make JSON of one takes ten times as long as
to read its fields: so that is done elsewhere, by whoever has the parts (`fame.robot.change_text`).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from functools import cache, lru_cache
from typing import Any

from fame.middleware import typesystem
from fame.middleware.definitions import Field
from fame.middleware.messages import Message
from fame.robot.change_text import name_text

LONG = 64
"""Items of an array in a message, above which it is cut: such a message is not taken apart."""

Parts = tuple[str, tuple[Any, ...]]
"""A template of JSON, and what belongs into it: numbers (``%r``), and JSON of everything else (``%s``)."""


def parts_of(message: Message) -> Parts | None:
    """The parts of a message; None if it has sequences or long arrays, or something in it has another class."""
    return reader(message.__msgtype__)(message)


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


class _Reader:
    """Reads the parts of the messages of one type."""

    def __init__(self, type: str) -> None:
        paths, kinds = map(list, zip(*_leaves(type, ""), strict=True))
        self._kinds = kinds
        self._template = _template(type)
        self._get = _getter(paths)
        self._others = [(place, _TEXTS[kind]) for place, kind in enumerate(self._kinds) if kind not in _NUMBERS]
        self._message: Message | None = None  # the last one: several scopes often have the same
        self._parts: Parts | None = None

    def read(self, message: Message) -> Parts | None:
        """The parts of a message; None if it has others than its type."""
        if message is self._message:
            return self._parts
        self._message, self._parts = message, None
        try:
            parts = self._get(message)
            if list(map(type, parts)) != self._kinds:
                return None
            if self._others:
                items = list(parts)
                for place, text in self._others:
                    items[place] = text(items[place])
                parts = tuple(items)
        except (AttributeError, ValueError):  # a number where a message belongs; numbers that JSON does not have
            return None
        self._parts = self._template, parts
        return self._parts


def _getter(paths: Sequence[str]) -> Callable[[Message], tuple[Any, ...]]:
    """The function that reads these attributes of attributes. Compiled, it is ten times as fast as an `attrgetter`."""
    function: Callable[[Message], tuple[Any, ...]] = eval(f"lambda m: ({''.join(f'm.{path}, ' for path in paths)})")
    return function


_KINDS: dict[str, type[Any]] = {"string": str, "wstring": str, "bool": bool, "float32": float, "float64": float}
"""The classes of single primitives; the others are int."""


@cache
def reader(type: str) -> Callable[[Message], Parts | None]:
    """The function that takes the messages of a type apart (see `parts_of`)."""
    if has_lists(type) or any(kind is None for _, kind in _leaves(type, "")):
        return lambda message: None
    return _Reader(type).read


def _leaves(type: str, path: str) -> Iterator[tuple[str, Any]]:
    """The path and class of every primitive and array of them; None: an array of another kind."""
    for field in _fields(type):
        here = path + field.attribute
        if field.shape != "single":
            yield here, None if field.is_message or field.base in ("string", "wstring") else _array_class()
        elif field.is_message:
            yield from _leaves(field.base, f"{here}.")
        else:
            yield here, _KINDS.get(field.base, int)


def _array_class() -> type[Any]:
    import numpy

    _TEXTS[numpy.ndarray] = _array_text
    return numpy.ndarray


def _template(type: str) -> str:
    """The JSON of a type, with a place for every part."""
    return "{" + ",".join(f"{name_text(field.attribute)}:{_place(field)}" for field in _fields(type)) + "}"


def _place(field: Field) -> str:
    if field.shape != "single":
        return "%s"
    return _template(field.base) if field.is_message else "%r" if _KINDS.get(field.base, int) in _NUMBERS else "%s"


def _array_text(array: Any) -> str:
    """The JSON of an array."""
    return _known_array(array.dtype.char, array.tobytes())


@lru_cache(256)
def _known_array(kind: str, data: bytes) -> str:
    """The JSON of an array. Most arrays in messages are covariances, which rarely differ."""
    import numpy

    return json.dumps(numpy.frombuffer(data, kind).tolist(), separators=(",", ":"), allow_nan=False)


_NUMBERS = (float, int)
_TEXTS: dict[type[Any], Callable[[Any], str]] = {str: name_text, bool: lambda value: "true" if value else "false"}
"""The JSON of what is no number, by class."""
