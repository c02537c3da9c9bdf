"""What has no end, what is too deep, and what must not grow (docs/semantics.md)."""

import pytest
from conftest import Play
from engine_models import (
    Run,
    boundary,
    call,
    catch,
    condition,
    end,
    error,
    flow,
    gateway,
    handler,
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

LOOP = start() + gateway("exclusive", "m") + script("a") + script("b") + path("s m a b m")


def test_a_loop_without_rest_fails_with_the_ids_of_the_loop(play: Play) -> None:
    run = play(LOOP, moves=1000).run()
    failure = run.instance.error
    assert failure is not None
    assert (run.status, failure.code) == ("failed", "livelock")
    assert {"a", "b", "m"} <= set(str(failure).replace(",", "").split())
    assert " s" not in str(failure).partition("loop over")[2]


def test_the_default_limit_is_a_million_moves(play: Play) -> None:
    assert play(LOOP).node.engine.limit == 1_000_000


def test_a_loop_through_throw_and_catch_is_one_too(play: Play) -> None:
    content = start() + gateway("parallel", "f") + gateway("exclusive", "m") + catch("c", signal("A"))
    content += gateway("exclusive", "n") + throw("t", signal("A")) + path("s f m c m") + path("f n t n")
    failure = play(content, moves=1000).run().instance.error
    assert failure is not None
    assert {"t", "c"} <= set(str(failure).replace(",", "").split())


def test_a_loop_through_a_sub_process_is_one_too(play: Play) -> None:
    content = start() + gateway("exclusive", "m") + sub("p", script("a")) + path("s m p m")
    failure = play(content, moves=1000).run().instance.error
    assert failure is not None
    assert {"m", "p", "a"} <= set(str(failure).replace(",", "").split())


@pytest.mark.long_but("recorded")
def test_an_event_sub_process_that_suspends_again_and_again_is_one_long_before(play: Play) -> None:
    low = handler("h", start("i", condition("low")), script("d"), end("e"), *path("i d e"), resume=True)
    run = play(start() + user("u") + path("s u") + low, {"low": True}).run()
    failure = run.instance.error
    assert failure is not None
    assert (run.status, failure.code) == ("failed", "livelock")
    assert "1000000 moves without waiting (a suspension counts as 100), in a loop over d" in str(failure)
    assert run.visits["d"] < 20_000


@pytest.mark.parametrize("rest", [end("u"), user("u")], ids=["which end", "which stay"])
def test_instances_that_start_each_other_for_ever_are_one_too(play: Play, rest: str) -> None:
    run = play(start("s", signal("go")) + throw("t", signal("go")) + rest + path("s t u"), moves=1000).run()
    run.signal("go")
    (failure,) = [one.error for one in run.simulation.instances if one.error is not None]
    assert "1000 moves without waiting, in a loop of instances that start each other over" in str(failure)
    assert {"s", "t"} <= set(str(failure).replace(",", "").split())
    assert len(run.simulation.instances) < 3000
    run.signal("go")  # and the robot takes further signals


def test_other_instances_go_on(play: Play) -> None:
    content = start("s", signal("go")) + user("u") + path("s u m a m") + gateway("exclusive", "m") + script("a")
    run = play(content, moves=1000).run().signal("go").signal("go").complete("u")
    assert [instance.status for instance in run.simulation.instances] == ["failed", "running"]


def test_a_long_loop_that_rests_now_and_then_is_none(play: Play) -> None:
    content = start() + gateway("exclusive", "m") + catch("c", timer("PT1S")) + script("a") + path("s m c a m")
    run = play(content, moves=100).run(500)
    assert (run.status, run.visits["a"]) == ("running", 500)


def test_calls_deeper_than_a_thousand_fail(play: Play) -> None:
    content = model(process(start() + script("a", "n = n + 1") + call("c", "P") + path("s a c")))
    run = play(content, {"n": 0}).run()
    assert run.status == "failed"
    assert "calls deeper than 1000" in str(run.instance.error)
    assert run.variables["n"] == 1001
    assert not run.left_behind()


def test_calls_less_deep_do_not(play: Play) -> None:
    content = start() + script("a", "n = n + 1") + gateway("exclusive", "g", default="g_e") + call("c", "P") + end()
    content += path("s a g e") + flow("g", "c", "n < 1000")
    run = play(model(process(content)), {"n": 0}).run()
    assert (run.status, run.variables["n"], run.visits["c"]) == ("completed", 1000, 999)


def test_sub_processes_nest_as_deep_as_they_are_drawn() -> None:
    inner = script("a")
    for level in range(60):
        inner = sub(f"p{level}", inner)
    assert Run(inner).run().visits["p59"] == 1


@pytest.mark.parametrize(
    ("body", "after"),
    [
        (script("a", "i = i + 1"), ""),
        (sub("a", script("k", "i = i + 1")), ""),
        (call("a", "Q"), ""),
        (throw("a", signal("A")) + script("k", "i = i + 1") + path("a k"), "k"),
        (script("a", "i = i + 1") + boundary("b", "a", signal("A")), ""),
    ],
    ids=["script", "sub-process", "call", "throw", "boundary"],
)
def test_a_long_loop_leaves_nothing_in_the_tables_of_the_engine(body: str, after: str) -> None:
    called = process(start("t") + script("z", "i = i + 1") + path("t z"), id="Q")
    content = start() + gateway("exclusive", "m") + body + gateway("exclusive", "g", default="g_u") + user("u")
    content += path("s m a") + path(f"{after or 'a'} g u") + flow("g", "m", "i < 1000")
    run = Run(model(content, called), {"i": 0}).run()
    engine = run.node.engine
    assert run.variables["i"] == 1000
    assert run.left_behind() == {"instances": 1}
    assert len(run.instance.root.children) == 1
    assert engine.counter < 3500


def test_a_loop_of_twenty_thousand_passes_completes() -> None:
    content = start() + gateway("exclusive", "m") + script("a", "i = i + 1") + gateway("exclusive", "g", default="g_e")
    content += end() + path("s m a g e") + flow("g", "m", "i < 20000")
    run = Run(content, {"i": 0}, moves=100_000)
    run.simulation.node.engine.tell = lambda *_: None
    run.run()
    assert run.node.engine.instances == {}
    assert run.left_behind() == {}


MULTI = "<multiInstanceLoopCharacteristics><loopCardinality>3</loopCardinality></multiInstanceLoopCharacteristics>"
TWICE = '<standardLoopCharacteristics loopMaximum="2"/>'


@pytest.mark.parametrize(
    "content",
    [
        start() + gateway("parallel", "g") + call("c", "P") + call("d", "P") + path("s g c") + path("g d"),
        start() + call("c", "P", MULTI) + path("s c"),
        start() + call("c", "P", TWICE) + path("s c"),
        start() + sub("c", MULTI, call("d", "P")) + path("s c"),
        start() + user("c", MULTI.replace("3", "5000")) + path("s c"),
    ],
    ids=["two calls", "parallel instances", "a loop", "inside instances", "many instances"],
)
def test_what_multiplies_without_end_fails(play: Play, monkeypatch: pytest.MonkeyPatch, content: str) -> None:
    monkeypatch.setattr("fame.engine.state.SCOPES", 2000)
    run = play(model(process(content))).run()
    assert run.status == "failed"
    assert "calls" in str(run.instance.error)
    assert not run.left_behind()


def test_a_loop_that_forks_its_tokens_fails(play: Play, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fame.engine.state.TOKENS", 500)
    parts = gateway("exclusive", "m") + gateway("parallel", "g") + gateway("exclusive", "n")
    run = play(start() + parts + path("s m g m") + path("g n m")).run()
    assert (run.status, run.instance.error.code) == ("failed", "livelock")
    assert "more than 500 tokens at a time" in str(run.instance.error)
    assert not run.left_behind()


def test_handlers_that_pile_up_fail(play: Play, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fame.engine.state.SCOPES", 20)
    piling = handler("h", start("t", signal("A"), interrupting=False) + user("k") + path("t k"))
    run = play(start() + user("u") + path("s u") + piling).run()
    for _ in range(19):
        run.signal("A")
    assert (run.status, len(run.waiting)) == ("running", 20)
    assert "more than 20 calls, sub-processes and handlers" in str(run.signal("A").instance.error)
    assert not run.left_behind()


def test_that_error_can_be_caught_like_any_other(play: Play, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fame.engine.state.SCOPES", 20)
    content = start() + user("c", MULTI.replace("3", "50")) + boundary("b", "c", error()) + script("k") + path("s c")
    assert play(content + path("b k")).run().log == "s b k =completed"
