"""Complex gateways (standard 13.4.5)."""

import pytest
from conftest import Play
from engine_models import Run, boundary, error, flow, gateway, path, script, start, sub, user

from fame.errors import ModelError


def three(text: str, after: str = "") -> str:
    joined = gateway("complex", "j", f"<activationCondition>{text}</activationCondition>")
    content = start() + gateway("parallel", "g") + joined + script("k") + path("s g") + path("j k")
    return content + "".join(user(id) + path(f"g {id} j") for id in "abc")


def test_it_passes_when_its_activation_condition_is_true(play: Play) -> None:
    run = play(three("activationCount >= 2")).run().complete("a")
    assert "j" not in run.visits
    assert run.complete("c").log.endswith("c) j k")


@pytest.mark.parametrize(("condition", "log"), [("n > 0", "s j k =completed"), ("n > 1", "s")])
def test_its_condition_counts_with_one_incoming_flow_too(play: Play, condition: str, log: str) -> None:
    joined = gateway("complex", "j", f"<activationCondition>{condition.replace('>', '&gt;')}</activationCondition>")
    run = play(start() + joined + script("k") + path("s j k"), {"n": 1}).run()
    assert run.log == log
    assert run.waiting == ([] if run.status == "completed" else ["j"])


def test_tokens_that_come_later_are_swallowed(play: Play) -> None:
    run = play(three("activationCount >= 2")).run().complete("a").complete("b").complete("c")
    assert run.visits["j"] == run.visits["k"] == 1
    assert run.status == "completed"
    assert not run.left_behind()


def test_afterwards_it_waits_anew(play: Play) -> None:
    begin = '<startEvent id="s"/>' + gateway("exclusive", "m") + gateway("parallel", "g") + path("s m g")
    joined = gateway("complex", "j", "<activationCondition>activationCount == 1</activationCondition>")
    content = begin + joined + path("j m") + "".join(user(id) + path(f"g {id} j") for id in "ab")
    run = play(content).run()
    for _ in range(3):
        run.complete("a")
        assert sorted(run.waiting) == ["a", "b", "b"]
        run.complete("b")
        assert sorted(run.waiting) == ["a", "b"]
    assert run.visits["j"] == 3


def test_it_does_not_wait_for_tokens_that_cannot_come(play: Play) -> None:
    joined = gateway("complex", "j", "<activationCondition>activationCount &gt;= 1</activationCondition>")
    content = start() + gateway("exclusive", "m") + gateway("inclusive", "g", default="g_a") + joined + path("s m g")
    content += "".join(user(id) + path(f"{id} j") for id in "abc") + flow("g", "a") + flow("g", "b", "n == 0")
    content += flow("g", "c", "n == 1") + script("k", "n = n + 1") + user("u") + path("j k u m")
    run = play(content, {"n": 0}).run().complete("b").complete("u").complete("c").complete("u")
    assert run.waiting == ["a"]
    assert run.complete("a").waiting == ["u"]
    assert run.visits["j"] == 3


def test_a_token_of_the_next_round_waits_for_the_reset(play: Play) -> None:
    merge = gateway("exclusive", "m") + user("x") + path("m x")
    joined = gateway("complex", "j", "<activationCondition>activationCount &gt;= 1</activationCondition>")
    content = start() + gateway("parallel", "g") + merge + user("b") + joined + script("k") + user("y") + path("s g m")
    content += path("x j") + path("g b j k") + path("g y m")
    run = play(content).run().complete("x").complete("y").complete("x")
    assert run.visits["k"] == 1
    assert run.complete("b").visits["k"] == 2
    assert run.status == "completed"
    assert not run.left_behind()


def test_flows_may_be_taken_at_its_reset(play: Play) -> None:
    joined = gateway("complex", "j", "<activationCondition>activationCount &gt;= 2</activationCondition>")
    content = start() + gateway("parallel", "g") + joined + script("x") + script("y") + path("s g")
    content += "".join(user(id) + path(f"g {id} j") for id in "abc")
    content += flow("j", "x", "waitingForStart") + flow("j", "y", "not waitingForStart")
    run = play(content).run().complete("a").complete("b")
    assert run.log.endswith("b) j x")
    assert run.complete("c").log.endswith("c) y =completed")
    run = play(content.replace("gt;= 2", "gt;= 3")).run().complete("a").complete("b").complete("c")
    assert run.log.endswith("c) j x y =completed")


def test_a_flow_at_its_reset_that_fails_is_an_error_of_the_gateway(play: Play) -> None:
    joined = gateway("complex", "j", "<activationCondition>activationCount &gt;= 1</activationCondition>")
    inner = gateway("parallel", "g") + joined + script("x") + "".join(user(id) + path(f"g {id} j") for id in "ab")
    inner += flow("j", "x", "waitingForStart or 1 / 0")
    content = start() + sub("p", inner) + boundary("c", "p", error()) + path("s p")
    assert play(content).run().complete("a").complete("b").log.endswith("x b) j!script c -p =completed")


def test_its_condition_may_name_variables(play: Play) -> None:
    assert play(three("activationCount == n"), {"n": 3}).run().complete("a").complete("b").visits.get("j") is None


def test_its_outgoing_flows_are_taken_by_their_conditions(play: Play) -> None:
    content = start() + gateway("complex", "g") + script("a") + script("b") + script("c") + path("s g")
    content += flow("g", "a", "x > 0") + flow("g", "b", "x > 5") + flow("g", "c", "x > 1")
    assert play(content, {"x": 3}).run().log == "s g a c =completed"


def test_a_condition_that_fails_is_an_error_of_the_gateway(play: Play) -> None:
    content = start() + sub("p", three("1 / 0").replace(start(), "")) + boundary("x", "p", error()) + path("s p")
    content = content.replace(path("s g"), "")
    run = play(content).run().complete("a")
    assert run.log.endswith("a) j!script x -p -b -c =completed")
    assert "j" not in run.visits


def test_one_that_joins_needs_a_condition() -> None:
    with pytest.raises(ModelError, match="activation condition"):
        Run(start() + gateway("complex", "j") + path("s j") + flow("s", "j").replace("s_j", "again"))


def test_an_inclusive_join_that_waits_for_its_reset_goes_on_then(play: Play) -> None:
    """What is swallowed at the reset cannot reach the join any more, and nothing else moves."""
    content = three("activationCount >= 1") + gateway("exclusive", "x") + script("b0") + gateway("inclusive", "i")
    content += path("k x") + flow("x", "e", "True") + "<endEvent id='e'/>" + flow("x", "i", "False") + path("g b0 i")
    run = play(content).run().complete("a").complete("b")
    assert "i" not in run.visits
    assert run.complete("c").log.endswith("c) i =completed")
