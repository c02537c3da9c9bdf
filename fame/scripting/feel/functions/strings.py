"""The functions of FEEL about texts, and those between texts and other values."""

from __future__ import annotations

import base64
import json
import math
import re
import uuid
from collections.abc import Mapping
from decimal import Decimal
from typing import Any

from fame.scripting.budget import spend
from fame.scripting.data import fields_of, is_list, is_number, plain
from fame.scripting.feel.patterns import Groups, matches
from fame.scripting.feel.values import Range
from fame.scripting.interface import random_source
from fame.scripting.signatures import functions

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,4})?")
_GROUP = re.compile(r"\\([\\$])|\$(\d)")
_LONGEST = 4000
"""Digits of a whole number in a text."""


def text_of(value: Any) -> str:
    """Return a value as FEEL writes it; texts in lists and contexts in quotes."""
    if isinstance(value, str):
        return str(value)
    spend(1)
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if is_number(value):
        return _digits(value)
    if isinstance(value, Range):
        brackets = "(["[value.with_low], ")]"[value.with_high]
        return f"{brackets[0]}{text_of(value.low)}..{text_of(value.high)}{brackets[1]}"
    if is_list(value):
        return f"[{', '.join(map(_quoted, plain(value)))}]"
    return "{" + ", ".join(f"{key}: {_quoted(item)}" for key, item in fields_of(value).items()) + "}"


def _quoted(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False) if type(value) is str else text_of(value)


def _digits(value: Any) -> str:
    """The text of a number; of a whole number without a decimal point."""
    if isinstance(value, int) or not -1e21 < value < 1e21:
        return str(value)
    text = format(Decimal(repr(float(value))), "f")
    return text.rstrip("0").rstrip(".") if "." in text else text


def number_of(value: Any, grouping: str | None = None, point: str | None = None) -> Any:
    """Return a number from a number or text. Raises ValueError."""
    if is_number(value):
        return value
    text = str(value).replace(grouping, "") if grouping else str(value)
    text = text.replace(point, ".") if point else text
    if isinstance(value, bool) or not _NUMBER.fullmatch(text):
        raise ValueError(f"{value!r} is not a number")
    return int(text) if text.lstrip("+-").isdecimal() and len(text) < _LONGEST else float(text)


def _part(text: str, start: Any, length: Any = None) -> str:
    first = int(start) - 1 if start > 0 else len(text) + int(start)
    if start == 0 or not 0 <= first <= len(text):
        raise ValueError(f"the text has no place {start}")
    return text[first:] if length is None else text[first : first + max(0, int(length))]


def _before(text: str, part: str) -> str:
    found = text.find(part)
    return text[: max(0, found)]


def _after(text: str, part: str) -> str:
    found = text.find(part)
    return text[found + len(part) :] if found >= 0 else ""


def _replace(text: str, pattern: str, replacement: str, flags: str = "") -> str:
    pieces, last = [], 0
    for found in matches(text, pattern, flags):
        pieces += [text[last : found[0]], _filled(replacement, text, found)]
        spend(len(pieces[-1]))
        last = found[1]
    return "".join([*pieces, text[last:]])


def _filled(replacement: str, text: str, found: Groups) -> str:
    """With the groups of a match for ``$0`` to ``$9``."""

    def of(sign: re.Match[str]) -> str:
        first, last = (found.get(2 * int(sign[2] or 0) + end, 0) for end in (0, 1))
        return sign[1] or text[first:last]

    return _GROUP.sub(of, replacement)


def _split(text: str, delimiter: str) -> list[str]:
    """At each match that is not empty, or between two letters."""
    pieces, last = [], 0
    for found in matches(text, delimiter):
        if found[0] < found[1] or 0 < found[0] < len(text):
            pieces.append(text[last : found[0]])
            last = found[1]
    return [*pieces, text[last:]]


def _data(value: Any) -> Any:
    """The value as data for JSON."""
    spend(1)
    if value is None or isinstance(value, (str, bool)) or value.__class__ in (int, float):
        return value
    if is_number(value):
        return float(value)
    if is_list(value):
        return [_data(item) for item in plain(value)]
    return {str(key): _data(item) for key, item in fields_of(value).items()}


def _json(text: str) -> Any:
    """The value of a JSON text. Raises ValueError for invalid JSON, and for numbers that are too large for a float."""
    return json.loads(text, parse_constant=_number, parse_float=_number)


def _number(text: str) -> float:
    if not math.isfinite(number := float(text)):
        raise ValueError(f"{text} is not a number")
    return number


def _uuid(variables: Mapping[str, Any]) -> str | None:
    source = random_source(variables)
    return None if source is None else str(uuid.UUID(int=source.getrandbits(128), version=4))


TEXTS = functions({"uuid()": _uuid}, sees=True) | functions(
    {
        "string(from: value)": text_of,
        "number(from: value, grouping separator?: any, decimal separator?: any)": number_of,
        "from json(value: string)": _json,
        "to json(value: any)": lambda value: json.dumps(_data(value), ensure_ascii=False, separators=(",", ":")),
        "string length(string: string)": len,
        "substring(string: string, start position: number, length?: number)": _part,
        "substring before(string: string, match: string)": _before,
        "substring after(string: string, match: string)": _after,
        "upper case(string: string)": lambda text: text.upper(),
        "lower case(string: string)": lambda text: text.lower(),
        "contains(string: string, match: string)": lambda text, part: part in text,
        "starts with(string: string, match: string)": lambda text, part: text.startswith(part),
        "ends with(string: string, match: string)": lambda text, part: text.endswith(part),
        "trim(string: string)": lambda text: text.strip(),
        "is blank(string: string)": lambda text: not text.strip(),
        "matches(input: string, pattern: string, flags?: string)": lambda *given: any(True for _ in matches(*given)),
        "replace(input: string, pattern: string, replacement: string, flags?: string)": _replace,
        "split(string: string, delimiter: string)": _split,
        "extract(string: string, pattern: string)": lambda text, pattern: [
            text[found[0] : found[1]] for found in matches(text, pattern)
        ],
        "to base64(value: string)": lambda text: base64.b64encode(text.encode()).decode(),
    }
)
"""Name -> its signatures."""
