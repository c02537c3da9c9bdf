"""Cancellation: dead at once, and what follows waits until scripts are out (docs/semantics.md)."""

import pytest
from conftest import Play
from engine_models import boundary, call, catch, error, handler, model, path, process, script, signal, start, sub, user

SLOW = "try:\n    await sleep(100)\nfinally:\n    await sleep({})\n    left = True"
FOR_EVER = "while True:\n    try:\n        await sleep(100)\n    except BaseException:\n        pass"
GUARDED = start() + sub("p", script("a", SLOW.format(1))) + boundary("b", "p", signal("A")) + script("x")
GUARDED += path("s p") + path("b x")


def test_a_script_is_cancelled_at_its_await_and_runs_its_finally(play: Play) -> None:
    content = (
        start()
        + script("a", "try:\n    await sleep(9)\nfinally:\n    stopped = True")
        + boundary("b", "a", signal("A"))
    )
    run = play(content + path("s a")).run(1).signal("A")
    assert run.log == "s (a b -a =completed"
    assert run.variables["stopped"] is True


def test_the_continuation_starts_when_the_last_script_is_out(play: Play) -> None:
    run = play(GUARDED).run(1).signal("A")
    assert run.log == "s (p (a b -p -a"
    assert run.run(1.9).log == "s (p (a b -p -a"
    assert run.run(2.1).log == "s (p (a b -p -a x =completed"
    assert run.variables["left"] is True


def test_of_several_scripts_the_slowest_is_waited_for(play: Play) -> None:
    inner = "".join(script(f"a{n}", SLOW.format(delay)) for n, delay in enumerate((0.5, 1.5, 1)))
    content = sub("p", inner) + boundary("b", "p", signal("A")) + script("x") + path("b x")
    run = play(content).run(1).signal("A")
    assert "x" not in run.run(2.4).visits
    assert run.run(2.6).status == "completed"


@pytest.mark.parametrize("text", [SLOW.format(50), FOR_EVER])
def test_the_grace_is_two_seconds(play: Play, text: str) -> None:
    content = script("a", text) + boundary("b", "a", signal("A")) + script("x") + path("b x")
    run = play(content).run(1).signal("A")
    assert run.run(2.9).status == "running"
    assert run.run(3.1).log == "(a b -a x =completed"
    assert "still running after 2 s" in run.reports[0]


def test_errors_while_leaving_are_reported_never_thrown(play: Play) -> None:
    content = script("a", "try:\n    await sleep(9)\nfinally:\n    1 / 0") + boundary("b", "a", signal("A"))
    content += boundary("c", "a", error()) + script("x") + path("b x")
    run = play(content).run(1).signal("A")
    assert run.log == "(a b -a x =completed"
    assert "division by zero" in run.reports[0]


def test_late_results_are_dropped(play: Play) -> None:
    content = script("a", SLOW.format(1)) + script("y") + boundary("b", "a", signal("A")) + user("u") + path("a y")
    assert play(content + path("b u")).run(1).signal("A").run(5).log == "(a b -a (u"


def test_catchers_are_disarmed_at_once(play: Play) -> None:
    content = sub("p", script("a", SLOW.format(1)) + catch("c", signal("A"))) + boundary("b", "p", signal("A"))
    run = play(content).run(1).signal("A").signal("A").run(5)
    assert run.log == "(p (a (c b -p -a -c =completed"


def test_an_event_sub_process_waits_for_scripts_to_leave(play: Play) -> None:
    content = script("a", SLOW.format(1)) + handler("h", start("t", signal("A")) + script("x") + path("t x"))
    run = play(content).run(1).signal("A")
    assert run.log == "(a -a (h t"
    assert run.run(2.5).log == "(a -a (h t x h) =completed"


def test_a_caller_waits_when_an_error_ends_its_call(play: Play) -> None:
    called = process(script("a", SLOW.format(1)) + script("k", "await sleep(1)\n1 / 0"), id="Q")
    content = model(
        start() + call("c", "Q") + boundary("b", "c", error()) + script("x") + path("s c") + path("b x"), called
    )
    run = play(content).run(1.5)
    assert run.log == "s (c (a (k k!script b -c -a"
    assert run.run(3).log == "s (c (a (k k!script b -c -a x =completed"


def test_a_failed_instance_ends_when_its_scripts_are_out(play: Play) -> None:
    run = play(script("a", SLOW.format(1)) + script("k", "await sleep(1)\n1 / 0")).run(1.5)
    assert run.status == "running"
    assert run.run(3).status == "failed"
    assert not run.left_behind()


def test_a_continuation_that_is_cancelled_while_it_waits_passes_its_wait_on(play: Play) -> None:
    inner = sub("p", script("a", SLOW.format(1)) + handler("h", start("t", signal("A")) + script("x") + path("t x")))
    content = inner + boundary("b", "p", signal("B")) + script("y") + path("b y")
    run = play(content).run(1).signal("A").signal("B")
    assert "y" not in run.run(1.9).visits
    assert run.run(2.1).log == "(p (a -a (h t b -p -h y =completed"
    assert not run.left_behind()


def test_a_continuation_that_is_suspended_while_it_waits_is_held(play: Play) -> None:
    pause = handler("h", start("t", signal("B")) + user("w") + path("t w"), resume=True)
    run = play(GUARDED + pause).run(1).signal("A").signal("B").run(5)
    assert "x" not in run.visits
    assert run.complete("w").log == "s (p (a b -p -a (h t w h) x =completed"


def test_stopping_ends_every_instance_at_once(play: Play) -> None:
    run = play(GUARDED).run(1)
    run.node.stop()
    assert run.log == "s (p (a -p -a =cancelled"
    run.run(9)
    assert run.log == "s (p (a -p -a =cancelled"
    assert run.variables["left"] is True
    assert not run.left_behind()
