"""A model that forks, waits or ends without measure leaves its engine time for deployment and status."""

import pytest
from deployment_field import Field, definitions, process

from fame.cli.robots import rows
from fame.clock import Kind, Scheduler
from fame.deploy.status import WAITS

TIMER = "<timerEventDefinition><{0}>{1}</{0}></timerEventDefinition>"
LOOP = "<multiInstanceLoopCharacteristics><loopCardinality>{}</loopCardinality></multiInstanceLoopCharacteristics>"


class Wall(Scheduler):
    """Passes for the wall clock, and jumps all the same."""

    is_simulated = False


class RealTime(Field):
    def __init__(self, **options) -> None:
        super().__init__("A", scheduler=Wall(), **options)


def parallel(number: int, task: str = '<userTask id="u">{}</userTask>') -> str:
    return definitions(process("p", '<startEvent id="s"/>' + task.format(LOOP.format(number)), ("s", "u")))


def test_between_two_turns_of_others_a_mission_takes_one_step(monkeypatch: pytest.MonkeyPatch) -> None:
    field, seen = RealTime(), []
    timer = f'<intermediateCatchEvent id="t">{TIMER.format("timeDuration", "PT1S")}</intermediateCatchEvent>'
    split = '<startEvent id="s"/><parallelGateway id="g"/>' + timer
    field.send("A", definitions(process("p", split, ("s", "g"), *[("g", "t")] * 500)))
    field.pass_time(0.5)
    running = field.engines["A"].running
    assert running is not None
    timer_fired = running.engine.timer_fired
    monkeypatch.setattr(running.engine, "timer_fired", lambda key, last: (seen.append("timer"), timer_fired(key, last)))

    def others() -> None:
        seen.append(" ")
        if len(seen) < 1000:
            field.scheduler.soon(others, Kind.TIMER)

    field.scheduler.at(min(running.host.timers.due(key) or 0 for key in running.engine.waits), others)
    field.pass_time(2)
    assert "".join(seen).split() == ["timer"] * 500


@pytest.mark.parametrize("number", [99, 1000])
def test_a_report_describes_a_limited_number_of_tokens_and_counts_the_others(number: int) -> None:
    field = Field("A")
    field.send("A", parallel(number))
    field.pass_time(3)
    report = field.said[-1]
    assert len(report.waits) == min(number, WAITS)
    assert report.more_waits == max(0, number - WAITS)
    assert ("and 900 more waiting tokens" in str(list(rows("A", report)))) == (number == 1000)


def test_many_ends_within_a_moment_make_few_reports() -> None:
    field = RealTime()
    start = f'<startEvent id="s">{TIMER.format("timeCycle", "R5000/PT0.0001S")}</startEvent><endEvent id="e"/>'
    field.send("A", definitions(process("p", start, ("s", "e"))))
    field.pass_time(3)
    assert field.said[-1].completed == 5000
    assert len(field.said) < 20


def test_many_failures_within_a_moment_are_told_once_with_their_number() -> None:
    told: list[str] = []
    field = RealTime(on_report=lambda event: told.append(str(event.detail)))
    task = '<scriptTask id="x"><script>1 / 0</script></scriptTask>'
    start = f'<startEvent id="s">{TIMER.format("timeCycle", "R500/PT0.0001S")}</startEvent>'
    field.send("A", definitions(process("p", start + task, ("s", "x"))))
    field.pass_time(3)
    failures = [text for text in told if "the mission has failed" in text]
    assert len(failures) == 2
    assert "(499 like this within a second)" in failures[1]


def test_an_activity_with_more_parallel_instances_than_tokens_are_allowed_begins_none() -> None:
    field = Field("A")
    field.send("A", parallel(50_001))
    field.pass_time(3)
    running = field.engines["A"].running
    assert running is not None
    error = running.instances[-1].error
    assert error is not None
    assert error.code == "livelock"
    assert "more than 50000 tokens" in str(error)
    assert running.engine.new_key() < 100


def test_simulated_time_keeps_timers_of_a_millisecond() -> None:
    field = Field("A")
    start = f'<startEvent id="s">{TIMER.format("timeCycle", "R/PT0.001S")}</startEvent><endEvent id="e"/>'
    field.send("A", definitions(process("p", start, ("s", "e"))))
    field.pass_time(1)
    running = field.engines["A"].running
    assert running is not None
    before = running.completed
    field.pass_time(2)
    assert running.completed - before == 2000


def test_a_report_has_no_large_values() -> None:
    field = Field("A")
    task = '<startEvent id="s"/><scriptTask id="x"><script>text = "x" * 10**8</script></scriptTask><userTask id="u"/>'
    field.send("A", definitions(process("p", task, ("s", "x"), ("x", "u"))))
    field.pass_time(3)
    running = field.engines["A"].running
    assert running is not None
    assert len(running.instances[0].variables["text"]) == 10**8
    assert len(field.said[-1].to_json()) < 2_000
