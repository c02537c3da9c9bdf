"""What `fame check` calls an error is refused by a run and a deployment, in the same words, before anything moves."""

from pathlib import Path

import pytest
from bpmn_text import process, properties
from check_drawing import alone, call, data, given, row

from fame.bpmn import read
from fame.bpmn.library import Library
from fame.check.gate import refuse_errors
from fame.cli import main
from fame.errors import ModelError

START = '<startEvent id="s"/><scriptTask id="first"><script>log("moved")</script></scriptTask>'
TIGGER = "std_srvs/srv/Tigger"
SIGNALS = '<signal id="S" name="done"/>'
BAD_TIMER = (
    '<intermediateCatchEvent id="t"><timerEventDefinition><timeDuration>5s</timeDuration></timerEventDefinition>'
    "</intermediateCatchEvent>"
)


def after_a_script(element: str, *more: str) -> str:
    """A process that says something before a token comes to the element ``t``."""
    flows = (
        '<sequenceFlow id="f" sourceRef="s" targetRef="first"/><sequenceFlow id="g" sourceRef="first" targetRef="t"/>'
    )
    return process(START + element + "".join(more) + flows, root=SIGNALS)


def throw(**said: str) -> str:
    event = f'<intermediateThrowEvent id="t">{properties(**said)}'
    return f'{event}<signalEventDefinition signalRef="S"/></intermediateThrowEvent>'


def script(text: str) -> str:
    return f'<scriptTask id="t"><script>{text}</script></scriptTask>'


LITERALS = {
    "a time that is none": BAD_TIMER,
    "a payload that does not fit": throw(type="std_msgs/msg/Bool", payload="{x: 1}"),
    "an unknown message type": throw(type="std_msgs/msg/Bolo"),
    "an unknown type in a script": script('robot.publish("led", "std_msgs/msg/Colour")'),
    "a field that is none in a script": script('robot.publish("led", "std_msgs/msg/ColorRGBA", red=1.0)'),
    "an unknown service type": f'<serviceTask id="t">{properties(service="arm", type=TIGGER)}</serviceTask>',
    "an unknown value of retry": script("x = 1").replace("<script>", properties(retry="Never") + "<script>"),
    "a constant that takes too long": '<scriptTask id="t" scriptFormat="feel"><script>count(for i in 1..1000000000 '
    "return i)</script></scriptTask>",
    "a call of itself": '<callActivity id="t" calledElement="P"/>',
}
COMPILED = {
    "a script that is not Python": script("x = (1"),
    "a call that leads nowhere": '<callActivity id="t" calledElement="Nowhere"/>',
    "a condition that is not Python": '<task id="t"/><endEvent id="e"/><sequenceFlow id="h" sourceRef="t" targetRef="e"'
    "><conditionExpression>x = = 1</conditionExpression></sequenceFlow>",
    "a quality of service that is none": throw(type="std_msgs/msg/Bool", qos_reliability="perfect"),
}
MISTAKES = LITERALS | COMPILED


@pytest.mark.parametrize("element", MISTAKES.values(), ids=MISTAKES)
def test_a_run_refuses_it_in_the_identifiers_of_a_check_before_anything_moves(
    element: str, tmp_path: Path, capsys
) -> None:
    path, log = tmp_path / "mission.bpmn", tmp_path / "run.jsonl"
    path.write_text(after_a_script(element))
    assert main(["check", str(path)]) == 1
    (error,) = [line for line in capsys.readouterr().out.splitlines() if ": error: " in line]
    assert main(["run", str(path), "--log", str(log)]) == 2
    out, err = capsys.readouterr()
    assert (out, err) == ("", f"fame: error: {error.replace(': error: ', ': ', 1)}\n")
    assert not log.exists() or log.read_text() == ""


def test_a_run_refuses_a_monitor_whose_configuration_is_wrong(tmp_path: Path, capsys) -> None:
    path = tmp_path / "mission.bpmn"
    path.write_text(alone(data("it", configuration="unit.yaml") + row(call("t", "ProcessingUnit", given("t", "it")))))
    path.with_name("unit.yaml").write_text("Inputs:\n  In: {Topic: a, Field: [x], MessageType: std_msgs/msg/Bool}\n")
    assert main(["check", str(path)]) == 1
    (error,) = [line for line in capsys.readouterr().out.splitlines() if ": error: " in line]
    assert "does not start: " in error
    assert main(["run", str(path)]) == 2
    assert capsys.readouterr() == ("", f"fame: error: {error.replace(': error: ', ': ', 1)}\n")
    definitions = read(path)
    refuse_errors(definitions, definitions.processes, Library(), sent=True)  # the file on the robot may be right


@pytest.mark.parametrize("element", MISTAKES.values(), ids=MISTAKES)
@pytest.mark.parametrize("middleware", ["dds", "ros"])
def test_a_run_in_many_processes_starts_none(element: str, middleware: str, tmp_path: Path, capsys) -> None:
    path = tmp_path / "mission.bpmn"
    path.write_text(after_a_script(element))
    assert main(["run", str(path), "--middleware", middleware]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert "mission.bpmn:3: t: " in err


TYPES = ("an unknown message type", "an unknown type in a script", "an unknown service type")


@pytest.mark.parametrize("what", [what for what in MISTAKES if what not in TYPES])
def test_a_deployment_is_refused_before_any_robot_is_looked_for(what: str, tmp_path: Path, capsys) -> None:
    path = tmp_path / "mission.bpmn"
    path.write_text(after_a_script(MISTAKES[what]))
    assert main(["deploy", str(path)]) == 2
    assert "mission.bpmn:3: t: " in capsys.readouterr().err


@pytest.mark.parametrize("what", TYPES)
def test_types_that_the_sender_does_not_know_do_not_refuse_what_is_sent(what: str, tmp_path: Path) -> None:
    path = tmp_path / "mission.bpmn"
    path.write_text(after_a_script(MISTAKES[what]))
    definitions = read(path)
    refuse_errors(definitions, definitions.processes, Library(), sent=True)
    with pytest.raises(ModelError, match="there is no such"):
        refuse_errors(definitions, definitions.processes, Library())


def test_a_mistake_in_a_called_file_is_refused_with_its_place(tmp_path: Path, capsys) -> None:
    (tmp_path / "Wait.bpmn").write_text(after_a_script(BAD_TIMER).replace('id="P"', 'id="Wait"'))
    mission = tmp_path / "mission.bpmn"
    mission.write_text(after_a_script('<callActivity id="t" calledElement="Wait"/>'))
    assert main(["run", str(mission)]) == 2
    assert f"{tmp_path / 'Wait.bpmn'}:3: t: timer duration: '5s' is not" in capsys.readouterr().err


def test_what_nobody_runs_refuses_nothing(tmp_path: Path, capsys) -> None:
    drawn = after_a_script('<task id="t"/>')
    spare = after_a_script(BAD_TIMER).partition("<process")[2].partition("</process>")[0].replace('id="', 'id="spare_')
    spare = spare.replace('Ref="', 'Ref="spare_')
    pools = '<collaboration id="C"><participant id="X" name="REX" processRef="P"/></collaboration>'
    text = drawn.replace("<process", f"{pools}<process", 1).replace(
        "</process>", f"</process><process{spare}</process>"
    )
    path = tmp_path / "mission.bpmn"
    path.write_text(text)
    assert main(["check", str(path)]) == 1
    assert "spare_t: timer duration" in capsys.readouterr().out
    assert main(["run", str(path)]) == 0


def test_warnings_refuse_nothing(tmp_path: Path, capsys) -> None:
    path = tmp_path / "mission.bpmn"
    path.write_text(after_a_script(script("x = speed if False else 0")))
    assert main(["check", str(path)]) == 0
    assert "warning: t: reads `speed`" in capsys.readouterr().out
    assert main(["run", str(path)]) == 0
