"""Timers: ISO 8601 durations, dates and cycles on the engine's clock (docs/semantics.md)."""

import pytest
from conftest import Play
from engine_models import boundary, catch, end, error, flow, path, script, start, sub, timer, user


@pytest.mark.parametrize(
    ("text", "kind", "seconds"),
    [
        ("PT5S", "Duration", 5),
        ("PT0.25S", "Duration", 0.25),
        ("PT1H30M", "Duration", 5400),
        ("P1W", "Duration", 604800),
        ("P1M", "Duration", 31 * 86400),
        ("1970-01-01T00:00:07Z", "Date", 7),
        ("1970-01-01T01:00:07+01:00", "Date", 7),
        ("R3/PT4S", "Cycle", 4),
        ("R/PT4S", "Cycle", 4),
        ("${dt}", "Duration", 3),
        ("PT${x}S", "Duration", 3),
    ],
)
def test_a_catching_event_waits_until_its_timer_is_due(play: Play, text: str, kind: str, seconds: float) -> None:
    run = play(start() + catch("c", timer(text, kind)) + end() + path("s c e"), {"x": 3, "dt": "PT3S"}).run()
    assert run.log == "s c e =completed"
    assert run.simulation.now == seconds
    assert not run.left_behind()


def test_a_date_in_the_past_is_due_at_once(play: Play) -> None:
    run = play(start() + catch("c", timer("1969-12-31T00:00:00Z", "Date")) + path("s c")).run()
    assert (run.status, run.simulation.now) == ("completed", 0)


def test_the_expression_is_evaluated_when_the_event_is_armed(play: Play) -> None:
    content = start() + script("a", "x = 7") + catch("c", timer("PT${x}S")) + path("s a c")
    assert play(content, {"x": 3}).run().simulation.now == 7


def test_a_timer_that_says_no_time_is_an_error_of_its_event(play: Play) -> None:
    content = start() + sub("p", catch("c", timer("${x}"))) + boundary("b", "p", error()) + path("s p")
    run = play(content, {"x": "soon"}).run()
    assert run.log == "s (p (c c!script b -p =completed"
    assert not run.left_behind()


def test_timers_of_one_instant_fire_in_the_order_of_arming(play: Play) -> None:
    content = start() + "".join(catch(id, timer("PT5S")) + path(f"s {id}") for id in "cab")
    assert play(content).run().log == "s (c (a (b c) a) b) =completed"


def test_a_timer_of_a_cancelled_activity_does_not_fire(play: Play) -> None:
    content = start() + user("u") + boundary("b", "u", timer("PT5S")) + user("v") + path("s u v")
    run = play(content).run(1).complete("u").run(9)
    assert run.log == "s u (v"
    assert run.node.engine.waits == {}


def test_a_loop_over_a_timer_that_takes_no_time_fails(play: Play, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fame.robot.timers.AT_ONE_INSTANT", 100)
    run = play(start() + catch("c", timer("PT0S")) + path("s c") + flow("c", "c")).run()
    assert run.status == "failed"
    assert "100 timers were due as soon as they were set" in str(run.instance.error)
    assert run.visits["c"] == 100


def test_timers_that_take_no_time_are_counted_anew_when_time_goes_on(
    play: Play, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fame.robot.timers.AT_ONE_INSTANT", 100)
    content = start() + catch("c", timer("PT0S")) + catch("d", timer("PT1S")) + path("s c d c")
    assert play(content).run(150.5).visits["c"] == 151
