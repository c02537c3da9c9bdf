"""Values between Python and JavaScript, as JSON texts; numbers that JSON has not are objects with one key."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from typing import Any

ATOMS = frozenset({int, float, str, bool, type(None)})
"""Types whose values never change."""

_SPECIAL = "\0"
_SPELLED = {math.inf: "Infinity", -math.inf: "-Infinity"}
_HIDDEN = re.compile(r"NaN|-?Infinity|-?[0-9]{1,400}n")


def encode(value: Any) -> str:
    """The text of a value: data, messages, arrays, objects with plain attributes.

    Raises TypeError, ValueError or RecursionError for what is no data.
    """
    text = _encoder.encode(value)
    return _encoder.encode(_marked(json.loads(text))) if "NaN" in text or "Infinity" in text else text


def decode(text: str) -> Any:
    """The value of a text that JavaScript made."""
    return json.loads(text, object_hook=_restored) if "\\u0000" in text else _decode(text)[0]


def _plain(value: Any) -> Any:
    if hasattr(value, "__msgtype__"):
        from fame.middleware.messages import to_mapping

        return to_mapping(value)
    if hasattr(value, "tolist"):  # of numpy's arrays and numbers
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, (set, frozenset, bytes, bytearray)):
        return list(value)
    fields = getattr(value, "__dataclass_fields__", None) or getattr(value, "__dict__", None)
    if fields is None or callable(value):
        raise TypeError(f"{type(value).__name__} is no data")
    return {name: getattr(value, name) for name in fields if not name.startswith("_")}


_encoder = json.JSONEncoder(default=_plain, skipkeys=True, separators=(",", ":"))


_decode = json.JSONDecoder().raw_decode


def _marked(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return {_SPECIAL: _SPELLED.get(value, "NaN")}
    if isinstance(value, dict):
        return {name: _marked(item) for name, item in value.items()}
    return [_marked(item) for item in value] if isinstance(value, list) else value


def _restored(mapping: dict[str, Any]) -> Any:
    if mapping.keys() == {_SPECIAL} and isinstance(mapping[_SPECIAL], str):
        found = _HIDDEN.fullmatch(mapping[_SPECIAL])
        if found is not None:
            return int(found[0][:-1]) if found[0][-1] == "n" else float(found[0])
    return mapping
