"""Local states become engines again, and a step that is known from another state goes as an engine takes it."""

from pathlib import Path
from typing import Any

import pytest
from collaborations import generated, team

from fame.bpmn.model import Definitions
from fame.check.explore import Request
from fame.check.explore.deliveries import SearchBudget, search
from fame.check.explore.footprints import Effect, Footprints, Watched
from fame.check.explore.local import Local
from fame.check.explore.team import Team
from fame.scenario.explore.exploration import cast_of

MODELS = Path(__file__).parent.parent / "models"
MISSIONS = ("ground_vehicles", "agriculture", "agriculture_resilient", "convoy", "shuttle", "reassembly", "sabotage",
            "warehouse")  # fmt: skip


def explored(model: str | Path | Definitions, delivery: str = "any", limit: int = 2_000) -> list[Local]:
    """The robots of a model, with the local states that a search has found."""
    found = Team(*cast_of(model, {}, ()), Request())
    search(found, delivery, SearchBudget(limit, lambda: False))  # type: ignore[arg-type]
    return list(dict.fromkeys(found.locals))


@pytest.mark.long_but("convoy", "reassembly", "shuttle", "sabotage")
@pytest.mark.parametrize("mission", MISSIONS)
def test_states_of_the_missions_come_back(mission: str) -> None:
    for local in explored(MODELS / f"{mission}.bpmn"):
        for state in range(len(local)):
            assert local.states.number(local.revived(state)) == state


@pytest.mark.long_but("0")
@pytest.mark.parametrize("part", range(5))
def test_states_of_generated_collaborations_come_back(part: int) -> None:
    count = 0
    for seed in range(part, 40, 5):
        for local in explored(team(generated(seed)), limit=500):
            for state in range(len(local)):
                assert local.states.number(local.revived(state)) == state, f"seed {seed}"
                count += 1
    assert count > 50


def test_a_token_that_waits_for_another_one_at_a_join_is_told_with_the_element() -> None:
    (robot,) = explored(team({"A": [("and", ["work"], ["catch go"])]}))
    join = next(node.id for node in robot.process.body.walk() if node.id.startswith("A_join"))
    assert [join in dict(view.waiting) for view in robot.views] == [False, True, True, False]


def test_a_message_that_nothing_listens_to_has_the_outcome_that_the_engine_gives() -> None:
    """It needs no engine; the engine would drop it."""
    unheard = 0
    for local in explored(MODELS / "agriculture_resilient.bpmn", "run"):
        for state, view in enumerate(local.views):
            for topic in local.topics - view.listens:
                stimulus = ("hear", topic, local.host.blank(topic))
                assert local.step(state, stimulus) == local.step_by_engine(state, stimulus)
                unheard += 1
    assert unheard > 100


@pytest.mark.long_but("convoy", "reassembly", "shuttle", "sabotage")
@pytest.mark.parametrize("mission", MISSIONS)
def test_a_step_goes_by_its_footprint_as_by_an_engine(mission: str) -> None:
    for local in explored(MODELS / f"{mission}.bpmn"):
        for state, view in enumerate(local.views[:200]):
            for stimulus in view.own:
                assert local.step(state, stimulus) == local.step_by_engine(state, stimulus), f"{state} {stimulus}"
            for topic in view.listens & local.topics:
                stimulus = ("hear", topic, local.host.blank(topic))
                assert local.step(state, stimulus) == local.step_by_engine(state, stimulus), f"{state} {stimulus}"


@pytest.mark.long
def test_values_of_variables_make_no_control_states() -> None:
    drone = explored(MODELS / "agriculture_resilient.bpmn", "run", 50_000)[0]
    assert len(drone) > 20 * len(drone.forms.controls)


def test_an_engine_runs_a_step_once_for_each_footprint(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = []
    computed = Local.step_by_engine
    monkeypatch.setattr(
        Local, "step_by_engine", lambda self, *arguments: runs.append(self) or computed(self, *arguments)
    )
    robots = explored(MODELS / "agriculture_resilient.bpmn", "run", 50_000)
    assert 5 * len(runs) < sum(local.steps for local in robots)


def watched(**values: Any) -> Watched:
    return Watched(values)


def test_variables_note_what_is_read_and_written() -> None:
    variables = watched(x=1, y=2, z=[3])
    exec("z.append(x)\nw = 1\nif 'q' in z: y = 3", variables)
    assert {"x", "z"} <= variables.reads
    assert not {"y", "w"} & variables.reads
    assert variables.writes == {"w"}
    assert not variables.whole


def test_a_variable_that_is_looked_for_counts_as_read() -> None:
    variables = watched()
    assert variables.get("x") is None
    assert "y" not in variables
    with pytest.raises(KeyError):
        del variables["z"]
    assert variables.reads == {"x", "y", "z"}


@pytest.mark.parametrize("use", [list, len, dict, dict.copy, "{**v}", "v | {}", "v == {}", "v.pop('x')", "v.items()"])
def test_variables_that_are_listed_have_no_footprint(use: Any) -> None:
    variables = watched(x=1)
    if isinstance(use, str):
        eval(use, {"v": variables})
    else:
        use(variables)
    assert variables.whole


def test_an_effect_holds_for_what_was_not_read() -> None:
    steps = Footprints(lambda content, names: tuple([CONTENTS[content].get(name) for name in names]))
    effect = Effect(1, (), (("y", 7),), (), (), True, ())
    steps.add("step", 0, {"x", "__builtins__"}, [effect])
    assert steps.find("step", 1) == (effect,)
    assert steps.find("step", 2) is None
    assert steps.find("other", 0) is None


CONTENTS: list[dict[str, int]] = [{"x": 1, "y": 2}, {"x": 1, "y": 3}, {"x": 2, "y": 2}]
