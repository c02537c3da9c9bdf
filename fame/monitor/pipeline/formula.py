"""Expressions over the inputs: formulas that compute, and can do nothing else.

A formula is a tree of functions of numpy over arrays whose first axis is the samples. What numpy would make of truth
values, whole numbers, NaN and arrays of other shapes is decided here, for every operator and function.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial, reduce
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from fame.errors import ConfigError
from fame.monitor.pipeline.processor import Parameter, Processor, Result, Samples, stacked


class Expression(Processor):
    """A formula over the inputs, by name: ``abs(left - right) > 2``, ``effort[:, 3] * 0.1``, ``mean(efforts)``.

    Arithmetic, comparison, ``and or not``, channels by index and the functions below; nothing else, so it cannot do
    anything but compute. ``mean``, ``max``, ``min``, ``sum``, ``norm`` go over the channels of each sample; a value per
    sample counts for all channels of another operand. True and false are 1 and 0 in arithmetic. The inputs must have
    the same stamps; one named like a constant (``pi``, ``e``) hides it.
    """

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("formula", "str", "", description="over the inputs, by name"),
    )
    outputs: tuple[str, ...] = ("value",)

    @property
    def formula(self) -> str:
        """The formula as given. Setting anything else raises ConfigError."""
        return self._formula

    @formula.setter
    def formula(self, text: str) -> None:
        if not text:
            raise ConfigError("needs a formula, such as abs(left - right)", element="formula")
        self._evaluate, self._formula = compile_formula(text), text

    @property
    def reads(self) -> list[str]:
        """The inputs of its formula, in its order."""
        tree = ast.walk(ast.parse(self._formula.strip(), mode="eval"))
        names = [each.id for each in tree if isinstance(each, ast.Name)]
        return [name for name in names if name not in _FUNCTIONS and name not in _CONSTANTS]

    def execute(self, inputs: Mapping[str, Samples], /) -> Result:
        samples = stacked(inputs)
        if not len(samples):
            return None
        with np.errstate(all="ignore"):  # what is not finite is not sent
            value = np.asarray(self._evaluate({name: item.values for name, item in inputs.items()}))
        if value.ndim == 0:
            value = np.full(len(samples), value)
        return {"value": Samples(value, samples.stamps)}


# ---- operators and functions -----------------------------------------------------------------------------------------

Evaluate = Callable[[Mapping[str, Any]], Any]


def _of_numbers(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function of floats: numpy adds truth values as "or", and lets whole numbers wrap around."""

    def compute(*operands: Any) -> Any:
        return function(*(each * 1.0 if np.asarray(each).dtype.kind in "biu" else each for each in operands))

    return compute


def _over_channels(function: Callable[..., Any]) -> Callable[[Any], Any]:
    return _of_numbers(lambda values: function(np.reshape(values, (len(values), -1)), axis=1))


def _unless_unknown(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, but NaN where its first or second operand is: what was not measured is not known, nor is this."""

    def judge(*operands: Any) -> Any:
        numbers = [each for each in operands[:2] if np.asarray(each).dtype.kind == "f"]
        unknown = reduce(np.logical_or, map(np.isnan, numbers), False)
        value = function(*operands)
        return np.where(unknown, np.nan, value) if np.any(unknown) else value

    return judge


def _where(test: Any, *values: Any) -> Any:
    return _unless_unknown(lambda known: np.where(known, *values))(test)


_OF_EACH = ("abs", "sqrt", "exp", "log", "sin", "cos", "tan", "arctan2", "sign", "clip")
_FUNCTIONS: dict[str, Callable[..., Any]] = {
    **{name: _of_numbers(getattr(np, name)) for name in _OF_EACH},
    **{name: _over_channels(getattr(np, name)) for name in ("mean", "max", "min", "sum")},
    "norm": _over_channels(np.linalg.norm),
    "where": _where,
}
_TAKES = {"arctan2": 2, "clip": 3, "where": 3}  # the others one; numpy would write to one more
_ARITHMETIC: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Pow: operator.pow, ast.Mod: operator.mod, ast.FloorDiv: operator.floordiv,
    ast.USub: operator.neg, ast.UAdd: operator.pos,
}  # fmt: skip
_JUDGING: dict[type, Callable[..., Any]] = {
    ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge,
    ast.Eq: operator.eq, ast.NotEq: operator.ne,
    ast.And: np.logical_and, ast.Or: np.logical_or, ast.Not: np.logical_not,
}  # fmt: skip
_OPERATORS = {kind: _of_numbers(function) for kind, function in _ARITHMETIC.items()} | {
    kind: _unless_unknown(function) for kind, function in _JUDGING.items()
}
_CONSTANTS = {"pi": np.pi, "e": np.e}


# ---- formulas --------------------------------------------------------------------------------------------------------


def compile_formula(text: str) -> Evaluate:
    """Return a function of the arrays by name. Raises ConfigError for anything but a formula."""
    try:
        tree = ast.parse(text.strip(), mode="eval").body
        return _evaluator(tree)
    except (SyntaxError, ValueError, ArithmeticError, RecursionError, MemoryError) as error:
        reason = error.msg if isinstance(error, SyntaxError) else str(error) or "it is too long"
        raise ConfigError(f"expected a formula, got {text[:60]!r}: {reason}", element="formula") from None


def _evaluator(node: ast.expr) -> Evaluate:
    match node:
        case ast.Constant(int() | float() as constant):
            value = float(constant)  # numbers of any length, as 9 ** 9 ** 9, would take forever
            return lambda arrays: value
        case ast.Name(name):
            return partial(_look_up, name)
        case ast.UnaryOp(kind, operand) if type(kind) in _OPERATORS:
            return _applied(_OPERATORS[type(kind)], _evaluator(operand))
        case ast.BinOp(left, kind, right) if type(kind) in _OPERATORS:
            return _applied(_OPERATORS[type(kind)], _evaluator(left), _evaluator(right))
        case ast.BoolOp(kind, operands):
            return _joined(type(kind), map(_evaluator, operands))
        case ast.Compare(left, kinds, others) if all(type(kind) in _OPERATORS for kind in kinds):
            pairs = zip(kinds, pairwise(map(_evaluator, (left, *others))), strict=True)
            return _joined(ast.And, (_applied(_OPERATORS[type(kind)], *pair) for kind, pair in pairs))
        case ast.Call(ast.Name(name), operands, []):
            return _call(name, operands)
        case ast.Subscript(operand, place):
            index = _channels_at(place)
            return _applied(lambda values: values[index], _evaluator(operand))
    raise ValueError(f"{ast.unparse(node)} is not allowed in a formula")


def _call(name: str, operands: Sequence[ast.expr]) -> Evaluate:
    if name not in _FUNCTIONS:
        raise ValueError(f"unknown function {name}; known are {', '.join(sorted(_FUNCTIONS))}")
    takes = _TAKES.get(name, 1)
    if len(operands) != takes:
        raise ValueError(f"{name} takes {takes} arguments, got {len(operands)}")
    return _applied(_FUNCTIONS[name], *map(_evaluator, operands))


def _look_up(name: str, arrays: Mapping[str, Any]) -> Any:
    if name not in arrays and name not in _CONSTANTS:
        raise ValueError(f"unknown input {name}; known are {', '.join(arrays)}")
    return arrays[name] if name in arrays else _CONSTANTS[name]


def _applied(function: Callable[..., Any], *parts: Evaluate) -> Evaluate:
    return lambda arrays: function(*_aligned([part(arrays) for part in parts]))


def _joined(kind: type[ast.boolop], parts: Iterable[Evaluate]) -> Evaluate:
    """The parts, joined by ``and`` or ``or`` from left to right."""
    return _applied(lambda *operands: reduce(_OPERATORS[kind], operands), *parts)


def _aligned(operands: Sequence[Any]) -> list[Any]:
    """Return operands whose first axes are samples so that numpy puts samples, not channels, side by side."""
    depth = max(map(np.ndim, operands))
    shapes = [np.shape(each) + (1,) * (depth - np.ndim(each)) for each in operands]
    return [np.reshape(each, shape) if np.ndim(each) else each for each, shape in zip(operands, shapes, strict=True)]


def _channels_at(node: ast.expr) -> Any:
    """Return a literal index of channels of all samples: ``[:, 3]``, ``[:, 1:]``."""
    index = _index(node)
    if (index[:1] if isinstance(index, tuple) else (index,)) != (slice(None),):
        text = f"expected an index of channels, as in [:, 3], got [{ast.unparse(node)}]: the first is the sample"
        raise ValueError(text)
    return index


def _index(node: ast.expr) -> Any:
    if isinstance(node, ast.Tuple):
        return tuple(_index(item) for item in node.elts)
    if isinstance(node, ast.Slice):
        return slice(*(None if part is None else _index(part) for part in (node.lower, node.upper, node.step)))
    value = ast.literal_eval(node)
    if type(value) is not int:
        raise ValueError(f"expected a whole number as index, got {ast.unparse(node)}")
    return value
