"""Boundary events (standard 13.5.3)."""

import pytest
from conftest import Play
from engine_models import (
    boundary,
    call,
    catch,
    condition,
    end,
    error,
    message,
    model,
    path,
    process,
    script,
    signal,
    start,
    sub,
    timer,
    user,
)

ACTIVITIES = {
    "user": user("u"),
    "script": script("u", "await sleep(100)"),
    "sub-process": sub("u", user("v")),
    "call": call("u", "Q"),
    "receive": '<receiveTask id="u" messageRef="message_M"/>',
}
TRIGGERS = {"signal": signal("A"), "message": message("A"), "timer": timer("PT5S"), "condition": condition("x > 0")}
CALLED = process(start("t") + user("w") + path("t w"), id="Q")


def guarded(activity: str, trigger: str, interrupting: bool) -> str:
    content = start() + ACTIVITIES[activity] + boundary("b", "u", TRIGGERS[trigger], interrupting=interrupting)
    content += script("y") + end() + path("s u e") + path("b y")
    other = catch("c", signal("C")) + script("k", "x = 1") + path("s c k")
    return content + other


@pytest.mark.parametrize("interrupting", [True, False])
@pytest.mark.parametrize("trigger", TRIGGERS)
@pytest.mark.parametrize("activity", ACTIVITIES)
def test_each_trigger_fires_at_each_activity(play: Play, activity: str, trigger: str, interrupting: bool) -> None:
    run = play(model(guarded(activity, trigger, interrupting), CALLED), {"x": 0}).run(1)
    if trigger == "timer":
        run.run(6)
    else:
        run.signal({"condition": "C"}.get(trigger, "A"))
    assert " b" in run.log
    assert run.visits["b"] == run.visits["y"] == 1
    assert ("-u" in run.log.split()) is interrupting
    assert bool({"u", "v", "w"} & set(run.waiting)) is not interrupting


def test_an_interrupting_one_cancels_its_activity(play: Play) -> None:
    content = start() + user("u") + boundary("b", "u", signal("A")) + script("y") + end() + path("s u e") + path("b y")
    assert play(content).run().signal("A").log == "s (u b -u y =completed"


def test_a_non_interrupting_one_runs_beside_it_each_time(play: Play) -> None:
    content = start() + user("u") + boundary("b", "u", signal("A"), interrupting=False) + script("y") + path("b y")
    run = play(content + path("s u")).run().signal("A").signal("A")
    assert run.log == "s (u b y b y"
    assert run.complete("u").status == "completed"


def test_it_is_disarmed_when_its_activity_ends(play: Play) -> None:
    content = start() + user("u") + boundary("b", "u", signal("A"), interrupting=False) + user("v") + path("s u v")
    assert play(content).run().complete("u").signal("A").log == "s u (v"


def test_a_cycle_fires_again_and_again(play: Play) -> None:
    content = start() + user("u") + boundary("b", "u", timer("R3/PT2S", "Cycle"), interrupting=False) + path("s u")
    run = play(content).run(20)
    assert run.visits["b"] == 3
    assert run.waiting == ["u"]


def test_several_fire_in_the_order_of_arming_until_one_interrupts(play: Play) -> None:
    content = (
        start() + user("u") + boundary("b", "u", signal("A"), interrupting=False) + boundary("c", "u", signal("A"))
    )
    content += boundary("d", "u", signal("A"), interrupting=False) + path("s u")
    assert play(content).run().signal("A").log == "s (u b c -u =completed"


def test_several_triggers_of_one_event_are_alternatives(play: Play) -> None:
    content = start() + user("u") + boundary("b", "u", signal("A"), timer("PT5S")) + path("s u")
    assert play(content).run(1).signal("A").log == "s (u b -u =completed"
    assert play(content).run(6).log == "s (u b -u =completed"


def test_a_timer_that_says_no_time_is_an_error(play: Play) -> None:
    content = (
        sub("p", user("u") + boundary("b", "u", timer("${dt}"))) + boundary("c", "p", error()) + catch("d", signal("A"))
    )
    run = play(content, {"dt": "soon"}).run()
    assert "c" in run.visits
    assert run.waiting == ["d"]
    assert run.signal("A").left_behind() == {}
