"""Values between Python and JavaScript, as JSON texts; numbers that JSON does not have are objects with one key."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from decimal import Decimal
from itertools import zip_longest
from typing import Any

from fame.text import sorted_set

ATOMS = frozenset({int, float, str, bool, type(None)})
"""Types whose values never change."""

_SPECIAL = "\0"
_SPELLED = {math.inf: "Infinity", -math.inf: "-Infinity"}
_HIDDEN = re.compile(r"NaN|-?Infinity|-?[0-9]{1,400}n")


_WHOLE = 2**53
"""Greatest whole number that JavaScript represents exactly."""

_FAR = 10**300
_LARGE = re.compile(r"(?<![\d.])-?[1-9][0-9]{15,299}(?![\d.eE])")
_REMEMBERED = 1000


class Digits:
    """Large whole numbers that JavaScript would round: what was sent comes back unchanged."""

    __slots__ = ("_sent",)

    def __init__(self) -> None:
        self._sent: dict[float, int] = {}

    def remember(self, text: str) -> None:
        """Remember the large numbers in a text that is sent to JavaScript."""
        for found in _LARGE.findall(text):
            if abs(number := int(found)) > _WHOLE:
                self._sent[float(number)] = number
        while len(self._sent) > _REMEMBERED:
            del self._sent[next(iter(self._sent))]

    def restored(self, value: Any, before: Any) -> Any:
        """Return the reply of JavaScript with exact numbers: that of the value `before`, else the last one sent."""
        return self._restored(value, before) if self._sent else value

    def _restored(self, value: Any, before: Any) -> Any:
        if value.__class__ is dict:
            named = before if isinstance(before, dict) else {}
            return {name: self._restored(item, named.get(name)) for name, item in value.items()}
        if value.__class__ is list:
            listed = before[: len(value)] if isinstance(before, list) else []
            return [self._restored(item, old) for item, old in zip_longest(value, listed)]
        if value.__class__ not in (int, float) or not _WHOLE < abs(value) < _FAR or not _is_rounded(value):
            return value
        if before.__class__ is int and abs(before) < _FAR and float(before) == float(value):
            return before
        return self._sent.get(float(value), value)


def _is_rounded(value: float) -> bool:
    """Whether it has only the digits that a number of JavaScript shows; a BigInt has all of them."""
    return value == Decimal(repr(float(value)))


class Encoded:
    """A cache of one text: a message is sent to all its subscriptions in a row."""

    __slots__ = ("_text", "_value")

    def __init__(self) -> None:
        self._value: Any = self
        self._text = ""

    def __call__(self, value: Any) -> str:
        if value is not self._value:
            self._value, self._text = value, encode(value)
        return self._text


def encode(value: Any) -> str:
    """Return the text of a value: data, messages, arrays, objects with plain attributes.

    Raises TypeError, ValueError or RecursionError for what cannot be serialised.
    """
    text = _encoder.encode(value)
    return _encoder.encode(_marked(json.loads(text))) if "NaN" in text or "Infinity" in text else text


def decode(text: str) -> Any:
    """Return the value of a text from JavaScript."""
    return json.loads(text, object_hook=_restored) if "\\u0000" in text else _decode(text)[0]


def _plain(value: Any) -> Any:
    if hasattr(value, "__msgtype__"):
        from fame.middleware.messages import to_mapping

        return to_mapping(value)
    if hasattr(value, "tolist"):  # of numpy's arrays and numbers
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, (bytes, bytearray)):
        return list(value)
    if isinstance(value, (set, frozenset)):
        return sorted_set(value)
    fields = getattr(value, "__dataclass_fields__", None) or getattr(value, "__dict__", None)
    if fields is None or callable(value):
        raise TypeError(f"{type(value).__name__} cannot be serialised")
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
