"""Variables as plain data, fit for JSON: any value of a mission, cut where it is large.

Numbers, texts, truth values, null, lists and mappings are themselves, messages and objects are mappings of their
fields. What is cut says so: ``{"$cut": "list of 10000", "first": [...]}``, ``{"$cut": "text of 5000", ...}``,
``{"$cut": "array of 15504"}``, ``{"$cut": "Plan of 12345 characters"}`` for what is too large as a whole. NaN and
infinities, which JSON does not have, are the texts ``"NaN"``, ``"Infinity"`` and ``"-Infinity"``; complex numbers are
texts, too.
"""

from __future__ import annotations

import marshal
import math
import reprlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from itertools import islice
from operator import attrgetter
from types import ModuleType
from typing import Any

from fame.engine.data import is_data
from fame.fast_json import json_bytes, json_fragment
from fame.middleware import typesystem
from fame.middleware.messages import Message
from fame.text import sorted_set

try:
    import orjson
except ImportError:  # a workspace of ROS that was built by colcon alone: messages are encoded field by field
    orjson = None  # type: ignore[assignment]

TEXT = 1000
"""Most characters of a text."""
ITEMS = 16
"""Most items of a list, array or mapping that is kept whole."""
LONG = 64
"""Items of an array in a message, above which it is cut."""
SIZE = 4000
"""Most characters of a value as JSON."""
_DEPTH = 8
_FIRST = 4

_Encode = Callable[[Any, int], Any]
"""Gives the data of a value; how many levels of lists and mappings it may have."""


def plain(value: Any) -> Any:
    """Return the plain data of a value, which do not change with it."""
    return _plain_and_text(value)[0]


def encoded(value: Any) -> tuple[Any, object]:
    """Return the plain data of a value as they are or as `json_fragment`, and a key for comparison: equal keys mean
    that the JSON is the same."""
    text = _message_json(value) if isinstance(value, Message) else None
    if text is None or len(text) > SIZE:
        plain, key = _plain_and_text(value)
        if not isinstance(key, bytes):
            return plain, key
        text = key
    return json_fragment(text), text


def _plain_and_text(value: Any) -> tuple[Any, object]:
    plain = _encode(value, _DEPTH)
    kind = plain.__class__
    if kind is not dict and kind is not list:
        return plain, plain if kind is float else (kind, plain)
    text = json_bytes(plain)
    if len(text) > SIZE and (characters := len(text.decode())) > SIZE:
        plain = _cut(f"{type(value).__name__} of {characters} characters")
        text = json_bytes(plain)
    return plain, text


def is_changeable(value: Any) -> bool:
    """Return whether a value may be changed in place, as lists, mappings, arrays and objects, but not messages."""
    kind = value.__class__
    if kind is tuple:
        return any(map(is_changeable, value))
    known = _CHANGED_IN_PLACE.get(kind)
    if known is None:
        mutable = kind.__hash__ is None or hasattr(value, "__dict__") or getattr(value, "ndim", 0) > 0
        known = _CHANGED_IN_PLACE[kind] = mutable and not (isinstance(value, Message | ModuleType) or callable(value))
    return known


_CHANGED_IN_PLACE: dict[type, bool] = {}


def content_of(value: Any) -> object:
    """Return the content of a value as far as it is shown, to see whether it is changed in place; None where nobody can
    tell, as of objects."""
    if value.__class__ is list and len(value) > ITEMS:
        value = [len(value), *value[:_FIRST]]
    elif getattr(value, "ndim", 0) and value.size > ITEMS:
        return value.size
    try:
        return marshal.dumps(value, 2)
    except ValueError:
        return None if value.__class__ is not list or any(map(is_changeable, value)) else value.copy()


# ---- values ----------------------------------------------------------------------------------------------------------


def _encode(value: Any, depth: int) -> Any:
    encoder = _ENCODERS.get(value.__class__)
    if encoder is None:
        encoder = _ENCODERS[value.__class__] = _encoder(value.__class__)
    return encoder(value, depth)


def _encoder(kind: type) -> _Encode:
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
    if issubclass(kind, Sequence):
        return _listing
    if issubclass(kind, set | frozenset):
        return lambda value, depth: _listing(sorted_set(value), depth, kind.__name__)
    return _object


def _itself(value: Any, depth: int) -> Any:
    return value


def _float(value: float, depth: int) -> float | str:
    if value - value == 0.0:
        return value
    return "NaN" if value != value else "Infinity" if value > 0 else "-Infinity"


_NUMBERS = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}


def with_numbers(value: Any) -> Any:
    """Return plain data with NaN and infinities as the numbers that they are."""
    if isinstance(value, str):
        return _NUMBERS.get(value, value)
    if isinstance(value, list):
        return [with_numbers(each) for each in value]
    return {name: with_numbers(each) for name, each in value.items()} if isinstance(value, dict) else value


def _text(value: str, depth: int) -> Any:
    return value if len(value) <= TEXT else _cut(f"text of {len(value)}", value[:80])


def _listing(value: Any, depth: int, kind: str = "") -> Any:
    if depth == 0:
        return _cut(reprlib.repr(value))
    if len(value) <= ITEMS:
        return [_encode(item, depth - 1) for item in value]
    first = [_encode(item, depth - 1) for item in islice(value, _FIRST)]
    return _cut(f"{kind or value.__class__.__name__} of {len(value)}", first)


def _array(value: Any, depth: int) -> Any:
    size = getattr(value, "size", None)
    if not getattr(value, "ndim", 0) or not isinstance(size, int):  # a number; an array of Python itself
        return _encode(value.tolist(), depth)
    return _listing(value.tolist(), depth) if size <= ITEMS else _cut(f"array of {size}")


def _mapping(items: Iterable[tuple[Any, Any]], kind: str, size: int, depth: int) -> dict[str, Any]:
    if depth == 0:
        return _cut(f"{kind} of {size}")
    shown = {str(key): _encode(item, depth - 1) for key, item in islice(items, ITEMS * 4) if is_data("", item)}
    return shown if size <= ITEMS * 4 else _cut(f"{kind} of {size}", shown)


def _object(value: Any, depth: int) -> dict[str, Any]:
    fields = getattr(value, "__dict__", None)
    if fields is None or depth == 0:
        return _cut(reprlib.repr(value))
    named = {name: item for name, item in fields.items() if not name.startswith("_")}
    return _mapping(named.items(), type(value).__name__, len(named), depth)


def _message(value: Any, depth: int) -> dict[str, Any]:
    text = _message_json(value)
    if text is not None:
        content: dict[str, Any] = orjson.loads(text)
        return content
    fields = _message_fields(value.__msgtype__)
    if depth == 0:
        return _cut(f"{value.__class__.__name__} of {len(fields)}")
    return {name: _field(getattr(value, name), depth - 1) for name in fields}


def _message_json(value: Any) -> bytes | None:
    """The JSON of a message; None if it has long lists or texts, or numbers that JSON does not have."""
    type = value.__msgtype__
    if orjson is None or (fields := _fields_of(type)) is None:
        return None
    try:
        text = orjson.dumps(fields(value), option=orjson.OPT_SERIALIZE_NUMPY)
    except TypeError:  # what was put into its fields does not fit
        return None
    long = len(text) > TEXT and any(len(attrgetter(path)(value)) > TEXT for path in _texts(type))
    return None if long or b"null" in text else text


def _field(value: Any, depth: int) -> Any:
    """What is in a message: its arrays are kept whole where other ones are cut."""
    size = getattr(value, "size", 0)
    if isinstance(size, int) and ITEMS < size <= LONG and getattr(value, "ndim", 0) == 1:
        return [_encode(item, depth) for item in value.tolist()]
    return _encode(value, depth)


@cache
def _fields_of(type: str) -> Callable[[Any], dict[str, Any]] | None:
    """The function that gives the fields of messages of a type, those of inner ones too: with it, orjson takes 0.35 to
    0.41 of the time of finding them itself. None if there are sequences, long arrays or ones of float32 (it rounds)."""
    return eval(f"lambda m: {_fields_source(type, 'm')}") if _is_simple(type) else None


def _fields_source(type: str, message: str) -> str:
    parts = ((f.name, f"{message}.{f.attribute}", f) for f in typesystem.definition(type).fields)
    inner = (f"{name!r}: {_fields_source(f.base, path) if f.is_message else path}" for name, path, f in parts)
    return f"{{{', '.join(inner)}}}"


@cache
def _is_simple(type: str) -> bool:
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
    return [field.name for field in typesystem.definition(type).fields]


def _cut(text: str, first: Any = None) -> dict[str, Any]:
    return {"$cut": text} if first is None else {"$cut": text, "first": first}


_ENCODERS: dict[type, _Encode] = {
    float: _float,
    str: _text,
    int: _itself,
    bool: _itself,
    type(None): _itself,
    complex: lambda value, depth: f"{value.real:.6g}{value.imag:+.6g}j",
    bytes: lambda value, depth: _cut(f"{len(value)} bytes"),
    bytearray: lambda value, depth: _cut(f"{len(value)} bytes"),
    list: _listing,
    tuple: _listing,
    dict: lambda value, depth: _mapping(value.items(), "dict", len(value), depth),
}
