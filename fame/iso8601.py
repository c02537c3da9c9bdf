"""Dates, durations and cycles of timer events, as ISO 8601 writes them.

A duration is a number of months and a number of nanoseconds, the value space of XML Schema 1.1 (part 2, section 3.3.6):
years and months depend on the calendar, weeks and days do not (a day is 24 h). Durations are exact integers and, being
those of timers, never negative. Dates are `datetime` objects, always with a time zone; they have microseconds.

Every parser takes text and raises ValueError with one line: what was expected and what was found.
"""

from __future__ import annotations

import re
from calendar import monthrange
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime, timedelta, tzinfo
from functools import lru_cache
from itertools import count

from fame.dataclasses import dataclass

_MONTHS = {"years": 12, "months": 1}
_NANOSECONDS = {
    "weeks": 604_800_000_000_000,
    "days": 86_400_000_000_000,
    "hours": 3_600_000_000_000,
    "minutes": 60_000_000_000,
    "seconds": 1_000_000_000,
}
_NUMBER = r"[0-9]{1,15}(?:[.,][0-9]{1,30})?(?:[eE][+-]?[0-9]{1,3})?"
"""With an exponent, as Python and others write what they have computed: ``5e-05``."""
_LONGEST = 10**15
_DURATION = re.compile(
    rf"P(?=.)(?:(?P<years>{_NUMBER})Y)?(?:(?P<months>{_NUMBER})M)?(?:(?P<weeks>{_NUMBER})W)?(?:(?P<days>{_NUMBER})D)?"
    rf"(?:T(?=.)(?:(?P<hours>{_NUMBER})H)?(?:(?P<minutes>{_NUMBER})M)?(?:(?P<seconds>{_NUMBER})S)?)?"
)
_DATETIME = re.compile(r"[0-9]{4}[0-9W-]*(?:T[0-9:.,]+(?:Z|[+-][0-9:]+)?)?")
_NAMED = re.compile(r"([^@\[]*)(?:@([^@\[\]]+)|\[([^@\[\]]+)\])")
_ZONE = re.compile(r"[\w+-]{1,40}(?:/[\w+-]{1,40}){0,3}", re.ASCII)
_END_OF_DAY = re.compile(r"T24(?=(?::?00(?::?00(?:[.,]0+)?)?)?(?:Z|[+-]|$))")


@dataclass(frozen=True, slots=True)
class Duration:
    """`months` (12 to a year), and then `rest` (ns)."""

    months: int = 0
    rest: int = 0

    @property
    def nanoseconds(self) -> int:
        """Its exact length (ns). Raises ValueError if it has years or months, whose length depends on the date."""
        if self.months:
            raise ValueError(f"{self} has no fixed length: years and months depend on the date that they are added to")
        return self.rest

    def __mul__(self, factor: int) -> Duration:
        return Duration(self.months * factor, self.rest * factor)

    __rmul__ = __mul__

    def __str__(self) -> str:
        """The canonical text, such as ``P1Y2M3DT4H5M6.5S``."""
        years, months = divmod(self.months, 12)
        days, rest = divmod(self.rest, _NANOSECONDS["days"])
        hours, rest = divmod(rest, _NANOSECONDS["hours"])
        minutes, rest = divmod(rest, _NANOSECONDS["minutes"])
        whole, fraction = divmod(rest, _NANOSECONDS["seconds"])
        seconds = f"{whole}.{fraction:09}".rstrip("0").rstrip(".") if rest else 0
        date = "".join(f"{value}{unit}" for value, unit in ((years, "Y"), (months, "M"), (days, "D")) if value)
        time = "".join(f"{value}{unit}" for value, unit in ((hours, "H"), (minutes, "M"), (seconds, "S")) if value)
        return f"P{date}T{time}" if time else f"P{date}" if date else "PT0S"


@dataclass(frozen=True, slots=True)
class Cycle:
    """A repeating interval: due `repetitions` times (None: without end), one `duration` apart.

    `start` is the first due time, `end` the last; at most one of them is given. With neither, it is first due one
    `duration` after it began to run.
    """

    duration: Duration
    repetitions: int | None = None
    start: datetime | None = None
    end: datetime | None = None

    @property
    def endless(self) -> bool:
        """Whether there is always a next time."""
        return self.repetitions is None and self.end is None

    def due_times(self, now: datetime) -> Iterator[datetime]:
        """When it is due, from `now` on. What is past by then is skipped, but counts as a repetition.

        Each is counted from the anchor, not from the one before: monthly from 31 January is 28 February, 31 March.
        """
        anchor, first, last = self._anchored(now)
        first = max(first, _whole_steps(self.duration, anchor, now))
        for number in count(first) if last is None else range(first, last + 1):
            due = add(anchor, self.duration * number)
            if self.end is not None and nanoseconds_between(due, self.end) < 0:
                return
            if nanoseconds_between(now, due) >= 0:
                yield due

    def delays(self, now: datetime) -> Iterator[int]:
        """Return the times relative to `now` (ns): exact without dates and months."""
        if self.start or self.end or self.duration.months:
            return (nanoseconds_between(now, due) for due in self.due_times(now))
        numbers = count(1) if self.repetitions is None else range(1, self.repetitions + 1)
        return (self.duration.rest * number for number in numbers)

    def _anchored(self, now: datetime) -> tuple[datetime, int, int | None]:
        """A date, and the numbers of the first and the last step from there (None: without end) that are due times."""
        repetitions = self.repetitions
        if self.start is not None:
            return self.start, 0, None if repetitions is None else repetitions - 1
        if self.end is not None and repetitions is not None:
            return self.end, 1 - repetitions, 0
        return now, 1, repetitions


@lru_cache(256)
def parse_duration(text: str) -> Duration:
    """Return the duration that `text` says, such as ``PT1.5S``, ``P1W`` or ``P1Y2M3DT4H``.

    The last part may have a fraction, unless it is years or months; it is rounded to the nanosecond.
    """
    text = text.strip()
    match = _DURATION.fullmatch(text)
    if match is None:
        if "-" in text and _DURATION.fullmatch(text.replace("-", "")):
            raise ValueError(f"{text!r} is a negative duration: a timer cannot run backwards")
        if re.fullmatch(r"[0-9]+([.,][0-9]+)?", text):
            raise ValueError(f"{text!r} is not an ISO 8601 duration: {text} seconds are PT{text}S")
        raise ValueError(f"{text!r} is not an ISO 8601 duration such as PT1.5S, PT10M or P1DT12H")

    from fractions import Fraction  # with decimal it takes longer to import than all the rest of FAME's clock

    parts = {unit: Fraction(number.replace(",", ".")) for unit, number in match.groupdict().items() if number}
    if max(parts.values()) >= _LONGEST:
        raise ValueError(f"{text!r} is too long: its numbers have at most 15 digits")
    if any(number.denominator > 1 for number in list(parts.values())[:-1]):
        raise ValueError(f"{text!r} has a fraction before its last part: ISO 8601 allows one in the last part only")
    if any(parts[unit].denominator > 1 for unit in _MONTHS if unit in parts):
        raise ValueError(f"{text!r} has a fraction of a year or month, which has no fixed length: give days")
    months = sum(int(parts.get(unit, 0)) * factor for unit, factor in _MONTHS.items())
    return Duration(months, round(sum(parts.get(unit, 0) * factor for unit, factor in _NANOSECONDS.items())))


def parse_datetime(text: str) -> datetime:
    """Return the date and time that `text` says, such as ``2026-01-31T12:00:00Z`` or ``20260131T130000,5+0100``.

    One without time zone is in UTC, one without time of day at midnight; digits beyond microseconds are dropped.
    A zone may be named behind it, as in FEEL: ``2026-01-31T12:00:00@Europe/Berlin``.
    """
    text, zone = _named_zone(text.strip())
    example = "an ISO 8601 date and time such as 2026-01-31T12:00:00Z"
    if not _DATETIME.fullmatch(text):
        raise ValueError(f"{text!r} is not {example}")
    try:
        moment = datetime.fromisoformat(_END_OF_DAY.sub("T00", text))
        moment = moment if moment.tzinfo else moment.replace(tzinfo=zone)
        return moment + timedelta(days=1) if _END_OF_DAY.search(text) else moment
    except (ValueError, OverflowError) as error:
        raise ValueError(f"{text!r} is not {example}: {error}") from None


def parse_cycle(text: str) -> Cycle:
    """Return the cycle that `text` says: ``R/PT10S``, ``R3/PT10S``, with a start
    ``R3/2026-01-01T00:00:00Z/PT1H``, with an end ``R3/PT1H/2026-01-01T00:00:00Z``, or between a first and a
    second date."""
    text = text.strip()
    match = re.fullmatch(r"R([0-9]{0,15})/([^/]+)(?:/([^/]+))?", text)
    if match is None:
        raise ValueError(f"{text!r} is not an ISO 8601 cycle such as R/PT10S, R3/PT10S or R3/2026-01-01T00:00:00Z/PT1H")
    repetitions = int(match[1]) if match[1] else None
    start, end = None, None
    if match[3] is None or match[2].lstrip("-").startswith("P"):
        duration = parse_duration(match[2])
        end = parse_datetime(match[3]) if match[3] else None
    else:
        start = parse_datetime(match[2])
        duration = _duration_or_until(start, match[3])
    if repetitions == 0:
        raise ValueError(f"{text!r} never repeats: give R1 or more, or R for without end")
    if duration == Duration():
        raise ValueError(f"{text!r} repeats without letting time pass: its duration has to be longer than zero")
    return Cycle(duration, repetitions, start, end)


TIMES: Mapping[str, Callable[[str], object]] = {
    "duration": parse_duration,
    "date": parse_datetime,
    "cycle": parse_cycle,
}
"""What reads the text of a timer, by its kind."""


def add(moment: datetime, duration: Duration) -> datetime:
    """`moment` plus `duration`: months on the calendar, a day the month lacks being its last, then the rest exactly.

    The rule is that of XML Schema 1.1, part 2, appendix E.3.3. Raises ValueError beyond the years 1 to 9999.
    """
    try:
        years, month = divmod(moment.month - 1 + duration.months, 12)
        year, month = moment.year + years, month + 1
        moment = moment.replace(year=year, month=month, day=min(moment.day, monthrange(year, month)[1]))
        exact = moment.astimezone(UTC) + timedelta(microseconds=duration.rest // 1000)
        return exact.astimezone(moment.tzinfo)
    except (ValueError, OverflowError):
        raise ValueError(f"{moment.isoformat()} and {duration} make a date beyond the years 1 to 9999") from None


def nanoseconds_between(start: datetime, end: datetime) -> int:
    """From `start` to `end` (ns), negative if `end` comes first."""
    # In UTC, since Python leaves the turning of clocks out of the difference of two dates in one and the same zone.
    return (end.astimezone(UTC) - start.astimezone(UTC)) // timedelta(microseconds=1) * 1000


def zone_named(name: str) -> tzinfo:
    """Return the time zone of that name, such as ``Europe/Berlin``. Raises ValueError."""
    from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

    try:
        if not _ZONE.fullmatch(name):  # a longer path would be followed, however deep
            raise ValueError
        return ZoneInfo(name)
    except (ValueError, OSError, ZoneInfoNotFoundError):
        raise ValueError(f"the time zone {name!r} is not known here") from None


def _named_zone(text: str) -> tuple[str, tzinfo]:
    """A date without the zone that FEEL writes behind it (``@Europe/Berlin``, ``[Europe/Berlin]``), and the zone for
    one without offset, UTC if none is named."""
    found = _NAMED.fullmatch(text)
    if found is None:
        return text, UTC
    try:
        return found[1], zone_named(found[2] or found[3])
    except ValueError:
        raise ValueError(f"{text!r} has a time zone that is not known here: an offset such as +01:00 is") from None


def _duration_or_until(start: datetime, text: str) -> Duration:
    if text.lstrip("-").startswith("P"):
        return parse_duration(text)
    end = parse_datetime(text)
    if nanoseconds_between(start, end) <= 0:
        raise ValueError(f"{text!r} is not after {start.isoformat()}: an interval begins before it ends")
    return Duration(rest=nanoseconds_between(start, end))


def _whole_steps(duration: Duration, anchor: datetime, now: datetime) -> int:
    """A lower bound, and a close one, of the number of durations from `anchor` to `now`."""
    span = nanoseconds_between(anchor, now)
    days = 31 if span > 0 else 28
    return span // (duration.rest + duration.months * days * _NANOSECONDS["days"])
