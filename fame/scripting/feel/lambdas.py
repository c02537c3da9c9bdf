"""Functions that an expression defines, ``function(x, y) x < y``, and calls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fame.scripting.data import Evaluate
from fame.scripting.feel.lists import scope
from fame.scripting.grammar import Parser
from fame.scripting.metering import spend


class Lambda:
    """A function, with the variables that it sees. It has no fields: nothing of it can be looked into."""

    __slots__ = ("_body", "_variables", "names")

    def __init__(self, names: tuple[str, ...], body: Evaluate, variables: Mapping[str, Any]) -> None:
        self.names, self._body, self._variables = names, body, variables

    def apply(self, *values: Any) -> Any:
        """Its result. Raises TypeError for another number of arguments."""
        spend()
        if len(values) != len(self.names):
            raise TypeError(f"a function of {len(self.names)} arguments was given {len(values)}")
        return self._body(scope(self._variables, dict(zip(self.names, values, strict=True))))


def definition(parser: Parser) -> Evaluate:
    """After ``function``."""
    parser.expect("(")
    names: list[str] = []
    while not parser.take(")"):
        names.append(parser.name())
        if not parser.at(")"):
            parser.expect(",")
    parser.after = _data
    body = parser.inside(names)
    return lambda variables: Lambda(tuple(names), body, variables)


def _data(value: Any) -> Any:
    """What leaves the expression: functions do not."""
    if isinstance(value, dict):
        return {key: _data(item) for key, item in value.items() if not isinstance(item, Lambda)}
    if isinstance(value, list):
        return [_data(item) for item in value]
    return None if isinstance(value, Lambda) else value


def invocation(parser: Parser, left: Evaluate) -> Evaluate:
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
