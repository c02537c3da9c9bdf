"""The properties of shipped missions: each example has three, they hold, and a mutated model breaks each of them."""

import re
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path

import pytest

from fame.properties.files import beside
from fame.scenario import Scenario
from fame.scenario.plan import read_scenario

ROOT = Path(__file__).parent.parent
EXAMPLES, LIBRARY = ROOT / "examples", ROOT / "models" / "library"
SCENARIOS = sorted(
    path.stem for path in EXAMPLES.glob("*.yaml") if "\nmodel:" in "\n" + path.read_text(encoding="utf-8")
)
COOKBOOK = {"battery": 1, "compensation": 1, "exclusive_zone": 2, "handover": 2}
"""Missions of the cookbook that have properties, and how many."""
MISSIONS = (*SCENARIOS, *COOKBOOK)


def mission(name: str) -> Path:
    """The scenario, or the model where there is no scenario."""
    if name in SCENARIOS:
        return EXAMPLES / f"{name}.yaml"
    path = EXAMPLES / "cookbook" / name / "mission.yaml"
    return path if path.is_file() else path.with_suffix(".bpmn")


def test_each_example_has_three_properties() -> None:
    assert {name: len(read_scenario(mission(name)).properties) for name in SCENARIOS} == dict.fromkeys(SCENARIOS, 3)


RUN_ELSEWHERE = {"agriculture", "agriculture_resilient", "convoy", "delivery", "ground_vehicles", "reassembly",
                 "sabotage", "shuttle", "warehouse"}  # fmt: skip
"""Missions that tests of their own run and judge: test_scenario, test_small_missions, others by their name."""


@pytest.mark.long_but("[!b]*")
@pytest.mark.parametrize("name", [name for name in MISSIONS if name not in RUN_ELSEWHERE])
def test_they_hold(name: str) -> None:
    assert [each.verdict for each in Scenario.load(mission(name)).run().judgements] == ["holds"] * COOKBOOK.get(name, 3)


SKIPS_LOADING = {"Flow_Begin_Load": "Activity_Deliver"}
HOME_AGAIN = {"Flow_Home_UndoAll": "Activity_Home"}
ANYBODY_GOES = {"${closest_tractor == tractor_name}": "${closest_tractor != ''}"}
TWO_IN_THE_ZONE = {'name="instances" value="1"': 'name="instances" value="2"'}
MUTATIONS: Mapping[str, tuple[float, Mapping[str, str]]] = {
    "agriculture answer": (30, {"PT10S": "PT15S"}),
    "agriculture cut": (130, {"Flow_GoTo_CutGrass": "Event_Cutting"}),
    "agriculture apart": (60, ANYBODY_GOES),
    "agriculture_resilient assigned": (30, ANYBODY_GOES),
    "agriculture_resilient explored_first": (30, {"Flow_TakeOff_Explore": "Gateway_SeeToTheRest"}),
    "agriculture_resilient apart": (45, ANYBODY_GOES),
    "convoy lined_up": (60, {"Flow_TakeLane_ToLine": "Activity_Go"}),
    "convoy patience": (60, {"Flow_SetOff_Go": "Event_There"}),
    "convoy apart": (10, {'float(me.rpartition("_")[2])': "3.0"}),
    "courier loaded": (5, SKIPS_LOADING),
    "courier unloaded": (90, HOME_AGAIN),
    "courier once": (40, HOME_AGAIN),
    "delivery loaded": (5, SKIPS_LOADING),
    "delivery unloaded": (90, HOME_AGAIN),
    "delivery once": (40, HOME_AGAIN),
    "ground_vehicles found_first": (
        5,
        {
            "Flow_TargetFound_GoTo": "Activity_Fire",
            '<bpmn:signalEventDefinition id="SignalEventDefinition_TargetFound" signalRef="Signal_target_found" />': "",
        },
    ),
    "ground_vehicles answer": (300, {"Flow_TargetFound_GoTo": "Activity_Fire"}),
    "ground_vehicles apart": (90, {"Flow_MapThrown_GoBack": "Event_Explore_TargetFound"}),  # REX stays at the target
    "reassembly planned": (1, {"Flow_Re_Begin_Plan": "Gateway_Re_Next"}),
    "reassembly over": (30, {"Flow_Re_MonitorOver_MonitorShut": "Activity_Re_Watch"}),
    "reassembly finish": (30, {"{x: 0.5, y: 0.0, z: 0.18}": "{x: 5.0, y: 0.0, z: 0.18}"}),  # out of reach
    "sabotage watched": (
        1,
        {'<bpmn:signalEventDefinition id="SignalEventDefinition_WatchingHeard" signalRef="Signal_watching" />': ""},
    ),
    "sabotage reported": (1, {"Flow_Sabotage_Begin_Next": "Activity_Sabotage_Report"}),
    "sabotage over": (20, {'name="parts_wanted" value="40"': 'name="parts_wanted" value="1"'}),  # it still collects
    "shuttle charge": (150, {"Flow_Low_ToCharger": "Event_Charged"}),
    "shuttle recharge": (165, {"Flow_Charged_GoesOn": "Activity_ToCharger"}),
    "shuttle finish": (292, {"Flow_Enough_Carried": "Gateway_NextTrip"}),
    "warehouse awarded": (1, {"Flow_ThrowBid_Award": "Event_ThrowAccepted"}),
    "warehouse unloaded": (300, {"Flow_ToStation_Unload": "Event_Delivered"}),
    "warehouse charge": (80, {"percentage &lt; 0.3": "percentage &lt; 0.03"}),
    "battery never_empty": (30, {"charge &lt; 0.2": "charge &lt; 0.02"}),
    "compensation part_first": (30, {'attachedToRef="Activity_Load"': 'attachedToRef="Activity_Transport"'}),
    "exclusive_zone alone_1": (30, TWO_IN_THE_ZONE),
    "exclusive_zone alone_2": (30, {**TWO_IN_THE_ZONE, "sleep(2)": "sleep(3 if robot.name == 'Car_1' else 2)"}),
    "handover never_dropped": (30, {"Flow_OfferedThrown_Answer": "Activity_OpenGripper"}),
    "handover never_torn": (30, {"Flow_GrippedThrown_ReleasedCaught": "Activity_CarryAway"}),
}
"""By mission and property: simulated seconds in which it breaks, and what stands in the model, or in a file that it
calls, instead of a text; a sequence flow leads elsewhere."""

SLOW = {case for case, (seconds, _) in MUTATIONS.items() if seconds > 20 and case.split()[0] not in COOKBOOK}


def mutated(files: Iterable[Path], changes: Mapping[str, str], folder: Path) -> None:
    """Write models to a folder, with changes: each in the first file that has the text, where it is once."""
    texts = {path.name: path.read_text(encoding="utf-8") for path in files}
    for old, new in changes.items():
        flow = old.startswith("Flow_")
        pattern, text = (rf'(id="{old}".*?targetRef=")\w+', rf"\g<1>{new}") if flow else (re.escape(old), new)
        name = next(name for name, text in texts.items() if re.search(pattern, text))
        texts[name], count = re.subn(pattern, text, texts[name])
        assert count == 1, old
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")


@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=[pytest.mark.long] if case in SLOW else []) for case in MUTATIONS]
)
def test_a_mutated_model_breaks_each(case: str, tmp_path: Path) -> None:
    name, broken = case.split()
    seconds, changes = MUTATIONS[case]
    path = mission(name)
    source = path if path.suffix == ".bpmn" else read_scenario(path).model
    for file in (*source.parent.glob("*.properties.yaml"), *source.parent.glob("*.skops")):
        shutil.copy(file, tmp_path)
    mutated([source, *source.parent.glob("*.bpmn"), *LIBRARY.glob("*.bpmn")], changes, tmp_path)
    model = tmp_path / source.name
    if path == source:
        scenario = Scenario.load(model, duration=seconds)
    else:
        scenario = Scenario.load(path, changes={"model": str(model), "duration": seconds})
    assert broken in [each.name for each in scenario.run().judgements if each.verdict == "violated"]


def test_each_property_has_a_mutation() -> None:
    paths = {name: mission(name) for name in MISSIONS}
    properties = {
        name: beside(path) if path.suffix == ".bpmn" else read_scenario(path).properties for name, path in paths.items()
    }
    assert list(MUTATIONS) == [f"{name} {one.name}" for name in MISSIONS for one in properties[name]]
