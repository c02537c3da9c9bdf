"""Event sub-processes (standard 13.5.4; docs/semantics.md)."""

import pytest
from conftest import Play
from engine_models import (
    boundary,
    call,
    condition,
    end,
    error,
    flow,
    gateway,
    handler,
    message,
    model,
    path,
    process,
    script,
    signal,
    start,
    sub,
    throw,
    timer,
    user,
)

WORK = start() + user("u") + end() + path("s u e")


def test_an_interrupting_one_cancels_what_its_scope_was_doing_and_takes_its_place(play: Play) -> None:
    run = play(WORK + handler("h", start("t", signal("A")) + user("w") + path("t w"))).run().signal("A")
    assert run.log == "s (u -u (h t (w"
    assert run.complete("w").log == "s (u -u (h t w h) =completed"
    assert not run.left_behind()


def test_tokens_in_motion_are_cancelled_too(play: Play) -> None:
    """The thrower waits in line behind its own message, and is gone when its turn comes."""
    content = start() + throw("t", signal("A")) + script("x") + path("s t x") + handler("h", start("b", signal("A")))
    assert play(content).run().log == "s t (h b h) =completed"


def test_so_are_tokens_that_wait_at_joins(play: Play) -> None:
    content = start() + gateway("parallel", "g") + script("a") + user("b") + gateway("parallel", "j")
    content += path("s g a j") + path("g b j") + handler("h", start("t", signal("A")))
    run = play(content).run().signal("A")
    assert run.log == "s g a (b -b (h t h) =completed"


def test_it_disarms_its_siblings_and_fires_once(play: Play) -> None:
    handlers = handler("h", start("t", signal("A")) + user("w") + path("t w")) + handler("i", start("v", signal("B")))
    run = play(WORK + handlers).run().signal("A").signal("B").signal("A")
    assert run.log == "s (u -u (h t (w"


def test_it_ends_with_its_scope(play: Play) -> None:
    run = play(WORK + handler("h", start("t", signal("A")))).run().complete("u")
    assert run.status == "completed"
    assert not run.left_behind()
    assert run.signal("A").log == "s u e =completed"


def test_it_is_armed_again_with_the_next_activation_of_the_scope(play: Play) -> None:
    inner = user("u") + handler("h", start("t", signal("A")))
    content = start() + sub("p", inner) + user("w") + path("s p w p")
    run = play(content).run().signal("A").complete("w").signal("A")
    assert run.log == "s (p (u -u (h t h) p) w (p (u -u (h t h) p) (w"


def test_a_non_interrupting_one_fires_for_every_delivery_concurrently(play: Play) -> None:
    handling = handler("h", start("t", signal("A"), interrupting=False) + user("w") + path("t w"))
    run = play(WORK + handling).run().signal("A").signal("A")
    assert run.log == "s (u (h t (w (h t (w"
    assert run.waiting == ["u", "w", "w"]


def test_the_scope_ends_after_its_last_handler(play: Play) -> None:
    handling = handler("h", start("t", signal("A"), interrupting=False) + user("w") + path("t w"))
    run = play(WORK + handling).run().signal("A").signal("A").complete("u").complete("w")
    assert run.status == "running"
    assert run.complete("w").log == "s (u (h t (w (h t (w u) e w) h) w) h) =completed"


def test_a_handler_still_armed_may_fire_while_only_handlers_run(play: Play) -> None:
    handling = handler("h", start("t", signal("A"), interrupting=False) + user("w") + path("t w"))
    run = play(WORK + handling).run().signal("A").complete("u").signal("A")
    assert run.waiting == ["w", "w"]


def test_an_interrupting_one_cancels_running_handlers_of_its_scope(play: Play) -> None:
    handlers = handler("h", start("t", signal("A"), interrupting=False) + user("w") + path("t w"))
    handlers += handler("i", start("v", signal("B")))
    assert play(WORK + handlers).run().signal("A").signal("B").log == "s (u (h t (w -u -h -w (i v i) =completed"


def test_several_are_told_in_the_order_of_arming(play: Play) -> None:
    handlers = "".join(handler(f"h{n}", start(f"t{n}", signal("A"), interrupting=False)) for n in range(3))
    run = play(WORK + handlers).run().signal("A")
    assert run.log == "s (u (h0 t0 (h1 t1 (h2 t2 h0) h1) h2)"


def test_an_interrupting_sibling_that_comes_first_takes_the_message_from_later_ones(play: Play) -> None:
    handlers = handler("h", start("t", signal("A"))) + handler("i", start("v", signal("A"), interrupting=False))
    assert play(WORK + handlers).run().signal("A").log == "s (u -u (h t h) =completed"


@pytest.mark.parametrize("depth", [1, 2, 5, 40])
def test_it_fires_at_any_depth_from_outside(play: Play, depth: int) -> None:
    inner = user("u") + handler("h", start("t", signal("A")) + script("x") + path("t x"))
    for level in range(depth):
        inner = sub(f"p{level}", inner)
    run = play(start() + inner + end() + path(f"s p{depth - 1} e")).run().signal("A")
    assert run.status == "completed"
    assert run.visits["x"] == run.visits["h"] == run.visits["e"] == 1
    assert "u" not in run.visits


@pytest.mark.parametrize("depth", [0, 1, 2, 5])
def test_it_fires_from_inside_at_any_depth(play: Play, depth: int) -> None:
    inner = throw("x", signal("A")) + user("u") + path("x u")
    for level in range(depth):
        inner = sub(f"p{level}", inner)
    run = play(inner + handler("h", start("t", signal("A")))).run()
    assert run.log.endswith("(h t h) =completed")
    assert run.visits["h"] == 1


def test_an_inner_one_and_an_outer_one_both_hear_the_same_message(play: Play) -> None:
    inner = sub("p", user("u") + handler("h", start("t", signal("A"), interrupting=False)))
    content = start() + inner + path("s p") + handler("i", start("v", signal("A"), interrupting=False))
    assert play(content).run().signal("A").log == "s (p (u (i v (h t i) h)"


def test_an_outer_interrupting_one_cancels_the_inner_scope_with_its_handlers(play: Play) -> None:
    inner = sub("p", user("u") + handler("h", start("t", signal("A"), interrupting=False)))
    content = start() + inner + path("s p") + handler("i", start("v", signal("A")))
    assert play(content).run().signal("A").log == "s (p (u -p -u (i v i) =completed"


def test_an_inner_interrupting_one_leaves_the_outer_scope_alone(play: Play) -> None:
    inner = sub("p", user("u") + handler("h", start("t", signal("A"))))
    content = start() + gateway("parallel", "g") + inner + user("w") + end() + path("s g p e") + path("g w")
    assert play(content).run().signal("A").log == "s g (p (w (u -u (h t h) p) e"


def test_one_inside_a_handler_interrupts_that_handler(play: Play) -> None:
    nested = handler("i", start("v", signal("B")) + user("x") + path("v x"))
    run = play(WORK + handler("h", start("t", signal("A")) + user("w") + path("t w") + nested)).run()
    run.signal("B").signal("A").signal("B")
    assert run.log == "s (u -u (h t (w -w (i v (x"
    assert run.complete("x").log == "s (u -u (h t (w -w (i v x i) h) =completed"


def test_one_inside_a_non_interrupting_handler_interrupts_that_activation(play: Play) -> None:
    nested = handler("i", start("v", signal("B")))
    content = WORK + handler("h", start("t", signal("A"), interrupting=False) + user("w") + path("t w") + nested)
    run = play(content).run().signal("A").signal("B")
    assert run.log == "s (u (h t (w -w (i v i) h)"
    assert run.complete("u").status == "completed"


def test_it_may_have_several_triggers(play: Play) -> None:
    handling = handler("h", start("t", signal("A"), timer("PT5S")))
    assert play(WORK + handling).run(6).log == "s (u -u (h t h) =completed"
    assert play(WORK + handling).run(1).signal("A").log == "s (u -u (h t h) =completed"


def test_a_timer_triggers_it(play: Play) -> None:
    run = play(WORK + handler("h", start("t", timer("PT5S")) + script("x") + path("t x"))).run()
    assert run.log == "s (u -u (h t x h) =completed"
    assert run.simulation.now == 5.0


def test_a_cycle_triggers_a_non_interrupting_one_again_and_again(play: Play) -> None:
    run = play(WORK + handler("h", start("t", timer("R/PT5S", "Cycle"), interrupting=False))).run(16)
    assert run.visits["h"] == 3
    run.complete("u")
    assert run.status == "completed"
    assert not run.left_behind()


def test_a_message_triggers_it(play: Play) -> None:
    assert play(WORK + handler("h", start("t", message("M")))).run().message("M").log == "s (u -u (h t h) =completed"


def test_a_condition_triggers_it(play: Play) -> None:
    run = play(WORK + handler("h", start("t", condition("x > 2")))).run().complete("u", {"x": 1})
    assert run.log == "s u e =completed"
    content = start() + user("u") + script("a", "x = 3") + script("b") + path("s u a b")
    run = play(content + handler("h", start("t", condition("x > 2")))).run().complete("u")
    assert run.log == "s u a (h t h) =completed"


def test_it_works_in_a_called_process(play: Play) -> None:
    called = process(start("t") + user("u") + path("t u") + handler("h", start("v", signal("A"))), id="Q")
    run = play(model(start() + call("c", "Q") + end() + path("s c e"), called)).run().signal("A")
    assert run.log == "s (c t (u -u (h v h) c) e =completed"


def test_the_handler_shares_the_variables_of_its_scope(play: Play) -> None:
    handling = handler("h", start("t", signal("B")) + script("x", "y = y + 1") + path("t x"))
    assert play(WORK + handling, {"y": 1}).run().signal("B").variables["y"] == 2


def test_boundary_events_still_guard_a_sub_process_whose_handler_took_its_place(play: Play) -> None:
    inner = sub("p", user("u") + handler("h", start("t", signal("A")) + user("w") + path("t w")))
    content = start() + inner + boundary("b", "p", signal("B")) + script("x") + path("s p") + path("b x")
    assert play(content).run().signal("A").signal("B").log == "s (p (u -u (h t (w b -p -h -w x =completed"


def test_a_thousand_firings_leave_nothing_behind(play: Play) -> None:
    handling = handler("h", start("t", signal("A"), interrupting=False) + script("x", "n = n + 1") + path("t x"))
    loop = start() + gateway("exclusive", "m") + throw("a", signal("A")) + script("k", "i = i + 1")
    loop += gateway("exclusive", "g") + end() + path("s m a k g") + flow("g", "m", "i < 1000")
    run = play(loop + flow("g", "e", "i >= 1000") + handling, {"n": 0, "i": 0}).run()
    assert (run.variables["n"], run.variables["i"]) == (1000, 1000)
    assert not run.left_behind()


def test_one_that_took_the_place_of_its_scope_is_cancelled_with_it(play: Play) -> None:
    taking = handler("h", start("t", signal("A")) + user("v") + path("t v"))
    content = start() + sub("p", user("u") + taking) + boundary("b", "p", signal("B")) + path("s p")
    run = play(content).run().signal("A").signal("B")
    assert run.log == "s (p (u -u (h t (v b -p -h -v =completed"


def test_one_that_took_the_place_of_its_process_is_cancelled_when_this_fails(play: Play) -> None:
    inside = start("t", signal("A")) + gateway("parallel", "g") + user("v") + end("e", error("E"))
    run = play(start() + user("u") + path("s u") + handler("h", inside + path("t g v") + path("g e"))).run()
    assert run.signal("A").log == "s (u -u (h t g (v e e!E -h -v =failed"
