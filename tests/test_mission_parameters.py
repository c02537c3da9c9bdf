"""Mission parameters: values of variables from outside, in scenarios, on the command line and in `fame check`."""

from pathlib import Path

import pytest
from bpmn_text import document, properties

from fame.bpmn import read_text
from fame.check.explain import readings
from fame.cli import main
from fame.errors import ConfigError
from fame.scenario import Scenario


def pool(name: str, start: str = "") -> str:
    """A process that logs its speed, which a data object gives, and its limit, which nobody does."""
    go = '<dataInputAssociation id="a{0}"><sourceRef>o{0}</sourceRef><targetRef>p{0}</targetRef></dataInputAssociation>'
    return (
        f'<process id="P{name}"><startEvent id="s{name}">{start}</startEvent><scriptTask id="t{name}">'
        f"{go.format(name)}<script>log(f'{{speed}} {{limit}}')</script></scriptTask>"
        f'<sequenceFlow id="f{name}" sourceRef="s{name}" targetRef="t{name}"/>'
        f'<dataObjectReference id="o{name}" name="given" dataObjectRef="d{name}">{properties(speed="0.25")}'
        f'</dataObjectReference><dataObject id="d{name}"/></process>'
    )


PARTICIPANTS = "".join(f'<participant id="{name}" name="{name}" processRef="P{name}"/>' for name in ("REX", "DINGO"))


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """REX starts by itself, DINGO after a second."""
    timer = '<timerEventDefinition id="x"><timeDuration>PT1S</timeDuration></timerEventDefinition>'
    path = tmp_path / "m.bpmn"
    path.write_text(
        document(f'<collaboration id="c">{PARTICIPANTS}</collaboration>{pool("REX")}{pool("DINGO", timer)}')
    )
    return path


def logged(scenario: Scenario) -> list[str]:
    return [event.detail for event in scenario.run().reports if event.what == "log"]


def test_a_parameter_replaces_the_value_of_the_model_and_reaches_every_instance(model: Path) -> None:
    variables = {"": {"limit": 3, "speed": 1.5}, "DINGO": {"speed": [1, 2]}}
    assert logged(Scenario.load(model, variables=variables)) == ["1.5 3", "[1, 2] 3"]


def test_a_scenario_gives_them_by_robot_and_for_all(model: Path) -> None:
    path = model.with_suffix(".yaml")
    path.write_text(f"model: {model.name}\ncomputers: [REX, DINGO]\nvariables: {{limit: 7, REX: {{speed: 0.5}}}}\n")
    assert logged(Scenario.load(path)) == ["0.5 7", "0.25 7"]
    assert logged(Scenario.load(path, variables={"REX": {"speed": 2}})) == ["2 7", "0.25 7"]
    assert logged(Scenario.load(path, variables={"limit": 8, "DINGO": {"speed": 2}})) == ["0.5 8", "2 8"]


def test_the_command_line_sets_them(model: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(model), "--set", "REX.speed=0.5", "--set", "limit=far"]) == 0
    told = capsys.readouterr().err
    assert "REX: 0.5 far" in told
    assert "DINGO: 0.25 far" in told


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["REX.sped=0.5"], "REX has no variable 'sped'; did you mean 'speed'?"),
        (["sped=0.5"], "the mission has no variable 'sped'; did you mean 'speed'?"),
        (["REKS.speed=0.5"], "unknown robot 'REKS' in variables; known are: REX, DINGO"),
        (["REX.speed"], "--set"),
        (["speed=1", "--middleware", "dds"], "--set needs --middleware local"),
    ],
)
def test_what_the_model_does_not_have_is_refused(
    model: Path, capsys: pytest.CaptureFixture[str], words: list[str], error: str
) -> None:
    assert main(["run", str(model), "--set", *words]) == 2
    assert error in capsys.readouterr().err


def test_the_python_interface_refuses_them_too(model: Path) -> None:
    with pytest.raises(ConfigError, match="REX has no variable 'sped'"):
        Scenario.load(model, variables={"REX": {"sped": 1}})
    with pytest.raises(ConfigError, match=r"variables: expected a mapping of names to values, got \[1\]"):
        Scenario.load(model, variables=[1])  # type: ignore[arg-type]


def test_check_explain_shows_them_with_their_defaults(model: Path) -> None:
    found = [str(one) for one in readings(read_text(model.read_text(), file="m.bpmn")) if one.kind == "parameter"]
    assert [text.split(": ", 3)[2:] for text in found] == [
        ["PREX", "can be set: speed = 0.25, limit"],
        ["PDINGO", "can be set: speed = 0.25, limit"],
    ]
