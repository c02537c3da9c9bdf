"""``complete`` of a scenario, ``--complete`` and `Completion`: somebody completes tasks at simulated seconds."""

import json
from pathlib import Path

import pytest
from bpmn_text import process, properties

import fame
from fame.cli import main
from fame.errors import ConfigError
from fame.scenario import Completion, Scenario

MODEL = process(
    """<startEvent id="s"/><userTask id="sign" name="Sign&#10;it"/><manualTask id="load"/>
    <scriptTask id="t"><script>log(f"{by} at {robot.now}")</script></scriptTask>
    <sequenceFlow id="f" sourceRef="s" targetRef="sign"/><sequenceFlow id="g" sourceRef="sign" targetRef="load"/>
    <sequenceFlow id="h" sourceRef="load" targetRef="t"/>""",
    attributes='name="PORTER"',
)
"""Somebody signs, somebody loads, and the robot tells who and when."""
SIGN, LOAD = Completion("PORTER", 2.5, "sign", {"by": "Ada"}), Completion("PORTER", 7.0, "load")
YAML = """model: m.bpmn
complete:
  - {at: 7, robot: PORTER, element: load}
  - {at: 2.5, robot: PORTER, element: sign, values: {by: Ada}}
"""


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """The model, in a folder of its own."""
    path = tmp_path / "m.bpmn"
    path.write_text(MODEL)
    return path


def test_what_the_file_says_is_done_at_its_second(model: Path) -> None:
    scenario = model.with_name("s.yaml")
    scenario.write_text(YAML)
    result = Scenario.load(scenario).run()
    assert (result.status, result.simulated) == ("completed", 7.0)
    assert [(event.time / 1e9, event.element, event.detail) for event in result.reports] == [
        (2.5, "sign", "completed by a person"),
        (7.0, "load", "completed by a person"),
        (7.0, "", "Ada at 7.0"),
    ]


def test_python_and_the_command_line_say_the_same(model: Path, capsys) -> None:
    words = ["--complete", "PORTER@2.5:sign:by=Ada", "--complete", "PORTER@7:load"]
    assert main(["run", str(model), "--json", *words]) == 0
    told = json.loads(capsys.readouterr().out)
    told["wall"] = 0
    assert Scenario.load(model, completions=[SIGN, LOAD]).run().to_json() | {"wall": 0} == told


def test_a_robot_may_have_a_name_of_several_words(model: Path, capsys) -> None:
    model.write_text(MODEL.replace("PORTER", "Old Porter"))
    words = ["--complete", "Old Porter@1:sign:by=Ada", "--complete", "Old Porter@2:load"]
    assert main(["run", str(model), *words]) == 0
    assert "Ada at 2.0" in capsys.readouterr().err
    assert main(["run", str(model), *words, "--fault", "Old Porter@0.5:engine"]) == 1
    assert "its engine died at 0.5 s" in capsys.readouterr().err
    assert main(["run", str(model), "--partition", "Old Porter,Q@1-2"]) == 2
    assert "unknown robot 'Q'" in capsys.readouterr().err


def test_several_values_may_be_lists_and_texts(model: Path, capsys) -> None:
    text = "PORTER@1:sign:by=[Ada, Bob],approved=true,why=it is due, now"
    assert main(["run", str(model), "--json", "--complete", text, "--complete", "PORTER@2:load"]) == 0
    assert "['Ada', 'Bob'] at 2.0" in capsys.readouterr().out


def test_where_nobody_is_waited_for_it_is_reported_and_nothing_happens(model: Path) -> None:
    result = Scenario.load(model, completions=[LOAD], duration=20).run()
    (said,) = result.reports
    assert (said.time / 1e9, said.element) == (7.0, "load")
    assert said.detail == "could not be completed by a person: is not waiting; currently waiting: sign"
    assert result.status == "timeout"


WRONG = {
    "{at: 7, robot: PORTR, element: load}": (
        "s.yaml:3: complete[0].robot: unknown robot 'PORTR' in the completion of load; robots are: PORTER"
    ),
    "{at: 7, robot: PORTER, element: t}": (
        "s.yaml:3: complete[0].element: expected a user, manual or receive task of PORTER, got 't'; it has "
        '"Sign it" (sign), load'
    ),
    "{at: -1, robot: PORTER, element: load}": "s.yaml:3: complete[0].at: expected a number of at least 0, got -1",
    "{robot: PORTER, element: load}": "s.yaml:3: complete[0]: expected the key at, as in {at: 12, robot: REX",
    "{at: 7, robot: PORTER, element: load, value: {}}": "complete[0].value: unknown key; did you mean 'values'?",
    "{at: 7, robot: PORTER, element: load, values: {a-b: 1}}": "complete[0].values.a-b: expected the name of a",
}


@pytest.mark.parametrize("entry", WRONG)
def test_what_cannot_be_is_refused_in_one_line_before_anything_moves(entry: str, model: Path, capsys) -> None:
    scenario = model.with_name("s.yaml")
    scenario.write_text(f"model: m.bpmn\ncomplete:\n  - {entry}\n")
    assert main(["run", str(scenario)]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert WRONG[entry] in err


def test_a_task_is_named_by_its_label_if_only_one_has_it(model: Path, capsys) -> None:
    labels = [Completion("PORTER", 2.5, "Sign it", {"by": "Ada"}), LOAD]
    assert Scenario.load(model, completions=labels).completions == (SIGN, LOAD)
    model.write_text(MODEL.replace('id="load"', 'id="load" name="Sign it"'))
    assert main(["run", str(model), "--complete", "PORTER@1:Sign it"]) == 2
    assert "got 'Sign it'; this is the label of sign, load\n" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["PORTER@sign", "PORTER@x:sign", "PORTER@1:sign:by", "PORTER@1:sign:a-b=1"])
def test_what_cannot_be_read_is_said(text: str, model: Path, capsys) -> None:
    assert main(["run", str(model), "--complete", text]) == 2
    err = capsys.readouterr().err
    assert err.startswith("fame: error: argument --complete: expected ")
    assert err.count("\n") == 1


def test_an_argument_that_is_none_is_named(model: Path) -> None:
    with pytest.raises(fame.ConfigError, match="completions: expected a Completion"):
        Scenario.load(model, completions=["PORTER@7:load"])  # type: ignore[list-item]


# ---- signals from outside --------------------------------------------------------------------------------------------

LISTENER = process(
    """<startEvent id="s"><signalEventDefinition signalRef="G"/></startEvent>
    <scriptTask id="t"><script>log(f"{go} at {robot.now}")</script></scriptTask>
    <sequenceFlow id="f" sourceRef="s" targetRef="t"/>""",
    '<signal id="G" name="go"/>',
    'name="PORTER"',
).replace('<startEvent id="s">', f'<startEvent id="s">{properties(type="std_msgs/msg/Int32")}')


def test_somebody_outside_publishes_signals_and_the_run_does_not_end_before_the_last(tmp_path: Path) -> None:
    (tmp_path / "m.bpmn").write_text(LISTENER)
    path = tmp_path / "s.yaml"
    path.write_text("model: m.bpmn\nsignal:\n  - {at: 9, name: /go, payload: 8}\n  - {at: 2, name: go, payload: 7}\n")
    result = Scenario.load(path).run()
    assert (result.status, result.simulated, result.robots[0].instances) == ("completed", 9.0, 2)
    assert [(event.time / 1e9, event.detail) for event in result.reports] == [
        (2.0, "/go is published from outside"),
        (2.0, "7 at 2.0"),
        (9.0, "/go is published from outside"),
        (9.0, "8 at 9.0"),
    ]


@pytest.mark.parametrize(
    ("item", "error"),
    {
        "{at: 2, name: og}": "s.yaml:2: signal.name: no robot uses the topic /og; did you mean '/go'?",
        "{at: 2, name: go, payload: x}": "s.yaml:2: signal.payload: std_msgs/msg/Int32",
        "{name: go}": "s.yaml:2: signal: expected the key at, as in {at: 12, name: go, payload: {x: 1.0}}",
    }.items(),
)
def test_a_signal_that_nobody_uses_or_that_does_not_fit_is_refused(tmp_path: Path, item: str, error: str) -> None:
    (tmp_path / "m.bpmn").write_text(LISTENER)
    (tmp_path / "s.yaml").write_text(f"model: m.bpmn\nsignal: {item}\n")
    with pytest.raises(ConfigError) as raised:
        Scenario.load(tmp_path / "s.yaml")
    assert error in str(raised.value)
