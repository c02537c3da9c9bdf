"""Complex gateways (standard 13.4.5)."""

from __future__ import annotations

import pytest
from conftest import Play
from engine_models import Run, flow, gateway, path, script, start, user

from fame.errors import ModelError


def three(text: str, after: str = "") -> str:
    joined = gateway("complex", "j", f"<activationCondition>{text}</activationCondition>")
    content = start() + gateway("parallel", "g") + joined + script("k") + path("s g") + path("j k")
    return content + "".join(user(id) + path(f"g {id} j") for id in "abc")


def test_it_passes_when_its_activation_condition_is_true(play: Play) -> None:
    run = play(three("activationCount >= 2")).run().complete("a")
    assert "j" not in run.visits
    assert run.complete("c").log.endswith("c) j k")


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


def test_its_condition_may_name_variables(play: Play) -> None:
    assert play(three("activationCount == n"), {"n": 3}).run().complete("a").complete("b").visits.get("j") is None


def test_its_outgoing_flows_are_taken_by_their_conditions(play: Play) -> None:
    content = start() + gateway("complex", "g") + script("a") + script("b") + script("c") + path("s g")
    content += flow("g", "a", "x > 0") + flow("g", "b", "x > 5") + flow("g", "c", "x > 1")
    assert play(content, {"x": 3}).run().log == "s g a c =completed"


def test_one_that_joins_needs_a_condition() -> None:
    with pytest.raises(ModelError, match="activation condition"):
        Run(start() + gateway("complex", "j") + path("s j") + flow("s", "j").replace("s_j", "again"))
