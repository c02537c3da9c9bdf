"""Variables as JSON: any value of a mission, cut where it is large.

Numbers, texts, truth values, null, lists and mappings are themselves, messages and objects are mappings of their
fields. What is cut says so: ``{"$cut": "list of 10000", "first": [...]}`` for lists and arrays, ``{"$cut": "text of
5000", "first": "..."}`` for texts, ``{"$cut": "Bag of 12345 characters"}`` for what is too large as a whole. NaN and
infinities, which JSON does not have, are the texts ``"NaN"``, ``"Infinity"`` and ``"-Infinity"``; complex numbers are
texts, too.
"""

from __future__ import annotations

import json
import math
import reprlib
from collections.abc import Mapping
from copy import copy
from itertools import islice
from types import ModuleType
from typing import Any

ITEMS = 64
"""Most items of a list that are kept whole; of a longer one, and of a longer text, the first are kept."""
TEXT = 1000
"""Most characters of a text."""
SIZE = 4000
"""Most characters of a value as JSON."""
_DEPTH = 8
_FIRST = 8

_encode = json.JSONEncoder(ensure_ascii=False, separators=(",", ":"), allow_nan=False).encode
_SCALARS = frozenset((str, int, bool, type(None)))


def json_text(value: Any) -> str:
    """A value as JSON, on one line."""
    text = _encode(_plain(value, _DEPTH))
    if len(text) > SIZE:
        return _encode({"$cut": f"{type(value).__name__} of {len(text)} characters"})
    return text


def is_data(name: str, value: Any) -> bool:
    """Whether a variable is data: functions, classes, modules and names with two leading underscores are not."""
    return not (name.startswith("__") or callable(value) or isinstance(value, ModuleType))


def snapshot_of(value: Any) -> Any:
    """A value to compare with later: a copy of what can be changed in place, else the value itself."""
    kind = value.__class__
    if kind is list:
        return [snapshot_of(item) for item in value]
    if kind is dict:
        return {key: snapshot_of(item) for key, item in value.items()}
    return copy(value) if kind in (set, bytearray) else value


def _plain(value: Any, depth: int) -> Any:
    kind = value.__class__
    if kind in _SCALARS:
        return value if kind is not str or len(value) <= TEXT else _cut("text", value)
    if kind is float:
        return value if math.isfinite(value) else {math.inf: "Infinity", -math.inf: "-Infinity"}.get(value, "NaN")
    if kind is complex:
        return f"{value.real:.6g}{value.imag:+.6g}j"
    if depth == 0:
        return {"$cut": reprlib.repr(value)}
    if kind in (list, tuple, set, frozenset):
        return _listed(value, kind.__name__, depth)
    if hasattr(value, "tolist"):  # an array, or a number of numpy
        return _listed(value, "array", depth) if getattr(value, "ndim", 0) else _plain(value.tolist(), depth)
    if isinstance(value, Mapping):
        return _mapped(value.items(), kind.__name__, len(value), depth)
    if isinstance(value, bytes | bytearray):
        return {"$cut": f"{len(value)} bytes"}
    fields = getattr(kind, "__slots__", None) if hasattr(kind, "__msgtype__") else getattr(value, "__dict__", None)
    if fields is None:
        return {"$cut": reprlib.repr(value)}
    named = ((name, getattr(value, name, None)) for name in fields if not str(name).startswith("_"))
    return _mapped(named, kind.__name__, len(fields), depth)


def _listed(value: Any, kind: str, depth: int) -> Any:
    items = (item.tolist() if hasattr(item, "tolist") else item for item in value)
    if len(value) <= ITEMS:
        return [_plain(item, depth - 1) for item in items]
    return {"$cut": f"{kind} of {len(value)}", "first": [_plain(item, depth - 1) for item in islice(items, _FIRST)]}


def _mapped(items: Any, kind: str, size: int, depth: int) -> Any:
    shown = {str(key): _plain(item, depth - 1) for key, item in islice(items, ITEMS) if not callable(item)}
    return shown if size <= ITEMS else {"$cut": f"{kind} of {size}", "first": shown}


def _cut(kind: str, text: str) -> dict[str, str]:
    return {"$cut": f"{kind} of {len(text)}", "first": text[:80]}
