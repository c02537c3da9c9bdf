"""The reduced search finds what the full search finds, on collaborations made at random."""

from __future__ import annotations

import pytest
from collaborations import generated, team

from fame.check.explore import Exploration
from fame.scenario.exploration import explore

_LIMIT = 1_500
_SEEDS = 240
_PARTS = 12


def verdicts(result: Exploration) -> set[tuple[str, tuple[str, ...]]]:
    """What was found, without the way to it. Which signal was lost on the way to a deadlock depends on the way."""
    kinds = {"lost": "deadlock"}
    checked = ("deadlock", "lost", "never", "dropped", "unreachable", "error")
    return {
        (kinds.get(one.kind, one.kind), tuple(sorted(place.element for place in one.places)))
        for one in result.findings
        if one.kind in checked
    }


@pytest.mark.parametrize("part", range(_PARTS))
def test_reduced_and_full_search_agree(part: int) -> None:
    compared = smaller = 0
    for seed in range(part, _SEEDS, _PARTS):
        model = team(generated(seed), several=("R0",) if seed % 3 == 0 else ())
        delivery = ("run", "fast", "any")[seed // 3 % 3]
        full = explore(model, delivery=delivery, reduced=False, limit=_LIMIT)
        if full.exhaustive:
            reduced = explore(model, delivery=delivery, limit=_LIMIT)
            assert verdicts(reduced) == verdicts(full), f"seed {seed}, delivery {delivery}"
            assert reduced.states <= full.states
            compared += 1
            smaller += reduced.states < full.states
    assert compared >= _SEEDS // _PARTS // 2
    assert smaller
