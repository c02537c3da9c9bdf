"""The part of FEEL that is about lists and ranges: brackets, filters, ``for``, ``some``, ``every``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from fame.engine.variables import Variables
from fame.scripting.data import is_list, is_number, plain
from fame.scripting.feel_values import Range
from fame.scripting.grammar import Evaluate, Parser, listing

COMPARE = 3
"""Binding power of comparisons: what stands between ``in`` and ``return`` binds tighter."""


def index_or_filter(parser: Parser, left: Evaluate) -> Evaluate:
    """After ``[``: a place, counted from 1 or from -1 at the end; or a condition on `item`."""
    inner = parser.inside(["item"])
    parser.expect("]")

    def evaluate(variables: Mapping[str, Any]) -> Any:
        value = left(variables)
        items = list(plain(value)) if is_list(value) else [] if value is None else [value]
        place = inner(_item_scope(variables, items[0] if items else None))
        if is_number(place):
            place = int(place)
            return items[place - 1 if place > 0 else place] if place and -len(items) <= place <= len(items) else None
        return [item for item in items if inner(_item_scope(variables, item)) is True]

    return evaluate


def _item_scope(variables: Mapping[str, Any], item: Any) -> Variables:
    """In a filter `item` is the element; its fields are names, too."""
    fields = item if isinstance(item, Mapping) else {
        name: getattr(item, name) for name in getattr(type(item), "__dataclass_fields__", ())
    }  # fmt: skip
    return _scope(variables, {"item": item, **fields})


def _scope(variables: Mapping[str, Any], names: Mapping[str, Any]) -> Variables:
    return Variables(variables if isinstance(variables, dict) else dict(variables), names)


def bracket(parser: Parser) -> Evaluate:
    """After ``[``: a list or a range."""
    if parser.take("]"):
        return lambda variables: []
    first = parser.expression()
    if parser.at(".."):
        return span(parser, first, with_low=True)
    if parser.take("]"):
        return lambda variables: [first(variables)]
    parser.expect(",")
    rest = listing(parser)
    return lambda variables: [first(variables), *rest(variables)]


def parenthesis(parser: Parser) -> Evaluate:
    """After ``(``: an expression or a range."""
    first = parser.expression()
    if parser.at(".."):
        return span(parser, first, with_low=False)
    parser.expect(")")
    return first


def span(parser: Parser, low: Evaluate, *, with_low: bool) -> Evaluate:
    parser.expect("..")
    high = parser.expression()
    with_high = parser.take("]")
    if not with_high:
        parser.expect(")")
    return lambda variables: Range(low(variables), high(variables), with_low, with_high)


def _iterated(parser: Parser) -> tuple[str, Callable[[Mapping[str, Any]], Iterable[Any]]]:
    """``x in items`` or ``i in 1..5``."""
    name = parser.name()
    parser.expect("in")
    first = parser.expression(COMPARE)
    last = parser.expression(COMPARE) if parser.take("..") else None

    def items(variables: Mapping[str, Any]) -> Iterable[Any]:
        value = first(variables)
        if last is not None:
            end = last(variables)
            if not (isinstance(value, int) and isinstance(end, int)):
                return ()
            return range(value, end + 1) if value <= end else range(value, end - 1, -1)
        if isinstance(value, Range) and isinstance(value.low, int) and isinstance(value.high, int):
            return range(value.low + (not value.with_low), value.high + value.with_high)
        return value if is_list(value) else () if value is None else (value,)

    return name, items


def iteration(parser: Parser) -> Evaluate:
    name, items = _iterated(parser)
    parser.expect("return")
    result = parser.inside([name])
    return lambda variables: [result(_scope(variables, {name: item})) for item in items(variables)]


def quantified(join: Callable[[Iterable[bool]], bool]) -> Callable[[Parser], Evaluate]:
    def quantified(parser: Parser) -> Evaluate:
        name, items = _iterated(parser)
        parser.expect("satisfies")
        test = parser.inside([name])
        return lambda variables: join(test(_scope(variables, {name: item})) is True for item in items(variables))

    return quantified
