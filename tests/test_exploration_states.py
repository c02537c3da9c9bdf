"""A state of a robot that was explored becomes an engine again, and that engine is in this state."""

from __future__ import annotations

from pathlib import Path

import pytest
from collaborations import generated, team

from fame.bpmn.model import Definitions
from fame.check.explore import Request
from fame.check.explore.exploration import Team
from fame.check.explore.local import Local
from fame.scenario.exploration import cast_of

MODELS = Path(__file__).parent.parent / "models"
MISSIONS = ("ground_vehicles", "agriculture", "agriculture_resilient", "convoy", "shuttle", "reassembly", "sabotage")


def explored(model: str | Path | Definitions, delivery: str = "any", limit: int = 2_000) -> list[Local]:
    """The robots of a model, with the local states that a search has found."""
    found = Team(*cast_of(model, {}, ()), Request())
    found.search(delivery, limit, lambda: False)  # type: ignore[arg-type]
    return list(dict.fromkeys(found.locals))


@pytest.mark.parametrize("mission", MISSIONS)
def test_states_of_the_missions_come_back(mission: str) -> None:
    for local in explored(MODELS / f"{mission}.bpmn"):
        for state in range(len(local)):
            assert local.number(local.revived(state)) == state


def test_states_of_generated_collaborations_come_back() -> None:
    count = 0
    for seed in range(40):
        for local in explored(team(generated(seed)), limit=500):
            for state in range(len(local)):
                assert local.number(local.revived(state)) == state, f"seed {seed}"
                count += 1
    assert count > 500


def test_a_message_that_nothing_listens_to_has_the_outcome_that_the_engine_gives() -> None:
    """It needs no engine; the engine would drop it."""
    unheard = 0
    for local in explored(MODELS / "agriculture_resilient.bpmn", "run"):
        for state, view in enumerate(local.views):
            for topic in local.topics - view.listens:
                stimulus = ("hear", topic, local.host.blank(topic))
                assert local.step(state, stimulus) == local.computed(state, stimulus)
                unheard += 1
    assert unheard > 100


def test_values_of_variables_make_no_control_states() -> None:
    drone = explored(MODELS / "agriculture_resilient.bpmn", "run", 50_000)[0]
    assert len(drone) > 20 * len(drone.forms.controls)
