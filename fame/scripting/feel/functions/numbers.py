"""The functions of FEEL about numbers and ranges.

Numbers are rounded in decimal, as they are written. The relations of ranges and points are those of DMN 1.5, table 78;
a point is a range from itself to itself.
"""

from __future__ import annotations

import decimal
import math
import operator
from collections.abc import Callable, Mapping
from typing import Any

from fame.iso8601 import Duration
from fame.scripting.data import is_number
from fame.scripting.feel.values import Range, kind_of, order, parsed, temporal
from fame.scripting.interface import random_source
from fame.scripting.signatures import functions

_SCALES = range(-6111, 6177)
"""Digits after the point (DMN 1.5, section 10.3.4.5, table 75: those of 128-bit decimals)."""

_EXACT = decimal.Context(prec=20_000)
_MODES = {
    "up": decimal.ROUND_UP,
    "down": decimal.ROUND_DOWN,
    "ceiling": decimal.ROUND_CEILING,
    "floor": decimal.ROUND_FLOOR,
    "half_up": decimal.ROUND_HALF_UP,
    "half_down": decimal.ROUND_HALF_DOWN,
    "half_even": decimal.ROUND_HALF_EVEN,
}


def rounded(value: Any, scale: Any, mode: str) -> Any:
    """Round to that number of digits after the point. Raises ValueError."""
    if scale != int(scale) or int(scale) not in _SCALES or mode.lower() not in _MODES:
        raise ValueError(f"expected a scale within -6111..6176 and a rounding mode, got {scale!r} and {mode!r}")
    if isinstance(value, int) and scale >= 0:
        return value
    exact = decimal.Decimal(value if isinstance(value, int) else repr(float(value)))
    digits = -int(exact.as_tuple().exponent)
    result = exact.quantize(decimal.Decimal(1).scaleb(-min(int(scale), digits)), _MODES[mode.lower()], _EXACT)
    return int(result) if scale <= 0 else float(result)


def _rounding(mode: str) -> Callable[..., Any]:
    return lambda value, scale=0: rounded(value, scale, mode)


def _abs(value: Any) -> Any:
    """The absolute value of a number or a duration."""
    if is_number(value):
        return abs(value)
    if kind_of(value)[-8:] != "duration":
        raise ValueError(f"{value!r} is not a number")
    length = parsed(value)
    assert isinstance(length, Duration)
    return temporal(length * (-1 if (length.months or length.rest) < 0 else 1))


def _random(variables: Mapping[str, Any]) -> float | None:
    source = random_source(variables)
    return None if source is None else source.random()


NUMBERS = functions({"random number()": _random}, sees=True) | functions(
    {
        "abs(n: value)": _abs,
        "floor(n: number, scale?: number)": _rounding("floor"),
        "ceiling(n: number, scale?: number)": _rounding("ceiling"),
        "round(n: number, scale?: number)": _rounding("half_even"),
        "round up(n: number, scale?: number)": _rounding("up"),
        "round down(n: number, scale?: number)": _rounding("down"),
        "round half up(n: number, scale?: number)": _rounding("half_up"),
        "round half down(n: number, scale?: number)": _rounding("half_down"),
        "decimal(n: number, scale: number, mode?: string)": lambda n, scale, mode="half_even": rounded(n, scale, mode),
        "sqrt(number: number)": math.sqrt,
        "modulo(dividend: number, divisor: number)": lambda dividend, divisor: dividend % divisor,
        "log(number: number)": math.log,
        "exp(number: number)": math.exp,
        "odd(number: number)": lambda number: number % 2 == 1,
        "even(number: number)": lambda number: number % 2 == 0,
    }
)
"""Name -> its signatures."""


# ---- ranges ----------------------------------------------------------------------------------------------------------


def _less(left: Any, right: Any) -> bool:
    found = order(operator.lt, left, right)
    if found is None:
        raise TypeError(f"{left!r} and {right!r} have no order")
    return found


def _same(left: Any, right: Any) -> bool:
    return not _less(left, right) and not _less(right, left)


def _before(a: Range, b: Range) -> bool:
    return _less(a.high, b.low) or (_same(a.high, b.low) and not (a.with_high and b.with_low))


def _meets(a: Range, b: Range) -> bool:
    return a.with_high and b.with_low and _same(a.high, b.low)


def _begins_no_later(a: Range, b: Range) -> bool:
    return _less(a.low, b.low) or (_same(a.low, b.low) and (a.with_low or not b.with_low))


def _ends_no_earlier(a: Range, b: Range) -> bool:
    return _less(b.high, a.high) or (_same(a.high, b.high) and (a.with_high or not b.with_high))


def _overlaps(a: Range, b: Range) -> bool:
    return not _before(a, b) and not _before(b, a)


def _overlaps_before(a: Range, b: Range) -> bool:
    return _overlaps(a, b) and not _begins_no_later(b, a) and _ends_no_earlier(b, a)


def _finishes(a: Range, b: Range) -> bool:
    return _same(a.high, b.high) and a.with_high == b.with_high and _begins_no_later(b, a)


def _starts(a: Range, b: Range) -> bool:
    return _same(a.low, b.low) and a.with_low == b.with_low and _ends_no_earlier(b, a)


def _includes(a: Range, b: Range) -> bool:
    return _begins_no_later(a, b) and _ends_no_earlier(a, b)


def _coincides(a: Range, b: Range) -> bool:
    return _includes(a, b) and _includes(b, a)


def _swapped(relation: Callable[[Range, Range], bool]) -> Callable[[Range, Range], bool]:
    return lambda a, b: relation(b, a)


def _relation(relation: Callable[[Range, Range], bool]) -> Callable[[Any, Any], bool]:
    def of(*values: Any) -> bool:
        a, b = (value if isinstance(value, Range) else Range(value, value) for value in values)
        return relation(a, b)

    return of


_RELATIONS: dict[str, Callable[[Range, Range], bool]] = {
    "before": _before,
    "after": _swapped(_before),
    "meets": _meets,
    "met by": _swapped(_meets),
    "overlaps": _overlaps,
    "overlaps before": _overlaps_before,
    "overlaps after": _swapped(_overlaps_before),
    "finishes": _finishes,
    "finished by": _swapped(_finishes),
    "includes": _includes,
    "during": _swapped(_includes),
    "starts": _starts,
    "started by": _swapped(_starts),
    "coincides": _coincides,
}

RANGES = functions(
    {f"{name}(range1: value, range2: value)": _relation(relation) for name, relation in _RELATIONS.items()}
)
"""Name -> its signatures."""
