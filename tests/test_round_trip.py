"""How long a receiver may make no progress is measured as TCP measures round trips (RFC 6298)."""

from fame.clock import SECOND
from fame.robot.round_trip import RoundTrip

LEAST, MOST = SECOND // 2, 8 * SECOND


def test_it_follows_the_way_there_and_back():
    trip = RoundTrip()
    for number in range(1, 51):
        trip.sent(number, number * SECOND)
        trip.answered(number, number * SECOND + SECOND * 4 // 5)
    assert 0.8 * SECOND <= trip.patience < 0.9 * SECOND  # a way that never varies
    trip.sent(51, 60 * SECOND)
    trip.answered(51, 62 * SECOND)
    assert trip.patience > 2 * SECOND  # it varies


def test_a_short_way_is_given_the_least():
    trip = RoundTrip()
    trip.sent(1, 0)
    trip.answered(1, 1000)
    assert trip.patience == LEAST


def test_who_does_not_answer_is_asked_less_and_less():
    trip, patience = RoundTrip(), []
    for _ in range(6):
        trip.asked(0)
        patience.append(trip.patience / SECOND)
    assert patience == [1, 2, 4, 8, 8, 8]


def test_what_may_have_been_sent_twice_is_not_measured():
    """Karn's algorithm: the answer may be that of the first time."""
    trip = RoundTrip()
    trip.sent(1, 0)
    trip.asked(SECOND)
    trip.answered(1, 7 * SECOND)
    assert (trip.mean, trip.patience) == (0, SECOND)
    trip.sent(2, 8 * SECOND)
    trip.sent(3, 9 * SECOND)  # the one before is measured
    trip.answered(3, 9 * SECOND + SECOND // 2)
    assert trip.mean == 1.5 * SECOND
