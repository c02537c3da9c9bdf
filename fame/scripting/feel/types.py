"""``instance of``: the names of types, and what is of each (DMN 1.5, section 10.3.2.9, and Camunda's names)."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from fame.scripting.budget import spend
from fame.scripting.data import Evaluate, fields_of, is_list, is_number
from fame.scripting.feel.syntax import Lambda
from fame.scripting.feel.times import Temporal, kind_of
from fame.scripting.feel.values import Range
from fame.scripting.grammar import Parser

Test = Callable[[Any], bool]


def _of(kind: str) -> Test:
    return lambda value: kind_of(value) == kind


def _is_context(value: Any) -> bool:
    return isinstance(value, Mapping) or (bool(fields_of(value)) and not isinstance(value, (Range, Lambda)))


_TYPES: dict[str, Test] = {
    "boolean": lambda value: isinstance(value, bool),
    "number": is_number,
    "string": lambda value: isinstance(value, str) and value.__class__ is not Temporal,
    "date and time": _of("date and time"),
    "date time": _of("date and time"),
    "date": _of("date"),
    "time": _of("time"),
    "days and time duration": _of("days and time duration"),
    "day-time-duration": _of("days and time duration"),
    "years and months duration": _of("years and months duration"),
    "year-month-duration": _of("years and months duration"),
    "list": is_list,
    "context": _is_context,
    "range": lambda value: isinstance(value, Range),
    "function": lambda value: isinstance(value, Lambda),
    "Any": lambda value: value is not None,
    "Null": lambda value: value is None,
}
"""Name -> test; of two that begin alike the longer one comes first."""

_SIGNS = {name: re.findall(r"\w+|-", name) for name in _TYPES}


def instance(parser: Parser, left: Evaluate) -> Evaluate:
    """After ``instance``."""
    parser.expect("of")
    test = _type(parser)
    return lambda variables: test(left(variables))


def _type(parser: Parser) -> Test:
    name = next((name for name, signs in _SIGNS.items() if _begins(parser, signs)), None)
    if name is None:
        raise parser.unexpected(f"a type, which is one of {', '.join(_TYPES)}")
    for sign in _SIGNS[name]:
        parser.expect(sign)
    if name in ("list", "range") and parser.take("<"):
        item = _type(parser)
        parser.expect(">")
        return _items(item) if name == "list" else _ends(item)
    return _TYPES[name]


def _begins(parser: Parser, signs: list[str]) -> bool:
    return all(parser.at(sign, ahead) for ahead, sign in enumerate(signs))


def _items(test: Test) -> Test:
    def all_are(value: Any) -> bool:
        if not is_list(value):
            return False
        spend(len(value))
        return all(test(item) for item in value)

    return all_are


def _ends(test: Test) -> Test:
    return lambda value: isinstance(value, Range) and test(value.low) and test(value.high)
