"""Event-based gateways and multiple events (standard 13.4.6, 10.5.3; docs/semantics.md)."""

import pytest
from conftest import Play
from engine_models import (
    Run,
    catch,
    condition,
    element,
    end,
    gateway,
    path,
    properties,
    script,
    signal,
    start,
    timer,
    user,
)

from fame.errors import ModelError

CHOICE = start() + gateway("eventBased", "g") + catch("a", signal("A")) + catch("b", timer("PT5S"))
CHOICE += catch("c", condition("x > 0")) + '<receiveTask id="m" messageRef="message_M"/>'
CHOICE += path("s g a") + path("g b") + path("g c") + path("g m")


def test_the_token_waits_at_the_gateway(play: Play) -> None:
    run = play(CHOICE, {"x": 0}).run(1)
    assert run.waiting == ["g"]


@pytest.mark.parametrize("first", "abcm")
def test_the_first_stimulus_wins_and_disarms_the_rest(play: Play, first: str) -> None:
    other = user("u") + script("k", "x = 1") + path("s u k")
    run = play(CHOICE + other, {"x": 0}).run(1)
    stimuli = {"a": lambda: run.signal("A"), "b": lambda: run.run(6), "c": lambda: run.complete("u"),
               "m": lambda: run.message("M")}  # fmt: skip
    stimuli[first]()
    for stimulus in (lambda: run.signal("A"), lambda: run.run(9), lambda: run.message("M")):
        stimulus()
    assert {id for id in "abcm" if id in run.visits} == {first}
    assert run.visits["g"] == 1


def test_the_log_tells_the_gateway_then_the_event(play: Play) -> None:
    assert play(CHOICE, {"x": 0}).run(1).signal("A").log == "s g a =completed"


def test_the_taken_flow_is_told_alone(play: Play) -> None:
    run = play(CHOICE, {"x": 0}).run(1).signal("A")
    assert [event.element for event in run.events if event.what == "take"] == ["s_g", "g_a"]


def test_one_message_for_two_events_takes_the_first_armed(play: Play) -> None:
    content = start() + gateway("eventBased", "g") + catch("a", signal("A")) + catch("b", signal("A"))
    assert play(content + path("s g a") + path("g b")).run().signal("A").log == "s g a =completed"


def test_a_condition_that_is_true_already_wins_at_once(play: Play) -> None:
    run = play(CHOICE, {"x": 1}).run()
    assert run.log == "s g c =completed"
    assert not run.left_behind()


def test_in_a_loop_it_leaves_nothing_armed(play: Play) -> None:
    content = start() + gateway("exclusive", "l") + gateway("eventBased", "g") + catch("a", signal("A"))
    content += catch("b", signal("B")) + path("s l g a l") + path("g b")
    run = play(content).run()
    for _ in range(20):
        run.signal("A")
    assert {topic: len(found) for topic, found in run.node.engine.listeners.items()} == {"/A": 1, "/B": 1}
    assert run.signal("B").left_behind() == {}


def test_a_message_that_sets_its_variables_wins_before_a_condition_on_them(play: Play) -> None:
    typed = properties(type="std_msgs/msg/Int32")
    content = start() + gateway("eventBased", "g") + catch("a", typed, signal("A")) + catch("c", condition("A > 0"))
    assert play(content + path("s g a") + path("g c")).run().signal("A", 1).visits == {"s": 1, "g": 1, "a": 1}


def test_it_may_not_lead_to_a_task(play: Play) -> None:
    with pytest.raises(ModelError, match="expected a catching event"):
        play(start() + gateway("eventBased", "g") + script("a") + path("s g a"))


def test_a_multiple_catching_event_waits_for_any_of_its_triggers(play: Play) -> None:
    content = start() + catch("c", signal("A"), timer("PT5S")) + end() + path("s c e")
    assert play(content).run(1).signal("A").log == "s c e =completed"
    run = play(content).run()
    assert (run.log, run.simulation.now) == ("s c e =completed", 5.0)
    assert not run.left_behind()


def test_what_it_waits_for_does_not_repeat() -> None:
    twice = "<standardLoopCharacteristics loopMaximum='2'/>"
    task = element("receiveTask", "r", twice, messageRef="message_M")
    with pytest.raises(ModelError, match="a receive task after an event-based gateway must not repeat"):
        Run(start() + gateway("eventBased", "g") + task + path("s g r"))
