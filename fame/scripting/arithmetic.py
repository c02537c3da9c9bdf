"""The arithmetic of expressions that has to be bounded: a step of them takes a known time, whatever the numbers are."""

from __future__ import annotations

import math
from typing import Any

_BITS = 4096
"""Longest product: each multiplication can double the length, so a few dozen of them would take for ever."""


def product(left: Any, right: Any) -> Any:
    """``*``. Raises OverflowError for a whole number of more than 1,233 digits."""
    result = left * right
    if result.__class__ is int and result.bit_length() > _BITS:
        raise OverflowError("the product has more than 1233 digits")
    return result


def power(base: Any, exponent: Any) -> Any:
    """In floating point, so that no exponent takes for ever; a whole result of whole numbers is whole."""
    result = math.pow(base, exponent)
    whole = isinstance(base, int) and isinstance(exponent, int) and result.is_integer() and abs(result) < 2**53
    return int(result) if whole else result


def quotient(dividend: Any, divisor: Any) -> Any:
    """A whole quotient of whole numbers is whole."""
    whole = isinstance(dividend, int) and isinstance(divisor, int) and dividend % divisor == 0
    return dividend // divisor if whole else dividend / divisor
