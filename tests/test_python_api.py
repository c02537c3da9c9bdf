"""What is handed to FAME in Python and is not what it has to be is an error that names the argument."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

import fame
from fame.bpmn.library import Library
from fame.check import check
from fame.scenario import Fault

ROOT = Path(__file__).parent.parent
MODEL, SCENARIO = ROOT / "models" / "ground_vehicles.bpmn", ROOT / "examples" / "ground_vehicles.yaml"
FIELD = ROOT / "examples" / "agriculture.yaml"


def dingo(**options) -> fame.Simulation:
    return fame.Simulation(MODEL, process="DINGO", **options)


WRONG = {
    "definitions: expected ..., got 'mission.bpmn'": lambda: fame.write("mission.bpmn"),
    "source: expected ..., got 7": lambda: check(7),
    "library: expected ..., got 'models'": lambda: check(MODEL, library="models"),
    "source: expected ..., got None": lambda: fame.read(None),
    "source: expected ..., got 5": lambda: fame.read(5),
    "source: expected ..., got '<definition": lambda: fame.read("<definitions/>"),
    "process: expected ..., got Process(id=": lambda: fame.Simulation(MODEL, fame.read(MODEL).processes[0]),
    "variables: expected ..., got ['x']": lambda: dingo(variables=["x"]),
    "services: expected ..., got {'grip': 3}": lambda: dingo(services={"grip": 3}),
    "observer: expected ..., got 'run.jsonl'": lambda: dingo(observer="run.jsonl"),
    "robot: expected ..., got 5": lambda: dingo(robot=5),
    "until: expected ..., got '5'": lambda: dingo().run("5"),
    "until: expected ..., got nan": lambda: dingo().run(math.nan),
    "name: expected ..., got None": lambda: dingo().signal(None),
    "values: expected ..., got ['yes']": lambda: dingo().complete("Task", ["yes"]),
    "path: expected ..., got Definitions(": lambda: fame.Scenario.load(fame.read(MODEL)),
    "seed: expected ..., got '7'": lambda: fame.Scenario.load(SCENARIO, seed="7"),
    "duration: expected ..., got '10'": lambda: fame.Scenario.load(SCENARIO, duration="10"),
    "robots: expected ..., got ['Tractor']": lambda: fame.Scenario.load(FIELD, robots=["Tractor"]),
    "robots: expected ..., got {'Tractor': -3}": lambda: fame.Scenario.load(FIELD, robots={"Tractor": -3}),
    "faults: expected ..., got 'REX@3:engine'": lambda: fame.Scenario.load(SCENARIO, faults=["REX@3:engine"]),
}


@pytest.mark.parametrize("said", WRONG)
def test_an_argument_that_is_none_is_named(said: str) -> None:
    with pytest.raises(fame.ConfigError) as caught:
        WRONG[said]()
    name, got = said.split("...")
    assert str(caught.value).startswith(name)
    assert got in str(caught.value)


NOT_THERE = {
    "nope.bpmn: cannot be read": lambda: fame.read("nope.bpmn"),
    "nope.bpmn: cannot be read: ": lambda: fame.Simulation(Path("nope.bpmn")),
    "nope.yaml: cannot be read": lambda: fame.Scenario.load("nope.yaml"),
    "nope: is not a folder": lambda: dingo(library="nope"),
    "has no process or pool 'TURTLE'; it has Process_REX, Process_DINGO": lambda: fame.Simulation(MODEL, "TURTLE"),
    "unknown robot 'TURTLE' in --fault; robots are: REX, DINGO": lambda: fame.Scenario.load(
        SCENARIO, faults=[Fault("TURTLE", 1.0, "engine")]
    ),
}


@pytest.mark.parametrize("said", NOT_THERE)
def test_what_is_not_there_is_named(said: str) -> None:
    with pytest.raises(fame.FameError) as caught:
        NOT_THERE[said]()
    assert said in str(caught.value)


def test_a_model_may_be_given_by_its_path() -> None:
    definitions = fame.read(MODEL)
    assert fame.read(definitions) is definitions
    for given in (definitions, MODEL, str(MODEL)):
        assert fame.Simulation(given, process="DINGO").run().now == 0.0
        assert [part.name for part in fame.split(given)] == ["REX", "DINGO"]


def test_a_model_is_checked_by_its_path() -> None:
    assert check(MODEL) == check(str(MODEL)) == check(fame.read(MODEL))


def test_one_folder_of_behaviours_needs_no_list() -> None:
    folder = ROOT / "models" / "library"
    assert Library(folder).folders == Library(str(folder)).folders == Library([folder]).folders


def test_numbers_of_numpy_are_numbers_and_an_endless_run_is_one_without_bound() -> None:
    numpy = pytest.importorskip("numpy")
    scenario = fame.Scenario.load(SCENARIO, seed=numpy.int64(3), duration=numpy.float32(0.5))
    assert (scenario.seed, scenario.run().simulated) == (3, 0.5)
    assert dingo().run(math.inf).run(numpy.int64(2)).now == 2.0
