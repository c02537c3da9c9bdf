"""``resume=true``: event sub-processes that suspend their scope (docs/semantics.md)."""

from conftest import Play
from engine_models import (
    TERMINATE,
    boundary,
    call,
    catch,
    condition,
    end,
    error,
    gateway,
    handler,
    model,
    path,
    process,
    properties,
    script,
    signal,
    start,
    sub,
    throw,
    timer,
    user,
)

STEPS = "i = i + 1\nawait sleep(10)\ndone = True"


def pausing(*content: str, on: str = "A", id: str = "h") -> str:
    """An event sub-process that suspends its scope until somebody completes ``w``."""
    return handler(id, start(f"{id}_t", signal(on)), *(content or (user("w") + path(f"{id}_t w"),)), resume=True)


def test_the_scope_keeps_its_tokens_and_goes_on_afterwards(play: Play) -> None:
    run = play(start() + user("u") + end() + path("s u e") + pausing()).run().signal("A")
    assert run.log == "s (u (h h_t (w"
    assert run.waiting == ["u", "w"]
    assert run.complete("w").complete("u").log == "s (u (h h_t w h) u) e =completed"


def test_running_scripts_are_cancelled_and_start_again(play: Play) -> None:
    run = play(start() + script("a", STEPS) + path("s a") + pausing(), {"i": 0}).run(3).signal("A")
    assert run.run(20).log == "s (a (h h_t (w"
    run.complete("w")
    assert run.variables["i"] == 2
    assert run.run(29.5).status == "running"
    assert run.run(30.5).log == "s (a (h h_t w h) a) =completed"
    assert run.visits["a"] == 1


def test_they_start_with_the_variables_as_they_are_then(play: Play) -> None:
    content = start() + script("a", "await sleep(dt)") + path("s a")
    content += handler("h", start("t", signal("A")) + script("x", "dt = 1") + path("t x"), resume=True)
    assert play(content, {"dt": 10}).run(3).signal("A").run(4.5).log == "s (a (h t x h) a) =completed"


def test_the_handler_starts_when_cancelled_scripts_are_out(play: Play) -> None:
    content = start() + script("a", "try:\n    await sleep(10)\nfinally:\n    await sleep(1)") + path("s a")
    content += handler("h", start("t", signal("A")) + script("x") + path("t x"), resume=True)
    run = play(content).run(3).signal("A")
    assert run.log == "s (a (h t"
    assert run.run(3.5).log == "s (a (h t"
    assert run.run(4.5).log == "s (a (h t x h)"
    assert run.run(20).status == "completed"


def test_suspension_reaches_into_sub_processes_and_calls(play: Play) -> None:
    called = process(start("t") + sub("p", catch("c", signal("B"))) + path("t p"), id="Q")
    run = play(model(start() + call("k", "Q") + path("s k") + pausing(), called)).run().signal("A").signal("B")
    assert run.waiting == ["c", "w"]
    assert run.complete("w").signal("B").log == "s (k t (p (c (h h_t w h) c) p) k) =completed"


def test_suspended_catches_do_not_listen(play: Play) -> None:
    run = play(start() + catch("c", signal("B")) + path("s c") + pausing()).run().signal("A").signal("B")
    assert run.complete("w").waiting == ["c"]
    assert run.signal("B").status == "completed"


def test_nor_do_suspended_boundary_events_and_inner_event_sub_processes(play: Play) -> None:
    inner = sub("p", user("u") + boundary("b", "u", signal("B")) + handler("i", start("v", signal("B"))))
    content = start() + inner + boundary("d", "p", signal("B")) + path("s p") + pausing()
    run = play(content).run().signal("A").signal("B").complete("w")
    assert run.log == "s (p (u (h h_t w h)"
    assert run.signal("B").log == "s (p (u (h h_t w h) d -p -u =completed"


def test_a_message_that_suspends_does_not_reach_later_catchers_of_the_same_delivery(play: Play) -> None:
    run = play(start() + catch("c", signal("A")) + path("s c") + pausing()).run().signal("A")
    assert run.waiting == ["c", "w"]
    assert run.complete("w").waiting == ["c"]


def test_with_a_queue_they_keep_what_comes(play: Play) -> None:
    content = start() + catch("c", properties(queue=1), signal("B")) + path("s c") + pausing()
    assert play(content).run().signal("A").signal("B").complete("w").log == "s (c (h h_t w h) c) =completed"


def test_timers_run_on(play: Play) -> None:
    content = start() + catch("c", timer("PT10S")) + path("s c") + pausing()
    run = play(content).run(1).signal("A").run(5).complete("w")
    assert run.run(9.5).waiting == ["c"]
    assert run.run(10.5).status == "completed"


def test_timers_that_come_due_fire_at_resumption_in_due_order(play: Play) -> None:
    content = start() + gateway("parallel", "g")
    for number, seconds in enumerate((9, 3, 6)):
        content += catch(f"c{number}", timer(f"PT{seconds}S")) + path(f"g c{number}")
    run = play(content + path("s g") + pausing()).run(1).signal("A").run(20)
    assert run.log == "s g (c0 (c1 (c2 (h h_t (w"
    assert run.complete("w").log == "s g (c0 (c1 (c2 (h h_t w h) c1) c2) c0) =completed"


def test_a_due_boundary_timer_fires_before_its_task_starts_again(play: Play) -> None:
    content = start() + script("a", STEPS) + boundary("b", "a", timer("PT5S")) + script("x") + path("s a") + path("b x")
    run = play(content + pausing(), {"i": 0}).run(1).signal("A").run(6).complete("w")
    assert run.variables["i"] == 1
    assert run.log == "s (a (h h_t w h) b -a x =completed"


def test_resume_events_of_the_scope_are_disarmed_meanwhile_and_others_stay_armed(play: Play) -> None:
    content = start() + user("u") + path("s u") + pausing()
    content += pausing(user("y") + path("k_t y"), on="B", id="k")
    content += handler("n", start("n_t", signal("C"), interrupting=False))
    run = play(content).run().signal("A").signal("B").signal("A").signal("C")
    assert run.log == "s (u (h h_t (w (n n_t n)"
    assert run.complete("w").signal("B").log == "s (u (h h_t (w (n n_t n) w) h) (k k_t (y"


def test_an_interrupting_one_without_resume_ends_the_suspended_scope(play: Play) -> None:
    content = start() + user("u") + path("s u") + pausing() + handler("i", start("v", signal("B")))
    assert play(content).run().signal("A").signal("B").log == "s (u (h h_t (w -u -h -w (i v i) =completed"


def test_it_is_armed_again_afterwards(play: Play) -> None:
    run = play(start() + user("u") + path("s u") + pausing()).run()
    for _ in range(3):
        run.signal("A").complete("w")
    assert run.visits == {"s": 1, "h": 3, "h_t": 3, "w": 3}
    assert run.complete("u").status == "completed"
    assert not run.left_behind()


def test_a_timer_that_suspends_is_set_anew_afterwards(play: Play) -> None:
    content = start() + user("u") + path("s u")
    content += handler("h", start("t", timer("PT10S")) + user("w") + path("t w"), resume=True)
    run = play(content).run(15).complete("w")
    assert run.run(24.5).visits["h"] == 1
    assert run.run(25.5).waiting == ["u", "w"]


def test_running_handlers_are_suspended_too(play: Play) -> None:
    content = start() + user("u") + path("s u") + pausing()
    content += handler("n", start("n_t", signal("B"), interrupting=False) + catch("c", signal("C")) + path("n_t c"))
    run = play(content).run().signal("B").signal("A").signal("C")
    assert run.waiting == ["u", "c", "w"]
    assert run.complete("w").signal("C").log == "s (u (n n_t (c (h h_t w h) c) n)"


def test_a_handler_that_begins_meanwhile_runs_on_beside_the_suspended_scope(play: Play) -> None:
    content = start() + user("u") + path("s u") + pausing()
    content += handler("n", start("n_t", signal("B"), interrupting=False) + user("x") + path("n_t x"))
    run = play(content).run().signal("A").signal("B").complete("x")
    assert run.log == "s (u (h h_t (w (n n_t x n)"
    assert run.complete("w").complete("u").status == "completed"


def test_tokens_in_motion_are_held(play: Play) -> None:
    content = start() + throw("a", signal("A")) + script("b") + path("s a b") + pausing()
    run = play(content).run()
    assert run.log == "s a (h h_t (w"
    assert run.complete("w").log == "s a (h h_t w h) b =completed"


def test_suspensions_nest(play: Play) -> None:
    inner = sub("p", script("a", STEPS) + pausing(user("x") + path("k_t x"), on="B", id="k"))
    run = play(start() + inner + path("s p") + pausing(), {"i": 0}).run(1).signal("B").signal("A")
    assert run.waiting == ["a", "x", "w"]
    run.complete("x")  # is remembered: the inner handler is suspended itself
    assert run.run(20).waiting == ["a", "x", "w"]
    run.complete("w")
    assert run.run(20).log == "s (p (a (k k_t (x (h h_t w h) x) k)"
    assert run.variables["i"] == 2
    assert run.run(31).log.endswith("a) p) =completed")
    assert not run.left_behind()


def test_an_outer_suspension_holds_a_scope_that_is_suspended_already(play: Play) -> None:
    inner = sub("p", catch("c", signal("C")) + pausing(user("x") + path("k_t x"), on="B", id="k"))
    run = play(start() + inner + path("s p") + pausing()).run().signal("B").signal("A").complete("w").signal("C")
    assert run.waiting == ["c", "x"]
    assert run.complete("x").signal("C").status == "completed"


def test_a_task_completed_while_it_is_suspended_goes_on_at_resumption(play: Play) -> None:
    run = play(start() + user("u") + end() + path("s u e") + pausing()).run().signal("A").complete("u", {"x": 1})
    assert run.waiting == ["u", "w"]
    assert run.complete("w").log == "s (u (h h_t w h) u) e =completed"


def test_an_error_that_leaves_the_handler_ends_the_suspended_scope(play: Play) -> None:
    failing = handler("h", start("t", signal("A")) + end("x", error("E")) + path("t x"), resume=True)
    content = start() + sub("p", user("u") + failing) + boundary("b", "p", error("E")) + script("y")
    run = play(content + path("s p") + path("b y")).run().signal("A")
    assert run.log == "s (p (u (h t x x!E b -p -u -h y =completed"
    assert not run.left_behind()


def test_an_error_caught_inside_the_handler_is_a_normal_end(play: Play) -> None:
    inside = start("t", signal("A")) + script("x", "raise BpmnError('E')") + boundary("b", "x", error()) + path("t x")
    run = play(start() + user("u") + path("s u") + handler("h", inside, resume=True)).run().signal("A")
    assert run.log == "s (u (h t (x x!E b h)"
    assert run.complete("u").status == "completed"


def test_a_terminate_in_the_handler_ends_the_suspended_scope(play: Play) -> None:
    ending = handler("h", start("t", signal("A")) + end("x", TERMINATE) + path("t x"), resume=True)
    content = start() + sub("p", user("u") + ending) + script("y") + path("s p y")
    assert play(content).run().signal("A").log == "s (p (u (h t x -u -h p) y =completed"


def test_a_boundary_event_of_the_suspended_scope_still_fires(play: Play) -> None:
    content = start() + sub("p", user("u") + pausing()) + boundary("b", "p", signal("B")) + script("y")
    run = play(content + path("s p") + path("b y")).run().signal("A").signal("B")
    assert run.log == "s (p (u (h h_t (w b -p -u -h -w y =completed"


def test_a_condition_that_is_still_true_fires_again_at_once_when_armed_again(play: Play) -> None:
    content = start() + user("u") + path("s u")
    content += handler("h", start("t", condition("n < 3")) + script("x", "n = n + 1") + path("t x"), resume=True)
    run = play(content, {"n": 0}).run()
    assert run.visits == {"s": 1, "h": 3, "t": 3, "x": 3}
    assert run.waiting == ["u"]


def test_a_condition_that_was_true_only_while_it_was_suspended_does_not_fire(play: Play) -> None:
    content = start() + gateway("parallel", "g") + catch("c", condition("x > 2")) + script("k", "x = 3") + path("s g c")
    content += path("g k")
    content += handler("h", start("t", condition("x > 2")) + script("y", "x = 0") + path("t y"), resume=True)
    run = play(content, {"x": 0}).run()
    assert run.log == "s g (c k (h t y h)"
    assert run.waiting == ["c"]


def test_semantics_original_makes_every_interrupting_one_resume(play: Play) -> None:
    handling = handler("h", start("t", signal("A")) + user("w") + path("t w"))
    content = process(start() + user("u") + path("s u") + handling, semantics="original")
    run = play(model(content)).run().signal("A").complete("w")
    assert run.log == "s (u (h t w h)"
    assert run.waiting == ["u"]


def test_semantics_original_leaves_non_interrupting_ones_alone(play: Play) -> None:
    handling = handler("h", start("t", signal("A"), interrupting=False))
    content = process(start() + catch("c", signal("A")) + path("s c") + handling, semantics="original")
    assert play(model(content)).run().signal("A").log == "s (c (h t c) h) =completed"


def test_it_may_stand_in_a_called_process_and_in_a_handler(play: Play) -> None:
    called = process(start("t") + user("u") + path("t u") + pausing(), id="Q")
    run = play(model(start() + call("c", "Q") + path("s c"), called)).run().signal("A").complete("w").complete("u")
    assert run.log == "s (c t (u (h h_t w h) u) c) =completed"
    outer = handler("o", start("o_t", signal("O")) + user("u") + path("o_t u") + pausing())
    run = play(start() + user("v") + path("s v") + outer).run().signal("O").signal("A").complete("w").complete("u")
    assert run.log == "s (v -v (o o_t (u (h h_t w h) u) o) =completed"


def test_an_inclusive_join_is_not_decided_while_its_scope_is_suspended(play: Play) -> None:
    content = start() + gateway("parallel", "g") + script("a") + catch("c", signal("A")) + gateway("inclusive", "j")
    content += end() + path("s g a j e") + path("g c j") + pausing(on="B")
    run = play(content).run().signal("B").signal("A").complete("w")
    assert run.waiting == ["c", "j"]
    assert run.signal("A").log.endswith("c) j e =completed")


def test_of_instances_that_are_suspended_each_may_be_completed(play: Play) -> None:
    twice = "<multiInstanceLoopCharacteristics><loopCardinality>2</loopCardinality></multiInstanceLoopCharacteristics>"
    run = play(start() + user("u", twice) + path("s u") + pausing()).run().signal("A")
    assert run.complete("u").complete("u").complete("w").status == "completed"


def test_conditions_see_what_a_script_that_starts_again_has_changed(play: Play) -> None:
    noticed = handler("i", start("it", condition("i == 2"), interrupting=False) + script("z") + path("it z"))
    run = (
        play(start() + script("t", STEPS) + path("s t") + pausing() + noticed, {"i": 0})
        .run(1)
        .signal("A")
        .complete("w")
    )
    assert run.run(2).visits["z"] == 1
