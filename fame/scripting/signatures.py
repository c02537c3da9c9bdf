"""Functions of expressions, by their signatures: texts such as ``substring(string: string, start position: number,
length?: number)``, as Camunda documents them.

A parameter with ``?`` may be left out; a last one with ``...`` takes all arguments that follow. Arguments are given by
position or by name. They are checked against the types: where a value is expected, null makes the result null.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from fame.dataclasses import dataclass
from fame.scripting.budget import PASS, spend, weight
from fame.scripting.data import Evaluate, is_list, is_number, plain

_PARAMETER = re.compile(r"(\w[\w ]*)(\?|\.\.\.)?: (\w+)")

Argument = tuple[str, Evaluate]
"""Its name, if it was given by name, and its value."""


@dataclass(frozen=True, slots=True)
class Function:
    """One signature: `parameters` are (name, type). `sees`: it takes the variables before its arguments."""

    call: Callable[..., Any]
    parameters: tuple[tuple[str, str], ...]
    required: int
    rest: bool
    sees: bool

    def placed(self, arguments: Sequence[Argument]) -> list[Evaluate] | None:
        """Return the arguments in the order of the parameters, None if they do not fit."""
        values = [value for _, value in arguments]
        if any(name for name, _ in arguments):
            given = dict(arguments)
            names = [name for name, _ in self.parameters[: len(values)]]
            if set(names) != given.keys():
                return None
            values = [given[name] for name in names]
        fits = self.required <= len(values) and (self.rest or len(values) <= len(self.parameters))
        return values if fits else None

    def __str__(self) -> str:
        names = [name for name, _ in self.parameters]
        names = names[: self.required] + [f"{name}?" for name in names[self.required :]]
        return f"({', '.join(names)})" if not self.rest else f"({', '.join(names).rstrip('?')}...)"

    def types(self, count: int) -> list[str]:
        """Return the types of the first `count` arguments."""
        types = [type for _, type in self.parameters]
        return types[:count] + types[-1:] * (count - len(types))


def functions(table: Mapping[str, Callable[..., Any]], *, sees: bool = False) -> dict[str, tuple[Function, ...]]:
    """Return the functions of a table by signature, as (name -> its signatures)."""
    found: dict[str, tuple[Function, ...]] = {}
    for signature, call in table.items():
        name, _, rest = signature.partition("(")
        parameters = _PARAMETER.findall(rest)
        required = sum(not mark for _, mark, _ in parameters)
        made = Function(call, tuple((name, type) for name, _, type in parameters), required, "..." in rest, sees)
        found[name] = (*found.get(name, ()), made)
    return found


def chosen(signatures: Sequence[Function], arguments: Sequence[Argument]) -> tuple[Function, list[Evaluate]] | None:
    """Return the first signature that the arguments fit, and the arguments in its order."""
    return next(
        ((function, placed) for function in signatures if (placed := function.placed(arguments)) is not None), None
    )


_SIZED = frozenset({list, str})


def called(function: Function, name: str, arguments: list[Evaluate], null: bool) -> Evaluate:
    """Return a function call. An error is null if `null`, else TypeError."""
    checks = [_CHECKS.get(type) for type in function.types(len(arguments))]

    def evaluate(variables: Mapping[str, Any]) -> Any:
        values = [argument(variables) for argument in arguments]
        cost = PASS
        for value in values:
            cost += weight(value)
        spend(cost)
        try:
            given = [value if check is None else check(value) for check, value in zip(checks, values)]  # noqa: B905 - as many
            result = function.call(variables, *given) if function.sees else function.call(*given)
        except _Null:
            return None
        except (TypeError, ValueError, AttributeError, ArithmeticError, LookupError) as error:
            if null:
                return None
            raise TypeError(f"{name}({', '.join(map(repr, values))}): {error}") from None
        if null and result.__class__ is float and not math.isfinite(result):
            return None
        if result.__class__ in _SIZED:
            spend(weight(result))
        return result

    return evaluate


# ---- types -----------------------------------------------------------------------------------------------------------


class _Null(Exception):
    """An argument is null that must not be."""


def _checked(what: str, fits: Callable[[Any], bool]) -> Callable[[Any], Any]:
    def check(value: Any) -> Any:
        if fits(value):
            return value
        if value is None:
            raise _Null
        raise TypeError(f"{value!r} is not {what}")

    return check


def _listed(value: Any) -> list[Any]:
    """A single value is a list of one (DMN 1.5, section 10.3.2.9.4)."""
    if value is None:
        raise _Null
    return list(plain(value)) if is_list(value) else [value]


_CHECKS: dict[str, Callable[[Any], Any]] = {
    "number": _checked("a number", is_number),
    "string": _checked("a text", lambda value: isinstance(value, str)),
    "boolean": _checked("true or false", lambda value: isinstance(value, bool)),
    "value": _checked("a value", lambda value: value is not None),
    "list": _listed,
}
"""Type -> conversion of a value to it. ``any`` has no conversion: null is of that type, too."""
