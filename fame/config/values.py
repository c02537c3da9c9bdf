"""Values of a configuration file with their places: methods that check them, and dataclasses filled from them.

The data stay plain (`dict`, `list`, `float`, `str`); the line of each key path is kept beside them in a `Source`. Every
error reads ``FILE:LINE: KEY.PATH: expected Y, got X``.

Two other sets of checks are not these: messages of strangers (`fame.deploy.fields`) are refused, not explained; the
`Parameter` of a processor is set while it runs, by ROS and commands too, and so has neither file nor line.
"""

from __future__ import annotations

import math
import reprlib
import unicodedata
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import Any, TypeVar, get_type_hints

from fame.dataclasses import dataclass, field, fields, is_dataclass, replace
from fame.errors import ConfigError
from fame.text import suggestion

Point = tuple[float, float]
"""x and y in m."""
_LARGEST, _LEAST = 1e9, 1e-6
"""The largest absolute value of any number, and the smallest of one above 0: beyond them physics overflows."""
_REPR = reprlib.Repr()  # a list may hold itself, or others a thousand times
_REPR.maxlevel, _REPR.maxlist, _REPR.maxstring, _REPR.maxother = 4, 8, 60, 60


def join(path: str, key: str) -> str:
    """Return the path of a key inside a mapping."""
    return f"{path}.{key}" if path else key


@dataclass(frozen=True, slots=True)
class Source:
    """Where data came from: a file, and the line (1-based) of each key path, as in ``robots.REX.at[0]``.

    `columns` (1-based) are those of the first character of texts that stand on one line.
    """

    file: str = ""
    lines: Mapping[str, int] = field(default_factory=dict)
    columns: Mapping[str, int] = field(default_factory=dict)

    def line(self, path: str) -> int:
        """Return the line of a key path, or that of the nearest key around it; 0 if unknown."""
        while path and path not in self.lines:
            path = path[: max(path.rfind("."), path.rfind("["), 0)]
        return self.lines.get(path, 0)

    def error(self, path: str, text: str) -> ConfigError:
        """Return an error about the value at `path`."""
        return ConfigError(text, file=self.file, line=self.line(path), element=path)


@dataclass(frozen=True, slots=True)
class ConfigValue:
    """A value and its place. Methods that check it raise ConfigError if it does not fit."""

    data: Any
    path: str = ""
    source: Source = Source()

    @property
    def line(self) -> int:
        """Its line in the file (1-based), 0 if unknown."""
        return self.source.line(self.path)

    @property
    def column(self) -> int:
        """The column (1-based) where its text begins, 0 if unknown."""
        return self.source.columns.get(self.path, 0)

    def error(self, text: str) -> ConfigError:
        return self.source.error(self.path, text)

    def expected(self, what: str) -> ConfigError:
        """Return the error "expected `what`, got ..."."""
        return self.error(f"expected {what}, got {self._shown()}")

    def _shown(self) -> str:
        if self.data is None:
            return "nothing" if self.path else "an empty file"
        if isinstance(self.data, int) and abs(self.data) > 1e18:
            return f"a {'larger' if self.data > 0 else 'smaller'} whole number"
        shown = _REPR.repr(self.data)
        return shown if len(shown) < 60 else shown[:57] + "..."

    def mapping(self, known: Iterable[str] | None = None) -> dict[str, ConfigValue]:
        """Return its values by key, in the order of the file; only keys that are `known`, if given."""
        if not isinstance(self.data, Mapping):
            raise self.expected("a mapping of keys to values")
        values = {}
        for key, data in self.data.items():
            value = ConfigValue(data, join(self.path, str(key)), self.source)
            if not isinstance(key, str):
                raise value.error(f"expected a text as key, got {key!r}")
            if known is not None and key not in known:
                hint = "expected square brackets around a list" if key.endswith(")") else suggestion(key, known)
                raise value.error(f"unknown key; {hint}")
            values[key] = value
        return values

    def required(self, key: str, example: str) -> ConfigValue:
        """Return the value of a key that the mapping must have; `example` is what to write after it."""
        if key not in self.mapping():
            raise self.error(f"expected the key {key}: {example}")
        return self.mapping()[key]

    def items(self) -> list[ConfigValue]:
        """Return its values, of a list."""
        if not isinstance(self.data, list | tuple):
            raise self.expected("a list")
        return [ConfigValue(data, f"{self.path}[{index}]", self.source) for index, data in enumerate(self.data)]

    def number(
        self, *, above: float | None = None, minimum: float | None = None, maximum: float | None = None
    ) -> float:
        """Return a finite number, greater than `above`, from `minimum` to `maximum`."""
        data, what = self.data, f"a number{_limits(above, minimum, maximum)}"
        if isinstance(data, bool) or not isinstance(data, int | float):
            raise self.expected(what)
        if not -math.inf < data < math.inf:
            raise self.expected(what.replace("number", "finite number"))
        if abs(data) > _LARGEST:
            least = -_LARGEST if above is None and minimum is None else minimum
            most = _LARGEST if maximum is None else min(maximum, _LARGEST)
            raise self.expected(f"a number{_limits(above, least, most)}")
        if above == 0 and 0 < data < _LEAST:
            raise self.expected(f"a number of at least {_LEAST:g}")
        low = (above is not None and data <= above) or (minimum is not None and data < minimum)
        if low or (maximum is not None and data > maximum):
            raise self.expected(what)
        return float(data)

    def integer(self, *, minimum: int, maximum: int | None = None) -> int:
        """Return a whole number from `minimum` to `maximum`."""
        data, most = self.data, math.inf if maximum is None else maximum
        if isinstance(data, bool) or not isinstance(data, int) or not minimum <= data <= most:
            raise self.expected(f"a whole number{_limits(None, minimum, maximum)}")
        return data

    def numbers(self, count: int, example: str) -> list[float]:
        """Return a list of `count` finite numbers, such as `example`."""
        if not isinstance(self.data, list | tuple) or len(self.data) != count:
            raise self.expected(example)
        return [value.number() for value in self.items()]

    def point(self) -> Point:
        """Return a place on the ground, in m."""
        x, y = self.numbers(2, "[x, y] in m")
        return x, y

    def text(self) -> str:
        """Text that is not empty and has no control characters."""
        if not isinstance(self.data, str) or not self.data.strip():
            raise self.expected("a text")
        if any(unicodedata.category(letter) in ("Cc", "Cs") for letter in self.data):
            raise self.expected("a text of one line without control characters")
        return self.data

    def choice(self, known: Iterable[str], what: str) -> str:
        """Return one of the `known` words, each of which is a `what`."""
        words = list(known)
        if self.text() not in words:
            raise self.error(f"expected {what}, got {self._shown()}; {suggestion(self.text(), words)}")
        return self.text()

    def boolean(self) -> bool:
        """True or false."""
        if not isinstance(self.data, bool):
            raise self.expected("true or false")
        return self.data


def entries(parts: Mapping[str, ConfigValue], key: str, known: Iterable[str] | None = None) -> dict[str, ConfigValue]:
    """Return the entries of a mapping that may be missing or empty."""
    return parts[key].mapping(known) if key in parts and parts[key].data is not None else {}


def _limits(above: float | None, minimum: float | None, maximum: float | None) -> str:
    """The limits of a number in words.

    >>> _limits(0, None, None), _limits(None, 1, 5), _limits(0, None, 2), _limits(None, None, None)
    (' above 0', ' from 1 to 5', ' above 0 and at most 2', '')
    """
    if minimum is not None and maximum is not None:
        return f" from {_shortest(minimum)} to {_shortest(maximum)}"
    limits = {"above": above, "of at least": minimum, "at most" if above is not None else "of at most": maximum}
    return "".join(
        f"{' and' if word == 'at most' else ''} {word} {_shortest(limit)}"
        for word, limit in limits.items()
        if limit is not None
    )


def _shortest(number: float) -> str:
    """A number with six digits, or twelve if it has more; the largest one below 1 is 1."""
    return text if math.isclose(float(text := f"{number:g}"), number) else f"{number:.12g}"


# ---- dataclasses of parameters ---------------------------------------------------------------------------------------

Parameters = TypeVar("Parameters")


def parameter(default: Any, unit: str = "", *, up_to: str = "", **limits: Any) -> Any:
    """Return a field of a dataclass of parameters, which people set in a file.

    default  its value where the file says nothing
    unit     of a number, such as ``m/s``
    up_to    the name of a field that bounds this one from above
    limits   of a number ``minimum``, ``maximum``, ``above``, and ``names``: words, and the numbers that they mean;
             of a text ``known``: the words that it may be
    """
    return field(default=default, metadata={"limits": limits, "unit": unit, "up_to": up_to})


def fill(defaults: Parameters, value: ConfigValue, *, besides: Iterable[str] = ()) -> Parameters:
    """Return a dataclass of parameters, changed as a mapping says; keys `besides` its own are left to the caller.

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


def _text(value: ConfigValue, *, known: Iterable[str] = ()) -> str:
    return value.choice(known, f"one of {', '.join(known)}") if known else value.text()


_READERS: dict[Any, Callable[..., Any]] = {
    float: _number,
    int: ConfigValue.integer,
    bool: ConfigValue.boolean,
    str: _text,
}
