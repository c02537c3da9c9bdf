"""Call activities and sub-processes (standard 13.3.4; docs/semantics.md)."""

import pytest
from conftest import Play
from engine_models import (
    boundary,
    call,
    end,
    error,
    extensions,
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
    user,
)

from fame.errors import ModelError


def called(text: str, *content: str) -> str:
    return process(start("t") + script("k", text) + path("t k") + "".join(content), id="Q")


def calling(said: str = "") -> str:
    return start() + call("c", "Q", extensions(said) if said else "") + end() + path("s c e")


def test_a_call_runs_the_process_that_it_names(play: Play) -> None:
    assert play(model(calling(), called("pass"))).run().log == "s (c t k c) e =completed"


def test_without_mappings_it_shares_the_variables_of_its_caller(play: Play) -> None:
    assert play(model(calling(), called("x = x + 1\ny = 2")), {"x": 1}).run().variables == {"x": 2, "y": 2}


def test_with_mappings_it_has_variables_of_its_own(play: Play) -> None:
    said = '<camunda:in source="x" target="a"/><camunda:out source="b" target="y"/>'
    assert play(model(calling(said), called("b = a + 1\nx = 9")), {"x": 1}).run().variables == {"x": 1, "y": 2}


def test_all_variables_may_go_in_and_out(play: Play) -> None:
    said = '<camunda:in variables="all"/>'
    assert play(model(calling(said), called("x = x + 1")), {"x": 1}).run().variables == {"x": 1}
    said += '<camunda:out variables="all"/>'
    assert play(model(calling(said), called("x = x + 1\nz = 3")), {"x": 1}).run().variables == {"x": 2, "z": 3}


def test_what_goes_in_may_be_an_expression(play: Play) -> None:
    said = '<camunda:in sourceExpression="${x * 2}" target="a"/><camunda:out sourceExpression="${a + 1}" target="y"/>'
    assert play(model(calling(said), called("pass")), {"x": 4}).run().variables == {"x": 4, "y": 9}


def test_a_mapping_that_fails_is_an_error_of_the_call(play: Play) -> None:
    said = '<camunda:in sourceExpression="${1 / x}" target="a"/>'
    content = calling(said) + boundary("b", "c", error())
    assert play(model(content, called("pass")), {"x": 0}).run().log == "s (c c!script b =completed"
    said = '<camunda:in source="x" target="x"/><camunda:out sourceExpression="${1 / x}" target="a"/>'
    run = play(model(calling(said) + boundary("b", "c", error()), called("pass")), {"x": 0}).run()
    assert run.log == "s (c t k c!script b =completed"


def test_a_process_may_call_itself(play: Play) -> None:
    content = start() + script("a", "n = n - 1") + gateway("exclusive", "g", default="g_e") + call("c", "P") + end()
    content += path("s a g e") + flow("g", "c", "n > 0")
    run = play(model(process(content)), {"n": 5}).run()
    assert (run.status, run.visits["a"], run.visits["c"]) == ("completed", 5, 4)


def test_two_calls_of_one_process_run_beside_each_other(play: Play) -> None:
    content = start() + call("c", "Q") + call("d", "Q") + path("s c") + path("s d")
    other = process(start("t") + user("u") + path("t u"), id="Q")
    run = play(model(content, other)).run()
    assert run.waiting == ["u", "u"]
    assert run.complete("u").log == "s (c (d t (u t u c)"


def test_a_signal_start_event_of_a_called_process_is_no_way_in(play: Play) -> None:
    with pytest.raises(ModelError, match="none start event"):
        play(model(calling(), process(start("t", signal("A")), id="Q")))


def test_a_call_that_leads_nowhere_is_refused(play: Play) -> None:
    with pytest.raises(ModelError, match="'Nowhere'"):
        play(start() + call("c", "Nowhere") + path("s c"))


def test_a_sub_process_without_start_event_begins_with_what_has_no_incoming_flow(play: Play) -> None:
    assert play(sub("p", script("a") + script("b") + script("c") + path("a c"))).run().log == "(p a c b p) =completed"


def test_an_empty_sub_process_ends_at_once(play: Play) -> None:
    handling = handler("h", start("t", signal("A")) + user("v") + path("t v"))
    for content in ("", handling):
        run = play(start() + sub("p", content) + end() + path("s p e")).run()
        assert run.log == "s p e =completed"
        assert not run.left_behind()


def test_a_sub_process_ends_with_its_last_token(play: Play) -> None:
    run = play(sub("p", user("u") + user("v")) + script("x") + path("p x")).run().complete("u")
    assert "p" not in run.visits
    assert run.complete("v").log == "(p (u (v u) v) p) x =completed"


def test_a_sub_process_shares_the_variables_around_it(play: Play) -> None:
    assert play(sub("p", script("a", "x = x + 1\ny = 1")), {"x": 1}).run().variables == {"x": 2, "y": 1}


def test_a_sub_process_with_a_mapping_sees_through_to_those_around_it(play: Play) -> None:
    said = extensions(
        '<camunda:inputOutput><camunda:inputParameter name="n">${x}</camunda:inputParameter></camunda:inputOutput>'
    )
    assert play(sub("p", said, script("a", "n = n + 1\nx = n\nz = 1")), {"x": 1}).run().variables == {"x": 2}


@pytest.mark.parametrize("depth", [1, 10, 100])
def test_calls_nest(play: Play, depth: int) -> None:
    levels = [
        process(start(f"s{n}") + call(f"c{n}", f"Q{n + 1}") + path(f"s{n} c{n}"), id=f"Q{n}") for n in range(depth)
    ]
    last = process(script("a", "x = 1"), id=f"Q{depth}")
    run = play(model(start() + call("c", "Q0") + path("s c"), *levels, last)).run()
    assert (run.status, run.variables) == ("completed", {"x": 1})
