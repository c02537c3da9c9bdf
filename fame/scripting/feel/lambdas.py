"""Functions that an expression defines, ``function(x, y) x < y``, and calls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fame.scripting.data import Evaluate
from fame.scripting.feel.lists import scope
from fame.scripting.grammar import Parser
from fame.scripting.metering import spend


@dataclass(frozen=True, slots=True, eq=False)
class Lambda:
    """A function, with the variables that it sees."""

    names: tuple[str, ...]
    body: Evaluate
    variables: Mapping[str, Any]

    def apply(self, *values: Any) -> Any:
        """Its result. Raises TypeError for another number of arguments."""
        spend()
        if len(values) != len(self.names):
            raise TypeError(f"a function of {len(self.names)} arguments was given {len(values)}")
        return self.body(scope(self.variables, dict(zip(self.names, values, strict=True))))


def definition(parser: Parser) -> Evaluate:
    """After ``function``."""
    parser.expect("(")
    names: list[str] = []
    while not parser.take(")"):
        names.append(parser.name())
        if not parser.at(")"):
            parser.expect(",")
    body = parser.inside(names)
    return lambda variables: Lambda(tuple(names), body, variables)


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
