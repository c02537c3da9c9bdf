"""The expressions of Camunda 8, ``=...``: the common subset of FEEL (DMN 1.5, chapter 10).

An operation that cannot be computed gives null (a name that is not set, a text minus a number, a division by zero),
and a condition that is null counts as false. Lists count from 1, and from -1 at their end.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from fame.engine.data import Temporal
from fame.scripting.budget import spend, weight
from fame.scripting.data import Evaluate, Parsed, constant, fields_of, is_list, is_number, power, product, quotient
from fame.scripting.feel.functions import FUNCTIONS
from fame.scripting.feel.functions.dates import literal
from fame.scripting.feel.syntax import (
    COMPARE,
    Lambda,
    bracket,
    context,
    definition,
    index_or_filter,
    invocation,
    iteration,
    parenthesis,
    quantified,
    span,
)
from fame.scripting.feel.values import (
    Bound,
    Range,
    are_times,
    computed,
    equal,
    field_of,
    kind_of,
    order,
    within,
)
from fame.scripting.grammar import Dialect, ExpressionParser, Infix, infix, numbers_first

OR, AND, SUM, PRODUCT, POWER, UNARY, PATH = 1, 2, 4, 5, 6, 7, 8
"""Binding powers (DMN 1.5, section 10.3.1.2); comparisons have `COMPARE`, 3."""


# ---- operators -------------------------------------------------------------------------------------------------------


def _comparison(compare: Callable[[Any, Any], bool]) -> Callable[[Evaluate, Evaluate], Evaluate]:
    return numbers_first(compare, partial(order, compare))


def _equality(compare: Callable[[Any, Any], bool]) -> Callable[[Evaluate, Evaluate], Evaluate]:
    def otherwise(left: Any, right: Any) -> bool | None:
        result = equal(left, right)
        return None if result is None else compare(result, True)

    return numbers_first(compare, otherwise)


def _arithmetic(compute: Callable[[Any, Any], Any]) -> Callable[[Evaluate, Evaluate], Evaluate]:
    def combine(left: Evaluate, right: Evaluate) -> Evaluate:
        def evaluate(variables: Mapping[str, Any]) -> Any:
            a, b = left(variables), right(variables)
            if is_number(a) and is_number(b):
                try:
                    result = compute(a, b)
                    return result if result.__class__ is not float or math.isfinite(result) else None
                except (ArithmeticError, ValueError):
                    return None
            if are_times(a, b) or _scales(a, b) or _scales(b, a):
                try:
                    return computed(compute, a, b)
                except (ArithmeticError, ValueError):
                    return None
            return _joined(a, b) if compute is operator.add and isinstance(a, str) and isinstance(b, str) else None

        return evaluate

    return combine


def _scales(number: Any, time: Any) -> bool:
    return time.__class__ is Temporal and is_number(number)


def _joined(left: str, right: str) -> str:
    text = left + right
    spend(weight(text))
    return text


def _connective(decisive: bool) -> Callable[[Evaluate, Evaluate], Evaluate]:
    """``and`` (false is decisive) or ``or`` (true is) of three values: what is decisive wins over null (DMN 1.5, table
    48)."""
    other = not decisive

    def connect(left: Evaluate, right: Evaluate) -> Evaluate:
        def evaluate(variables: Mapping[str, Any]) -> Any:
            first = left(variables)
            if first is decisive:
                return decisive
            second = right(variables)
            if second is decisive:
                return decisive
            return other if first is other and second is other else None

        return evaluate

    return connect


def _between(parser: ExpressionParser, left: Evaluate) -> Evaluate:
    low = parser.expression(COMPARE)
    parser.expect("and")
    high = parser.expression(COMPARE)
    return lambda variables: Range(low(variables), high(variables)).has(left(variables))


def _in(parser: ExpressionParser, left: Evaluate) -> Evaluate:
    test = _tests(parser) if parser.take("(") else _test(parser)
    return lambda variables: within(left(variables), test(variables))


_BOUNDS = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}


def _tests(parser: ExpressionParser) -> Evaluate:
    """After ``in (``: tests with commas between them, or a range without its lower end."""
    tests = [_test(parser)]
    if parser.at(".."):
        return span(parser, tests[0], with_low=False)
    while parser.take(","):
        tests.append(_test(parser))
    parser.expect(")")
    return lambda variables: [test(variables) for test in tests]


def _test(parser: ExpressionParser) -> Evaluate:
    sign = next((sign for sign in _BOUNDS if parser.take(sign)), None)
    value = parser.expression(COMPARE)
    return value if sign is None else lambda variables: Bound(_BOUNDS[sign], value(variables))


_SECOND = {"time": "offset", "start": "included", "end": "included"}
"""Properties of two words."""


def _path(parser: ExpressionParser, left: Evaluate) -> Evaluate:
    name = parser.name()
    if name in _SECOND and parser.take(_SECOND[name]):
        name = f"{name} {_SECOND[name]}"
    return lambda variables: field_of(left(variables), name)


# ---- types (DMN 1.5, section 10.3.2.9; Camunda's names) ------------------------------------------------------------

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


def instance(parser: ExpressionParser, left: Evaluate) -> Evaluate:
    """After ``instance``."""
    parser.expect("of")
    test = _type(parser)
    return lambda variables: test(left(variables))


def _type(parser: ExpressionParser) -> Test:
    name = next((name for name, signs in _SIGNS.items() if _begins(parser, signs)), None)
    if name is None:
        raise parser.unexpected(f"a type, which is one of {', '.join(_TYPES)}")
    for sign in _SIGNS[name]:
        parser.expect(sign)
    if name in ("list", "range") and parser.take("<"):
        item = _type(parser)
        parser.expect(">")
        return _items(item) if name == "list" else _ends(item)
    if name == "context" and parser.take("<"):
        return _has([_field(parser) for _ in parser.separated(">")])
    if name == "function" and parser.take("<"):
        count = sum(_type(parser) is not None for _ in parser.separated(">"))
        parser.expect("-")
        parser.expect(">")
        _type(parser)
        return lambda value: isinstance(value, Lambda) and len(value.names) == count
    return _TYPES[name]


def _field(parser: ExpressionParser) -> tuple[str, Test]:
    key = parser.key()
    return key, _type(parser)


def _has(fields: Sequence[tuple[str, Test]]) -> Test:
    def fits(value: Any) -> bool:
        known = fields_of(value) if _is_context(value) else {}
        return _is_context(value) and all(key in known and test(known[key]) for key, test in fields)

    return fits


def _begins(parser: ExpressionParser, signs: list[str]) -> bool:
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


# ---- first tokens of an operand --------------------------------------------------------------------------------------


def _not(parser: ExpressionParser) -> Evaluate:
    operand = parser.expression(UNARY if parser.at("(") else AND)  # `not x = 4` is about the comparison

    def evaluate(variables: Mapping[str, Any]) -> bool | None:
        value = operand(variables)
        return not value if isinstance(value, bool) else None

    return evaluate


def _minus(parser: ExpressionParser) -> Evaluate:
    operand = parser.expression(UNARY)

    def evaluate(variables: Mapping[str, Any]) -> Any:
        value = operand(variables)
        if value.__class__ is Temporal:
            return computed(product, value, -1)
        return -value if is_number(value) else None

    return evaluate


def _if(parser: ExpressionParser) -> Evaluate:
    condition = parser.expression()
    parser.expect("then")
    then = parser.expression()
    parser.expect("else")
    otherwise = parser.expression()
    return lambda variables: then(variables) if condition(variables) is True else otherwise(variables)


def _literal(parser: ExpressionParser) -> Evaluate:
    """After ``@``: a date, a time, both, or a duration."""
    return constant(literal(str(parser.advance().value)))


def _table() -> dict[str, tuple[int, Infix]]:
    operators: dict[str, tuple[int, Callable[[Evaluate, Evaluate], Evaluate]]] = {
        "or": (OR, _connective(True)),
        "and": (AND, _connective(False)),
        "=": (COMPARE, _equality(operator.eq)),
        "!=": (COMPARE, _equality(operator.ne)),
        "<": (COMPARE, _comparison(operator.lt)),
        "<=": (COMPARE, _comparison(operator.le)),
        ">": (COMPARE, _comparison(operator.gt)),
        ">=": (COMPARE, _comparison(operator.ge)),
        "+": (SUM, _arithmetic(operator.add)),
        "-": (SUM, _arithmetic(operator.sub)),
        "*": (PRODUCT, _arithmetic(product)),
        "/": (PRODUCT, _arithmetic(quotient)),
        "**": (POWER, _arithmetic(power)),
    }
    table = {sign: infix(power, combine) for sign, (power, combine) in operators.items()}
    return table | {
        "between": (COMPARE, _between),
        "in": (COMPARE, _in),
        "instance": (UNARY, instance),
        "(": (PATH, invocation),
        ".": (PATH, _path),
        "[": (PATH, index_or_filter),
    }


FEEL = Dialect(
    name="=...",
    prefixes={
        "true": lambda parser: constant(True),
        "false": lambda parser: constant(False),
        "null": lambda parser: constant(None),
        "not": _not,
        "-": _minus,
        "if": _if,
        "for": iteration,
        "some": quantified(True),
        "every": quantified(False),
        "function": definition,
        "@": _literal,
        "(": parenthesis,
        "[": bracket,
        "]": lambda parser: span(parser, parser.expression(), with_low=False),
        "{": context,
    },
    infixes=_table(),
    functions=FUNCTIONS,
    undefined_is_null=True,
)
"""The language."""


def parse_feel(text: str) -> Parsed:
    """Return the expression. Raises ExpressionError."""
    return ExpressionParser(text, FEEL).parsed()
