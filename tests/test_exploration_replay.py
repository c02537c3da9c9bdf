"""Every deadlock, lost signal and mission that never completes is reproduced by real engines along its run."""

from __future__ import annotations

import pytest
from collaborations import Steps, generated, philosophers, team

from fame.bpmn.model import Definitions
from fame.check.explore import Exploration, Finding
from fame.check.explore.findings import FAILING
from fame.scenario.exploration import explore
from fame.scenario.replay import Replay, replay


def replayed(model: str | Definitions, finding: Finding, **options: object) -> Replay:
    """Replay the run of a finding."""
    steps = [(step.robot, step.kind, step.element, step.detail) for step in finding.run]
    return replay(model, steps, choices=finding.choices, **options)  # type: ignore[arg-type]


def failing(result: Exploration) -> list[Finding]:
    return [one for one in result.findings if one.kind in FAILING]


@pytest.mark.parametrize("seed", range(60))
def test_generated_collaborations(seed: int) -> None:
    model = team(generated(seed))
    for finding in failing(explore(model, delivery="run", timers="ordered", limit=2_000)):
        outcome = replayed(model, finding)
        assert not outcome.completed, finding.text
        early = {kind for _, kind, _, _ in outcome.skipped}
        assert early <= {"timer"}, "timers that are due together fire together"


def test_philosophers() -> None:
    model = team(philosophers(3, ordered=False))
    (finding,) = failing(explore(model, delivery="run"))
    assert set(replayed(model, finding).waiting) == {f"{who}{n}" for who in ("Phil", "Fork") for n in range(3)}


def test_a_mended_mission_completes_along_the_same_run() -> None:
    broken: dict[str, Steps] = {"A": ["throw go", "catch done"], "B": ["work", "catch go", "throw done"]}
    (finding,) = failing(explore(team(broken), delivery="run"))
    assert not replayed(team(broken), finding).completed
    mended = {**broken, "B": ["work", "queue go", "throw done"]}
    assert replayed(team(mended), finding).completed
