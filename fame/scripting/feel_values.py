"""How FEEL compares, orders and looks into values (DMN 1.5, section 10.3.2): what has no answer is null."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from fame.scripting.data import Undefined, field, is_list, is_number, plain
from fame.scripting.feel_times import are_times, compared


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
    return bool(plain(left) == plain(right))


def order(compare: Callable[[Any, Any], bool], left: Any, right: Any) -> bool | None:
    """``<`` and the like, of two numbers or two texts; else null."""
    if are_times(left, right):
        return compared(compare, left, right)
    if (is_number(left) and is_number(right)) or (isinstance(left, str) and isinstance(right, str)):
        return bool(compare(left, right))
    return None


def power(base: Any, exponent: Any) -> Any:
    """In floating point, so that no exponent takes for ever; a whole result of whole numbers is whole."""
    result = math.pow(base, exponent)
    whole = isinstance(base, int) and isinstance(exponent, int) and result.is_integer() and abs(result) < 2**53
    return int(result) if whole else result


def quotient(dividend: Any, divisor: Any) -> Any:
    """A whole quotient of whole numbers is whole."""
    whole = isinstance(dividend, int) and isinstance(divisor, int) and dividend % divisor == 0
    return dividend // divisor if whole else dividend / divisor


def field_of(value: Any, name: str) -> Any:
    """``value.name``: of a list the list of its elements' fields; null where there is none."""
    if value.__class__ is not dict and is_list(value):
        return [field_of(item, name) for item in value]
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
        return any(within(value, one) for one in test)
    return equal(value, test)


def _kind(value: Any) -> str:
    if isinstance(value, bool):
        return "boolean"
    if is_number(value):
        return "number"
    return "list" if is_list(value) else type(value).__name__
