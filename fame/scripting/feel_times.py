"""Durations and dates of FEEL: the texts that timers take, computed with (DMN 1.5, section 10.3.2.3)."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable
from datetime import datetime
from typing import Any

from fame.iso8601 import Duration, add, nanoseconds_between, parse_datetime, parse_duration
from fame.scripting.data import is_number

_ZONED = re.compile(r"(Z|[+-]\d\d:?\d\d|\])$")


class Time(str):
    """A duration or a date and time. To all but FEEL it is the text that ISO 8601 has for it."""

    __slots__ = ()


def are_times(left: Any, right: Any) -> bool:
    """Whether one is, and the other may be: what a variable brings back from a file is plain text."""
    return (left.__class__ is Time and isinstance(right, str)) or (right.__class__ is Time and isinstance(left, str))


def compared(compare: Callable[[Any, Any], bool], left: str, right: str) -> bool | None:
    """As `compare`; null for a date beside a duration, and for months beside days."""
    try:
        first, second = _parsed(left), _parsed(right)
    except ValueError:
        return None
    if isinstance(first, datetime) or isinstance(second, datetime):
        return bool(compare(first, second)) if type(first) is type(second) else None
    if (first.months or second.months) and (first.rest or second.rest):
        return None
    return bool(compare((first.months, first.rest), (second.months, second.rest)))


def computed(compute: Callable[[Any, Any], Any], left: Any, right: Any) -> Time | None:
    """A sum, a difference, or a multiple of a duration; null for what has none. Raises ValueError, ArithmeticError."""
    if is_number(left) and compute is operator.mul:
        left, right = right, left
    if is_number(right):
        length = _parsed(left)
        if isinstance(length, datetime) or length.months or compute in (operator.add, operator.sub):
            return None
        return _told(Duration(0, round(compute(length.rest, right))))
    if compute not in (operator.add, operator.sub):
        return None
    first, second, sign = _parsed(left), _parsed(right), 1 if compute is operator.add else -1
    if isinstance(first, Duration) and isinstance(second, datetime) and sign > 0:
        first, second, left = second, first, right
    if isinstance(second, datetime):
        return _told(Duration(0, nanoseconds_between(second, first))) if isinstance(first, datetime) else None
    if isinstance(first, datetime):
        return _dated(add(first, second * sign), left)
    return _told(Duration(first.months + sign * second.months, first.rest + sign * second.rest))


def _parsed(text: str) -> Duration | datetime:
    return parse_duration(str(text)) if text.strip()[:1] in ("P", "-") else parse_datetime(str(text))


def _told(length: Duration) -> Time | None:
    """A duration; null for one that is negative, which no timer takes."""
    return None if length.months < 0 or length.rest < 0 else Time(length)


def _dated(moment: datetime, like: str) -> Time:
    """With a zone if `like` has one."""
    text = moment.isoformat()
    return Time(text if _ZONED.search(like.strip()) else text.removesuffix("+00:00"))
