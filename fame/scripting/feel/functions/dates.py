"""The functions of FEEL about dates, times and durations; what is now comes from the mission's clock, in UTC."""

from __future__ import annotations

from calendar import monthrange
from collections.abc import Callable, Mapping
from datetime import UTC
from typing import Any

from fame.engine.data import Temporal
from fame.iso8601 import Duration
from fame.scripting.data import to_text
from fame.scripting.feel.values import HOUR, MINUTE, Moment, moment, parsed, temporal, zone_of
from fame.scripting.interface import mission_date
from fame.scripting.signatures import functions

_DATES, _TIMES = ("date", "date and time"), ("time", "date and time")
_MONTHS = ("January", "February", "March", "April", "May", "June", "July", "August", "September", "October",
           "November", "December")  # fmt: skip
_DAYS = ("Monday", "Tuesday", "Wednesday", "Thursday", "Friday", "Saturday", "Sunday")
"""Always English, independent of the locale."""


def _now(variables: Mapping[str, Any]) -> Temporal | None:
    date = mission_date(variables)
    return None if date is None else temporal(Moment("date and time", date, "Z"))


def _today(variables: Mapping[str, Any]) -> Temporal | None:
    date = mission_date(variables)
    return None if date is None else _date(temporal(Moment("date and time", date, "Z")))


def _date(value: Any) -> Temporal:
    at = moment(value, *_DATES).at
    return temporal(Moment("date", at.replace(hour=0, minute=0, second=0, microsecond=0, tzinfo=UTC)))


def _time(value: Any) -> Temporal:
    found = moment(value, *_TIMES)
    return temporal(Moment("time", found.at.replace(year=1970, month=1, day=1), found.zone))


def _time_of(hour: Any, minute: Any, second: Any, offset: str = "") -> Temporal:
    zone = ""
    if offset:
        length = parsed(offset)
        if not isinstance(length, Duration) or length.months:
            raise ValueError(f"{offset!r} is not a UTC offset")
        rest = abs(length.rest)
        zone = f"{'-' if length.rest < 0 else '+'}{rest // HOUR:02}:{rest % HOUR // MINUTE:02}"
    whole, fraction = divmod(round(second * 1_000_000), 1_000_000)
    return _known(f"{int(hour):02}:{int(minute):02}:{whole:02}.{fraction:06}{zone}")


def _date_and_time(value: Any) -> Temporal:
    found = moment(value, *_DATES)
    return temporal(Moment("date and time", found.at, found.zone))


def _combined(date: Any, other: str) -> Temporal:
    """The date and time of a date and a time; or a date and time converted to another zone."""
    start = moment(date, *_DATES)
    try:
        time = moment(other, "time")
    except ValueError:
        zone, shown = zone_of(other.removeprefix("@"))
        return temporal(Moment("date and time", start.at.astimezone(zone), shown))
    at = time.at.replace(year=start.at.year, month=start.at.month, day=start.at.day)
    return temporal(Moment("date and time", at, time.zone))


def _known(text: str) -> Temporal:
    """The normal form of a temporal text. Raises ValueError."""
    return temporal(parsed(text))


def _duration(text: str) -> Temporal:
    found = parsed(text)
    if not isinstance(found, Duration):
        raise ValueError(f"{text!r} is not a duration")
    zero = not (found.months or found.rest)
    return Temporal(text) if zero else temporal(found)


def _months_between(start: Any, end: Any) -> Temporal:
    first, last = moment(start, *_DATES).at, moment(end, *_DATES).at
    months = (last.year - first.year) * 12 + last.month - first.month
    months -= (months > 0 and last.day < first.day) - (months < 0 and last.day > first.day)
    return temporal(Duration(months)) if months else Temporal("P0M")


def _last_day(value: Any) -> Temporal:
    at = moment(value, *_DATES).at
    return _known(f"{at:%Y-%m}-{monthrange(at.year, at.month)[1]}")


def literal(text: str) -> Temporal | None:
    """``@"2026-01-31"``: null if the text says nothing."""
    try:
        found = parsed(text)
        return _duration(text) if isinstance(found, Duration) else temporal(found)
    except ValueError:
        return None


def _cycle(*parts: Any) -> str:
    """The cycle of Camunda 8's timers: ``R3/PT10S``; without a number it is unlimited."""
    return f"R{parts[0]}/{parts[1]}" if len(parts) == 2 else f"R/{to_text(*parts)}"


_ON_A_DATE: dict[str, Callable[[Any], Any]] = {
    "day of week": lambda at: _DAYS[at.weekday()],
    "day of year": lambda at: at.timetuple().tm_yday,
    "week of year": lambda at: at.isocalendar().week,
    "month of year": lambda at: _MONTHS[at.month - 1],
}


def _on(get: Callable[[Any], Any]) -> Callable[[Any], Any]:
    return lambda value: get(moment(value, *_DATES).at)


MOMENTS = functions({"now()": _now, "today()": _today}, sees=True) | functions(
    {
        "date(from: string)": _date,
        "date(year: number, month: number, day: number)": lambda *parts: _known("{:04}-{:02}-{:02}".format(*parts)),
        "time(from: string)": _time,
        "time(hour: number, minute: number, second: number, offset?: string)": _time_of,
        "date and time(from: string)": _date_and_time,
        "date and time(date: string, time: string)": _combined,
        "duration(from: string)": _duration,
        "years and months duration(from: string, to: string)": _months_between,
        **{f"{name}(date: string)": _on(get) for name, get in _ON_A_DATE.items()},
        "last day of month(date: string)": _last_day,
        "cycle(repetitions: any, interval?: any)": _cycle,
    }
)
"""Name -> its signatures. A date is also taken from the text that it is."""
