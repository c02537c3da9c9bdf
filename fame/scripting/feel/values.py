"""How FEEL compares, orders and looks into values (DMN 1.5, section 10.3.2): what has no answer is null."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from fame.iso8601 import Duration
from fame.scripting.budget import spend
from fame.scripting.data import Undefined, field, fields_of, is_list, is_number, plain
from fame.scripting.feel.times import Temporal, are_times, compared, parsed, property_of


@dataclass(frozen=True, slots=True)
class Range:
    """``[low..high]``, or with a round bracket without that end."""

    low: Any
    high: Any
    with_low: bool = True
    with_high: bool = True

    def has(self, value: Any) -> bool | None:
        """Whether it lies between the ends; null if that has no order."""
        above = order(operator.ge if self.with_low else operator.gt, value, self.low)
        below = order(operator.le if self.with_high else operator.lt, value, self.high)
        return None if above is None or below is None else above and below


@dataclass(frozen=True, slots=True)
class Bound:
    """``< value``, as a test of ``in``."""

    compare: Callable[[Any, Any], bool]
    value: Any


def equal(left: Any, right: Any) -> bool | None:
    """``=``: null for values of different kinds, unless one is null."""
    if left is None or right is None:
        return left is right
    if are_times(left, right):
        return compared(operator.eq, left, right)
    if _kind(left) != _kind(right):
        return None
    return bool(identity(left) == identity(right))


def identity(value: Any) -> Any:
    """What is the same of two values that are equal, and of no others; it can be hashed."""
    if value.__class__ in (str, int, float, type(None)):
        return value
    spend(1)
    if value.__class__ is Temporal:
        found = parsed(value)
        return found if isinstance(found, Duration) else (found.kind, bool(found.zone), found.at)
    if isinstance(value, bool):
        return ("boolean", value)
    if isinstance(value, Mapping):
        return frozenset((key, identity(item)) for key, item in value.items())
    if is_list(value):
        return tuple([identity(item) for item in plain(value)])
    return value if is_number(value) else (type(value), _attributes(value))


def order(compare: Callable[[Any, Any], bool], left: Any, right: Any) -> bool | None:
    """``<`` and the like, of two numbers or two texts; else null."""
    if are_times(left, right):
        return compared(compare, left, right)
    if (is_number(left) and is_number(right)) or (isinstance(left, str) and isinstance(right, str)):
        return bool(compare(left, right))
    return None


def field_of(value: Any, name: str) -> Any:
    """``value.name``: of a list the list of its elements' fields; null where there is none."""
    if value.__class__ is not dict and is_list(value):
        return [field_of(item, name) for item in value]
    if value.__class__ is Temporal:
        return property_of(value, name)
    if isinstance(value, Range):
        ends = {"start": value.low, "end": value.high}
        return ends.get(name, {"start included": value.with_low, "end included": value.with_high}.get(name))
    try:
        return field(value, name)
    except Undefined:
        return None


def within(value: Any, test: Any) -> bool | None:
    """``value in test``: a range, a bound, a value, or a list of such tests."""
    if isinstance(test, Range):
        return test.has(value)
    if isinstance(test, Bound):
        return order(test.compare, value, test.value)
    if is_list(test):
        spend(len(test))
        return (is_list(value) and equal(value, test)) or any(within(value, one) for one in plain(test))
    return equal(value, test)


def _kind(value: Any) -> str:
    if isinstance(value, bool):
        return "boolean"
    if is_number(value):
        return "number"
    if isinstance(value, Mapping):
        return "context"
    return "list" if is_list(value) else type(value).__name__


def _attributes(value: Any) -> Any:
    fields = fields_of(value)
    return frozenset((key, identity(item)) for key, item in fields.items()) if fields else id(value)
