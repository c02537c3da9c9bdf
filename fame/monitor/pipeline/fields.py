"""Paths into messages: reading numbers there, and messages made from numbers.

A path is a list of steps: the name of a field, an index, or a list of either. ``["pose", "position", "x"]``,
``["effort", 3]``; ``["effort", "elbow_joint"]`` finds the place in the message's own list of names (`name` of
JointState, `joint_names` of JointTrajectory), and ``["effort", ["elbow_joint", "wrist_1_joint"]]`` several of them. A
path that ends at an array means all of it. Every path is checked against the type before the first message.

Several outputs may fill one message: fields of their own, the places of one array (all of them, from 0 on), or its
named places, whose names go into the message's list of names.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import Any, TypeAlias

import numpy as np

from fame.dataclasses import dataclass
from fame.errors import MessageError
from fame.middleware import messages, typesystem
from fame.middleware.definitions import Definition, Field

FieldStep: TypeAlias = str | int | list[Any]
FieldPath: TypeAlias = tuple[FieldStep, ...]
Read: TypeAlias = Callable[[Any], tuple[Any, tuple[str, ...]]]

_NAMES = ("name", "joint_names", "names")
"""Fields that name the places of a message's arrays."""
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")


class UnusableMessage(Exception):
    """A message that cannot be used; the text gives the reason."""


class OtherDevice(UnusableMessage):
    """A message that has names, but none of those that are wanted: it is of another device on the topic."""


class Unwanted(OtherDevice):
    """One that has none of the places that a path names: nothing of it was wanted."""


def unusable(text: str, names: Sequence[str], wanted: Sequence[str]) -> UnusableMessage:
    """Return the error for a message with `names` where others are `wanted`."""
    return (OtherDevice if names and wanted and set(names).isdisjoint(wanted) else UnusableMessage)(text)


def has_stamp(type: str) -> bool:
    """Return whether messages of a type carry a time."""
    fields = typesystem.definition(type).fields
    return any(field.name == "header" and field.base == "std_msgs/msg/Header" for field in fields)


def stamp_of(message: Any) -> float:
    """Return the time in the header of a message in s, 0.0 if it has none."""
    stamp = message.header.stamp
    return float(stamp.sec + stamp.nanosec * 1e-9)


def reader(type: str, path: FieldPath) -> Read:
    """Return a function that reads the numbers at a path of a message, and the names of their channels if it has some.

    A single number is a float, several are an array. The function raises UnusableMessage for a message that lacks an
    element of the path. Raises MessageError if the type has no such path, or no number is there.
    """
    return _read(typesystem.definition(type), path, ())


def _read(content: Definition, path: FieldPath, done: tuple[Any, ...]) -> Read:
    if not path:
        if content.name in _TIMES:
            return lambda message: (message.sec + message.nanosec * 1e-9, ())
        have = ", ".join(field.name for field in content.fields)
        raise MessageError(f"the path ends at a message; expected one of its fields: {have}", type=content.name)
    field = field_of(content, path[0], done)
    rest, place = path[1:], (*done, path[0])
    get = attrgetter(field.attribute)
    if field.shape == "single":
        if field.is_message:
            return _then(get, _read(typesystem.definition(field.base), rest, place))
        _check_number(content, field, rest, place)
        return lambda message: (float(get(message)), ())
    if field.is_message:
        return _read_element(content, field, rest, place)
    if field.base == "string":
        raise MessageError(f"{format_path(place)} holds texts; expected numbers", type=content.name)
    return _read_array(content, field, rest, place)


def _read_element(content: Definition, field: Field, rest: FieldPath, place: tuple[Any, ...]) -> Read:
    """Return the function that reads one message of a list of messages."""
    if not rest or type(rest[0]) is not int:
        text = f"{format_path(place)} is a list of {field.base}; expected an index such as 0 after it"
        raise MessageError(text, type=content.name)
    index = checked_index(content, field, rest[0], place)
    inner = _read(typesystem.definition(field.base), rest[1:], (*place, index))

    def read(message: Any) -> Any:
        items = getattr(message, field.attribute)
        if len(items) <= index:
            raise UnusableMessage(f"{format_path(place)} has {len(items)} entries, not {index + 1}")
        return inner(items[index])

    return read


def _read_array(content: Definition, field: Field, rest: FieldPath, place: tuple[Any, ...]) -> Read:
    beside = names_field(content, field)
    if not rest:
        return _read_whole(field, beside)
    if len(rest) > 1:
        raise MessageError(f"{format_path((*place, rest[0]))} is a number; nothing may follow", type=content.name)
    wanted = rest[0] if isinstance(rest[0], list) else [rest[0]]
    if not wanted or not all(type(item) in (int, str) for item in wanted):
        raise MessageError(f"{format_path(place)}: expected an index or a name, got {rest[0]!r}", type=content.name)
    for item in wanted:
        if isinstance(item, int):
            checked_index(content, field, item, place)
        elif beside is None:
            text = f"{format_path(place)} has no names to find {item!r} by; expected an index such as 0"
            raise MessageError(text, type=content.name)
    return _read_places(field, beside, wanted, place, single=not isinstance(rest[0], list))


def _read_whole(field: Field, beside: str | None) -> Read:
    get = attrgetter(field.attribute)
    if beside is None:
        return lambda message: (np.asarray(get(message), dtype=np.float64), ())
    kept: tuple[list[str], tuple[str, ...]] = ([], ())

    def read(message: Any) -> Any:
        nonlocal kept
        values = get(message)
        names = getattr(message, beside)
        if names != kept[0]:
            kept = (list(names), tuple(names))
        if not len(values):
            raise UnusableMessage(f"{field.name} is empty")
        return np.asarray(values, dtype=np.float64), kept[1] if len(names) == len(values) else ()

    return read


def _read_places(
    field: Field, beside: str | None, wanted: Sequence[Any], place: tuple[Any, ...], *, single: bool
) -> Read:
    """Return the function that reads places of an array, by index or by name; where a name stands is remembered."""
    get, places = attrgetter(field.attribute), [0]
    kept: list[str] | None = None
    channels = () if single else tuple(map(str, wanted))
    by_name = any(isinstance(item, str) for item in wanted)

    def find(names: Sequence[str]) -> list[int]:
        missing = [item for item in wanted if isinstance(item, str) and item not in names]
        if missing:
            text = f"{', '.join(missing)} is not among its names: {', '.join(names) or 'none'}"
            none = bool(names) and len(missing) == len(wanted)
            raise Unwanted(text) if none else UnusableMessage(text)
        return [names.index(item) if isinstance(item, str) else item for item in wanted]

    def read(message: Any) -> Any:
        nonlocal kept, places
        if not by_name:
            places = list(wanted)
        elif (names := getattr(message, str(beside))) != kept:
            places, kept = find(names), list(names)
        values = get(message)
        if len(values) <= max(places):
            raise UnusableMessage(f"{format_path(place)} has {len(values)} values, not {max(places) + 1}")
        return (float(values[places[0]]) if single else np.asarray(values, dtype=np.float64)[places]), channels

    return read


def names_field(content: Definition, field: Field) -> str | None:
    """Return the field that names the places of an array, if the type has one."""
    for other in content.fields:
        if other.name in _NAMES and other.base == "string" and other.shape != "single" and field.base == "float64":
            return other.attribute
    return None


def field_of(content: Definition, step: Any, done: tuple[Any, ...]) -> Field:
    for field in content.fields:
        if field.name == step:
            return field
    have = ", ".join(field.name for field in content.fields) or "none"
    raise MessageError(f"there is no field {format_path((*done, step))}; it has {have}", type=content.name)


def _check_number(content: Definition, field: Field, rest: FieldPath, place: tuple[Any, ...]) -> None:
    if field.base == "string":
        raise MessageError(f"{format_path(place)} is a text; expected a number", type=content.name)
    if rest:
        text = f"{format_path(place)} is a {field.base}; nothing may follow, found {format_path(rest)}"
        raise MessageError(text, type=content.name)


def checked_index(content: Definition, field: Field, index: int, place: tuple[Any, ...]) -> int:
    if index < 0 or (field.shape == "array" and index >= field.size) or (field.size and index >= field.size):
        right = f"0 to {field.size - 1}" if field.size else "0 on"
        raise MessageError(f"{format_path(place)}: expected an index from {right}, got {index}", type=content.name)
    return index


def _then(get: Callable[[Any], Any], read: Read) -> Read:
    return lambda message: read(get(message))


def format_path(steps: Sequence[Any]) -> str:
    return ".".join(map(str, steps))


@dataclass(frozen=True, slots=True)
class _Slot:
    """A field to fill.

    path     of names of fields
    values   which of the given values go there, in order; of an array that is filled in places, one each
    places   whether it is filled in places
    names    of its places, if outputs name them
    beside   the field next to it that takes names, if there is one
    several  whether it is an array
    """

    path: tuple[str, ...]
    values: tuple[int, ...]
    places: bool
    names: tuple[str, ...]
    beside: str | None
    several: bool


@dataclass(frozen=True, slots=True)
class Writer:
    type: str
    stamped: bool
    slots: tuple[_Slot, ...]

    def message(self, values: Sequence[Any], stamp: float, names: tuple[str, ...] = ()) -> Any:
        """Return a message with these values, one per path, and names of the channels of a whole array if known.

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


def writer(type: str, paths: Sequence[FieldPath]) -> Writer:
    """Return what makes messages of a type from values at these paths.

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
    slots = tuple(_slot(content, steps, filled, *ends[steps]) for steps, filled in grouped.items())
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
    raise MessageError(f"{format_path(steps)}: two outputs set this field", type=content.name)


def _checked(
    content: Definition, path: FieldPath, done: tuple[str, ...]
) -> tuple[tuple[str, ...], Any, bool, str | None]:
    """Return the fields of a path, what follows them, whether that is in an array, and the field for its names."""
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
    """Return the value for a whole field: a list for an array, one value otherwise."""
    array = np.asarray(value)
    if slot.several:
        return array.ravel() if array.dtype != object else array.ravel().tolist()
    return _plain(array.reshape(-1)[0]) if array.size == 1 else value


def _plain(value: Any) -> Any:
    return value.item() if hasattr(value, "item") and np.ndim(value) == 0 else value
