"""A model is read, checked and compiled in a thread beside the mission."""

import threading
import time

import pytest
from action_server import DRIVE
from bpmn_text import document, properties
from deployment_field import Field, patrol, process

from fame.clock import SECOND, Scheduler, WallScheduler
from fame.deploy import loading
from fame.deploy.loading import Work
from fame.errors import FameError, ModelError
from fame.middleware.local import LocalNode
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
        return (yield lambda: beat.wait(60))

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
    assert ended.wait(60)
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


ASKS = (
    '<startEvent id="s"/><parallelGateway id="g"/>'
    f'<serviceTask id="a">{properties(action="drive", type=DRIVE)}</serviceTask>'
    f'<serviceTask id="b">{properties(service="blade", type="std_srvs/srv/SetBool")}</serviceTask>'
    f'<scriptTask id="c"><script>await robot.act("drive", "{DRIVE}")</script></scriptTask>'
)


def test_every_endpoint_is_made_in_the_thread_of_the_scheduler(monkeypatch):
    """A backend may be iterating over its endpoints there: rclpy's wait set, the topics of a participant."""
    made = []
    for kind in ("publisher", "subscription", "client", "service"):
        make = getattr(LocalNode, kind)

        def note(node, name, *more, _make=make, **options):
            made.append((name, threading.current_thread()))
            return _make(node, name, *more, **options)

        monkeypatch.setattr(LocalNode, kind, note)
    field = Field("A", scheduler=WallScheduler())
    field.send("A", document(process("p", ASKS, ("s", "g"), ("g", "a"), ("g", "b"), ("g", "c"))))
    field.pass_time(0.3)
    while field.engines["A"].running is None:
        field.pass_time(0.05)
    assert {"blade", "/A/drive/_action/send_goal", "/A/drive/_action/feedback"} <= {name for name, _ in made}
    assert {thread for _, thread in made} == {threading.main_thread()}
    field.engines["A"].close()
