"""The reduced search finds what the full search finds, on collaborations made at random."""

from __future__ import annotations

import pytest
from collaborations import Steps, generated, team, with_lists

from fame.check.explore import Exploration, abstraction as abstracting
from fame.check.explore.liveness import Liveness
from fame.scenario.exploration import explore

_LIMIT = 1_500
_SEEDS = 240
_PARTS = 12


def verdicts(result: Exploration, *without: str) -> set[tuple[str, tuple[str, ...]]]:
    """What was found, without the way to it. Which signal was lost on the way to a deadlock depends on the way.

    A mission that never completes goes on between several states, of which any one may be reported.
    """
    kinds = {"lost": "deadlock"}
    checked = {"deadlock", "lost", "never", "dropped", "unreachable", "error"} - {*without}
    return {
        (kinds.get(one.kind, one.kind), tuple(sorted(place.element for place in one.places if one.kind != "never")))
        for one in result.findings
        if one.kind in checked
    }


@pytest.mark.parametrize("part", range(_PARTS))
def test_reduced_and_full_search_agree(part: int) -> None:
    compared = smaller = 0
    for seed in range(part, _SEEDS, _PARTS):
        model = team(generated(seed), several=("R0",) if seed % 3 == 0 else ())
        delivery = ("run", "fast", "any")[seed // 3 % 3]
        full = explore(model, delivery=delivery, reduced=False, limit=_LIMIT, samples=False)
        if full.exhaustive:
            reduced = explore(model, delivery=delivery, limit=_LIMIT, samples=False)
            assert verdicts(reduced) == verdicts(full), f"seed {seed}, delivery {delivery}"
            assert reduced.states <= full.states
            compared += 1
            smaller += reduced.states < full.states
    assert compared >= _SEEDS // _PARTS // 2
    assert smaller


@pytest.mark.parametrize("part", range(_PARTS))
def test_robots_that_drop_triggers_while_they_run(part: int) -> None:
    """Nobody notices what they do meanwhile, although they listen."""
    compared = smaller = 0
    for seed in range(part, _SEEDS, _PARTS):
        robots = generated(seed, size=2)
        first, *steps = robots["R1"]
        robots["R1"] = ["start a", first, "work", "work", *steps]
        robots["R0"] = ["throw a", "work", *robots["R0"]]
        model = team(robots, several=("R1",) if seed % 3 == 0 else (), single=("R1",))
        delivery = ("run", "fast", "any")[seed // 3 % 3]
        full = explore(model, delivery=delivery, reduced=False, limit=_LIMIT, samples=False)
        if full.exhaustive:
            reduced = explore(model, delivery=delivery, limit=_LIMIT, samples=False)
            assert verdicts(reduced) == verdicts(full), f"seed {seed}, delivery {delivery}"
            compared += 1
            smaller += reduced.states < full.states
    assert compared >= _SEEDS // _PARTS // 3
    assert smaller


def told_apart(robots: dict[str, Steps]) -> dict[str, Steps]:
    """The same robots, of which those of R0 know their names and tell them."""
    return {**robots, "R0": ["run me = robot.name", *robots["R0"]]}


@pytest.mark.parametrize("part", range(_PARTS))
def test_what_decides_nothing_changes_no_verdict(part: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Dead variables, items of counted lists, and statements that decide nothing may as well be kept."""
    models = [(seed, team(told_apart(with_lists(seed)), several=("R0",) if seed % 4 == 0 else ()))
              for seed in range(part, _SEEDS, _PARTS)]  # fmt: skip
    small = {seed: explore(model, delivery="run", limit=_LIMIT, samples=False) for seed, model in models}
    monkeypatch.setattr(Liveness, "dead", lambda self, waiting: (frozenset(), frozenset()))
    monkeypatch.setattr(abstracting, "sliced", lambda script, needed: script)
    monkeypatch.setattr(abstracting, "without_items", lambda script, counted: script)
    monkeypatch.setattr(abstracting, "without_operations", lambda script, unknown: script)
    compared = 0
    for seed, model in models:
        large = explore(model, delivery="run", limit=_LIMIT, samples=False)
        if large.exhaustive:
            assert verdicts(small[seed], "error") == verdicts(large, "error"), f"seed {seed}"
            assert small[seed].states <= large.states
            compared += 1
    assert compared >= _SEEDS // _PARTS // 3


def test_a_value_that_nothing_reads_any_more_makes_no_states() -> None:
    counting: Steps = ["run x = 0", ("loop", ["work", "run x = (x + 1) % 9", ("if", "x == 5", ["work"], [])])]
    short, longer = (explore(team({"A": [*counting, *["work"] * count]})).local["A"] for count in (1, 2))
    assert longer == short + 1  # not one for each value
