"""Messages as JSON: dataclasses whose fields say what they may have.

A field is declared with its check, as ``Annotated[str, text(64)]``. What comes from the network is accepted only if
every field of it passes.

These checks are not those of `fame.config.values`, which are for people: they convert, and say line and value. What a
stranger sends is taken as it is or refused by the name of its field, and its size is bounded.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from operator import attrgetter
from typing import Annotated, Any, TypeVar, get_type_hints

from fame.dataclasses import field, fields
from fame.text import is_ros_name


def values(message: Any) -> dict[str, Any]:
    """Return the fields of a message, a dataclass, by name. Their values are JSON as they are: nothing is copied.

    A `later` field is left out where it has its default, so that a receiver of protocol 1 can read the others.
    """
    names, all_of, added = _getter(message.__class__)
    data = dict(zip(names, all_of(message), strict=True))
    for name, default in added:
        if data[name] == default:
            del data[name]
    return data


def shortened(value: Any, longest: int) -> Any:
    """Return JSON with the same objects and lists, and only the beginning of texts that are longer than `longest`."""
    if isinstance(value, str):
        return value if len(value) <= longest else f"{value[: longest - 3]}..."
    if isinstance(value, Mapping):
        return {shortened(name, longest): shortened(item, longest) for name, item in value.items()}
    return [shortened(item, longest) for item in value] if isinstance(value, list | tuple) else value


def later(default: Any) -> Any:
    """Return a field that protocol 1 does not have; its `default` means what messages without it mean."""
    return field(default=default, metadata={"later": default})


@cache
def _getter(cls: Any) -> tuple[Sequence[str], Callable[[Any], tuple[Any, ...]], Sequence[tuple[str, Any]]]:
    """The names of the fields of a class, of which there are two at least, what gives their values, and later ones.

    A field that is not compared does not belong to the message.
    """
    compared = [each for each in fields(cls) if each.compare]
    names = [each.name for each in compared]
    added = [(each.name, each.metadata["later"]) for each in compared if "later" in each.metadata]
    return names, attrgetter(*names), added


FieldCheck = Callable[[Any], bool]
"""Whether a field may have a JSON value."""
_Message = TypeVar("_Message")
LAST = 2**53
"""Integers are smaller: exact in the JSON of every language. As a sequence: microseconds until the year 2255."""


def text(longest: int) -> FieldCheck:
    """Return the check of a text of at most `longest` characters."""
    return lambda value: isinstance(value, str) and len(value) <= longest


def among(*values: str) -> FieldCheck:
    """Return the check of one of some texts."""
    return lambda value: isinstance(value, str) and value in values


def integer(lowest: int = 0, end: int = LAST) -> FieldCheck:
    """Return the check of an integer from `lowest` to below `end`."""
    return lambda value: type(value) is int and lowest <= value < end


def number(value: Any) -> bool:
    """Return whether a value is a finite number that fits into a float."""
    return (type(value) is int and abs(value) < LAST) or (type(value) is float and math.isfinite(value))


def seconds(longest: float) -> FieldCheck:
    """Return the check of a number from 0 to `longest`."""
    return lambda value: number(value) and 0 <= value <= longest


def flag(value: Any) -> bool:
    return isinstance(value, bool)


def robot(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= 200 and is_ros_name(f"/{value}")


def topic(value: Any) -> bool:
    """Return whether a value is the full name of a topic."""
    return isinstance(value, str) and len(value) <= 250 and is_ros_name(value)


def sequence(item: FieldCheck) -> FieldCheck:
    """Return the check of a list of at most 10,000 values."""
    return lambda value: isinstance(value, list) and len(value) <= 10_000 and all(map(item, value))


def mapping(key: FieldCheck, item: FieldCheck) -> FieldCheck:
    """Return the check of an object of at most 10,000 names."""
    return lambda value: (
        isinstance(value, dict) and len(value) <= 10_000 and all(map(key, value)) and all(map(item, value.values()))
    )


def record(checks: Mapping[str, FieldCheck]) -> FieldCheck:
    """Return the check of an object with these fields, or some of them; others are ignored."""
    return lambda value: (
        isinstance(value, dict) and all(check(value[name]) for name, check in checks.items() if name in value)
    )


@cache
def checks(cls: Any) -> Mapping[str, FieldCheck]:
    """Return the checks of the fields of a message."""
    hints = get_type_hints(cls, include_extras=True)
    return {name: hints[name].__metadata__[0] for name in _getter(cls)[0]}


def read(cls: Callable[..., _Message], data: Any, *, ignore: bool = False) -> _Message:
    """Return a message made of JSON. Raises TypeError for a field that has a wrong value, or is unknown.

    ignore  leave out unknown fields: of messages that only tell, and make nobody act (docs/deployment.md)
    """
    if not isinstance(data, dict):
        raise TypeError("not an object")
    known = checks(cls)
    taken = {name: value for name, value in data.items() if name in known} if ignore else data
    invalid = first_invalid(taken, known)
    if invalid is not None:
        raise TypeError(f"field {invalid[:40]!r}")
    return cls(**taken)


def first_invalid(data: Mapping[str, Any], checks: Mapping[str, FieldCheck]) -> str | None:
    """Return the first field of `data` that is unknown or does not pass, or None."""
    for name, value in data.items():
        check = checks.get(name)
        if check is None or not check(value):
            return name
    return None


# ---- fields of several messages --------------------------------------------------------------------------------------


def is_object(value: Any) -> bool:
    return isinstance(value, dict)


Name = Annotated[str, text(1000)]
Hash = Annotated[str, text(64)]
RobotField = Annotated[str, robot]
FlagField = Annotated[bool, flag]
Number = Annotated[float, number]
Count = Annotated[int, integer()]
Birth = Annotated[int, integer(0, 2**63)]
"""When an engine began (ns since 1970)."""
