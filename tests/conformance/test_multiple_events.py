"""Events that throw several things, and gateways that start a process (standard 10.5.3, 13.4.6)."""

from __future__ import annotations

import pytest
from conftest import Play
from engine_models import (
    TERMINATE,
    Run,
    boundary,
    catch,
    end,
    error,
    gateway,
    path,
    script,
    signal,
    start,
    sub,
    throw,
    user,
)

from fame.errors import ModelError


def test_a_multiple_throwing_event_throws_all_in_document_order(play: Play) -> None:
    content = start() + gateway("parallel", "g") + catch("b", signal("B")) + catch("a", signal("A"))
    content += throw("t", signal("A"), signal("B")) + end() + path("s g b") + path("g a") + path("g t e")
    run = play(content).run()
    assert run.log == "s g (b (a t a) b) e =completed"
    assert run.visits["t"] == 1


def test_a_multiple_end_event_may_end_with_an_error(play: Play) -> None:
    inner = start("t") + end("x", signal("A"), error("E")) + path("t x")
    content = start() + catch("c", signal("A")) + sub("p", inner) + boundary("b", "p", error("E")) + path("s c")
    assert play(content + path("s p")).run().log == "s (c (p t x c) x!E b -p =completed"


def test_nothing_can_follow_what_ends_the_token() -> None:
    with pytest.raises(ModelError, match="put it last"):
        Run(start() + end("x", TERMINATE, signal("A")) + path("s x"))


BEGINNING = gateway("eventBased", "g", instantiate="true") + catch("a", signal("A")) + catch("b", signal("B"))
BEGINNING += script("k") + user("u") + path("g a k u") + path("g b u")


def test_an_event_based_gateway_may_start_a_process(play: Play) -> None:
    run = play(BEGINNING).run()
    assert run.simulation.instances == []
    assert run.signal("B").log == "g b (u"


def test_each_of_its_events_starts_an_instance_of_its_own(play: Play) -> None:
    run = play(BEGINNING).run().signal("A").signal("B").signal("A")
    assert run.log == "g a k (u g b (u g a k (u"
    assert len(run.simulation.instances) == 3


def test_what_cannot_be_executed_is_refused_by_name() -> None:
    with pytest.raises(ModelError, match="all of several"):
        Run(BEGINNING.replace('instantiate="true"', 'instantiate="true" eventGatewayType="Parallel"'))
