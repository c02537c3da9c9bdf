"""The safe state of a robot (docs/semantics.md): when the engine asks for it."""

import pytest
from conftest import Play
from engine_models import TERMINATE, Run, boundary, end, error, handler, path, script, signal, start, sub, user


def asked(run: Run) -> list[str]:
    """Keeps what `make_safe` is called with."""
    reasons: list[str] = []
    run.node.host.make_safe = reasons.append  # type: ignore[method-assign]
    return reasons


def test_after_an_uncaught_error(play: Play) -> None:
    run = play(start() + user("u") + script("a", "1 / 0") + path("s u a"))
    reasons = asked(run)
    run.run().complete("u")
    assert reasons == ["failed"]


def test_not_after_one_that_is_caught(play: Play) -> None:
    run = play(start() + script("a", "1 / 0") + boundary("b", "a", error()) + path("s a"))
    reasons = asked(run)
    assert run.run().status == "completed"
    assert reasons == []


@pytest.mark.parametrize(("inside", "reasons"), [(False, ["terminated"]), (True, [])])
def test_after_a_terminate_of_the_mission(play: Play, inside: bool, reasons: list[str]) -> None:
    content = start() + end("x", TERMINATE) + path("s x")
    run = play(sub("p", content) if inside else content)
    found = asked(run)
    run.run()
    assert found == reasons


def test_on_suspension(play: Play) -> None:
    run = play(start() + user("u") + path("s u") + handler("h", start("t", signal("A")), resume=True))
    reasons = asked(run)
    run.run().signal("A")
    assert reasons == ["suspended"]


def test_on_shutdown(play: Play) -> None:
    run = play(start() + user("u") + path("s u"))
    reasons = asked(run)
    run.run().node.stop()
    assert reasons == ["terminated"]
