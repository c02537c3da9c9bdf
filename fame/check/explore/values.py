"""Values in an exploration: known ones by number, and those that are unknown.

`Unknown` takes part in expressions of Python: what is computed from it is unknown, and its truth is a decision of the
exploration, which goes both ways. `Values` numbers what variables and messages hold, so that states are small and
compare fast; each value is made anew from its number where it can be changed.
"""

from __future__ import annotations

import marshal
import math
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

from fame.errors import FameError, MessageError
from fame.middleware import messages, typesystem
from fame.middleware.definitions import EMPTY_FIELD
from fame.scripting.python_effects import CHANGING_METHODS

MOST_ITEMS = 2
"""Items of a list that is unknown."""


class _Lengths(int):
    """A number of ways that `choose` tells from others."""


LENGTHS = _Lengths(MOST_ITEMS + 1)
MARK = "\u2047"
"""Stands for an unknown value in a text, which is then unknown itself."""
_NOT_ITS_OWN = ("send", "throw", "close")
"""Attributes by which the engine recognises a suspended script."""


class UndecidableError(BaseException):
    """Code asked an unknown value for what it cannot give. Not an `Exception`, so that scripts do not catch it."""


class Unknown:
    """A value that is not known. `choose(n)` decides between n ways wherever code asks for its truth.

    Each one is an object of its own: whether two of them are equal is unknown. Python's lists and tuples take an object
    as equal to itself, and sets and mappings find by a hash: what asks for that of an unknown value is undecidable.
    """

    __slots__ = ("choose",)

    def __init__(self, choose: Callable[[int], int]) -> None:
        self.choose: Callable[[int], int] = choose

    def __bool__(self) -> bool:
        return self.choose(2) == 0

    def __iter__(self) -> Iterator[Unknown]:
        return iter([Unknown(self.choose) for _ in range(self.choose(LENGTHS))])

    def __index__(self) -> int:
        return self.choose(LENGTHS)

    __int__ = __index__

    def __contains__(self, item: object) -> bool:
        return self.choose(2) == 0

    def __str__(self) -> str:
        return MARK

    __repr__ = __str__

    def __format__(self, spec: str) -> str:
        return MARK

    def __float__(self) -> float:
        raise UndecidableError

    def __hash__(self) -> int:
        raise UndecidableError

    def __len__(self) -> int:
        raise UndecidableError

    def __getitem__(self, key: object) -> Unknown:
        return Unknown(self.choose)

    def __setitem__(self, key: object, value: object) -> None:
        """It is as unknown afterwards."""

    __delitem__ = __getitem__

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name in _NOT_ITS_OWN:
            raise AttributeError(name)
        return self._changed if name in CHANGING_METHODS else Unknown(self.choose)

    def _changed(self, *arguments: object, **named: object) -> Unknown:
        """What ``append`` and the like give: it is as unknown afterwards."""
        return Unknown(self.choose)


def is_unknown(value: object) -> bool:
    return value.__class__ is Unknown


def _unknown(self: Unknown, *others: object) -> Unknown:
    return Unknown(self.choose)


for _name in ("add", "sub", "mul", "truediv", "floordiv", "mod", "pow", "and", "or", "xor", "lshift", "rshift"):
    setattr(Unknown, f"__{_name}__", _unknown)
    setattr(Unknown, f"__r{_name}__", _unknown)
for _name in ("eq", "ne", "lt", "le", "gt", "ge", "neg", "pos", "abs", "invert", "round", "divmod", "rdivmod"):
    setattr(Unknown, f"__{_name}__", _unknown)


def numbers_of(values: Values) -> dict[str, Any]:
    """`math`, ``float`` and ``int`` for scripts: what they make of something unknown is unknown."""

    def known(function: Callable[..., Any]) -> Callable[..., Any]:
        def compute(*arguments: Any, **named: Any) -> Any:
            if any(map(is_unknown, arguments)):
                return values.unknown
            try:
                return function(*arguments, **named)
            except UndecidableError:  # something in a list is unknown
                return values.unknown

        return compute

    functions = {name: known(one) if callable(one) else one for name, one in vars(math).items() if name[0] != "_"}
    return {"math": SimpleNamespace(**functions), "float": known(float), "int": known(int)}


_ATOMS = frozenset({type(None), bool, int, float, str, bytes})
_PLAIN = frozenset({list, tuple, dict, set, frozenset})
_MUTABLE: dict[str, Callable[[Any], Any]] = {"list": list, "set": set}
_FROZEN: dict[str, Callable[[Any], Any]] = {"tuple": tuple, "frozenset": frozenset}
UNKNOWN = 0
"""The number of the unknown value."""


class Values:
    """Numbers for values; those that are not known have number 0. `choose` is asked for their truth, see `Unknown`."""

    def __init__(self) -> None:
        self.choose: Callable[[int], int] = lambda ways: 0
        self._numbers: dict[Any, int] = {"?": UNKNOWN}
        self._made: list[tuple[str, Any]] = [("unknown", None)]
        self._constants: dict[int, Any] = {}  # values that nothing can change
        self._places: dict[int, int] = {}  # their numbers by id
        self._fixed: set[int] = {UNKNOWN}  # other values that nothing can change, but that are made anew

    @property
    def unknown(self) -> Unknown:
        return Unknown(self.choose)

    def __len__(self) -> int:
        return len(self._made)

    def number(self, value: Any) -> int:
        """Return the number of a value; that of the unknown one for what is not plain data or a message."""
        kind = value.__class__
        if kind in _ATOMS:
            key: Any = (kind, value)
            number = self._numbers.get(key)
            if number is None:
                if (kind is str and MARK in value) or value != value:
                    return UNKNOWN
                number = self._add(key, "atom", value)
            return number
        try:
            return self._compound(value)
        except RecursionError:  # nested too deep
            return UNKNOWN

    def _compound(self, value: Any) -> int:
        number = self._places.get(id(value))
        if number is not None:
            return number
        kind = value.__class__
        if kind in _PLAIN:
            try:
                data = marshal.dumps(value, 2)  # without references, so that equal values give equal bytes
            except ValueError:  # it holds a message, or something unknown
                return self._structured(value)
            number = self._numbers.get(data)
            if number is None:
                if marshal.loads(data) != value or MARK.encode() in data:
                    return self._structured(value)
                number = self._add(data, "data", data)
                if kind is tuple and _is_constant(value):
                    self._keep(number, value)
            return number
        return self._structured(value)

    def _structured(self, value: Any) -> int:
        """The number of a value by its parts."""
        kind = value.__class__
        name: str = kind.__name__
        content: Any
        if kind in (list, tuple):
            content = tuple([self.number(item) for item in value])
        elif kind in (set, frozenset):
            content = tuple(sorted(self.number(item) for item in value))
        elif kind is dict:
            content = tuple([(self.number(key), self.number(item)) for key, item in value.items()])
        elif names := _names_of_fields(kind):
            name = value.__msgtype__
            content = tuple([self.number(getattr(value, field)) for field in names])
        else:
            return UNKNOWN
        key = (name, content)
        number = self._numbers.get(key)
        if number is None:
            number = self._add(key, name, content if "/" not in name else (kind, content))
            fixed = kind is tuple or "/" in name  # messages are never changed
            if fixed and all(map(self.is_constant, content)):
                self._keep(number, self.value(number))
            elif fixed and all(map(self.is_fixed, content)):
                self._fixed.add(number)
        return number

    def _add(self, key: Any, name: str, content: Any) -> int:
        number = self._numbers[key] = len(self._made)
        self._made.append((name, content))
        if name == "atom":
            self._constants[number] = content
        return number

    def _keep(self, number: int, value: Any) -> None:
        """Give the same value for a number from now on: it cannot be changed."""
        self._constants[number] = value
        self._places[id(value)] = number

    def is_constant(self, number: Any) -> bool:
        """Return whether the value of a number is always the same one, since nothing can change it."""
        return number in self._constants

    def is_fixed(self, number: Any) -> bool:
        """Return whether nothing can change an object with the value of a number: parts of it may be unknown."""
        return number in self._constants or number in self._fixed

    def value(self, number: int) -> Any:
        """Return the value of a number, made anew if it can be changed."""
        if number in self._constants:
            return self._constants[number]
        if number == UNKNOWN:
            return Unknown(self.choose)
        name, content = self._made[number]
        if name == "data":
            return marshal.loads(content)
        if name in _MUTABLE or name in _FROZEN:
            make = _MUTABLE.get(name) or _FROZEN[name]
            return make([self.value(item) for item in content])
        if name == "dict":
            return {self.value(key): self.value(item) for key, item in content}
        kind, numbers = content
        return kind(*[self.value(item) for item in numbers])

    def text(self, number: int, width: int = 60) -> str:
        """Return the known part of a value, for people; empty if nothing is known."""
        shown = self._known(self.value(number))
        text = "" if shown in (None, {}) else repr(shown)
        return text if len(text) <= width else f"{text[: width - 3]}..."

    def _known(self, value: Any) -> Any:
        """A value without what is unknown, messages as mappings."""
        if is_unknown(value):
            return None
        if hasattr(value, "__msgtype__"):
            known = {field.name: self._known(getattr(value, field.name)) for field in fields(value)}
            return {name: item for name, item in known.items() if item not in (None, {}) and name != EMPTY_FIELD}
        if isinstance(value, list | tuple):
            return [self._known(item) for item in value]
        return value

    # ---- messages ------------------------------------------------------------------------------------

    def message(self, type_name: str, value: Any) -> Any:
        """Return a message of that type with a payload whose parts may be unknown. Raises
        MessageError if it does not fit."""
        if not isinstance(value, dict) and self._has_unknown(value):
            blank = self.unknown_message(type_name)
            return value if value.__class__ is blank.__class__ else blank
        known, unknown = self._split(value)
        message = messages.create(type_name, known)
        for path in unknown:
            _set(message, path, self.unknown)
        return message

    def unknown_message(self, type_name: str) -> Any:
        """Return a message of which nothing is known but its type; the unknown value if FAME does not know that."""
        try:
            message = messages.create(type_name)
        except FameError:
            return self.unknown
        self._forget(message)
        return message

    def _forget(self, message: Any) -> None:
        for field in fields(message):
            inner = getattr(message, field.name)
            if is_dataclass(inner):
                self._forget(inner)
            else:
                object.__setattr__(message, field.name, self.unknown)

    def _split(self, value: Any, path: tuple[str, ...] = ()) -> tuple[Any, list[tuple[str, ...]]]:
        """The payload without its unknown fields, and the paths of these."""
        if not isinstance(value, dict):
            return (None, [path]) if self._has_unknown(value) else (value, [])
        known, unknown_paths = {}, list[tuple[str, ...]]()
        for name, item in value.items():
            inner, paths = self._split(item, (*path, str(name)))
            unknown_paths += paths
            if not paths or isinstance(item, dict):
                known[name] = inner
        return known, unknown_paths

    def _has_unknown(self, value: Any) -> bool:
        return self.number(value) == UNKNOWN or holds_unknown(value)


@lru_cache(maxsize=256)
def _names_of_fields(kind: type) -> tuple[str, ...]:
    """The fields of a class of messages; of any other class none."""
    is_message = is_dataclass(kind) and hasattr(kind, "__msgtype__")
    return tuple(field.name for field in fields(kind)) if is_message else ()


def is_fixed(value: Any) -> bool:
    """Return whether nothing can change a value: it is a number, a text, a tuple of such, or a message."""
    return _is_constant(value) or hasattr(value, "__msgtype__")


def _is_constant(value: Any) -> bool:
    """Whether nothing can change a value."""
    return value.__class__ in _ATOMS or (value.__class__ is tuple and all(map(_is_constant, value)))


def holds_unknown(value: Any) -> bool:
    """Return whether something unknown is somewhere in a list, or in a mapping or message of one."""
    if isinstance(value, dict):
        return any(map(holds_unknown, value.values()))
    if isinstance(value, list | tuple):
        return any(map(holds_unknown, value))
    if hasattr(value, "__msgtype__"):
        return any(holds_unknown(getattr(value, field.name)) for field in fields(value))
    return is_unknown(value)


def _set(message: Any, path: tuple[str, ...], value: Any) -> None:
    """Set a field, by names as in the definitions of types. Raises MessageError if there is no such field."""
    for place, name in enumerate(path, 1):
        attributes = {field.name: field.attribute for field in typesystem.definition(message.__msgtype__).fields}
        if name not in attributes:
            raise MessageError("there is no such field", type=message.__msgtype__, field=name)
        if place == len(path):
            object.__setattr__(message, attributes[name], value)
        else:
            message = getattr(message, attributes[name])
