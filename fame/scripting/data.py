"""The data that expressions can use, without access to Python objects; bounded arithmetic and conditions.

Data are numbers, texts, truth values, null, lists (also tuples and arrays), mappings, and objects with fields
(messages, and what a script made with plain attributes). Functions, classes, modules and names with a leading
underscore are rejected.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from numbers import Number
from types import ModuleType
from typing import Any, NamedTuple

# ---- values ----------------------------------------------------------------------------------------------------------


Evaluate = Callable[[Mapping[str, Any]], Any]
"""A compiled expression: a function of the variables."""

PLAIN = frozenset({int, float, str, bool, type(None), list, tuple, dict})
"""Types that are always data."""

NUMBERS = frozenset({int, float})


_TABLES = ("__field_names__", "__dataclass_fields__", "__dict__")
"""Where the names of fields are; the second has `class_` for the field `class` of a message, as until 0.3."""


class Undefined(NameError):
    """A name that is not set, or a field that an object does not have."""


class ExpressionError(ValueError):
    """An expression is wrong. `place` is the index of the letter where."""

    def __init__(self, text: str, place: int = 0) -> None:
        super().__init__(text)
        self.place = place


class Parsed(NamedTuple):
    """A parsed text: its value, the variables that it reads, and its constant parts that have loops or calls."""

    evaluate: Evaluate
    names: Mapping[str, None]
    constants: Sequence[Evaluate] = ()


def constant(value: Any) -> Evaluate:
    return lambda variables: value


def checked(value: Any, name: str) -> Any:
    """Return the value if it is data, that of a scalar of numpy as Python's own. Raises TypeError."""
    if value.__class__ in PLAIN:
        return value
    if value.__class__.__module__ == "numpy" and getattr(value, "shape", None) == ():
        return value.tolist()  # integers of numpy overflow without an error, and its truth values are not bool
    if callable(value) or isinstance(value, ModuleType):
        raise TypeError(f"`{name}` is not data: functions, classes and modules cannot be used here")
    return value


def is_number(value: Any) -> bool:
    """Return whether it is a number; true and false are not."""
    return value.__class__ in NUMBERS or (isinstance(value, Number) and not isinstance(value, bool))


def is_list(value: Any) -> bool:
    """Return whether it is a list, a tuple or an array; not a text."""
    if isinstance(value, (str, bytes)):
        return False
    return isinstance(value, Sequence) or (hasattr(value, "tolist") and hasattr(value, "__len__"))


def is_empty(value: Any) -> bool:
    """Null, an empty text, list or mapping (the operator ``empty`` of Jakarta EL, section 1.10)."""
    return value is None or ((isinstance(value, (str, Mapping)) or is_list(value)) and len(value) == 0)


def field(value: Any, name: str) -> Any:
    """Return the field of a mapping or object.

    Of null it is null, of a mapping without it too. Raises Undefined, TypeError.
    """
    if value.__class__ is dict or isinstance(value, Mapping):
        return checked(value.get(name), name)
    if value is None:
        return None
    if any(name in getattr(value, table, ()) for table in _TABLES):
        return checked(getattr(value, name), name)
    known = ", ".join(_fields(value))
    raise Undefined(f"{type(value).__name__} has no field `{name}`" + (f"; it has {known}" if known else ""))


def plain(value: Any) -> Any:
    """Return the value with arrays and tuples as lists, so that it can be compared."""
    if value.__class__ is tuple:
        return list(value)
    return value.tolist() if hasattr(value, "tolist") else value


def to_number(value: Any) -> int | float | None:
    """Return a number from a number or text; null from null. Raises TypeError."""
    if value is None or is_number(value):
        return value  # type: ignore[no-any-return]
    try:
        text = str(value).strip().replace("_", "no number")  # Python reads 1_000
        return int(text) if text.lstrip("+-").isdecimal() else float(text)
    except ValueError:
        raise TypeError(f"{value!r} is not a number") from None


def to_text(value: Any) -> str:
    """Return the text of a value as expressions write it: true, false; empty for null."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return str(value)


def fields_of(value: Any) -> dict[str, Any]:
    """Return the entries of a mapping or the fields of an object such as a message; empty if it has none."""
    if isinstance(value, Mapping):
        return dict(value)
    return {name: getattr(value, name) for name in _fields(value)}


def _fields(value: Any) -> list[str]:
    of_type = getattr(value, "__field_names__", ()) or getattr(value, "__dataclass_fields__", ())
    names = [*of_type, *getattr(value, "__dict__", ())]
    return [name for name in dict.fromkeys(names) if not name.startswith("_")]


# ---- arithmetic in a known time, whatever the numbers are ------------------------------------------------------------


_BITS = 4096
"""Longest product: each multiplication can double the length, so a few dozen of them would take forever."""


def product(left: Any, right: Any) -> Any:
    """``*``. Raises OverflowError for a whole number of more than 1,233 digits."""
    result = left * right
    if result.__class__ is int and result.bit_length() > _BITS:
        raise OverflowError("the product has more than 1233 digits")
    return result


def power(base: Any, exponent: Any) -> Any:
    """Compute in floating point, so that every exponent takes a short time; whole results of integers are integers."""
    result = math.pow(base, exponent)
    whole = isinstance(base, int) and isinstance(exponent, int) and result.is_integer() and abs(result) < 2**53
    return int(result) if whole else result


def quotient(dividend: Any, divisor: Any) -> Any:
    """Divide; a whole quotient of integers is an integer."""
    whole = isinstance(dividend, int) and isinstance(divisor, int) and dividend % divisor == 0
    return dividend // divisor if whole else dividend / divisor


# ---- conditions ------------------------------------------------------------------------------------------------------


_BOOLEANS = {"true": True, "false": False, "": False}
_SHOWN = 60


def judged(evaluate: Evaluate) -> Evaluate:
    """Evaluate as a condition: true or false, or TypeError that shows the value."""

    def judge(variables: Mapping[str, Any]) -> bool:
        value = evaluate(variables)
        return value if value is True or value is False else verdict(value)

    return judge


def verdict(value: Any) -> bool:
    """Return what a value means as a condition. Raises TypeError where it means neither: NaN, a list, other texts."""
    if isinstance(value, str):
        boolean = _BOOLEANS.get(value.strip().lower())
        if boolean is not None:
            return boolean
    elif value is None or (is_number(value) and value == value) or type(value).__name__ in ("bool", "bool_"):  # numpy's
        return bool(value)
    shown = repr(value)
    shown = shown if len(shown) <= _SHOWN else f"{shown[: _SHOWN - 3]}..."
    raise TypeError(f"the condition: expected true or false, got {shown}")
