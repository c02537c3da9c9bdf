"""JSON by orjson, many times faster than Python's, which is used where there is no orjson or it refuses a value."""

from __future__ import annotations

import json
from typing import Any

try:
    import orjson
except ImportError:  # a workspace of ROS that was built by colcon alone
    orjson = None  # type: ignore[assignment]


def _as_text(value: Any) -> Any:
    return json.loads(orjson.dumps(value)) if orjson is not None and isinstance(value, orjson.Fragment) else str(value)


_encode = json.JSONEncoder(ensure_ascii=False, separators=(",", ":"), default=_as_text).encode


def json_bytes(value: Any) -> bytes:
    """JSON on one line; what JSON does not have is text. Raises ValueError for a value that contains itself."""
    if orjson is not None:
        try:
            return orjson.dumps(value, _other)
        except TypeError:  # large numbers, keys that are no texts, texts that are not Unicode
            pass
    return _encode(value).encode("utf-8", "backslashreplace")


def json_fragment(text: bytes) -> Any:
    """Return what `json_bytes` writes as this JSON, without encoding it again."""
    return json.loads(text) if orjson is None else orjson.Fragment(text)


def _other(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else str(value)


def json_value(data: bytes | str) -> Any:
    """Return the value of JSON, for readers to which all large numbers are floating point. Raises ValueError."""
    if orjson is not None:
        try:
            return orjson.loads(data)
        except ValueError:  # numbers and texts that Python's JSON alone has
            pass
    return json.loads(data)
