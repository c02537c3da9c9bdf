"""Durations, dates and cycles of timer events."""

from datetime import UTC, datetime, timedelta
from itertools import islice
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given, strategies as st

from fame.iso8601 import Cycle, Duration, add, nanoseconds_between, parse_cycle, parse_datetime, parse_duration

SECOND = 1_000_000_000
HOUR = 3600 * SECOND
NEW_YEAR = datetime(2026, 1, 1, tzinfo=UTC)


def day(text: str) -> datetime:
    return datetime.fromisoformat(text).replace(tzinfo=UTC)


@pytest.mark.parametrize(
    ("text", "months", "rest"),
    [
        ("PT0S", 0, 0),
        ("PT1.5S", 0, 1_500_000_000),
        ("PT0.1S", 0, 100_000_000),
        ("PT0,000000001S", 0, 1),
        ("PT5e-05S", 0, 50_000),
        ("PT1e-300S", 0, 0),
        ("PT1.5E+3S", 0, 1500 * SECOND),
        ("P1e+2Y", 1200, 0),
        ("PT450359962737049.123456789S", 0, 450_359_962_737_049_123_456_789),
        ("PT10M", 0, 600 * SECOND),
        ("PT0.5H", 0, HOUR // 2),
        ("P1W", 0, 7 * 24 * HOUR),
        ("P0.5D", 0, 12 * HOUR),
        ("P1Y2M", 14, 0),
        ("P1M", 1, 0),
        ("PT1M", 0, 60 * SECOND),
        (" P1Y2M3DT4H5M6.5S ", 14, 3 * 24 * HOUR + 4 * HOUR + 5 * 60 * SECOND + 6_500_000_000),
    ],
)
def test_a_duration_is_read_exactly(text: str, months: int, rest: int) -> None:
    assert parse_duration(text) == Duration(months, rest)


@given(st.integers(0, 10**6), st.integers(0, 10**24))
def test_a_duration_reads_back_as_it_was_written(months: int, rest: int) -> None:
    assert parse_duration(str(Duration(months, rest))) == Duration(months, rest)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "is not an ISO 8601 duration"),
        ("P", "is not an ISO 8601 duration"),
        ("30", "is not an ISO 8601 duration: 30 seconds are PT30S"),
        ("PT", "is not an ISO 8601 duration"),
        ("P1DT", "is not an ISO 8601 duration"),
        ("5s", "such as PT1.5S"),
        ("PT5", "such as PT1.5S"),
        ("PT1S2M", "such as PT1.5S"),
        ("pt5s", "such as PT1.5S"),
        ("PT٣S", "such as PT1.5S"),
        ("P" + "9" * 5000 + "D", "such as PT1.5S"),
        ("-PT5S", "negative"),
        ("PT-5S", "negative"),
        ("PT-5e-05S", "negative"),
        ("PT1e+22S", "too long"),
        ("P1e+999D", "too long"),
        ("P1e-1Y", "fraction of a year or month"),
        ("P1.5Y", "fraction of a year or month"),
        ("P0.5M", "fraction of a year or month"),
        ("PT1.5H3S", "fraction before its last part"),
    ],
)
def test_a_bad_duration_is_refused_in_one_line_that_says_what_is_wrong(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason) as caught:
        parse_duration(text)
    assert "\n" not in str(caught.value)


def test_a_duration_with_months_has_no_fixed_length() -> None:
    assert parse_duration("P2DT1S").nanoseconds == 2 * 24 * HOUR + SECOND
    with pytest.raises(ValueError, match="P1M has no fixed length"):
        _ = parse_duration("P1M").nanoseconds


@pytest.mark.parametrize(
    ("text", "moment"),
    [
        ("2026-01-31T12:00:00Z", datetime(2026, 1, 31, 12, tzinfo=UTC)),
        ("2026-01-31T12:00:00", datetime(2026, 1, 31, 12, tzinfo=UTC)),
        ("2026-01-31T12", datetime(2026, 1, 31, 12, tzinfo=UTC)),
        ("2026-01-31", datetime(2026, 1, 31, tzinfo=UTC)),
        ("20260131T120000Z", datetime(2026, 1, 31, 12, tzinfo=UTC)),
        ("2026-01-31T12:00:00.25+01:00", datetime(2026, 1, 31, 11, 0, 0, 250_000, tzinfo=UTC)),
        ("20260131T120000,123456789-0530", datetime(2026, 1, 31, 17, 30, 0, 123_456, tzinfo=UTC)),
        ("2026-W05-6T12:00Z", datetime(2026, 1, 31, 12, tzinfo=UTC)),
        ("2026-01-31T24:00:00Z", datetime(2026, 2, 1, tzinfo=UTC)),
        ("20260131T24Z", datetime(2026, 2, 1, tzinfo=UTC)),
    ],
)
def test_a_date_is_read_in_extended_and_basic_form(text: str, moment: datetime) -> None:
    assert parse_datetime(text) == moment


def test_a_date_without_time_zone_is_in_utc() -> None:
    assert parse_datetime("2026-01-31T12:00") == datetime(2026, 1, 31, 12, tzinfo=UTC)
    assert parse_datetime("2026-01-31T12:00+02:00") == datetime(2026, 1, 31, 10, tzinfo=UTC)


def test_a_date_may_name_its_zone_as_feel_does() -> None:
    noon = datetime(2026, 7, 1, 10, tzinfo=UTC)
    for text in ("2026-07-01T12:00:00[Europe/Berlin]", "2026-07-01T12:00:00+02:00[Europe/Berlin]", "2026-07-01T10:00Z"):
        assert parse_datetime(text) == noon
    with pytest.raises(ValueError, match="time zone that is not known here"):
        parse_datetime("2026-07-01T12:00:00[Mars/Olympus]")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "tomorrow",
        "12:00",
        "PT5S",
        "2026-01-31 12:00",
        "2026-02-30T00:00Z",
        "2026-01-31T25:00Z",
        "2026-01-31T24:00:01Z",
        "2026-01-31T12:00+99:00",
        "9999-12-31T24:00Z",
    ],
)
def test_a_bad_date_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="not an ISO 8601 date and time such as 2026-01-31T12:00:00Z"):
        parse_datetime(text)


@pytest.mark.parametrize(
    ("moment", "duration", "result"),
    [
        ("2026-01-31", "P1M", "2026-02-28"),
        ("2028-01-31", "P1M", "2028-02-29"),
        ("2028-02-29", "P1Y", "2029-02-28"),
        ("2026-11-30", "P3M", "2027-02-28"),
        ("2026-01-31", "P1M1D", "2026-03-01"),
        ("2026-12-31", "PT24H", "2027-01-01"),
    ],
)
def test_months_are_added_on_the_calendar_and_then_the_rest(moment: str, duration: str, result: str) -> None:
    assert add(day(moment), parse_duration(duration)) == day(result)


def test_a_day_is_24_hours_where_clocks_are_turned() -> None:
    moment = datetime(2026, 3, 28, 12, tzinfo=ZoneInfo("Europe/Rome"))
    assert add(moment, parse_duration("P1D")) == datetime(2026, 3, 29, 13, tzinfo=ZoneInfo("Europe/Rome"))
    assert nanoseconds_between(moment, add(moment, parse_duration("P1D"))) == 24 * HOUR
    assert nanoseconds_between(add(moment, parse_duration("P1D")), moment) == -24 * HOUR


def test_a_sum_beyond_the_calendar_is_refused() -> None:
    with pytest.raises(ValueError, match="beyond the years 1 to 9999"):
        add(NEW_YEAR, parse_duration("P9000Y"))
    with pytest.raises(ValueError, match="beyond the years 1 to 9999"):
        add(NEW_YEAR, parse_duration("P999999999999D"))


@pytest.mark.parametrize(
    ("text", "due"),
    [
        ("R3/PT10M", ["2026-01-01T00:10", "2026-01-01T00:20", "2026-01-01T00:30"]),
        ("R/P1D", ["2026-01-02", "2026-01-03", "2026-01-04", "2026-01-05"]),
        ("R3/2026-01-01T06:00Z/PT1H", ["2026-01-01T06:00", "2026-01-01T07:00", "2026-01-01T08:00"]),
        ("R2/2026-01-01T06:00Z/2026-01-01T09:00Z", ["2026-01-01T06:00", "2026-01-01T09:00"]),
        ("R3/2025-12-31T23:30Z/PT1H", ["2026-01-01T00:30", "2026-01-01T01:30"]),
        ("R3/2026-01-01T00:00Z/PT1H", ["2026-01-01T00:00", "2026-01-01T01:00", "2026-01-01T02:00"]),
        ("R2/2020-01-01T00:00Z/PT1H", []),
        ("R/1999-12-31/P1M", ["2026-01-31", "2026-02-28", "2026-03-31", "2026-04-30"]),
        ("R3/P1M/2026-03-31", ["2026-01-31", "2026-02-28", "2026-03-31"]),
        ("R4/PT6H/2026-01-01T12:00Z", ["2026-01-01T00:00", "2026-01-01T06:00", "2026-01-01T12:00"]),
        ("R/PT6H/2026-01-01T12:00Z", ["2026-01-01T06:00", "2026-01-01T12:00"]),
        ("R999999999999999/PT1H/2026-01-01T02:00Z", ["2026-01-01T00:00", "2026-01-01T01:00", "2026-01-01T02:00"]),
    ],
)
def test_a_cycle_is_due_from_now_on_and_counts_what_is_past(text: str, due: list[str]) -> None:
    assert list(islice(parse_cycle(text).due_times(NEW_YEAR), 4)) == [day(moment) for moment in due]


def test_a_cycle_that_began_long_ago_finds_its_next_time_at_once() -> None:
    moments = parse_cycle("R/1970-01-01T00:00:00Z/PT0.001S").due_times(NEW_YEAR)
    assert next(moments) == NEW_YEAR
    assert next(moments) == NEW_YEAR + timedelta(milliseconds=1)


@given(st.integers(0, 30), st.integers(1, 40), st.integers(0, 10**16), st.integers(0, 10**18))
def test_a_cycle_misses_no_due_time_and_adds_none(months: int, number: int, rest: int, later: int) -> None:
    cycle = Cycle(Duration(months, rest + 1000), number, start=NEW_YEAR)
    now = NEW_YEAR + timedelta(microseconds=later // 1000)
    every = [add(NEW_YEAR, cycle.duration * step) for step in range(number)]
    assert list(cycle.due_times(now)) == [moment for moment in every if moment >= now]


def test_delays_of_a_cycle_without_dates_are_exact_to_the_nanosecond() -> None:
    assert list(islice(parse_cycle("R/PT0.333333333S").delays(NEW_YEAR), 3)) == [333_333_333, 666_666_666, 999_999_999]
    assert list(parse_cycle("R2/PT10S").delays(NEW_YEAR)) == [10 * SECOND, 20 * SECOND]


def test_delays_of_a_cycle_with_dates_or_months_count_from_now() -> None:
    assert list(parse_cycle("R2/2026-01-01T00:00:01Z/PT1S").delays(NEW_YEAR)) == [SECOND, 2 * SECOND]
    assert list(parse_cycle("R2/P1M").delays(NEW_YEAR)) == [31 * 24 * HOUR, 59 * 24 * HOUR]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("PT5S", "is not an ISO 8601 cycle such as R/PT10S"),
        ("R3", "is not an ISO 8601 cycle"),
        ("R-1/PT5S", "is not an ISO 8601 cycle"),
        ("0 0 * * *", "is not an ISO 8601 cycle"),
        ("R0/PT5S", "never repeats"),
        ("R/PT0S", "longer than zero"),
        ("R/-PT5S", "negative"),
        ("R/2026-01-01/-PT5S", "negative"),
        ("R/5s", "such as PT1.5S"),
        ("R/2026-01-02/2026-01-01", "is not after"),
        ("R/2026-01-32/PT1S", "not an ISO 8601 date"),
        ("R/PT1S/PT1S", "not an ISO 8601 date"),
    ],
)
def test_a_bad_cycle_is_refused_in_one_line_that_says_what_is_wrong(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason) as caught:
        parse_cycle(text)
    assert "\n" not in str(caught.value)
