"""Messages put together from numbers, by paths into their type (see `fame.monitor.pipeline.fields`).

Several outputs may fill one message: fields of their own, the places of one array (all of them, from 0 on), or its
named places, whose names go into the message's list of names.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fame.clock import SECOND
from fame.errors import MessageError
from fame.middleware import messages, typesystem
from fame.middleware.definitions import Definition
from fame.monitor.pipeline.fields import Path, checked_index, field_of, format_path, has_stamp, names_field


@dataclass(frozen=True, slots=True)
class _Slot:
    """A field to fill.

    path     of names of fields
    values   which of the given values go there, in order; of an array that is filled in places, one each
    places   whether it is filled in places
    names    of its places, if outputs name them
    beside   the field next to it that takes names, if there is one
    several  whether it is an array
    floats   whether it is one of float64 without bounds
    """

    path: tuple[str, ...]
    values: tuple[int, ...]
    places: bool
    names: tuple[str, ...]
    beside: str | None
    several: bool
    floats: bool = False


@dataclass(frozen=True, slots=True)
class Writer:
    """Makes messages of a type."""

    type: str
    stamped: bool
    slots: tuple[_Slot, ...]

    def message(self, values: Sequence[Any], stamp: float, names: tuple[str, ...] = ()) -> Any:
        """A message with these values, one per path, and names of the channels of a whole array if they are known.

        Raises MessageError if they do not fit.
        """
        content: dict[str, Any] = {"header": {"stamp": stamp}} if self.stamped else {}
        for slot in self.slots:
            tree = content
            for step in slot.path[:-1]:
                tree = tree.setdefault(step, {})
            given = [values[index] for index in slot.values]
            tree[slot.path[-1]] = [_plain(item) for item in given] if slot.places else _fitting(given[0], slot)
            channels = slot.names or names
            if slot.beside is not None and channels:
                tree.setdefault(slot.beside, list(channels))
        return messages.create(self.type, content)

    def alike(self, first: Any, rows: Sequence[Any], stamps: Sequence[float]) -> Iterator[Any]:
        """Messages as `first`, which `message` made, but with these values and stamps: without asking what fits."""
        make, header = first.__class__, first.header
        fields: list[Any] = [getattr(first, name) for name in first.__slots__]
        at = first.__slots__.index("header")
        places = [(first.__slots__.index(slot.path[0]), rows[slot.values[0]]) for slot in self.slots]
        for index, stamp in enumerate(stamps):
            time = header.stamp.__class__(*divmod(round(stamp * SECOND), SECOND))
            fields[at] = header.__class__(time, header.frame_id)
            for place, values in places:
                fields[place] = values[index]
            yield make(*fields)

    def is_plain(self, values: Sequence[Any]) -> bool:
        """Whether `alike` will do: fields of the message itself that take arrays of float64 as they are."""
        return self.stamped and all(
            len(slot.path) == 1 and slot.several and not slot.places and slot.floats and value.dtype == np.float64
            for slot, value in ((slot, values[slot.values[0]]) for slot in self.slots)
        )


def writer(type: str, paths: Sequence[Path]) -> Writer:
    """What makes messages of a type from values at these paths.

    Raises MessageError for a path that the type lacks, for two outputs at one place, and for gaps in an array.
    """
    content = typesystem.definition(type)
    grouped: dict[tuple[str, ...], list[tuple[int, Any]]] = {}
    ends: dict[tuple[str, ...], tuple[bool, str | None]] = {}
    for number, path in enumerate(paths):
        if not path and not content.fields:
            continue  # an empty message: that it comes is all it says
        steps, last, several, beside = _checked(content, path, ())
        grouped.setdefault(steps, []).append((number, last))
        ends[steps] = (several, beside)
    floats = {field.name for field in content.fields if str(field) == "float64[]"}
    slots = tuple(
        replace(_slot(content, steps, filled, *ends[steps]), floats=steps[0] in floats)
        for steps, filled in grouped.items()
    )
    return Writer(content.name, has_stamp(content.name), slots)


def _slot(
    content: Definition, steps: tuple[str, ...], filled: list[tuple[int, Any]], several: bool, beside: str | None
) -> _Slot:
    numbers, places = [number for number, _ in filled], [place for _, place in filled]
    if places == [None]:
        return _Slot(steps, tuple(numbers), False, (), beside, several)
    if len(filled) == 1 and isinstance(places[0], list):
        return _Slot(steps, tuple(numbers), False, tuple(map(str, places[0])), beside, several)
    if all(isinstance(place, int) for place in places):
        if sorted(places) != list(range(len(places))):
            text = f"{format_path(steps)}: expected outputs for the places 0, 1, ... once each, got {sorted(places)}"
            raise MessageError(text, type=content.name)
        return _Slot(
            steps, tuple(number for _, number in sorted(zip(places, numbers, strict=True))), True, (), None, True
        )
    if all(isinstance(place, str) for place in places) and len(set(places)) == len(places):
        return _Slot(steps, tuple(numbers), True, tuple(places), beside, True)
    raise MessageError(f"{format_path(steps)}: two outputs go to one place", type=content.name)


def _checked(content: Definition, path: Path, done: tuple[str, ...]) -> tuple[tuple[str, ...], Any, bool, str | None]:
    """The names of fields of a path, what follows them, whether that is in an array, and the field for its names."""
    if not path:
        have = ", ".join(field.name for field in content.fields)
        raise MessageError(f"the path ends at a message; expected one of its fields: {have}", type=content.name)
    field = field_of(content, path[0], done)
    rest, place = path[1:], (*done, str(path[0]))
    if field.is_message and field.shape == "single":
        return _checked(typesystem.definition(field.base), rest, place)
    if field.is_message:
        raise MessageError(f"{format_path(place)} is a list of messages, which no output can fill", type=content.name)
    beside = names_field(content, field)
    if rest and (field.shape == "single" or len(rest) > 1):
        raise MessageError(f"{format_path(place)} is a {field}; {format_path(rest)} cannot follow", type=content.name)
    if rest and isinstance(rest[0], int):
        checked_index(content, field, rest[0], place)
    elif rest and beside is None:
        raise MessageError(f"{format_path(place)} has no names; expected an index after it", type=content.name)
    return place, rest[0] if rest else None, field.shape != "single", beside


def _fitting(value: Any, slot: _Slot) -> Any:
    """The value for a whole field: a list for an array, one value otherwise."""
    array = np.asarray(value)
    if slot.several:
        return array.ravel() if array.dtype != object else array.ravel().tolist()
    return _plain(array.reshape(-1)[0]) if array.size == 1 else value


def _plain(value: Any) -> Any:
    return value.item() if hasattr(value, "item") and np.ndim(value) == 0 else value
