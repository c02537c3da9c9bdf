"""The functions that expressions may call: a table, by the names of FEEL (DMN 1.5, table 72 and following).

Durations, dates and the cycles of Camunda 8 are for timers: they stay the text that ISO 8601 has for them.
Null in, null out, except where a function is about null or about lists.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from fame.scripting.data import is_list, is_number, plain
from fame.scripting.feel_times import Time


def to_number(value: Any) -> int | float | None:
    """A number from a number or text; null from null. Raises TypeError."""
    if value is None or is_number(value):
        return value  # type: ignore[no-any-return]
    try:
        text = str(value).strip()
        return int(text) if text.lstrip("+-").isdecimal() else float(text)
    except ValueError:
        raise TypeError(f"{value!r} is not a number") from None


def to_text(value: Any) -> str:
    """As it is written in an expression: true, false, the text itself; nothing for null."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return str(value)


def _or_null(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *values: None if any(value is None for value in values) else function(*values)


def _over(function: Callable[[list[Any]], Any]) -> Callable[..., Any]:
    """Of a list, or of the arguments; null where there is nothing."""

    def over(*values: Any) -> Any:
        items = list(plain(values[0])) if len(values) == 1 and is_list(values[0]) else list(values)
        return function(items) if items and None not in items else None

    return over


def _sub(text: str, start: int, length: int | None = None) -> str:
    first = start - 1 if start > 0 else len(text) + start
    if start == 0 or not 0 <= first <= len(text):
        raise ValueError(f"the text has no place {start}")
    return text[first:] if length is None else text[first : first + length]


def _round_to(rounding: Callable[[float], int]) -> Callable[..., Any]:
    def rounded(value: float, digits: int = 0) -> float:
        return rounding(value * 10**digits) / 10**digits if digits else rounding(value)

    return _or_null(rounded)


def _put(context: Any, keys: Any, value: Any) -> dict[str, Any]:
    """The context with another value under a key, or under a path of keys (DMN 1.5, table 81)."""
    first, *rest = keys if isinstance(keys, list) else [keys]
    entries = dict(plain(context)) if isinstance(context, dict) else {}
    return {**entries, first: _put(entries.get(first), rest, value) if rest else value}


FUNCTIONS: dict[str, Callable[..., Any]] = {
    "abs": _or_null(abs),
    "floor": _round_to(math.floor),
    "ceiling": _round_to(math.ceil),
    "round": _or_null(round),
    "sqrt": _or_null(math.sqrt),
    "modulo": _or_null(lambda dividend, divisor: dividend % divisor),
    "number": to_number,
    "string": lambda value: None if value is None else to_text(value),
    "count": lambda items: 0 if items is None else len(items) if is_list(items) else 1,
    "sum": _over(sum),
    "min": _over(min),
    "max": _over(max),
    "mean": _over(lambda items: sum(items) / len(items)),
    "append": lambda items, *more: [*(items or ()), *more],
    "concatenate": lambda *lists: [item for items in lists for item in items or ()],
    "reverse": _or_null(lambda items: list(plain(items))[::-1]),
    "list contains": lambda items, item: item in (() if items is None else plain(items)),
    "contains": _or_null(lambda text, part: part in text),
    "starts with": _or_null(lambda text, part: text.startswith(part)),
    "ends with": _or_null(lambda text, part: text.endswith(part)),
    "upper case": _or_null(lambda text: text.upper()),
    "lower case": _or_null(lambda text: text.lower()),
    "string length": _or_null(len),
    "substring": _or_null(_sub),
    "context put": _put,
    "split": _or_null(lambda text, separator: text.split(separator)),
    "duration": lambda value: Time(to_text(value)),
    "date and time": lambda value: Time(to_text(value)),
    "cycle": lambda *parts: f"R{parts[0]}/{parts[1]}" if len(parts) == 2 else f"R/{to_text(*parts)}",
}
"""Name -> function."""
