"""Variables as JSON: any value of a mission, cut where it is large.

Numbers, texts, truth values, null, lists and mappings are themselves, messages and objects are mappings of their
fields. What is cut says so: ``{"$cut": "list of 10000", "first": [...]}``, ``{"$cut": "text of 5000", ...}``,
``{"$cut": "array of 15504"}``, ``{"$cut": "Plan of 12345 characters"}`` for what is too large as a whole. NaN and
infinities, which JSON does not have, are the texts ``"NaN"``, ``"Infinity"`` and ``"-Infinity"``; complex numbers are
texts, too.
"""

from __future__ import annotations

import reprlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from copy import copy
from functools import cache
from itertools import islice
from operator import attrgetter
from types import ModuleType
from typing import Any

from fame.middleware import typesystem
from fame.middleware.messages import Message
from fame.robot.change_text import TEXT, complex_text, float_text, name_text, string

try:
    import orjson
except ImportError:  # a workspace of ROS that was built by colcon alone: messages are encoded field by field
    orjson = None  # type: ignore[assignment]

ITEMS = 16
"""Most items of a list, array or mapping that is kept whole."""
LONG = 64
"""Items of an array in a message, above which it is cut."""
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

    That is a number or short text itself, JSON (bytes), or ``...`` for code, which is no data.
    """
    kind = value.__class__
    if kind in PLAIN or (kind is str and len(value) <= TEXT):
        return value
    number = next((base for base in (int, float, complex) if isinstance(value, base)), None)
    if number is not None:
        return number(value)
    return json_text(value).encode("utf-8", "surrogatepass") if is_data("", value) else ...


PLAIN: frozenset[type] = frozenset((float, int, bool, type(None), complex))
"""The classes of values that stand for themselves."""


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
        return _message
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
    """A message; field by field if it has long lists or texts, or numbers that JSON does not have."""
    type = value.__msgtype__
    if orjson is not None and _is_simple(type):
        with suppress(TypeError):  # what was put into its fields does not fit
            text: str = orjson.dumps(value, option=orjson.OPT_SERIALIZE_NUMPY).decode()
            long = len(text) > TEXT and any(len(attrgetter(path)(value)) > TEXT for path in _texts(type))
            if "null" not in text and not long:
                return text
    fields = _message_fields(type)
    if depth == 0:
        return _cut(f"{value.__class__.__name__} of {len(fields)}")
    members = [f"{name_text(name)}:{_field(getattr(value, name), depth - 1)}" for name in fields]
    return f"{{{','.join(members)}}}"


def _field(value: Any, depth: int) -> str:
    """What is in a message: its arrays are kept whole where other ones are cut."""
    size = getattr(value, "size", 0)
    if isinstance(size, int) and ITEMS < size <= LONG and getattr(value, "ndim", 0) == 1:
        return f"[{','.join([_encode(item, depth) for item in value.tolist()])}]"
    return _encode(value, depth)


@cache
def _is_simple(type: str) -> bool:
    """Whether messages of a type have neither sequences nor long arrays, nor ones of float32 (orjson rounds)."""
    fields = typesystem.definition(type).fields
    return bool(fields) and not any(
        field.shape == "sequence"
        or field.size > LONG
        or (field.is_message and (field.shape != "single" or not _is_simple(field.base)))
        or (field.shape != "single" and field.base == "float32")
        for field in fields
    )


@cache
def _texts(type: str) -> Sequence[str]:
    """The paths of all texts in messages of a type."""
    fields = typesystem.definition(type).fields
    inner = [f"{field.attribute}.{path}" for field in fields if field.is_message for path in _texts(field.base)]
    return [*inner, *(field.attribute for field in fields if field.base in ("string", "wstring"))]


@cache
def _message_fields(type: str) -> list[str]:
    return [field.attribute for field in typesystem.definition(type).fields]


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
