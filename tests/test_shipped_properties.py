"""The properties of shipped missions: each has three, they hold, and a mutated model breaks each of them."""

import re
import shutil
from pathlib import Path

import pytest

from fame.properties import Judgement
from fame.scenario import Scenario
from fame.scenario.plan import read_scenario

ROOT = Path(__file__).parent.parent
SCENARIOS = sorted(
    path for path in (ROOT / "examples").glob("*.yaml") if "\nmodel:" in "\n" + path.read_text(encoding="utf-8")
)
SHORT = ("convoy", "delivery", "ground_vehicles", "shuttle")
"""Missions that are run here; the others take longer: ``fame run`` of each example judges them."""


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_each_mission_has_three_properties(path: Path) -> None:
    assert len(read_scenario(path).properties) == 3


def judged(path: Path) -> list[Judgement]:
    return list(Scenario.load(path).run().judgements)


@pytest.mark.parametrize("name", SHORT)
def test_they_hold(name: str) -> None:
    assert [each.verdict for each in judged(ROOT / "examples" / f"{name}.yaml")] == ["holds"] * 3


MUTATIONS = {
    "delivery loaded": {"Flow_Begin_Load": "Activity_Deliver"},
    "delivery unloaded": {"Flow_Home_UndoAll": "Activity_Home"},
    "delivery once": {"Flow_Home_UndoAll": "Activity_Home"},
    "ground_vehicles found_first": {
        "Flow_TargetFound_GoTo": "Activity_Fire", "signal": "SignalEventDefinition_TargetFound"
    },
    "ground_vehicles answer": {"Flow_TargetFound_GoTo": "Activity_Fire"},
    "convoy lined_up": {"Flow_TakeLane_ToLine": "Activity_Go"},
    "convoy patience": {"Flow_SetOff_Go": "Event_There"},
    "shuttle charge": {"Flow_Low_ToCharger": "Event_Charged"},
    "shuttle recharge": {"Flow_Charged_GoesOn": "Activity_ToCharger"},
    "shuttle finish": {"Flow_Enough_Carried": "Gateway_NextTrip"},
}  # fmt: skip
"""By mission and property: sequence flows and where they lead instead; a signal: its event starts by itself."""


@pytest.mark.parametrize("case", MUTATIONS)
def test_a_mutated_model_breaks_each(case: str, tmp_path: Path) -> None:
    name, broken = case.split()
    source = read_scenario(ROOT / "examples" / f"{name}.yaml").model
    for path in source.parent.glob("*.bpmn"):
        shutil.copy(path, tmp_path)
    model = tmp_path / source.name
    text = model.read_text(encoding="utf-8")
    for flow, target in MUTATIONS[case].items():
        pattern = (
            rf'<bpmn:signalEventDefinition id="{target}".*?/>'
            if flow == "signal"
            else rf'(id="{flow}".*?targetRef=")\w+'
        )
        text, count = re.subn(pattern, "" if flow == "signal" else rf"\g<1>{target}", text, count=1)
        assert count == 1
    model.write_text(text, encoding="utf-8")
    scenario = Scenario.load(ROOT / "examples" / f"{name}.yaml", changes={"model": str(model)})
    assert broken in [each.name for each in scenario.run().judgements if each.verdict == "violated"]
