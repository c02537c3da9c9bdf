"""Values of FEEL: dates, times, durations and ranges; comparison, order and fields (DMN 1.5, section 10.3.2).

Outside FEEL a date, time or duration is its ISO 8601 text, which timers take and which variables keep. Here it is
parsed and computed with: a `Moment` for a date, a time or both, a `Duration` (which may be negative) for the rest. A
date is at midnight, a time on the first day of 1970; one without zone is kept as UTC, but never compared with one that
has a zone. The resolution is a microsecond. A comparison that has no answer gives null.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Mapping
from datetime import UTC, date, datetime, time, timedelta, timezone, tzinfo
from functools import lru_cache
from typing import Any

from fame.dataclasses import dataclass
from fame.engine.data import Temporal
from fame.iso8601 import Duration, add, nanoseconds_between, parse_duration, zone_named
from fame.scripting.budget import PASS, spend
from fame.scripting.data import Undefined, field, fields_of, is_list, is_number, plain, product, quotient

SECOND = 1_000_000_000
MINUTE, HOUR, DAY = 60 * SECOND, 3600 * SECOND, 86_400 * SECOND
"""Lengths of the units of durations (ns)."""

_DATE = r"(?P<date>\d{4}-\d\d-\d\d)"
_TIME = r"T?(?P<time>(?!24)\d\d:\d\d(?::\d\d(?:\.\d{1,30})?)?)"
_ZONE = r"(?P<offset>Z|[+-]\d\d:\d\d(?::\d\d)?)?(?:@(?P<named>[\w/+-]+)|\[(?P<bracketed>[\w/+-]+)\])?"
_MOMENT = re.compile(rf"(?:{_DATE}(?=T|$))?(?:{_TIME}{_ZONE})?")
_LONGEST = 10**15
"""Years or days of a duration."""

_SUMS = (operator.add, operator.sub)
_ONLY_MONTHS = re.compile(r"P[0-9YM]+")


@dataclass(frozen=True, slots=True)
class Moment:
    """`kind` is ``date``, ``time`` or ``date and time``; `zone` as written after it, empty without a zone."""

    kind: str
    at: datetime
    zone: str = ""

    def __str__(self) -> str:
        return f"{self._date() if 'date' in self.kind else ''}{self._time() if 'time' in self.kind else ''}"

    def _date(self) -> str:
        return self.at.date().isoformat() + ("T" if self.kind != "date" else "")

    def _time(self) -> str:
        text = self.at.time().isoformat()
        zone = self.zone
        if self.at.fold and zone[:1] == "@":
            zone = f"{self.at.isoformat()[-6:]}[{zone[1:]}]"
        return (text.rstrip("0") if "." in text else text) + zone

    @property
    def instant(self) -> datetime:
        """What is compared: in UTC, since Python compares dates of one zone by what its clocks say."""
        return self.at.astimezone(UTC) if self.zone[:1] == "@" and 1 < self.at.year < 9999 else self.at


def are_times(left: Any, right: Any) -> bool:
    """Return whether one is, and the other may be: what a variable brings back from a file is plain text."""
    return (left.__class__ is Temporal and isinstance(right, str)) or (
        right.__class__ is Temporal and isinstance(left, str)
    )


@lru_cache(1024)
def parsed(text: str) -> Moment | Duration:
    """Return the moment or duration that a text denotes. Raises ValueError."""
    text = str(text).strip()
    if text.startswith("-P"):
        return -1 * parse_duration(text[1:])
    if text.startswith("P"):
        return parse_duration(text)
    match = _MOMENT.fullmatch(text)
    if match is None or not text:
        raise ValueError(f"{text!r} is neither a date nor a time nor a duration")
    kind = " and ".join(kind for kind in ("date", "time") if match[kind])
    day, clock = match["date"] or "1970-01-01", match["time"] or "00:00"
    name = match["named"] or match["bracketed"]
    zone, shown = zone_of(name or match["offset"] or "")
    at = datetime.combine(date.fromisoformat(day), time.fromisoformat(clock), zone)
    if name and match["offset"] and "0002" <= (match["date"] or "") < "9999":  # which of two times in autumn it is
        at = at.replace(tzinfo=zone_of(match["offset"])[0]).astimezone(zone)
    return Moment(kind, at, shown)


def zone_of(text: str) -> tuple[tzinfo, str]:
    """Return a zone by offset or name, and how it is written behind a time. Raises ValueError."""
    if text in ("", "Z"):
        return UTC, text
    if text[0] in "+-":
        hours, minutes, seconds = (int(part) for part in f"{text[1:]}:00".split(":")[:3])
        offset = timedelta(hours=hours, minutes=minutes, seconds=seconds)
        return timezone(-offset if text[0] == "-" else offset), text if offset else "Z"
    return zone_named(text), f"@{text}"


def moment(value: Any, *kinds: str) -> Moment:
    """Return a value as a moment of one of these kinds. Raises ValueError."""
    read = parsed(value) if isinstance(value, str) else None
    if not isinstance(read, Moment) or read.kind not in kinds:
        raise ValueError(f"{value!r} is no {' or '.join(kinds)}")
    return read


def temporal(value: Moment | Duration) -> Temporal:
    """Return the text of a moment or duration. Raises ValueError for what FEEL does not have: too long ones, and months
    beside days."""
    if not isinstance(value, Duration):
        return Temporal(value)
    if (value.months and value.rest) or abs(value.months) >= _LONGEST * 12 or abs(value.rest) >= _LONGEST * DAY:
        raise ValueError("no text has this duration")
    return Temporal(f"-{-1 * value}" if (value.months or value.rest) < 0 else value)


def kind_of(value: Any) -> str:
    """Return the name of a value's type in FEEL; empty for any other value."""
    if value.__class__ is not Temporal:
        return ""
    read = parsed(value)
    if isinstance(read, Moment):
        return read.kind
    months = read.months or (not read.rest and _ONLY_MONTHS.fullmatch(value))
    return "years and months duration" if months else "days and time duration"


# ---- operators -------------------------------------------------------------------------------------------------------


def compared(compare: Callable[[Any, Any], bool], left: str, right: str) -> bool | None:
    """As `compare`; null for two kinds. One with a zone has no order beside one without, and is never equal to it."""
    try:
        first, second = parsed(left), parsed(right)
    except ValueError:
        return None
    if isinstance(first, Moment) and isinstance(second, Moment):
        if compare is operator.eq and first.kind == second.kind and not _alike(first, second):
            return False
        return bool(compare(first.instant, second.instant)) if _alike(first, second) else None
    if isinstance(first, Moment) or isinstance(second, Moment):
        return None
    if (first.months or second.months) and (first.rest or second.rest):
        return None
    return bool(compare((first.months, first.rest), (second.months, second.rest)))


def computed(compute: Callable[[Any, Any], Any], left: Any, right: Any) -> Any:
    """Return a sum, difference, product or quotient; null for what has none. Raises ValueError, ArithmeticError."""
    spend(10 * PASS)
    first = left if is_number(left) else parsed(left)
    second = right if is_number(right) else parsed(right)
    if (compute is product and is_number(first)) or (compute is operator.add and isinstance(second, Moment)):
        first, second = second, first
    match first, second:
        case Duration(), Duration():
            return _of_durations(compute, first, second)
        case Moment(), Moment():
            return _between(first, second) if compute is operator.sub else None
        case Moment(), Duration() if compute in _SUMS:
            return temporal(_moved(first, second * (1 if compute is operator.add else -1)))
        case Duration(), _ if compute in (product, quotient) and is_number(second):
            return temporal(Duration(int(compute(first.months, second)), round(compute(first.rest, second))))
    return None


def _of_durations(compute: Callable[[Any, Any], Any], first: Duration, second: Duration) -> Any:
    if compute in _SUMS:
        return temporal(Duration(compute(first.months, second.months), compute(first.rest, second.rest)))
    if compute is not quotient or (first.months and second.rest) or (first.rest and second.months):
        return None
    return compute(first.months, second.months) if second.months else compute(first.rest, second.rest)


def _between(first: Moment, second: Moment) -> Temporal | None:
    return temporal(Duration(0, nanoseconds_between(second.at, first.at))) if _alike(first, second) else None


def _alike(first: Moment, second: Moment) -> bool:
    return first.kind == second.kind and bool(first.zone) == bool(second.zone)


def _moved(start: Moment, length: Duration) -> Moment:
    if start.kind == "time" and length.months:
        raise ValueError("a time has no months")
    rest = length.rest % DAY if start.kind == "time" else length.rest
    end = add(start.at, Duration(length.months, rest))
    if start.kind == "time":
        end = end.replace(year=1970, month=1, day=1)
    elif start.kind == "date":
        end = end.replace(hour=0, minute=0, second=0, microsecond=0)
    return Moment(start.kind, end, start.zone)


# ---- properties ------------------------------------------------------------------------------------------------------


def property_of(value: Temporal, name: str) -> Any:
    """``value.year`` and the like (Camunda's table of temporal properties); null for what it does not have."""
    kind, read = kind_of(value), parsed(value)
    get = _PROPERTIES.get(kind, {}).get(name)
    if get is None:
        return None
    if isinstance(read, Duration) and (read.months or read.rest) < 0:
        return -get(-1 * read)
    return get(read)


def _offset(moment: Moment) -> Temporal | None:
    offset = moment.at.utcoffset() if moment.zone else None
    return None if offset is None else temporal(Duration(0, offset // timedelta(microseconds=1) * 1000))


_OF_DATES: dict[str, Callable[[Any], Any]] = {
    "year": lambda moment: moment.at.year,
    "month": lambda moment: moment.at.month,
    "day": lambda moment: moment.at.day,
    "weekday": lambda moment: moment.at.isoweekday(),
}
_OF_TIMES: dict[str, Callable[[Any], Any]] = {
    "hour": lambda moment: moment.at.hour,
    "minute": lambda moment: moment.at.minute,
    "second": lambda moment: moment.at.second,
    "time offset": _offset,
    "timezone": lambda moment: moment.zone[1:] if moment.zone[:1] == "@" else None,
}
_PROPERTIES: dict[str, dict[str, Callable[[Any], Any]]] = {
    "date": _OF_DATES,
    "time": _OF_TIMES,
    "date and time": _OF_DATES | _OF_TIMES,
    "years and months duration": {
        "years": lambda length: length.months // 12,
        "months": lambda length: length.months % 12,
    },
    "days and time duration": {
        "days": lambda length: length.rest // DAY,
        "hours": lambda length: length.rest % DAY // HOUR,
        "minutes": lambda length: length.rest % HOUR // MINUTE,
        "seconds": lambda length: length.rest % MINUTE // SECOND,
    },
}


@dataclass(frozen=True, slots=True)
class Range:
    """``[low..high]``, or with a round bracket without that end."""

    low: Any
    high: Any
    with_low: bool = True
    with_high: bool = True

    def has(self, value: Any) -> bool | None:
        """Return whether it lies between the ends; null if that has no order."""
        above = order(operator.ge if self.with_low else operator.gt, value, self.low)
        below = order(operator.le if self.with_high else operator.lt, value, self.high)
        return None if above is None or below is None else above and below


@dataclass(frozen=True, slots=True)
class Bound:
    """``< value``, as a test of ``in``."""

    compare: Callable[[Any, Any], bool]
    value: Any


def equal(left: Any, right: Any) -> bool | None:
    """``=``: null for values of different kinds, unless one is null."""
    if left is None or right is None:
        return left is right
    if are_times(left, right):
        return compared(operator.eq, left, right)
    if _kind(left) != _kind(right):
        return None
    return bool(identity(left) == identity(right))


def identity(value: Any) -> Any:
    """Return a hashable key of a value: equal for equal values only."""
    if value.__class__ in (str, int, float, type(None)):
        return value
    spend(1)
    if value.__class__ is Temporal:
        read = parsed(value)
        return read if isinstance(read, Duration) else (read.kind, bool(read.zone), read.instant)
    if isinstance(value, bool):
        return ("boolean", value)
    if isinstance(value, Mapping):
        return frozenset((key, identity(item)) for key, item in value.items())
    if is_list(value):
        return tuple([identity(item) for item in plain(value)])
    return value if is_number(value) else (type(value), _attributes(value))


def order(compare: Callable[[Any, Any], bool], left: Any, right: Any) -> bool | None:
    """``<`` and the like, of two numbers or two texts; else null."""
    if are_times(left, right):
        return compared(compare, left, right)
    if (is_number(left) and is_number(right)) or (isinstance(left, str) and isinstance(right, str)):
        return bool(compare(left, right))
    return None


def field_of(value: Any, name: str) -> Any:
    """``value.name``: of a list the list of its elements' fields; null for a missing field."""
    if value.__class__ is not dict and is_list(value):
        return [field_of(item, name) for item in value]
    if value.__class__ is Temporal:
        return property_of(value, name)
    if isinstance(value, Range):
        ends = {"start": value.low, "end": value.high}
        return ends.get(name, {"start included": value.with_low, "end included": value.with_high}.get(name))
    try:
        return field(value, name)
    except Undefined:
        return None


def within(value: Any, test: Any) -> bool | None:
    """``value in test``: a range, a bound, a value, or a list of such tests."""
    if isinstance(test, Range):
        return test.has(value)
    if isinstance(test, Bound):
        return order(test.compare, value, test.value)
    if is_list(test):
        spend(len(test))
        return (is_list(value) and equal(value, test)) or any(within(value, one) for one in plain(test))
    return equal(value, test)


def _kind(value: Any) -> str:
    if isinstance(value, bool):
        return "boolean"
    if is_number(value):
        return "number"
    if isinstance(value, Mapping):
        return "context"
    return "list" if is_list(value) else type(value).__name__


def _attributes(value: Any) -> Any:
    fields = fields_of(value)
    return frozenset((key, identity(item)) for key, item in fields.items()) if fields else id(value)
