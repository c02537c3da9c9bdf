"""The functions of FEEL about numbers. Roundings are decimal, digit by digit, as the number is written."""

from __future__ import annotations

import decimal
import math
from collections.abc import Callable, Mapping
from typing import Any

from fame.iso8601 import Duration
from fame.scripting.data import is_number
from fame.scripting.feel.times import kind_of, parsed, told
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
    """A number with so many digits after the point. Raises ValueError."""
    if scale != int(scale) or int(scale) not in _SCALES or mode.lower() not in _MODES:
        raise ValueError(f"{scale!r} digits cannot be rounded to, or {mode!r} is no way to do so")
    if isinstance(value, int) and scale >= 0:
        return value
    exact = decimal.Decimal(value if isinstance(value, int) else repr(float(value)))
    digits = -int(exact.as_tuple().exponent)
    result = exact.quantize(decimal.Decimal(1).scaleb(-min(int(scale), digits)), _MODES[mode.lower()], _EXACT)
    return int(result) if scale <= 0 else float(result)


def _rounding(mode: str) -> Callable[..., Any]:
    return lambda value, scale=0: rounded(value, scale, mode)


def _abs(value: Any) -> Any:
    """Of a number or a duration."""
    if is_number(value):
        return abs(value)
    if kind_of(value)[-8:] != "duration":
        raise ValueError(f"{value!r} is not a number")
    length = parsed(value)
    assert isinstance(length, Duration)
    return told(length * (-1 if (length.months or length.rest) < 0 else 1))


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
