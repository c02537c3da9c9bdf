"""Threshold with hysteresis, and expressions over the inputs."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import reduce
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from fame.errors import ConfigError
from fame.monitor.pipeline.processor import ActiveElements, Parameter, Processor, Result, Samples, per_channel, stacked
from fame.monitor.pipeline.sequence import OrderWatch

_Alarm = tuple[float, int, str, float, float]
"""Stamp (s), channel, its name or a sentence, loss and excess."""


class Threshold(Processor):
    """Raises an alarm when any channel exceeds its threshold; again only after all of them have come well below. With a
    model that knows the order of the elements of a mission, also when one is left out, or comes in another order.

    `alarm`, `channel`, `name`, `loss`, `excess` have a sample per alarm: true, the channel that is farthest above its
    threshold, its name (a list of one), its value, and that divided by the threshold. `active` has one per judged
    sample: whether the alarm is set. A sample with a value that is no number is not judged, unless another channel is
    above its threshold: it neither sets nor ends the alarm, and is reported. An alarm for the order has a sentence as
    `name`, -1 as `channel`, 0 as `loss` and `excess`.
    """

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("threshold", "floats", (), (1e-300, None), "", "above 0; one for all channels, or one per channel"),
        Parameter(
            "model", "file", "", description="trained model whose thresholds are used if none are given", fixed=True
        ),
        Parameter("hysteresis", "float", 0.1, (0, 1), description="part below the threshold at which the alarm ends"),
        Parameter("names", "strs", (), description="of the channels, if the data do not tell"),
    )
    outputs: tuple[str, ...] = ("alarm", "channel", "name", "loss", "excess", "active")
    model: str
    hysteresis: float
    names: tuple[str, ...]
    elements: ActiveElements = ()
    lost: float = -np.inf

    def __init__(self, **values: object) -> None:
        super().__init__(**values)
        self._active = False
        self._order: OrderWatch | None = None
        if self.model:
            from fame.monitor.pipeline.trained_model import TrainedModel

            trained = TrainedModel.load(self.model)
            if not self.threshold:
                self.threshold, self.names = trained.thresholds, self.names or trained.columns
            if usual := trained.conditions.get("order"):
                self._order = OrderWatch(usual)
        if not self.threshold:
            raise ConfigError("needs a threshold, or a model with thresholds", element="threshold")

    @property
    def needs_elements(self) -> bool:
        """Whether the model knows the order of the elements of a mission."""
        return self._order is not None

    @property
    def threshold(self) -> tuple[float, ...]:
        """One, or one per channel."""
        return self._threshold

    @threshold.setter
    def threshold(self, values: tuple[float, ...]) -> None:
        if not values and getattr(self, "_threshold", None):
            raise ConfigError("expected one value or more, got an empty list", element="threshold")
        self._threshold = values

    def execute(self, inputs: Mapping[str, Samples], /) -> Result:
        samples = stacked(inputs)
        alarms = self._wrong_order(samples)
        if not len(samples):
            return _alarms(alarms) or None
        names, threshold = self._channels(samples)
        excess = samples.channels() / per_channel(threshold, samples.channels().shape, "threshold")
        unknown = np.isnan(excess)
        for channel in np.flatnonzero(unknown.any(axis=0)):
            self.report(f"{names[channel]} is no number: not judged")
        excess[unknown] = -np.inf
        worst = excess.max(axis=1)
        judged = ~unknown.any(axis=1) | (worst > 1)
        active = self._states(worst, judged)
        rising = np.flatnonzero(active & ~np.concatenate(([self._active], active[:-1])))
        self._active = bool(active[-1])
        for row, top in zip(rising.tolist(), excess[rising].argmax(axis=1).tolist(), strict=True):
            loss = float(samples.channels()[row, top])
            alarms.append((float(samples.stamps[row]), top, names[top], loss, float(worst[row])))
        return {**_alarms(alarms), "active": Samples(active[judged], samples.stamps[judged])}

    def _wrong_order(self, samples: Samples) -> list[_Alarm]:
        if self._order is None:
            return []
        now = float(samples.stamps[-1]) if len(samples) else 0.0
        wrong = self._order.feed(self.elements, now, self.lost)
        for _, text in wrong:
            self.report(text)
        return [(stamp, -1, text, 0.0, 0.0) for stamp, text in wrong]

    def _channels(self, samples: Samples) -> tuple[tuple[str, ...], tuple[float, ...]]:
        """Return names and thresholds of the channels. Data that name theirs are matched to `names`, in any order.

        Raises ValueError if there are not as many names as channels.
        """
        own, data = _short(self.names), _short(samples.names)
        width = samples.channels().shape[1]
        if len(own) > 1 and own != data and sorted(own) == sorted(data):
            several = len(self.threshold) == len(own)
            return data, tuple(self.threshold[own.index(name)] for name in data) if several else self.threshold
        names = own or data or tuple(map(str, range(width)))
        if len(names) != width:
            raise ValueError(f"names has {len(names)} texts, the data {width} channels")
        return names, self.threshold

    def _states(self, worst: Any, judged: Any) -> Any:
        """Return the alarm after each sample: set above 1, cleared below the hysteresis, else as before."""
        states = np.where(worst > 1, 1, np.where(judged & (worst <= 1 - self.hysteresis), 0, -1))
        states = np.concatenate(([int(self._active)], states))
        last = np.maximum.accumulate(np.where(states >= 0, np.arange(len(states)), 0))
        return states[last][1:].astype(bool)


def _short(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return names without what is before their last dot, if that does not make two of them equal."""
    last = tuple(name.rpartition(".")[2] for name in names)
    return last if len({*last}) == len(last) else names


def _alarms(alarms: Sequence[_Alarm]) -> dict[str, Samples]:
    """Return the outputs that have a sample per alarm; none without alarms."""
    if not alarms:
        return {}
    stamps, channel, names, loss, excess = (np.array(part) for part in zip(*sorted(alarms), strict=True))
    values = {"channel": channel, "name": names.astype(object).reshape(-1, 1), "loss": loss, "excess": excess}
    return {name: Samples(each, stamps) for name, each in {"alarm": channel >= -1, **values}.items()}


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

    def execute(self, inputs: Mapping[str, Samples], /) -> Result:
        samples = stacked(inputs)
        if not len(samples):
            return None
        with np.errstate(all="ignore"):  # what is not finite is not sent
            value = np.asarray(self._evaluate({name: item.values for name, item in inputs.items()}))
        if value.ndim == 0:
            value = np.full(len(samples), value)
        return {"value": Samples(value, samples.stamps)}


# ---- formulas --------------------------------------------------------------------------------------------------------

Evaluate = Callable[[Mapping[str, Any]], Any]


def _of_numbers(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function of floats: numpy adds truth values as "or", and lets whole numbers wrap around."""

    def compute(*operands: Any) -> Any:
        return function(
            *(np.multiply(each, 1.0) if np.asarray(each).dtype.kind in "biu" else each for each in operands)
        )

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


_FUNCTIONS: dict[str, Callable[..., Any]] = {
    **{
        name: _of_numbers(getattr(np, name))
        for name in ("abs", "sqrt", "exp", "log", "sin", "cos", "tan", "arctan2", "sign", "clip")
    },
    **{name: _over_channels(getattr(np, name)) for name in ("mean", "max", "min", "sum")},
    "norm": _over_channels(np.linalg.norm),
    "where": lambda test, *values: _unless_unknown(lambda known: np.where(known, *values))(test),
}
_TAKES = {"arctan2": 2, "clip": 3, "where": 3}  # the others one; numpy would write to one more
_ARITHMETIC: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Pow: operator.pow, ast.Mod: operator.mod, ast.FloorDiv: operator.floordiv,
    ast.USub: operator.neg, ast.UAdd: operator.pos,
}  # fmt: skip
_OPERATORS: dict[type, Callable[..., Any]] = {
    **{kind: _of_numbers(function) for kind, function in _ARITHMETIC.items()}, ast.Not: np.logical_not,
    ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge,
    ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.And: np.logical_and, ast.Or: np.logical_or,
}  # fmt: skip
_CONSTANTS = {"pi": np.pi, "e": np.e}


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
            return _name(name)
        case ast.UnaryOp(kind, operand) if type(kind) in _OPERATORS:
            return _applied(_unless_unknown(_OPERATORS[type(kind)]), _evaluator(operand))
        case ast.BinOp(left, kind, right) if type(kind) in _OPERATORS:
            return _applied(_OPERATORS[type(kind)], _evaluator(left), _evaluator(right))
        case ast.BoolOp(kind, operands):
            return _joined(_OPERATORS[type(kind)], map(_evaluator, operands))
        case ast.Compare(left, kinds, others) if all(type(kind) in _OPERATORS for kind in kinds):
            parts = map(_evaluator, (left, *others))
            compared = zip(kinds, pairwise(parts), strict=True)
            return _joined(
                np.logical_and, (_applied(_unless_unknown(_OPERATORS[type(kind)]), *pair) for kind, pair in compared)
            )
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


def _name(name: str) -> Evaluate:
    def look_up(arrays: Mapping[str, Any]) -> Any:
        if name in arrays:
            return arrays[name]
        if name in _CONSTANTS:
            return _CONSTANTS[name]
        raise ValueError(f"unknown input {name}; known are {', '.join(arrays)}")

    return look_up


def _applied(function: Callable[..., Any], *parts: Evaluate) -> Evaluate:
    return lambda arrays: function(*_aligned([part(arrays) for part in parts]))


def _joined(function: Callable[..., Any], parts: Iterable[Evaluate]) -> Evaluate:
    """The parts, joined from left to right by a function of two."""
    return _applied(lambda *operands: reduce(_unless_unknown(function), operands), *parts)


def _aligned(operands: Sequence[Any]) -> list[Any]:
    """Return operands whose first axes are samples so that numpy puts samples, not channels, side by side."""
    depth = max(map(np.ndim, operands))
    shapes = [np.shape(each) + (1,) * (depth - np.ndim(each)) for each in operands]
    return [np.reshape(each, shape) if np.ndim(each) else each for each, shape in zip(operands, shapes, strict=True)]


def _channels_at(node: ast.expr) -> Any:
    """Return a literal index of channels of all samples: ``[:, 3]``, ``[:, 1:]``."""
    index = _index(node)
    if (index[:1] if isinstance(index, tuple) else (index,)) != (slice(None),):
        raise ValueError(
            f"expected an index of channels, as in [:, 3], got [{ast.unparse(node)}]: the first is the sample"
        )
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
