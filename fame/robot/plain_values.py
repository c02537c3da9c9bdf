"""Variables as JSON: any value of a mission, cut where it is large.

Numbers, texts, truth values, null, lists and mappings are themselves, messages and objects are mappings of their
fields. What is cut says so: ``{"$cut": "list of 10000", "first": [...]}``, ``{"$cut": "text of 5000", ...}``,
``{"$cut": "array of 15504"}``, ``{"$cut": "Plan of 12345 characters"}`` for what is too large as a whole. NaN and
infinities, which JSON does not have, are the texts ``"NaN"``, ``"Infinity"`` and ``"-Infinity"``; complex numbers are
texts, too. In messages without lists, NaN and infinities are null.
"""

from __future__ import annotations

import reprlib
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from copy import copy
from functools import cache
from itertools import islice
from types import ModuleType
from typing import Any

from fame.middleware import typesystem
from fame.middleware.messages import Message
from fame.robot.change_text import TEXT, complex_text, float_text, message_text, name_text, string
from fame.robot.message_parts import LONG, has_lists, reader

try:
    import orjson
except ImportError:  # a workspace of ROS that was built by colcon alone: messages are encoded field by field
    orjson = None  # type: ignore[assignment]

ITEMS = 16
"""Most items of a list, array or mapping that is kept whole."""
SIZE = 4000
"""Most characters of a value as JSON."""
_DEPTH = 8
_FIRST = 4

Encode = Callable[[Any, int], str]
"""Gives the JSON of a value; how many levels of lists and mappings it may have."""


def json_text(value: Any) -> str:
    """A value as JSON, on one line."""
    text = _encode(value, _DEPTH)
    return text if len(text) <= SIZE else _cut(f"{type(value).__name__} of {len(text)} characters")


def is_data(name: str, value: Any) -> bool:
    """Whether a variable is data: functions, classes, modules and names with two leading underscores are not."""
    return not (name.startswith("__") or callable(value) or isinstance(value, ModuleType))


def plain(value: Any) -> Any:
    """The plain form of a value in changes: plain data that `marshal` takes and that does not change.

    That is a number or short text itself, the parts of a message, the format and bytes of an array of numbers, JSON
    (bytes), or ``...`` for code, which is no data.
    """
    kind = value.__class__
    make = _PLAIN.get(kind)
    if make is None:
        make = _PLAIN[kind] = _plain_maker(kind)
        if kind is not tuple and not is_changeable(value):
            FIXED[kind] = make
    try:
        return make(value)
    except (AttributeError, struct.error):  # a message with a number where a message belongs, a text where a number
        return _json_bytes(value)


def _plain_maker(kind: type) -> Callable[[Any], Any]:
    """The function that converts the values of a class to their plain form."""
    if issubclass(kind, Message):
        return reader(kind.__msgtype__) or _json_bytes
    if kind is str:
        return _plain_text
    if kind.__module__ == "numpy" and kind.__name__ == "ndarray":
        return _plain_array
    return next((base for base in (bool, int, float, complex) if issubclass(kind, base)), _json_bytes)


def _plain_text(text: str) -> Any:
    return text if len(text) <= TEXT else _json_bytes(text)


def _json_bytes(value: Any) -> Any:
    return json_text(value).encode("utf-8", "surrogatepass") if is_data("", value) else ...


def _plain_array(array: Any) -> Any:
    """A small array of numbers as the format of its items (`struct`) and bytes; another one as JSON."""
    code = array.dtype.char
    if array.ndim == 1 and 0 < array.size <= ITEMS and code in _NUMBERS and array.dtype.isnative:
        return f"{array.size}{code}", array.tobytes()
    return _json_bytes(array)


_NUMBERS = frozenset("bBhHiIlLqQfd")
"""The codes of items that numpy and `struct` have in common."""
FIXED: dict[type, Callable[[Any], Any]] = {type(None): lambda none: none}
"""The functions that `plain` calls for values that are not changed in place, by their class. They raise AttributeError
or struct.error for a message with a value of another class in it; `plain` does not."""
_PLAIN: dict[type, Callable[[Any], Any]] = {**FIXED}


def is_changeable(value: Any) -> bool:
    """Whether a value may be changed in place, as lists, mappings, arrays and objects, but not messages."""
    kind = value.__class__
    if kind is tuple:
        return any(map(is_changeable, value))
    known = _CHANGED_IN_PLACE.get(kind)
    if known is None:
        mutable = kind.__hash__ is None or hasattr(value, "__dict__") or getattr(value, "ndim", 0) > 0
        known = _CHANGED_IN_PLACE[kind] = mutable and not (isinstance(value, Message | ModuleType) or callable(value))
    return known


def snapshot_of(value: Any, depth: int = _DEPTH) -> Any:
    """A value to compare with later: a copy of what can be changed in place, else the value itself.

    What is below `depth` is not copied: its JSON is cut there, and a list may contain itself.
    """
    kind = value.__class__
    if depth == 0:
        return value
    if kind is list:
        return [snapshot_of(item, depth - 1) if item.__class__ in _CHANGEABLE else item for item in value]
    if kind is dict:
        return {key: snapshot_of(item, depth - 1) for key, item in value.items()}
    if kind in _CHANGEABLE:
        return copy(value)
    has_bytes = hasattr(kind, "tobytes") and not getattr(getattr(value, "dtype", None), "hasobject", True)  # numpy
    return value.copy() if has_bytes else value


def differs(value: Any, snapshot: Any) -> bool:
    """Whether a value has changed since its snapshot was taken; True where nobody can tell."""
    kind = value.__class__
    if kind is not snapshot.__class__ or value is snapshot:  # there is no copy of an object
        return True
    try:
        if kind in _CHANGEABLE:
            return bool(value != snapshot)
        return value.tobytes() != snapshot.tobytes() or (value.dtype, value.shape) != (snapshot.dtype, snapshot.shape)
    except Exception:  # of what a list has in it
        return True


_CHANGEABLE = frozenset((list, dict, set, bytearray))
_CHANGED_IN_PLACE: dict[type, bool] = {}


# ---- values ----------------------------------------------------------------------------------------------------------


def _encode(value: Any, depth: int) -> str:
    encoder = _ENCODERS.get(value.__class__)
    if encoder is None:
        encoder = _ENCODERS[value.__class__] = _encoder(value.__class__)
    return encoder(value, depth)


def _encoder(kind: type) -> Encode:
    """The function that encodes values of a class."""
    if issubclass(kind, Message):
        return _message if has_lists(kind.__msgtype__) else _small_message
    if issubclass(kind, bool | int | float | str | bytes | complex):
        base = next(base for base in (bool, int, float, str, bytes, complex) if issubclass(kind, base))
        return lambda value, depth: _ENCODERS[base](base(value), depth)
    if hasattr(kind, "tolist"):  # arrays and numbers of numpy
        return _array
    if issubclass(kind, Mapping):
        return lambda value, depth: _mapping(value.items(), kind.__name__, len(value), depth)
    if issubclass(kind, Sequence | set | frozenset):
        return _listing
    return _object


def _float(value: float, depth: int) -> str:
    return float_text(value)


def _text(value: str, depth: int) -> str:
    return string(value) if len(value) <= TEXT else _cut(f"text of {len(value)}", string(value[:80]))


def _listing(value: Any, depth: int) -> str:
    if depth == 0:
        return _cut(reprlib.repr(value))
    if len(value) <= ITEMS:
        return f"[{','.join([_encode(item, depth - 1) for item in value])}]"
    first = ",".join([_encode(item, depth - 1) for item in islice(value, _FIRST)])
    return _cut(f"{value.__class__.__name__} of {len(value)}", f"[{first}]")


def _array(value: Any, depth: int) -> str:
    size = getattr(value, "size", None)
    if not getattr(value, "ndim", 0) or not isinstance(size, int):  # a number; an array of Python itself
        return _encode(value.tolist(), depth)
    return _listing(value.tolist(), depth) if size <= ITEMS else _long_array(size)


@cache
def _long_array(size: int) -> str:
    return _cut(f"array of {size}")


def _mapping(items: Iterable[tuple[Any, Any]], kind: str, size: int, depth: int) -> str:
    if depth == 0:
        return _cut(f"{kind} of {size}")
    members = [
        f"{name_text(str(key))}:{_encode(item, depth - 1)}"
        for key, item in islice(items, ITEMS * 4)
        if is_data("", item)
    ]
    text = f"{{{','.join(members)}}}"
    return text if size <= ITEMS * 4 else _cut(f"{kind} of {size}", text)


def _object(value: Any, depth: int) -> str:
    fields = getattr(value, "__dict__", None)
    if fields is None or depth == 0:
        return _cut(reprlib.repr(value))
    named = {name: item for name, item in fields.items() if not name.startswith("_")}
    return _mapping(named.items(), type(value).__name__, len(named), depth)


def _message(value: Any, depth: int) -> str:
    """A message of a type with lists: field by field if one of them is long."""
    sequences = _sequences(value.__msgtype__)
    if depth == _DEPTH and sequences and orjson is not None:
        with suppress(TypeError):  # what was put into its fields does not fit
            if max(len(getattr(value, name)) for name in sequences) <= ITEMS:
                text: str = orjson.dumps(value, option=orjson.OPT_SERIALIZE_NUMPY).decode()
                if "null" not in text:
                    return text
    fields = _message_fields(value.__msgtype__)
    return _mapping(((name, getattr(value, name)) for name in fields), type(value).__name__, len(fields), depth)


def _small_message(value: Any, depth: int) -> str:
    """A message of a type without lists of any length."""
    read = reader(value.__msgtype__)
    if read is not None:
        with suppress(AttributeError, struct.error):
            return message_text(read(value))
    return _message(value, depth)


@cache
def _message_fields(type: str) -> list[str]:
    return [field.attribute for field in typesystem.definition(type).fields]


@cache
def _sequences(type: str) -> list[str]:
    """The fields of a type of messages that are sequences, if they are of messages and nothing else has lists."""
    fields = typesystem.definition(type).fields
    sequences = [field for field in fields if field.shape == "sequence"]
    others = [field for field in fields if field.shape != "sequence"]
    simple = not any(field.size > LONG or (field.is_message and has_lists(field.base)) for field in others)
    if simple and all(field.is_message and not has_lists(field.base) for field in sequences):
        return [field.attribute for field in sequences]
    return []


def _cut(text: str, first: str = "") -> str:
    return f'{{"$cut":{string(text)}' + (f',"first":{first}' if first else "") + "}"


_ENCODERS: dict[type, Encode] = {
    float: _float,
    str: _text,
    int: lambda value, depth: repr(value),
    bool: lambda value, depth: "true" if value else "false",
    type(None): lambda value, depth: "null",
    complex: lambda value, depth: complex_text(value),
    bytes: lambda value, depth: _cut(f"{len(value)} bytes"),
    bytearray: lambda value, depth: _cut(f"{len(value)} bytes"),
    list: _listing,
    tuple: _listing,
    dict: lambda value, depth: _mapping(value.items(), "dict", len(value), depth),
}
