"""What `fame check` says of monitors: their configurations, the code of others in these, the variables of services."""

import sys
from pathlib import Path

import pytest
from check_drawing import alone, call, data, given, row, told

from fame.check import check
from fame.clock import Scheduler
from fame.errors import ConfigError
from fame.middleware.local import LocalMiddleware
from fame.monitor.pipeline.configuration import load
from fame.monitor.pipeline.node import ProcessingNode

POWER = """
import sys
from fame.monitor import Parameter
from fame.monitor.pipeline.processor import Processor
from os.path import basename as Renamed

sys.ran = True


class Power:
    outputs = ("power",)
    parameters = (Parameter("gain", "float", 1.0, (0, 10), "", "a factor"), Parameter("mode", "str", "a", ("a", "b")))

    def __init__(self, gain=1.0, *, mode="a"):
        self.gain, self.mode = gain, mode

    def execute(self, inputs):
        return None


class Derived(Processor):
    parameters = (Parameter("gain", "float", 1.0, (0, 10)), Parameter("size", "int", 1, (1, sys.maxsize)))

    def execute(self, inputs):
        return None


class Needs:
    outputs = ("power",)

    def __init__(self, gain):
        self.outputs = (gain,)

    def execute(self, inputs):
        return None


class Nothing:
    pass


def ask():
    return 1


Assigned = type("Assigned", (Power,), {})
"""
PORT = "%s: {Topic: %s, Field: [data], MessageType: std_msgs/msg/Float64}"


def unit(processor: str, *outputs: str) -> str:
    """A configuration with this section `Processor`."""
    ports = ", ".join(PORT % (name, name) for name in outputs or ("power",))
    reads = "" if "Machine" in processor else f"Inputs: {{{PORT % ('In', 'a')}}}\n"
    return f"{reads}Outputs: {{{ports}}}\nProcessor: {processor}\n"


def checked(folder: Path, text: str, called: str = "ProcessingUnit", **variables: str) -> list[str]:
    """What is said of a mission beside this configuration."""
    (folder / "unit.yaml").write_text(text)
    (folder / "power.py").write_text(POWER)
    (folder / "wrong.py").write_text("class Power(:")
    (folder / "more.py").write_text("from power import *")
    (folder / "warned.py").write_text(f"PATTERN = '\\d'\n{POWER}")
    drawn = data("it", **({"configuration": "unit.yaml"} | variables))
    return told(alone(drawn + row(call("call", called, given("call", "it")))))


def run_error(folder: Path) -> str:
    """Why the node of a configuration does not start; empty if it does."""
    scheduler = Scheduler()
    try:
        ProcessingNode(LocalMiddleware(scheduler), scheduler, load(folder / "unit.yaml")).close()
    except ConfigError as error:
        return str(error).removeprefix(f"{folder}/")
    return ""


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "ran", False, raising=False)


REFUSED = {
    "an unknown scheme": unit("{Class: Machine, Parameters: {source: 'ftp://host/file'}}", "value"),
    "no source": unit("{Class: Machine}", "value"),
    "a function that is not there": unit("{Class: Machine, Parameters: {source: 'power.py:aks'}}", "value"),
    "a file of a function that is not there": unit("{Class: Machine, Parameters: {source: 'pwer.py:ask'}}", "value"),
    "a number that nobody asks for": unit(
        "{Class: Machine, Parameters: {source: 'power.py:ask', fields: [sped, load]}}", "speed", "load"
    ),
    "a misspelt parameter of a source": unit("{Class: Machine, Parameters: {sorce: 'tcp://host:1'}}", "value"),
    "a file that is not there": unit("pover.py:Power"),
    "a class that is not there": unit("power.py:Pover"),
    "a class of a module that is not there": unit("fame.errors:Pover"),
    "a class that does not execute": unit("power.py:Nothing"),
    "a function for a class": unit("power.py:ask"),
    "a file that is not Python": unit("wrong.py:Power"),
    "a parameter beyond its limits": unit("{Class: 'power.py:Power', Parameters: {gain: 99}}"),
    "a parameter that is none of the choices": unit("{Class: 'power.py:Power', Parameters: {mode: c}}"),
    "a parameter of another kind": unit("{Class: 'power.py:Power', Parameters: {gain: high}}"),
    "a parameter of a derived class": unit("{Class: 'power.py:Derived', Parameters: {gain: 99}}"),
    "a misspelt parameter": unit("{Class: 'power.py:Power', Parameters: {gian: 9}}"),
    "an output that it does not compute": unit("power.py:Power", "power", "speed"),
    "another one in a sequence": unit("[LowPass, 'power.py:Pover']"),
}


@pytest.mark.parametrize("text", REFUSED.values(), ids=REFUSED)
def test_what_a_node_refuses_is_told_with_file_line_and_key(text: str, tmp_path: Path) -> None:
    (found,) = checked(tmp_path, text)
    assert not sys.ran  # type: ignore[attr-defined]
    assert found == f"call: does not start: {run_error(tmp_path)}"
    assert "unit.yaml:" in found
    assert ": Processor" in found or ": Outputs." in found


def test_modules_and_arguments_that_are_not_there_are_told(tmp_path: Path) -> None:
    for name in ("own_tools:Power", "fame.own_tools:Power"):
        (found,) = checked(tmp_path, unit(name))
        assert f"Processor: Python does not find the module {name[:-6]} here" in found
        assert run_error(tmp_path)
    (found,) = checked(tmp_path, unit("power.py:Needs"))
    assert "Needs cannot be made: TypeError: missing a required argument: 'gain'" in found


FINE = {
    "within limits": unit("{Class: 'power.py:Power', Parameters: {gain: 9, mode: b}}"),
    "a limit that is computed": unit("{Class: 'power.py:Derived', Parameters: {size: 0}}"),
    "a parameter that a base class may have": unit("{Class: 'power.py:Derived', Parameters: {other: 0}}"),
    "outputs that it computes": unit("{Class: 'power.py:Needs', Parameters: {gain: x}}", "x"),
    "a class that is made by a call": unit("power.py:Assigned"),
    "a class that is imported": unit("power.py:Renamed"),
    "a file that imports all of another": unit("more.py:Power"),
    "a file that Python warns of": unit("warned.py:Power"),
    "a function to poll": unit("{Class: Machine, Parameters: {source: 'power.py:ask'}}", "value"),
    "an address": unit("{Class: Machine, Parameters: {source: 'tcp://host:1', fields: [a, b]}}", "b", "a"),
    "a class of FAME by its module": unit("{Class: 'fame.monitor.pipeline.filters:LowPass', Parameters: {cutoff: 5}}"),
}


@pytest.mark.parametrize("text", FINE.values(), ids=FINE)
def test_what_is_right_or_not_known_without_running_it_is_not_told(text: str, tmp_path: Path) -> None:
    assert checked(tmp_path, text) == []
    assert not sys.ran  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("cls", "parameters", "said"),
    [
        ("power.py:Power", "{gain: 99}", "unit.yaml:3: Processor: gain: expected a number from 0 to 10, got 99.0"),
        ("power.py:Power", "{gian: 9}", "gian: no processor has this parameter"),
        ("power.py:Power", "{gain: 9}", ""),
        ("power.py:Derived", "{gian: 9}", ""),
    ],
)
def test_parameters_of_a_mission_are_those_of_code_of_others(
    cls: str, parameters: str, said: str, tmp_path: Path
) -> None:
    found = checked(tmp_path, unit(cls), parameters=parameters)
    assert [said in one for one in found] == ([True] if said else []), found


CHOICES = [
    ("ProcessingUnit", {"blind": "wiat"}, "variable blind: expected one of continue, wait, error, got 'wiat'"),
    ("adm_operate", {"model": "m", "threshold": "1.5"}, "variable threshold: expected a number from 0 to 1, got 1.5"),
    ("adm_operate", {"model": "m", "field": "force"}, "variable field: expected one of position, velocity, effort"),
    ("adm_collect", {"output": "o", "label": "2"}, "variable label: expected 1 (benign) or -1 (anomalous), got 2"),
    ("adm_collect", {"output": "o", "label": "1", "rule": "hom"}, "variable rule: expected one of home, signal, count"),
    ("watch_property", {"property": "p", "sentence": "REX nevr ends"}, "properties.p: expected what REX does"),
]


@pytest.mark.parametrize(("called", "variables", "said"), CHOICES)
def test_variables_with_which_a_service_does_not_start_are_told(
    called: str, variables: dict[str, str], said: str, tmp_path: Path
) -> None:
    found = checked(tmp_path, unit("LowPass"), called, **variables)
    assert [line for line in found if f"call: does not start: {said}" in line], found


def test_the_configuration_of_a_training_is_read(tmp_path: Path) -> None:
    (found,) = checked(tmp_path, "Inputs: 3\n", "Train")
    assert found.startswith("call: does not start: unit.yaml:1: Inputs: ")


def test_files_of_a_library_process_are_those_of_the_mission(tmp_path: Path) -> None:
    library = tmp_path / "library"
    library.mkdir()
    drawn = data("it", configuration="own.yaml") + row(call("call", "ProcessingUnit", given("call", "it")))
    (library / "Watch.bpmn").write_text(alone(drawn).replace('id="P"', 'id="Watch"'))
    (tmp_path / "mission.bpmn").write_text(alone(row(call("watch", "Watch"))))
    for folder, said in (
        (library, f"does not start: there is no configuration own.yaml in {tmp_path}, "),
        (tmp_path, f"does not start: {tmp_path / 'own.yaml'}:1: Inputs: "),
    ):
        (folder / "own.yaml").write_text("Inputs: 3\n")
        (found,) = [one.text for one in check(tmp_path / "mission.bpmn") if one.element == "call"]
        assert found.startswith(said)
