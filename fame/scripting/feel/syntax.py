"""The syntax of FEEL beyond operators: lists, ranges, contexts, filters, iterations, functions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from fame.engine.data import Variables
from fame.scripting.budget import spend
from fame.scripting.data import Evaluate, fields_of, is_list, is_number, plain
from fame.scripting.feel.values import Moment, Range, moment, temporal
from fame.scripting.grammar import ExpressionParser, listing

# ---- lists, ranges, contexts, iterations -----------------------------------------------------------------------------


COMPARE = 3
"""Binding power of comparisons: the operand between ``in`` and ``return`` binds tighter."""


def index_or_filter(parser: ExpressionParser, left: Evaluate) -> Evaluate:
    """After ``[``: a place, counted from 1 or from -1 at the end; or a condition on `item`."""
    parser.counts = True
    inner = parser.inside(["item"], fields=True)
    parser.expect("]")

    def evaluate(variables: Mapping[str, Any]) -> Any:
        value = left(variables)
        items = list(plain(value)) if is_list(value) else [] if value is None else [value]
        place = inner(_item_scope(variables, items[0] if items else None))
        if is_number(place):
            return _at(items, place)
        return [item for item in items if inner(_item_scope(variables, item)) is True]

    return evaluate


def _at(items: list[Any], place: Any) -> Any:
    if not 1 <= abs(place) <= len(items):
        return None
    return items[int(place) - 1 if place > 0 else int(place)]


def _item_scope(variables: Mapping[str, Any], item: Any) -> Variables:
    """In a filter `item` is the element; its fields are names, too."""
    spend()
    return scope(variables, {"item": item, **fields_of(item)})


def scope(variables: Mapping[str, Any], names: Mapping[str, Any]) -> Variables:
    """Return the variables with these before them."""
    return Variables(variables if isinstance(variables, dict) else dict(variables), names)


def bracket(parser: ExpressionParser) -> Evaluate:
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


def parenthesis(parser: ExpressionParser) -> Evaluate:
    """After ``(``: an expression or a range."""
    first = parser.expression()
    if parser.at(".."):
        return span(parser, first, with_low=False)
    parser.expect(")")
    return first


def span(parser: ExpressionParser, low: Evaluate, *, with_low: bool) -> Evaluate:
    parser.expect("..")
    high = parser.expression()
    with_high = parser.take("]")
    if not with_high:
        parser.expect(")")
    return lambda variables: Range(low(variables), high(variables), with_low, with_high)


def _iterated(parser: ExpressionParser) -> tuple[list[str], Callable[[Mapping[str, Any]], Iterable[Mapping[str, Any]]]]:
    """``x in items, i in 1..5``: the names, and a scope for each combination; the last one runs fastest."""
    parser.counts = True
    domains = [_domain(parser, [])]
    while parser.take(","):
        domains.append(_domain(parser, [name for name, _ in domains]))

    def scopes(variables: Mapping[str, Any], place: int = 0) -> Iterable[Mapping[str, Any]]:
        name, items = domains[place]
        for item in items(variables):
            spend()
            inner = scope(variables, {name: item})
            if place + 1 < len(domains):
                yield from scopes(inner, place + 1)
            else:
                yield inner

    return [name for name, _ in domains], scopes


def _domain(parser: ExpressionParser, before: list[str]) -> tuple[str, Callable[[Mapping[str, Any]], Iterable[Any]]]:
    """``x in items`` or ``i in 1..5``; it may name what was iterated `before`."""
    name = parser.name()
    parser.expect("in")
    first = parser.inside(before, COMPARE)
    last = parser.inside(before, COMPARE) if parser.take("..") else None

    def items(variables: Mapping[str, Any]) -> Iterable[Any]:
        value = first(variables)
        if last is not None:
            return _steps(value, last(variables))
        if isinstance(value, Range):
            steps = _steps(value.low, value.high)
            return steps[(not value.with_low) : len(steps) - (not value.with_high)]
        if value is None:
            raise _NoItemsError
        return value if is_list(value) else (value,)

    return name, items


class _NoItemsError(Exception):
    """What is iterated over is null."""


def _steps(start: Any, end: Any) -> Sequence[Any]:
    """The whole numbers or dates from one to another, up or down. Raises _NoItemsError for other ends."""
    if isinstance(start, int) and isinstance(end, int):
        return range(start, end + 1) if start <= end else range(start, end - 1, -1)
    try:
        first, last = moment(start, "date"), moment(end, "date")
    except ValueError:
        raise _NoItemsError from None
    days = _steps(first.at.toordinal(), last.at.toordinal())
    spend(10 * len(days))
    return [temporal(Moment("date", datetime.fromordinal(day).replace(tzinfo=UTC))) for day in days]


def iteration(parser: ExpressionParser) -> Evaluate:
    """After ``for``. `partial` is the list of the results so far (DMN 1.5, section 10.3.2.14)."""
    names, scopes = _iterated(parser)
    parser.expect("return")
    result = parser.inside([*names, "partial"])

    def evaluate(variables: Mapping[str, Any]) -> list[Any] | None:
        results: list[Any] = []
        try:
            for inner in scopes(scope(variables, {"partial": results})):
                results.append(result(inner))  # noqa: PERF401 - the results so far are seen from inside
        except _NoItemsError:
            return None
        return results

    return evaluate


def context(parser: ExpressionParser) -> Evaluate:
    """After ``{``: keys are names or texts; an entry sees those before it (DMN 1.5, section 10.3.2.6)."""
    entries: list[tuple[str, Evaluate]] = []
    for _ in parser.separated("}"):
        entries.append((parser.key(), parser.inside([key for key, _ in entries])))

    def evaluate(variables: Mapping[str, Any]) -> dict[str, Any]:
        made: dict[str, Any] = {}
        inner = scope(variables, made)
        for key, value in entries:
            made[key] = value(inner)
            inner.define(key, made[key])
        return made

    return evaluate


def quantified(decisive: bool) -> Callable[[ExpressionParser], Evaluate]:
    """``some`` (true is decisive) and ``every`` (false is): of three values, as ``or`` and ``and``."""

    def quantified(parser: ExpressionParser) -> Evaluate:
        names, scopes = _iterated(parser)
        parser.expect("satisfies")
        test = parser.inside(names)

        def evaluate(variables: Mapping[str, Any]) -> Any:
            undecided: bool | None = not decisive
            try:
                for inner in scopes(variables):
                    value = test(inner)
                    if value is decisive:
                        return decisive
                    undecided = undecided if isinstance(value, bool) else None
            except _NoItemsError:
                return None
            return undecided

        return evaluate

    return quantified


# ---- functions that an expression defines ----------------------------------------------------------------------------


class Lambda:
    """A function, with the variables that it sees. It has no fields: nothing of it can be looked into."""

    __slots__ = ("_body", "_variables", "names")

    def __init__(self, names: tuple[str, ...], body: Evaluate, variables: Mapping[str, Any]) -> None:
        self.names: tuple[str, ...] = names
        self._body, self._variables = body, variables

    def apply(self, *values: Any) -> Any:
        """Return its result. Raises TypeError for another number of arguments."""
        spend()
        if len(values) != len(self.names):
            raise TypeError(f"a function of {len(self.names)} arguments was given {len(values)}")
        return self._body(scope(self._variables, dict(zip(self.names, values, strict=True))))


def definition(parser: ExpressionParser) -> Evaluate:
    """After ``function``."""
    parser.expect("(")
    names = [parser.name() for _ in parser.separated(")")]
    parser.after = _data
    body = parser.inside(names)
    return lambda variables: Lambda(tuple(names), body, variables)


def _data(value: Any) -> Any:
    """The result of an expression, which must not be a function."""
    if isinstance(value, dict):
        return {key: _data(item) for key, item in value.items() if not isinstance(item, Lambda)}
    if isinstance(value, list):
        return [_data(item) for item in value]
    return None if isinstance(value, Lambda) else value


def invocation(parser: ExpressionParser, left: Evaluate) -> Evaluate:
    """After ``(``, behind what gives a function; null for what does not."""
    arguments = parser.arguments()

    def evaluate(variables: Mapping[str, Any]) -> Any:
        function = left(variables)
        values = [(name, value(variables)) for name, value in arguments]
        return function.apply(*_placed(function.names, values)) if _fits(function, values) else None

    return evaluate


def _fits(function: Any, values: Sequence[tuple[str, Any]]) -> bool:
    if not isinstance(function, Lambda) or len(function.names) != len(values):
        return False
    named = {name for name, _ in values if name}
    return not named or named == set(function.names)


def _placed(names: Sequence[str], values: Sequence[tuple[str, Any]]) -> list[Any]:
    given = dict(values)
    return [given[name] for name in names] if all(name for name, _ in values) else [value for _, value in values]
