"""Dataclasses of parameters, filled from a mapping: names, types, limits and defaults are written once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import field, fields, is_dataclass, replace
from functools import cache
from typing import Any, TypeVar, get_type_hints

from fame.config.values import ConfigValue

Parameters = TypeVar("Parameters")


def parameter(default: Any, unit: str = "", *, up_to: str = "", **limits: Any) -> Any:
    """A field of a dataclass of parameters, with the limits of `ConfigValue.number` or `ConfigValue.integer`.

    `names` maps words to the numbers that they mean; `up_to` names a field that bounds this one from above.
    """
    return field(default=default, metadata={"limits": limits, "unit": unit, "up_to": up_to})


def fill(defaults: Parameters, value: ConfigValue, *, besides: Iterable[str] = ()) -> Parameters:
    """A dataclass of parameters, changed as a mapping says; keys `besides` its own are left to the caller.

    Raises ConfigError for an unknown key and a value that does not fit.
    """
    assert is_dataclass(defaults)
    assert not isinstance(defaults, type)
    hints = _hints(type(defaults))
    limits = {item.name: item.metadata.get("limits", {}) for item in fields(defaults)}
    values = value.mapping([*besides, *limits])
    read = {
        name: fill(getattr(defaults, name), values[name])
        if is_dataclass(hints[name])
        else _READERS[hints[name]](values[name], **limits[name])
        for name in limits
        if name in values
    }
    filled = replace(defaults, **read)
    for low, high in ((item.name, item.metadata.get("up_to")) for item in fields(defaults)):
        if high and (got := getattr(filled, low)) > (most := getattr(filled, high)):
            raise (values.get(low) or values.get(high, value)).error(
                f"expected {low} to be at most {high} ({most:g}), got {got:g}"
            )
    return filled


_hints = cache(get_type_hints)


def _number(value: ConfigValue, *, names: Mapping[str, float] | None = None, **limits: float) -> float:
    if names and isinstance(value.data, str):
        return names[value.choice(names, "a number or a name")]
    return value.number(**limits)


_READERS: dict[Any, Callable[..., Any]] = {
    float: _number,
    int: ConfigValue.integer,
    bool: ConfigValue.boolean,
    str: ConfigValue.text,
}
