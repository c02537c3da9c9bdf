"""Ad-hoc sub-processes (standard 13.3.5)."""

import pytest
from conftest import Play
from engine_models import (
    Run,
    boundary,
    catch,
    element,
    end,
    error,
    extensions,
    flow,
    gateway,
    handler,
    path,
    properties,
    script,
    signal,
    start,
    sub,
    timer,
    user,
)

from fame.errors import MissionError, ModelError


def ad_hoc(*content: str, until: str = "", **said: str) -> str:
    """A process with an ad-hoc sub-process ``p`` that is complete when ``until`` is true."""
    enough = f"<completionCondition>{until}</completionCondition>" if until else ""
    return start() + element("adHocSubProcess", "p", *content, enough, **said) + end() + path("s p e")


ABC = user("a") + user("b") + user("c")


def test_what_no_flow_leads_to_begins_and_the_last_of_it_ends_the_sub_process(play: Play) -> None:
    run = play(ad_hoc(ABC, user("d"), path("c d"))).run()
    assert run.waiting == ["a", "b", "c"]
    run.complete("b").complete("c").complete("a")
    assert run.waiting == ["d"]
    assert run.complete("d").log == "s (p (a (b (c b) c) (d a) d) p) e =completed"
    assert not run.left_behind()


def test_one_at_a_time_in_the_order_of_the_file_if_it_is_sequential(play: Play) -> None:
    run = play(ad_hoc(ABC, ordering="Sequential")).run().complete("a").complete("b").complete("c")
    assert run.log == "s (p a b c p) e =completed"


def test_what_an_activity_leads_to_comes_before_the_next_one_its_forks_in_turn(play: Play) -> None:
    inner = script("a") + script("x") + script("y") + path("a x") + path("a y") + script("b")
    assert play(ad_hoc(inner, ordering="Sequential")).run().log == "s (p a x b y p) e =completed"
    inner = user("a") + user("x") + user("y") + path("a x") + path("a y") + user("b")
    run = play(ad_hoc(inner, ordering="Sequential")).run()
    for id in ("a", "x", "b", "y"):
        assert run.waiting == [id]
        run.complete(id)
    assert run.status == "completed"


def test_an_inclusive_join_waits_for_those_that_wait_for_their_turn(play: Play) -> None:
    inner = (
        script("a") + gateway("inclusive", "g") + script("x") + script("y") + gateway("inclusive", "j") + script("k")
    )
    inner += path("a g x j k") + path("g y j") + user("b")
    run = play(ad_hoc(inner, ordering="Sequential")).run()
    assert run.log == "s (p a g x (b"
    assert run.complete("b").log == "s (p a g x b y j k p) e =completed"


def test_a_boundary_event_that_interrupts_lets_the_next_one_begin(play: Play) -> None:
    late = boundary("t", "a", timer("PT5S")) + script("k") + path("t k")
    run = play(ad_hoc(ABC, late, ordering="Sequential")).run(6)
    assert run.log == "s (p (a t -a k (b"
    failing = script("a", "1 / 0") + boundary("t", "a", error(), interrupting=False) + user("b")
    assert play(ad_hoc(failing, ordering="Sequential")).run().log == "s (p (a a!script t (b"
    beside = boundary("t", "a", signal("A"), interrupting=False) + script("k") + path("t k")
    run = play(ad_hoc(ABC, beside, ordering="Sequential")).run().signal("A")
    assert run.log == "s (p (a t"
    assert run.complete("a").log == "s (p (a t a) (b"


def test_the_completion_condition_is_asked_after_each_activity_and_cancels_the_rest(play: Play) -> None:
    run = play(ad_hoc(ABC, script("d"), until="n &gt; 1"), {"n": 0}).run()
    assert run.waiting == ["a", "b", "c"]
    run.complete("a", {"n": 1}).complete("b", {"n": 2})
    assert run.log == "s (p (a (b (c d a) b) -c p) e =completed"
    assert not run.left_behind()


def test_sequential_behaviours_are_tried_until_one_succeeds(play: Play) -> None:
    inner = script("a") + script("b", "found = True") + script("c")
    run = play(ad_hoc(inner, until="found", ordering="Sequential"), {"found": False}).run()
    assert run.log == "s (p a b p) e =completed"


def test_without_cancellation_the_others_may_end_and_nothing_new_begins(play: Play) -> None:
    inner = ABC + user("d") + path("b d") + catch("w", signal("W"))
    run = play(ad_hoc(inner, until="True", cancelRemainingInstances="false")).run()
    assert run.waiting == ["a", "b", "c", "w"]
    run.complete("a")
    assert run.waiting == ["b", "c"]
    run.complete("b").complete("c")
    assert run.log == "s (p (a (b (c (w a) -w b) c) p) e =completed"
    assert not run.left_behind()


def test_nor_what_waits_for_its_turn_or_at_a_join(play: Play) -> None:
    run = play(ad_hoc(ABC, until="True", ordering="Sequential", cancelRemainingInstances="false")).run()
    assert run.complete("a").log == "s (p a p) e =completed"
    inner = script("a") + user("b") + gateway("parallel", "j") + script("k") + path("a j k") + path("b j")
    inner += user("c")
    run = (
        play(ad_hoc(inner, until="n &gt; 0", cancelRemainingInstances="false"), {"n": 0}).run().complete("c", {"n": 1})
    )
    assert run.complete("b").log == "s (p a (b c b) p) e =completed"


def test_nor_what_a_boundary_event_leads_to(play: Play) -> None:
    beside = boundary("t", "b", signal("A"), interrupting=False) + script("k") + path("t k")
    run = play(ad_hoc(ABC, beside, until="True", cancelRemainingInstances="false")).run().complete("a").signal("A")
    assert run.complete("b").complete("c").log == "s (p (a (b (c a) t b) c) p) e =completed"


def test_a_condition_that_is_never_true_does_not_hold_it_open(play: Play) -> None:
    assert play(ad_hoc(script("a"), until="False")).run().log == "s (p a p) e =completed"


def test_a_condition_that_fails_is_an_error_of_the_sub_process(play: Play) -> None:
    content = ad_hoc(script("a"), until="1 / 0") + boundary("b", "p", error()) + script("k") + path("b k")
    assert play(content).run().log == "s (p a b -p k =completed"


def test_a_collection_chooses_what_begins(play: Play) -> None:
    chosen = extensions('<zeebe:adHoc activeElementsCollection="=chosen"/>')
    run = play(ad_hoc(chosen, ABC, ordering="Sequential"), {"chosen": ["c", "a", "c"]}).run()
    assert run.complete("c").complete("a").complete("c").log == "s (p c a c p) e =completed"
    run = play(ad_hoc(properties(activities="chosen"), ABC), {"chosen": []}).run()
    assert run.log == "s p e =completed"


@pytest.mark.parametrize("chosen", [["a", "x"], ["k"], [["a"]], [{}], "a", None, 7])
def test_what_cannot_begin_is_an_error_of_the_sub_process(play: Play, chosen: object) -> None:
    inner = properties(activities="${chosen}") + ABC + script("k") + path("a k")
    content = ad_hoc(inner) + boundary("x", "p", error()) + path("x e").replace("x_e", "xe")
    assert play(content, {"chosen": chosen}).run().log == "s (p x -p e =completed"
    failure = play(ad_hoc(inner), {"chosen": chosen}).run().instance.error
    assert "expected a list of any of a, b, c" in str(failure)


def test_somebody_may_begin_an_element_again_while_it_is_open(play: Play) -> None:
    run = play(ad_hoc(properties(activities="${['a']}"), ABC)).run().activate("b").activate("a")
    assert run.waiting == ["a", "b", "a"]
    run.complete("a").complete("a").complete("b")
    assert run.log == "s (p (a (b a a) b) p) e =completed"


def test_in_its_turn_if_it_is_sequential(play: Play) -> None:
    run = play(ad_hoc(properties(activities="${['a']}"), ABC, ordering="Sequential")).run().activate("c").activate("b")
    assert run.waiting == ["a"]
    assert run.complete("a").complete("c").complete("b").log == "s (p a c b p) e =completed"


def test_nobody_can_begin_what_stands_in_none_that_is_open(play: Play) -> None:
    run = play(ad_hoc(user("a"), user("k"), path("a k"))).run()
    for id in ("e", "k", "nothing"):
        with pytest.raises(MissionError, match=f"{id}: cannot start now: it is in no open ad-hoc sub-process"):
            run.activate(id)
    run.complete("a").complete("k")
    with pytest.raises(MissionError):
        run.activate("a")


def test_event_sub_processes_and_boundary_events_interrupt_it(play: Play) -> None:
    handling = handler("h", start("t", signal("A")) + script("k") + path("t k"))
    run = play(ad_hoc(ABC, handling, until="False")).run().complete("a").signal("A")
    assert run.log == "s (p (a (b (c a) -b -c (h t k h) p) e =completed"
    run = play(ad_hoc(ABC) + boundary("b2", "p", signal("B")) + script("k") + path("b2 k")).run().signal("B")
    assert run.log == "s (p (a (b (c b2 -p -a -b -c k =completed"
    assert not run.left_behind()


def test_it_is_suspended_and_resumed_with_those_that_wait_for_their_turn(play: Play) -> None:
    handling = handler("h", start("t", signal("A")) + user("k") + path("t k"), resume=True)
    run = play(ad_hoc(ABC, ordering="Sequential") + handling).run().signal("A").complete("a")
    assert "b" not in run.waiting
    assert run.complete("k").waiting == ["b"]
    assert run.complete("b").complete("c").status == "completed"


def test_it_repeats_and_nests(play: Play) -> None:
    several = (
        "<multiInstanceLoopCharacteristics><loopCardinality>2</loopCardinality></multiInstanceLoopCharacteristics>"
    )
    run = play(ad_hoc(several, user("a"), user("b"), ordering="Sequential")).run()
    assert run.waiting == ["a", "a"]
    assert sorted(run.complete("a").waiting) == ["a", "b"]
    inner = element("adHocSubProcess", "q", script("a"), user("b"), script("c"), ordering="Sequential")
    run = play(ad_hoc(inner, script("d"), ordering="Sequential")).run().complete("b")
    assert run.log == "s (p (q a b c q) d p) e =completed"


def test_activities_in_it_repeat_and_have_their_flows(play: Play) -> None:
    several = (
        "<multiInstanceLoopCharacteristics><loopCardinality>2</loopCardinality></multiInstanceLoopCharacteristics>"
    )
    inner = sub("a", several, script("k")) + gateway("exclusive", "g") + script("x") + script("y")
    inner += path("a g") + flow("g", "x", "n") + flow("g", "y", "not n") + script("b")
    run = play(ad_hoc(inner, ordering="Sequential"), {"n": 1}).run()
    assert run.log == "s (p (a (a k a) k a) g x b p) e =completed"


def test_start_events_do_not_stand_in_one() -> None:
    with pytest.raises(ModelError, match=r"test.bpmn:1: p: an ad-hoc sub-process has no start event"):
        Run(ad_hoc(start("t"), script("a"), path("t a")))
