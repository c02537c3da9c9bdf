"""Parallel multiple events wait for all of their triggers (standard 10.5.3, 13.5.3)."""

from __future__ import annotations

import pytest
from conftest import Play
from engine_models import boundary, catch, condition, end, handler, path, signal, start, timer, user

from fame.errors import ModelError

ALL = {"parallelMultiple": "true"}


def all_of(id: str, *content: str) -> str:
    return catch(id, *content, **ALL)


def test_a_catching_event_waits_for_all_of_its_triggers(play: Play) -> None:
    run = play(start() + all_of("c", signal("A"), signal("B"), timer("PT5S")) + end() + path("s c e")).run(1)
    run.signal("B").signal("B")
    assert run.waiting == ["c"]
    run.signal("A")
    assert run.waiting == ["c"]
    assert run.run(6).log == "s c e =completed"
    assert not run.left_behind()


def test_one_delivery_may_be_several_of_them(play: Play) -> None:
    assert play(start() + all_of("c", signal("A"), condition("A == 1")) + path("s c"), {"A": 0}).run().waiting == ["c"]


def test_a_boundary_event_fires_when_all_have_come(play: Play) -> None:
    content = start() + user("u") + boundary("b", "u", signal("A"), signal("B"), **ALL) + path("s u")
    run = play(content).run().signal("A")
    assert run.waiting == ["u"]
    assert run.signal("B").log == "s (u b -u =completed"
    assert not run.left_behind()


def test_one_that_does_not_interrupt_waits_for_all_again(play: Play) -> None:
    content = (
        start() + user("u") + boundary("b", "u", signal("A"), signal("B"), interrupting=False, **ALL) + path("s u")
    )
    run = play(content).run()
    for _ in range(3):
        run.signal("A").signal("A").signal("B")
    assert run.visits["b"] == 3
    assert run.complete("u").left_behind() == {}


def test_an_event_sub_process_begins_when_all_have_come(play: Play) -> None:
    begin = start("t", signal("A"), signal("B")).replace("isInterrupting", 'parallelMultiple="true" isInterrupting')
    run = play(start() + user("u") + path("s u") + handler("h", begin)).run().signal("B")
    assert run.log == "s (u"
    assert run.signal("A").log == "s (u -u (h t h) =completed"


def test_what_came_before_a_suspension_counts_after_it(play: Play) -> None:
    pause = handler("h", start("t", signal("P")) + user("w") + path("t w"), resume=True)
    content = start() + all_of("c", signal("A"), signal("B")) + path("s c") + pause
    run = play(content).run().signal("A").signal("P").signal("B").complete("w")
    assert run.waiting == ["c"]
    assert run.signal("B").status == "completed"


def test_one_that_suspends_waits_for_all_again_afterwards(play: Play) -> None:
    begin = start("t", signal("A"), signal("B")).replace("isInterrupting", 'parallelMultiple="true" isInterrupting')
    content = start() + user("u") + path("s u") + handler("h", begin + user("w") + path("t w"), resume=True)
    run = play(content).run().signal("A").signal("B").signal("A").complete("w").signal("B")
    assert run.waiting == ["u"]
    assert run.signal("A").waiting == ["u", "w"]


def test_it_cannot_start_a_process(play: Play) -> None:
    begin = start("s", signal("A"), signal("B")).replace("isInterrupting", 'parallelMultiple="true" isInterrupting')
    with pytest.raises(ModelError, match="parallel multiple"):
        play(begin)
