"""The expressions of Camunda 7, ``${...}``: the data side of Jakarta Expression Language 3 (its chapter 1).

A name that is not set is an error, except for ``empty``; a field of null is null. Texts that hold numbers count as
numbers beside numbers. Unlike there: ``+`` joins texts that are not numbers, an empty text is not a number, and
dividing by zero is an error, not infinity.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from fame.scripting.data import (
    PLAIN,
    Evaluate,
    ExpressionError,
    Parsed,
    Undefined,
    constant,
    field,
    is_empty,
    is_list,
    is_number,
    plain,
    product,
    to_number,
    to_text,
    verdict,
)
from fame.scripting.feel.functions import FUNCTIONS
from fame.scripting.grammar import (
    Dialect,
    ExpressionParser,
    Infix,
    infix,
    listing,
    mapping,
    numbers_first,
    parenthesized,
)
from fame.scripting.signatures import functions

Compare = Callable[[Any, Any], bool]
Compute = Callable[[Any, Any], Any]

OR, AND, EQUAL, ORDER, SUM, PRODUCT, UNARY, PATH = 2, 3, 4, 5, 6, 7, 8, 9
"""Binding powers; the ternary ``? :`` has 1."""


def truth(value: Any) -> bool:
    """EL section 1.23: null and the empty text are false, a text is true if it says so. Raises TypeError."""
    if isinstance(value, str):
        return value.lower() == "true"
    return verdict(value) if value.__class__ in PLAIN else bool(value)


def equal(left: Any, right: Any) -> bool:
    """``==``, after EL section 1.8.2."""
    if left is None or right is None:
        return left is right
    if left.__class__ is str and right.__class__ is str:
        return bool(left == right)
    if isinstance(left, bool) != isinstance(right, bool):
        return isinstance(left, (bool, str)) and isinstance(right, (bool, str)) and truth(left) == truth(right)
    if is_number(left) != is_number(right):
        try:
            left, right = to_number(left), to_number(right)
        except TypeError:
            return False
    return bool(plain(left) == plain(right))


def order(compare: Compare, left: Any, right: Any) -> bool:
    """``<`` and the like, after EL section 1.8.1: with null it is false. Raises TypeError for what has no order."""
    if left is None or right is None:
        return False
    if is_number(left) or is_number(right):
        left, right = to_number(left), to_number(right)
    elif not (isinstance(left, str) and isinstance(right, str)):
        raise TypeError(f"{left!r} and {right!r} have no order")
    return compare(left, right)


def item_of(value: Any, key: Any) -> Any:
    """``value[key]``: an element (0-based) of a list or text, a field of anything else; outside it is null."""
    if value is None or key is None:
        return None
    if isinstance(value, str) or is_list(value):
        index = int(to_number(key) or 0)
        return plain(value[index]) if 0 <= index < len(value) else None
    if not isinstance(key, str):
        return value.get(key) if isinstance(value, Mapping) else None
    if key.startswith("_"):
        raise TypeError(f"`{key}`: names with a leading underscore cannot be used here")
    return field(value, key)


def _same(left: Any, right: Any) -> bool:
    """``equals`` of Java, which converts nothing."""
    return isinstance(left, bool) == isinstance(right, bool) and bool(plain(left) == plain(right))


def _place(items: Any, item: Any) -> int:
    return next((place for place, each in enumerate(plain(items)) if _same(each, item)), -1)


_METHODS: dict[str, Callable[..., Any]] = {
    "size": len,
    "length": len,
    "isEmpty": is_empty,
    "contains": lambda value, item: item in value if isinstance(value, str) else _place(value, item) >= 0,
    "containsKey": lambda value, key: key in value,
    "get": item_of,
    "indexOf": lambda value, item: value.find(item) if isinstance(value, str) else _place(value, item),
    "equals": _same,
    "startsWith": lambda value, part: to_text(value).startswith(part),
    "endsWith": lambda value, part: to_text(value).endswith(part),
    "toLowerCase": lambda value: to_text(value).lower(),
    "toUpperCase": lambda value: to_text(value).upper(),
    "toString": to_text,
    "trim": lambda value: to_text(value).strip(),
}
"""The methods of Java's texts, lists and maps that models call."""
_BINARY = {"contains", "containsKey", "get", "indexOf", "equals", "startsWith", "endsWith"}
"""Those that take an argument."""


def _comparison(compare: Compare) -> Callable[[Evaluate, Evaluate], Evaluate]:
    return numbers_first(compare, partial(order, compare))


def _equality(compare: Compare) -> Callable[[Evaluate, Evaluate], Evaluate]:
    return numbers_first(compare, lambda left, right: compare(equal(left, right), True))


def _arithmetic(compute: Compute) -> Callable[[Evaluate, Evaluate], Evaluate]:
    return numbers_first(compute, lambda left, right: compute(to_number(left) or 0, to_number(right) or 0))


def _plus(left: Any, right: Any) -> Any:
    """The sum; of texts that are not numbers, the two joined."""
    try:
        return (to_number(left) or 0) + (to_number(right) or 0)
    except TypeError:
        if isinstance(left, str) or isinstance(right, str):
            return to_text(left) + to_text(right)
        raise


def _remainder(dividend: Any, divisor: Any) -> Any:
    """With the sign of the dividend, as in Java."""
    if isinstance(dividend, int) and isinstance(divisor, int):
        return abs(dividend) % abs(divisor) * (-1 if dividend < 0 else 1)
    return math.fmod(dividend, divisor)


def _both(left: Evaluate, right: Evaluate) -> Evaluate:
    return lambda variables: truth(left(variables)) and truth(right(variables))


def _either(left: Evaluate, right: Evaluate) -> Evaluate:
    return lambda variables: truth(left(variables)) or truth(right(variables))


def _not(parser: ExpressionParser) -> Evaluate:
    operand = parser.expression(UNARY)
    return lambda variables: not truth(operand(variables))


def _minus(parser: ExpressionParser) -> Evaluate:
    operand = parser.expression(UNARY)
    return lambda variables: -(to_number(operand(variables)) or 0)


def _empty(parser: ExpressionParser) -> Evaluate:
    operand = parser.expression(UNARY)

    def evaluate(variables: Mapping[str, Any]) -> bool:
        try:
            return is_empty(operand(variables))
        except Undefined:
            return True

    return evaluate


def _ternary(parser: ExpressionParser, condition: Evaluate) -> Evaluate:
    then = parser.expression()
    parser.expect(":")
    otherwise = parser.expression()
    return lambda variables: then(variables) if truth(condition(variables)) else otherwise(variables)


def _path(parser: ExpressionParser, left: Evaluate) -> Evaluate:
    place, name = parser.token.place, parser.name()
    if parser.take("("):
        if name not in _METHODS:
            raise ExpressionError(f"the method `{name}` cannot be called here; {', '.join(_METHODS)} can", place)
        method, arguments = _METHODS[name], parser.listed(")")
        if len(arguments) != (name in _BINARY):
            raise ExpressionError(f"`{name}` takes {'one argument' if name in _BINARY else 'no arguments'}", place)
        return lambda variables: method(left(variables), *[argument(variables) for argument in arguments])
    return lambda variables: field(left(variables), name)


def _index(parser: ExpressionParser, left: Evaluate) -> Evaluate:
    key = parser.expression()
    parser.expect("]")
    return lambda variables: item_of(left(variables), key(variables))


def _table() -> dict[str, tuple[int, Infix]]:
    operators: list[tuple[str, int, Callable[[Evaluate, Evaluate], Evaluate]]] = [
        ("|| or", OR, _either),
        ("&& and", AND, _both),
        ("== eq", EQUAL, _equality(operator.eq)),
        ("!= ne", EQUAL, _equality(operator.ne)),
        ("< lt", ORDER, _comparison(operator.lt)),
        ("<= le", ORDER, _comparison(operator.le)),
        ("> gt", ORDER, _comparison(operator.gt)),
        (">= ge", ORDER, _comparison(operator.ge)),
        ("+", SUM, numbers_first(operator.add, _plus)),
        ("-", SUM, _arithmetic(operator.sub)),
        ("*", PRODUCT, _arithmetic(product)),
        ("/ div", PRODUCT, _arithmetic(operator.truediv)),
        ("% mod", PRODUCT, _arithmetic(_remainder)),
    ]
    table = {sign: infix(power, combine) for signs, power, combine in operators for sign in signs.split()}
    return table | {"?": (1, _ternary), ".": (PATH, _path), "[": (PATH, _index)}


_SHARED = frozenset({
    "abs", "floor", "ceiling", "round", "sqrt", "modulo", "number", "string", "count", "sum", "min", "max", "mean",
    "append", "concatenate", "reverse", "contains", "substring", "duration", "cycle",
})  # fmt: skip
_FUNCTIONS = {name: function for name, function in FUNCTIONS.items() if name in _SHARED} | functions(
    {"split(string: string, separator: string)": lambda text, separator: text.split(separator)}
)
"""The functions of FEEL with one-word names on numbers, texts and lists; a separator is plain text."""

JUEL = Dialect(
    name="${...}",
    prefixes={
        "true": lambda parser: constant(True),
        "false": lambda parser: constant(False),
        "null": lambda parser: constant(None),
        "not": _not,
        "!": _not,
        "-": _minus,
        "empty": _empty,
        "(": parenthesized,
        "[": listing,
        "{": mapping,
    },
    infixes=_table(),
    functions=_FUNCTIONS,
    undefined_is_null=False,
)
"""The language."""


def parse_juel(text: str) -> Parsed:
    """Return the expression. Raises ExpressionError."""
    return ExpressionParser(text, JUEL).parsed()
