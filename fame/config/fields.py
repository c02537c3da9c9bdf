"""Reads YAML so that every complaint can name the file, the line and the key.

The data stay plain (`dict`, `list`, `float`, `str`); the line of each key is kept beside them in a `Source`. An
`Entry` is a value together with its place: its methods hand out the value checked, or raise a `ConfigError` that says
what was found and what would be right. `fill` does this for a whole dataclass of parameters: names, types, limits and
defaults are the dataclass's own, so that they are written once.
"""

from __future__ import annotations

import math
import reprlib
import unicodedata
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cache
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import yaml

from fame.errors import ConfigError
from fame.text import suggestion

Point = tuple[float, float]
"""x and y in m."""
Parameters = TypeVar("Parameters")
_LARGEST, _LEAST = 1e9, 1e-6
"""What any number is at most, to either side of 0, and at least where it has to be above 0: what physics can bear."""
_REPR = reprlib.Repr()  # a list may hold itself, or others a thousand times
_REPR.maxlevel, _REPR.maxlist, _REPR.maxstring, _REPR.maxother = 4, 8, 60, 60


@dataclass(frozen=True, slots=True)
class Source:
    """Where data came from: a file, and the line (1-based) of each key path, as in ``robots.REX.at[0]``."""

    file: str = ""
    lines: Mapping[str, int] = field(default_factory=dict)

    def error(self, path: str, text: str) -> ConfigError:
        """The complaint about the value at `path`, on its line or that of the nearest key around it."""
        inner = path
        while inner and inner not in self.lines:
            inner = inner[: max(inner.rfind("."), inner.rfind("["), 0)]
        return ConfigError(text, file=self.file, line=self.lines.get(inner, 0), element=path)


def read_yaml(path: str | PathLike[str]) -> tuple[Any, Source]:
    """The data of a YAML file, and their source. Raises ConfigError: no such file, not YAML, a key given twice."""
    file = str(path)
    try:
        text = Path(path).read_text(encoding="utf-8")
        loader = yaml.SafeLoader(text)
        node = loader.get_single_node()
        lines: dict[str, int] = {}
        if node is not None:
            _note_lines(node, "", lines, set(), file)
        data = loader.construct_document(node) if node is not None else None
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", file=file) from None
    except UnicodeDecodeError:
        raise ConfigError("is not text in UTF-8", file=file) from None
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 0
        raise ConfigError(f"is not YAML: {error.problem or error.context}", file=file, line=line) from None
    except (yaml.YAMLError, ValueError) as error:
        raise ConfigError(f"is not YAML: {error}", file=file) from None
    except RecursionError:
        raise ConfigError("is nested too deeply, a few levels would be right", file=file) from None
    except (LookupError, AttributeError, TypeError, OverflowError):  # PyYAML's own, of `!!bool maybe` and its like
        raise ConfigError("is not YAML: found a tag (!!...) whose value is of another kind", file=file) from None
    return data, Source(file, lines)


def _note_lines(node: yaml.Node, path: str, lines: dict[str, int], seen: set[int], file: str) -> None:
    lines.setdefault(path, node.start_mark.line + 1)
    if id(node) in seen:  # an alias: its lines are noted, and it may contain itself
        return
    seen.add(id(node))
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            inner = f"{path}.{key.value}" if path else str(key.value)
            if inner in lines:
                raise ConfigError("is given twice", file=file, line=key.start_mark.line + 1, element=inner)
            lines[inner] = key.start_mark.line + 1
            _note_lines(value, inner, lines, seen, file)
    elif isinstance(node, yaml.SequenceNode):
        for index, value in enumerate(node.value):
            _note_lines(value, f"{path}[{index}]", lines, seen, file)


@dataclass(frozen=True, slots=True)
class Entry:
    """A value and its place. Every method raises ConfigError if the value is not what it asks for."""

    value: Any
    path: str = ""
    source: Source = Source()

    def error(self, text: str) -> ConfigError:
        """A complaint about this value."""
        return self.source.error(self.path, text)

    def wrong(self, right: str) -> ConfigError:
        """The complaint that this value was found where `right` belongs."""
        if self.value is None:
            found = "nothing" if self.path else "an empty file"
        elif isinstance(self.value, int) and abs(self.value) > _LARGEST:
            found = "a whole number" if abs(self.value) > 1e18 else repr(self.value)
        else:
            found = _REPR.repr(self.value)
        return self.error(f"found {found if len(found) < 60 else found[:57] + '...'}, {right} would be right")

    def mapping(self, known: Iterable[str] | None = None) -> dict[str, Entry]:
        """Its entries by key, in the order of the file; only keys that are `known`, if given."""
        if not isinstance(self.value, Mapping):
            raise self.wrong("a mapping of keys to values")
        entries = {}
        for key, value in self.value.items():
            entry = Entry(value, f"{self.path}.{key}" if self.path else str(key), self.source)
            if not isinstance(key, str):
                raise entry.error(f"found the key {key!r}, text would be right")
            if known is not None and key not in known:
                raise entry.error(f"unknown key; {suggestion(key, known)}")
            entries[key] = entry
        return entries

    def items(self) -> list[Entry]:
        """Its entries, of a list."""
        if not isinstance(self.value, list | tuple):
            raise self.wrong("a list")
        return [Entry(value, f"{self.path}[{index}]", self.source) for index, value in enumerate(self.value)]

    def number(
        self, *, above: float | None = None, minimum: float | None = None, maximum: float | None = None
    ) -> float:
        """A finite number, greater than `above`, from `minimum` to `maximum`."""
        value = self.value
        limits = {"above": above, "of at least": minimum, "of at most": maximum}
        right = " and ".join(f"{word} {limit:g}" for word, limit in limits.items() if limit is not None)
        right = f"a finite number {right}".rstrip()
        if isinstance(value, bool) or not isinstance(value, int | float) or value != value or abs(value) == math.inf:
            raise self.wrong(right)
        if abs(value) > _LARGEST:
            raise self.wrong(f"{right} from {-_LARGEST:g} to {_LARGEST:g}")
        if above == 0 and 0 < value < _LEAST:
            raise self.wrong(f"a number of at least {_LEAST:g}")
        low = (above is not None and value <= above) or (minimum is not None and value < minimum)
        if low or (maximum is not None and value > maximum):
            raise self.wrong(right)
        return float(value)

    def whole(self, *, minimum: int, maximum: int | None = None) -> int:
        """A whole number from `minimum` to `maximum`."""
        value, most = self.value, math.inf if maximum is None else maximum
        if isinstance(value, bool) or not isinstance(value, int) or not minimum <= value <= most:
            right = f"a whole number of at least {minimum}"
            raise self.wrong(right if maximum is None else f"{right} and at most {maximum}")
        return value

    def numbers(self, count: int, right: str) -> list[float]:
        """A list of `count` finite numbers; `right` is an example of it."""
        if not isinstance(self.value, list | tuple) or len(self.value) != count:
            raise self.wrong(right)
        return [entry.number() for entry in self.items()]

    def point(self) -> Point:
        """A place on the ground, in m."""
        x, y = self.numbers(2, "[x, y] in m")
        return x, y

    def text(self) -> str:
        """Text that is not empty and has no control characters."""
        if not isinstance(self.value, str) or not self.value.strip():
            raise self.wrong("a text")
        if any(unicodedata.category(letter) in ("Cc", "Cs") for letter in self.value):
            raise self.wrong("a text of one line, without control characters,")
        return self.value

    def flag(self) -> bool:
        """True or false."""
        if not isinstance(self.value, bool):
            raise self.wrong("true or false")
        return self.value


def parameter(default: Any, unit: str = "", *, up_to: str = "", **limits: Any) -> Any:
    """A field of a parameter dataclass, with the limits that `fill` holds: those of `Entry.number` or `Entry.whole`.

    `names` maps words that may stand for a number to that number; `up_to` names a field that it must not be above.
    """
    return field(default=default, metadata={"limits": limits, "unit": unit, "up_to": up_to})


def fill(defaults: Parameters, entry: Entry, *, besides: Iterable[str] = ()) -> Parameters:
    """A dataclass of parameters, changed as a mapping says; keys `besides` its own are left to the caller.

    Raises ConfigError for a key that it does not have and a value that does not fit.
    """
    assert is_dataclass(defaults)
    assert not isinstance(defaults, type)
    hints = _hints(type(defaults))
    limits = {item.name: item.metadata.get("limits", {}) for item in fields(defaults)}
    values = entry.mapping([*besides, *limits])
    given = {name: values[name] for name in limits if name in values}
    read = {
        name: fill(getattr(defaults, name), value)
        if is_dataclass(hints[name])
        else _READERS[hints[name]](value, **limits[name])
        for name, value in given.items()
    }
    filled = replace(defaults, **read)
    for low, high in ((item.name, item.metadata.get("up_to")) for item in fields(defaults)):
        if high and (found := getattr(filled, low)) > (most := getattr(filled, high)):
            raise (values.get(low) or values.get(high, entry)).error(
                f"found {low} {found:g}, at most that of {high}, {most:g}, would be right"
            )
    return filled


_hints = cache(get_type_hints)


def _number(entry: Entry, *, names: Mapping[str, float] | None = None, **limits: float) -> float:
    if names and isinstance(entry.value, str):
        if entry.value not in names:
            raise entry.error(f"found {entry.value!r}; {suggestion(entry.value, names)}, or a number")
        return names[entry.value]
    return entry.number(**limits)


_READERS: dict[Any, Callable[..., Any]] = {
    float: _number,
    int: Entry.whole,
    bool: Entry.flag,
    str: Entry.text,
}
