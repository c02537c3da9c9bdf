"""Sequence flow, splits and joins (standard 13.3, 13.4.1 to 13.4.3)."""

from typing import Any

import pytest
from conftest import Play
from engine_models import (
    boundary,
    catch,
    end,
    error,
    flow,
    gateway,
    link,
    model,
    path,
    script,
    signal,
    start,
    sub,
    throw,
    timer,
    user,
)

import fame


def test_tokens_pass_along_sequence_flow(play: Play) -> None:
    run = play(start() + script("a", "x = 1") + script("b", "x = x + 1") + end() + path("s a b e")).run()
    assert run.log == "s a b e =completed"
    assert run.variables == {"x": 2}
    assert run.visits == {"s": 1, "a": 1, "b": 1, "e": 1}


def test_an_activity_without_incoming_flow_starts_by_itself(play: Play) -> None:
    assert play(script("a") + script("b")).run().log == "a b =completed"


def test_an_activity_with_several_outgoing_flows_forks(play: Play) -> None:
    run = play(start() + script("a") + script("b") + script("c") + path("s a b") + path("a c")).run()
    assert run.log == "s a b c =completed"


def test_an_activity_with_several_incoming_flows_runs_for_each_token(play: Play) -> None:
    run = play(start() + script("a") + script("b") + script("c") + path("s a c") + path("s b c")).run()
    assert run.visits == {"s": 1, "a": 1, "b": 1, "c": 2}


def test_a_token_runs_until_it_rests_before_the_next_one_moves(play: Play) -> None:
    content = start() + "".join(script(id) for id in "abcd") + gateway("parallel", "g")
    assert play(content + path("s g a b") + path("g c d")).run().log == "s g a b c d =completed"


def test_a_parallel_gateway_forks_and_joins(play: Play) -> None:
    content = start() + gateway("parallel", "g") + script("a") + script("b") + gateway("parallel", "j") + end()
    run = play(content + path("s g a j e") + path("g b j")).run()
    assert run.log == "s g a b j e =completed"


def test_a_parallel_join_waits_for_every_incoming_flow(play: Play) -> None:
    content = start() + gateway("parallel", "g") + user("a") + user("b") + gateway("parallel", "j") + end()
    run = play(content + path("s g a j e") + path("g b j")).run().complete("b")
    assert run.waiting == ["a", "j"]
    assert run.complete("a").log == "s g (a b a) j e =completed"


def test_a_parallel_join_counts_tokens_per_flow(play: Play) -> None:
    """Two tokens on one flow do not make up for none on the other."""
    content = start() + gateway("parallel", "g") + script("m") + user("u") + gateway("parallel", "j") + end()
    run = play(content + path("s g m j e") + flow("s", "m") + path("g u j")).run()
    assert run.waiting == ["u", "j"]
    assert run.complete("u").visits["j"] == 1
    assert run.status == "running"  # the second token waits at the join forever


def test_an_exclusive_gateway_takes_the_first_true_flow(play: Play) -> None:
    content = start() + gateway("exclusive", "g") + script("a") + script("b") + script("c")
    content += path("s g") + flow("g", "a", "x > 5") + flow("g", "b", "x > 1") + flow("g", "c", "x > 0")
    assert play(content, {"x": 3}).run().log == "s g b =completed"


def test_an_exclusive_gateway_takes_its_default_flow_if_no_other_is_true(play: Play) -> None:
    content = start() + gateway("exclusive", "g", default="g_a") + script("a") + script("b")
    content += path("s g a") + flow("g", "b", "x > 5")
    assert play(content, {"x": 3}).run().log == "s g a =completed"


@pytest.mark.parametrize("condition", ["${x}", "=x"])
@pytest.mark.parametrize(("value", "end"), [("false", "a"), ("true", "b"), ("", "a"), (None, "a"), (0, "a"), (2, "b")])
def test_a_condition_takes_a_value_as_it_says(play: Play, condition: str, value: Any, end: str) -> None:
    content = start() + gateway("exclusive", "g", default="g_a") + script("a") + script("b")
    content += path("s g a") + flow("g", "b", condition)
    assert play(content, {"x": value}).run().log == f"s g {end} =completed"


@pytest.mark.parametrize("condition", ["${x}", "=x"])
@pytest.mark.parametrize("value", ["weed", [1], {"data": False}])
def test_what_is_neither_true_nor_false_is_an_error_that_shows_it(play: Play, condition: str, value: Any) -> None:
    content = start() + gateway("exclusive", "g", default="g_a") + script("a") + script("b")
    run = play(content + path("s g a") + flow("g", "b", condition), {"x": value}).run()
    assert run.log == "s (g g!script =failed"
    assert f"the condition: expected true or false, got {value!r}" in str(run.instance.error)


def test_an_exclusive_gateway_without_a_true_condition_is_an_error(play: Play) -> None:
    content = start() + gateway("exclusive", "g") + script("a") + path("s g") + flow("g", "a", "False")
    run = play(content).run()
    assert run.log == "s (g g!no_flow =failed"
    assert "no condition is true" in str(run.instance.error)


def test_that_error_can_be_caught(play: Play) -> None:
    inner = start("t") + gateway("exclusive", "g") + script("a") + path("t g") + flow("g", "a", "False")
    content = start() + sub("p", inner) + boundary("b", "p", error("no_flow")) + script("c") + path("s p") + path("b c")
    assert play(content).run().log == "s (p t (g g!no_flow b -p c =completed"


def test_an_exclusive_gateway_merges_without_waiting(play: Play) -> None:
    content = start() + gateway("parallel", "g") + gateway("exclusive", "m") + script("a")
    assert play(content + path("s g m a") + "<task id='n'/>" + path("g n m")).run().visits["a"] == 2


def test_an_inclusive_gateway_takes_every_true_flow(play: Play) -> None:
    content = start() + gateway("inclusive", "g") + script("a") + script("b") + script("c")
    content += path("s g") + flow("g", "a", "x > 0") + flow("g", "b", "x > 5") + flow("g", "c", "x > 1")
    assert play(content, {"x": 3}).run().log == "s g a c =completed"


def test_an_inclusive_gateway_takes_its_default_flow_alone(play: Play) -> None:
    content = start() + gateway("inclusive", "g", default="g_a") + script("a") + script("b")
    content += path("s g a") + flow("g", "b", "x > 5")
    assert play(content, {"x": 3}).run().log == "s g a =completed"
    assert play(content, {"x": 7}).run().log == "s g b =completed"


def test_an_inclusive_gateway_without_a_true_condition_is_an_error(play: Play) -> None:
    content = start() + gateway("inclusive", "g") + script("a") + script("b")
    content += path("s g") + flow("g", "a", "False") + flow("g", "b", "False")
    assert play(content).run().log == "s (g g!no_flow =failed"


def test_conditions_stand_on_flows_of_activities_too(play: Play) -> None:
    content = start() + script("t", "x = 3") + script("a") + script("b")
    run = play(content + path("s t") + flow("t", "a", "x > 1") + flow("t", "b", "x > 5")).run()
    assert run.log == "s t a =completed"


def test_an_activity_without_a_true_flow_is_an_error_that_its_boundary_catches(play: Play) -> None:
    content = start() + script("t") + script("a") + boundary("b", "t", error()) + script("c")
    run = play(content + path("s t") + flow("t", "a", "False") + path("b c")).run()
    assert run.log == "s t t!no_flow b c =completed"


# ---- inclusive joins (standard 13.4.3) ---------------------------------------------------------------------------

INCLUSIVE = (
    start() + gateway("inclusive", "g") + user("a") + user("b") + user("c") + gateway("inclusive", "j") + end()
    + path("s g") + flow("g", "a", "1 in x") + flow("g", "b", "2 in x") + flow("g", "c", "3 in x")
    + path("a j e") + path("b j") + path("c j")
)  # fmt: skip


@pytest.mark.parametrize("chosen", ["a", "b", "ab", "bc", "abc"])
def test_an_inclusive_join_waits_for_the_tokens_that_can_reach_it(play: Play, chosen: str) -> None:
    run = play(INCLUSIVE, {"x": ["_abc".index(id) for id in chosen]}).run()
    for id in chosen:
        assert "j" not in run.visits
        run.complete(id)
    assert run.visits["j"] == 1
    assert run.status == "completed"


def test_an_inclusive_join_does_not_wait_for_a_token_that_cannot_reach_it(play: Play) -> None:
    content = start() + gateway("parallel", "g") + script("a") + script("b") + user("u") + end("f")
    content += gateway("inclusive", "j") + script("k") + path("s g a j k") + path("g b j") + path("g u f")
    run = play(content).run()
    assert run.log == "s g a b (u j k"
    assert run.complete("u").log.endswith("u) f =completed")


def test_an_inclusive_join_is_decided_when_nothing_else_can_move(play: Play) -> None:
    """A token that is still on its way is waited for, however long its way."""
    content = start() + gateway("parallel", "g") + script("a") + "".join(script(f"b{n}") for n in range(5))
    content += gateway("inclusive", "j") + end() + path("s g a j e") + path("g b0 b1 b2 b3 b4 j")
    run = play(content).run()
    assert run.log == "s g a b0 b1 b2 b3 b4 j e =completed"


def test_an_inclusive_join_waits_for_a_token_inside_a_sub_process(play: Play) -> None:
    content = start() + gateway("parallel", "g") + script("a") + sub("p", user("u")) + gateway("inclusive", "j")
    run = play(content + script("k") + path("s g a j k") + path("g p j")).run()
    assert run.log == "s g a (p (u"
    assert run.complete("u").log == "s g a (p u p) j k =completed"


def test_an_inclusive_join_waits_for_what_a_boundary_event_may_send(play: Play) -> None:
    content = start() + gateway("parallel", "g") + script("a") + user("u") + boundary("t", "u", timer("PT5S"))
    content += gateway("inclusive", "j") + script("k") + end("f") + path("s g a j k") + path("g u f") + path("t j")
    run = play(content).run(1)
    assert run.log == "s g a (u"
    assert run.run(6).log == "s g a (u t -u j k =completed"


def test_a_loop_back_before_an_inclusive_join_passes_it_each_time(play: Play) -> None:
    """A token that reaches a filled flow as well as an empty one is not waited for."""
    content = start() + gateway("inclusive", "m") + script("t", "x = x + 1") + gateway("exclusive", "g") + end()
    content += path("s m t g") + flow("g", "m", "x < 3") + flow("g", "e", "x >= 3")
    assert play(content, {"x": 0}).run().log == "s m t g m t g m t g e =completed"


def test_an_inclusive_join_that_lost_its_token_to_a_boundary_event_goes_on(play: Play) -> None:
    content = start() + gateway("parallel", "g") + script("a") + user("u") + boundary("t", "u", signal("A"))
    content += gateway("inclusive", "j") + script("k") + end("f") + path("s g a j k") + path("g u j") + path("t f")
    assert play(content).run().signal("A").log == "s g a (u t -u f j k =completed"


def test_an_inclusive_join_waits_for_a_token_that_reaches_it_by_a_link(play: Play) -> None:
    content = start() + gateway("parallel", "g") + script("a") + user("u") + throw("t", link("l"))
    content += (
        catch("c", link("l"))
        + gateway("inclusive", "j")
        + script("k")
        + path("s g a j k")
        + path("g u t")
        + path("c j")
    )
    assert play(content).run().complete("u").log == "s g a u t c j k =completed"


@pytest.mark.parametrize("observer", [None, lambda event: None])
def test_an_inclusive_join_waits_for_the_script_that_leaves_before_a_token_comes(observer: Any) -> None:
    slow = script("w", "try:\n    await sleep(9)\nfinally:\n    await sleep(1)")
    content = start() + gateway("parallel", "g") + script("a") + slow + boundary("b", "w", signal("A"))
    content += gateway("inclusive", "j") + end("f") + path("s g a j") + path("g w f") + path("b j")
    simulation = fame.Simulation(model(content), "P", observer=observer)
    simulation.run(1)
    simulation.signal("A")
    simulation.run()
    assert simulation.instances[0].visits["j"] == 1
