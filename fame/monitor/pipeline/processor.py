"""Processor, Parameter and Samples: the interface of everything that computes.

A processor is an object with `execute`; a user's own needs nothing else, and no base class::

    class Power:
        outputs = ("power",)

        def execute(self, inputs):
            effort, velocity = inputs["effort"], inputs["velocity"]
            return {"power": Samples(effort.values * velocity.values, effort.stamps)}

Three attributes are optional. `parameters`: what can be set, also while it runs; each is an attribute of the object.
`outputs`: the names that it computes; if empty, it gives one output per input, under the input's name; without the
attribute, its outputs are known after its first call.
`report`: set by whoever runs the processor, to be called with a line of text about data that cannot be used.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from fame.dataclasses import dataclass
from fame.errors import ConfigError
from fame.monitor.arrays import Floats

Type: TypeAlias = Literal["float", "int", "bool", "str", "file", "floats", "strs"]


ActiveElements: TypeAlias = tuple[tuple[float, str], ...]
"""From which stamp (s) which element of the mission was active."""


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Samples that arrived on an input, or that were computed.

    values  (n,) or (n, channels, ...)
    stamps  (n,), s, ascending
    names   of the channels; empty if they have none
    elements  of the mission that were active in a recorded run; empty if that is not known
    """

    values: NDArray[Any]
    stamps: Floats
    names: tuple[str, ...] = ()
    elements: ActiveElements = ()

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.stamps)

    def replace(
        self, values: NDArray[Any], stamps: Floats | None = None, names: tuple[str, ...] | None = None
    ) -> Samples:
        """Return these samples with other values and, if given, other stamps and names."""
        stamps, names = self.stamps if stamps is None else stamps, self.names if names is None else names
        return Samples(values, stamps, names, self.elements)

    def channels(self) -> NDArray[Any]:
        """Return the values as (n, channels)."""
        return self.values.reshape(len(self.stamps), -1) if self.values.ndim != 2 else self.values


Result: TypeAlias = Mapping[str, Any] | None
"""Per output a value, which is published once, or `Samples`, which are published one by one; None: nothing."""


class SupportsExecute(Protocol):
    """The interface of every processor."""

    def execute(self, inputs: Mapping[str, Samples], /) -> Result:
        """Compute from the samples that arrived since the last call, by name of the input. They may be empty."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One that can be set.

    type     ``floats`` and ``strs`` are lists; a single value is taken as a list of one; a ``file`` is a text, in a
             configuration relative to its folder
    fixed    it is given when the processor is made, and cannot be changed later
    range    lowest and highest value allowed (None: no bound); of a text the values allowed
    """

    name: str
    type: Type
    default: Any
    range: tuple[Any, ...] | None = None
    unit: str = ""
    description: str = ""
    fixed: bool = False

    def convert(self, value: Any) -> Any:
        """Return the value as the processor keeps it. Raises ConfigError for what does not fit."""
        several = self.type in ("floats", "strs")
        items = value if several and isinstance(value, (list, tuple)) else [value]
        if not items and self.default:
            raise ConfigError("expected one value or more, got an empty list", element=self.name)
        converted = tuple(self._single(item) for item in items)
        return converted if several else converted[0]

    def _single(self, value: Any) -> Any:
        kind = self.type.rstrip("s") if self.type in ("floats", "strs") else self.type
        right = f"{_KINDS[kind]}{self._bounds()}"
        if kind == "float" and isinstance(value, (int, float)) and not isinstance(value, bool) and _is_finite(value):
            value = float(value)
        elif not isinstance(value, _TYPES[kind]) or isinstance(value, bool) is not (kind == "bool"):
            raise ConfigError(f"expected {right}, got {value!r}", element=self.name)
        if not self._within(kind, value):
            raise ConfigError(f"expected {right}, got {value!r}", element=self.name)
        return value

    def _within(self, kind: str, value: Any) -> bool:
        if kind == "int" and not -(2**63) <= value < 2**63:
            return False  # no message could tell it
        if self.range is None:
            return True
        if kind == "str":
            return value in self.range
        low, high = self.range
        return (low is None or value >= low) and (high is None or value <= high)

    def _bounds(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        if self.range is None:
            return unit
        if self.type in ("str", "strs"):
            return f": {', '.join(map(str, self.range))}"
        low, high = self.range
        return f" of {low:g} or more{unit}" if high is None else f" from {low:g} to {high:g}{unit}"


def _is_finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number beyond every float
        return False


_KINDS = {"float": "a number", "int": "a whole number", "bool": "true or false", "str": "a text", "file": "a file"}
_TYPES: dict[str, type] = {"float": float, "int": int, "bool": bool, "str": str, "file": str}


class Processor:
    """A convenient base of what `SupportsExecute`: takes its parameters by keyword and keeps each as an attribute.

    Raises ConfigError.
    """

    parameters: ClassVar[tuple[Parameter, ...]] = ()
    outputs: tuple[str, ...] = ()
    report: Callable[[str], object] = staticmethod(lambda text: None)

    def __init__(self, **values: Any) -> None:
        given = {name: _declared(self, name).convert(value) for name, value in values.items()}
        for parameter in self.parameters:
            setattr(self, parameter.name, given.get(parameter.name, parameter.convert(parameter.default)))


def declared_parameters(processor: Any) -> Sequence[Parameter]:
    """Return the parameters of any processor."""
    return tuple(getattr(processor, "parameters", ()))


def set_value(processor: Any, name: str, value: Any) -> Any:
    """Set a parameter and give the value as it is kept. Raises ConfigError for an unknown one or a wrong value."""
    parameter = _declared(processor, name)
    if parameter.fixed:
        raise ConfigError("cannot be changed while it runs", element=name)
    converted = parameter.convert(value)
    setattr(processor, name, converted)
    return converted


def _declared(processor: Any, name: str) -> Parameter:
    known = {parameter.name: parameter for parameter in declared_parameters(processor)}
    if name not in known:
        text = f"{type(processor).__name__} has no such parameter; it has {', '.join(known) or 'none'}"
        raise ConfigError(text, element=name)
    return known[name]


def output_names(processor: Any, inputs: Sequence[str] | None) -> tuple[str, ...] | None:
    """Return the names of what a processor computes from these inputs; None if it does not declare them."""
    outputs = getattr(processor, "outputs", None)
    return tuple(outputs) if outputs else None if outputs is None or inputs is None else tuple(inputs)


def stacked(inputs: Mapping[str, Samples]) -> Samples:
    """Return all channels of all inputs, in their order: values (n, channels).

    Inputs of one topic have the same stamps. Raises ValueError for inputs that do not.
    """
    items = list(inputs.values())
    if len(items) == 1:
        return items[0]
    first = items[0]
    for name, item in inputs.items():
        if len(item) != len(first) or not np.array_equal(item.stamps, first.stamps):
            there = next(iter(inputs))
            raise ValueError(f"{name} has not the stamps of {there}: resample both, or take them from one topic")
    names = tuple(name for key, item in inputs.items() for name in (item.names or _made_up(key, item)))
    return Samples(np.hstack([item.channels() for item in items]), first.stamps, names)


def _made_up(key: str, item: Samples) -> tuple[str, ...]:
    width = item.channels().shape[1] if len(item) else 1
    return (key,) if width == 1 else tuple(f"{key}.{index}" for index in range(width))


def per_channel(values: tuple[float, ...], shape: tuple[int, ...], name: str) -> Floats | float:
    """Return one number for all channels of values of a shape (n, channels), or one for each. Raises ValueError."""
    if len(values) == 1:
        return values[0]
    if len(shape) < 2 or len(values) != shape[1]:
        found = f"{shape[1]} channels" if len(shape) > 1 else "one channel"
        raise ValueError(f"{name} has {len(values)} numbers, the data {found}")
    return np.array(values)
