"""A model is read, checked and compiled in a thread beside the mission."""

import threading
import time

import pytest
from deployment_field import Field, patrol

from fame.clock import SECOND, Scheduler, WallScheduler
from fame.deploy import loading
from fame.deploy.loading import Work
from fame.errors import FameError, ModelError
from fame.worker import Interrupted


def done_with(scheduler: Scheduler, task) -> object:
    """How a task ends on a scheduler."""
    outcomes: list[object] = []
    Work(scheduler, task, lambda outcome: (outcomes.append(outcome), scheduler.stop()))
    scheduler.run(scheduler.now + 10 * SECOND)
    assert len(outcomes) == 1
    return outcomes[0]


@pytest.mark.parametrize("kind", [Scheduler, WallScheduler])
def test_a_task_gets_what_its_functions_give_and_its_errors_are_told(kind):
    def task(last):
        first = yield lambda: 20
        try:
            yield lambda: 1 / 0
        except ZeroDivisionError:
            return (yield lambda: last(first))

    def wrong(number):
        raise ModelError(f"{number} is wrong")

    assert done_with(kind(), task(lambda number: number + 1)) == 21
    assert str(done_with(kind(), task(wrong))) == "20 is wrong"


def test_the_scheduler_goes_on_while_a_function_is_at_work():
    scheduler, beat = WallScheduler(), threading.Event()

    def task():
        scheduler.after(1, beat.set)
        return (yield lambda: beat.wait(5))

    assert done_with(scheduler, task()) is True


def test_what_takes_too_long_is_given_up_and_its_thread_ends(monkeypatch):
    monkeypatch.setattr(loading, "LIMIT", 0.05)
    ended, closed = threading.Event(), []

    def for_ever():
        try:
            while True:
                time.sleep(0.001)
        except Interrupted:
            ended.set()
            raise

    def task():
        try:
            yield for_ever
        finally:
            closed.append(True)

    outcome = done_with(WallScheduler(), task())
    assert isinstance(outcome, FameError)
    assert "takes more than" in str(outcome)
    assert ended.wait(5)
    assert closed == [True]


def test_of_two_models_that_come_while_one_is_read_the_newest_runs():
    field = Field("A", scheduler=WallScheduler())
    engine = field.engines["A"]
    for mark in (1, 2, 3):
        field.send("A", patrol(mark))
    for _ in range(500):
        field.pass_time(0.01)
        if engine.running is not None and "started" in field.answers():
            break
    assert field.answers() == ["superseded", "superseded", "started"]
    assert engine.running.instances[-1].variables["mark"] == 3
    engine.close()
