"""The scripts and expressions of a process with their effects, and conditions of which one is always true.

`cover_all` recognises ``x`` and ``not x``, ``x > 3`` and ``x <= 3``, three ranges of a number. Conditions of all
languages are read as Python expressions, as far as they can be. Their parts (a variable, a call, a comparison) get
every value that makes a difference, each independently of the others: if some condition is true whatever the values
are, the conditions cover all cases. A wrong "no" costs a warning, a wrong "yes" hides one.
"""

from __future__ import annotations

import ast
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any

from fame.bpmn.model import Body, DataObject, Element, Expression, Use
from fame.dataclasses import dataclass, field
from fame.errors import ModelError
from fame.scripting.budget import BudgetExceeded
from fame.scripting.effects import Effects, effects_of
from fame.scripting.languages import parse_expression


@dataclass(frozen=True, slots=True)
class ExpressionUse:
    """A script or expression, its element and use, its effects, and the variables that it reads.

    `reads`: without what a data object only declares, ``x: ${x}``.
    """

    expression: Expression
    element: Element
    use: Use
    effects: Effects
    reads: frozenset[str]


def expressions_in(body: Body) -> Iterator[ExpressionUse]:
    """Yield every script and expression of a body; those of its sub-processes belong to their own bodies."""
    elements: list[Element] = [*body.data_objects, *body.flows, *body.nodes]
    for element in elements:
        for expression, use in element.texts():
            effects = effects_of(expression, script=use == "script")
            yield ExpressionUse(expression, element, use, effects, effects.reads - _own(element, expression))


def _own(element: Element, value: Expression) -> set[str]:
    """The name of the data object's value itself: ``x: ${x}`` only declares it."""
    if not isinstance(element, DataObject):
        return set()
    return {name for name, expression in element.values if expression is value}


@lru_cache
def constant(expression: Expression) -> tuple[Any, str]:
    """Return the value of an expression that reads no names, else None; and why it cannot be
    computed in time, else empty.

    What cannot be computed may be a part that reads no names: ``x + count(for i in 1..1000000000 return i)``.
    """
    if expression.language in ("python", "javascript"):
        return None, ""
    try:
        whole, names, parts = parse_expression(expression)
    except (ModelError, RecursionError):  # reported by the compiler
        return None, ""
    value = None
    for evaluate in parts if names else [whole]:
        try:
            value = evaluate({})
        except BudgetExceeded as error:
            return None, str(error)
        except Exception:  # reported when the element is reached
            value = None
    return None if names else value, ""


# ---- conditions of which one is always true --------------------------------------------------------------------------


_MOST = 4096
"""Combinations of values that are tried."""

_LARGEST = 1e300
"""Larger numbers are not considered."""

_HOLDS = {
    ast.Lt: {-1}, ast.LtE: {-1, 0}, ast.Eq: {0}, ast.Is: {0}, ast.NotEq: {-1, 1}, ast.IsNot: {-1, 1},
    ast.GtE: {0, 1}, ast.Gt: {1},
}  # fmt: skip
"""Operator -> the orders of its operands (left less, equal, greater) in which it holds."""

_Value = bool | float


def cover_all(conditions: Sequence[Expression]) -> bool:
    """Return whether one of the conditions is true for all values of the variables; False if that is unknown."""
    trees = [effects_of(condition).condition for condition in conditions]
    try:
        return _cover_all([tree for tree in trees if tree is not None]) if None not in trees else False
    except RecursionError:  # nested too deeply
        return False


def _cover_all(trees: Sequence[ast.expr]) -> bool:
    made = _Parts()
    for tree in trees:
        made.collect(tree)
    values = made.values()
    if math.prod(map(len, values.values())) > _MOST:
        return False
    cases = (dict(zip(values, case, strict=True)) for case in itertools.product(*values.values()))
    return all(any(_is_true(tree, case) for tree in trees) for case in cases)


@dataclass(slots=True)
class _Parts:
    """The parts of conditions: truth values, numbers compared with constants, pairs compared with each other."""

    truths: set[str] = field(default_factory=set)
    numbers: dict[str, set[float]] = field(default_factory=dict)
    pairs: set[str] = field(default_factory=set)

    def collect(self, tree: ast.expr) -> None:
        """Add those of one condition."""
        if isinstance(tree, ast.BoolOp):
            for value in tree.values:
                self.collect(value)
        elif isinstance(tree, ast.UnaryOp) and isinstance(tree.op, ast.Not):
            self.collect(tree.operand)
        elif isinstance(tree, ast.Compare):
            for left, _, right in _comparisons(tree):
                self._compare(left, right)
        elif not isinstance(tree, ast.Constant):
            self.truths.add(ast.dump(tree))

    def _compare(self, left: ast.expr, right: ast.expr) -> None:
        constant = _number(right)
        if isinstance(right, ast.Constant) and isinstance(right.value, bool):
            self.collect(left)
        elif constant is not None:
            self.numbers.setdefault(ast.dump(left), set()).add(constant)
        else:
            self.pairs.add(_pair(left, right))

    def values(self) -> Mapping[str, Sequence[_Value]]:
        """Return the values of each part that make a difference."""
        values: dict[str, Sequence[_Value]] = dict.fromkeys(sorted(self.truths), (False, True))
        values |= dict.fromkeys(sorted(self.pairs), (-1.0, 0.0, 1.0))
        return values | {f"number {name}": _around(sorted(constants)) for name, constants in self.numbers.items()}


def _around(constants: Sequence[float]) -> list[float]:
    """The constants and numbers below, between and above them."""
    between = [(low + high) / 2 for low, high in itertools.pairwise(constants)]
    return sorted({constants[0] - 1, *constants, *between, constants[-1] + 1})


def _comparisons(tree: ast.Compare) -> list[tuple[ast.expr, ast.cmpop, ast.expr]]:
    """The comparisons of a chain such as ``0 <= x < 10``, constants on the right, else in a fixed order."""
    operands = [tree.left, *tree.comparators]
    comparisons = []
    for left, operator, right in zip(operands, tree.ops, operands[1:], strict=False):
        turned = (_is_constant(left), ast.dump(left)) > (_is_constant(right), ast.dump(right))
        comparisons.append((right, _turned(operator), left) if turned else (left, operator, right))
    return comparisons


def _turned(operator: ast.cmpop) -> ast.cmpop:
    """The operator for swapped operands."""
    others: dict[type[ast.cmpop], type[ast.cmpop]] = {
        ast.Lt: ast.Gt, ast.Gt: ast.Lt, ast.LtE: ast.GtE, ast.GtE: ast.LtE,
    }  # fmt: skip
    return others.get(type(operator), type(operator))()


def _is_constant(tree: ast.expr) -> bool:
    return isinstance(tree, ast.Constant) or _number(tree) is not None


def _number(tree: ast.expr) -> float | None:
    sign = -1 if isinstance(tree, ast.UnaryOp) and isinstance(tree.op, ast.USub) else 1
    inner = tree.operand if isinstance(tree, ast.UnaryOp) and sign < 0 else tree
    value = inner.value if isinstance(inner, ast.Constant) else None
    if isinstance(value, bool) or not isinstance(value, int | float) or abs(value) > _LARGEST:
        return None
    return sign * float(value)


def _pair(left: ast.expr, right: ast.expr) -> str:
    return f"{ast.dump(left)} ? {ast.dump(right)}"


def _is_true(tree: ast.expr, case: Mapping[str, _Value]) -> bool:
    """The value of a condition in one case."""
    if isinstance(tree, ast.BoolOp):
        truths = [_is_true(value, case) for value in tree.values]
        return all(truths) if isinstance(tree.op, ast.And) else any(truths)
    if isinstance(tree, ast.UnaryOp) and isinstance(tree.op, ast.Not):
        return not _is_true(tree.operand, case)
    if isinstance(tree, ast.Compare):
        return all(_holds(left, operator, right, case) for left, operator, right in _comparisons(tree))
    return bool(tree.value) if isinstance(tree, ast.Constant) else bool(case[ast.dump(tree)])


def _holds(left: ast.expr, operator: ast.cmpop, right: ast.expr, case: Mapping[str, _Value]) -> bool:
    constant = _number(right)
    if isinstance(right, ast.Constant) and isinstance(right.value, bool):
        order = 0 if _is_true(left, case) == right.value else 1
    elif constant is not None:
        number = case[f"number {ast.dump(left)}"]
        order = (number > constant) - (number < constant)
    else:
        order = int(case[_pair(left, right)])
    if isinstance(operator, ast.In | ast.NotIn):
        return (order == 0) == isinstance(operator, ast.In)
    return order in _HOLDS[type(operator)]
