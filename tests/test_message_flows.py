"""Message flows: what a sender sends goes to the topic of its receiver, in the whole and in the parts of a model."""

from pathlib import Path

import pytest

from fame.bpmn import read_bytes, read_text
from fame.bpmn.model import Definitions
from fame.bpmn.split import split
from fame.check import check
from fame.scenario import Scenario

HEAD = '<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" targetNamespace="http://fame">'
MESSAGE = "<messageEventDefinition{}/>"


def team(sends: str, receives: str, flow: str = "", root: str = "") -> str:
    """Two pools: a robot that sends by element ``x``, one that waits at ``y``, and a flow between the two."""
    return (
        f'{HEAD}<collaboration id="c"><participant id="pa" name="Digger" processRef="A"/>'
        f'<participant id="pb" name="Truck" processRef="B"/>'
        f'<messageFlow id="m" sourceRef="x" targetRef="y"{flow}/></collaboration>'
        f'<process id="A" isExecutable="true"><startEvent id="s"/>{sends}'
        '<sequenceFlow id="f" sourceRef="s" targetRef="x"/></process>'
        f'<process id="B" isExecutable="true">{receives}<task id="z"/>'
        f'<sequenceFlow id="g" sourceRef="y" targetRef="z"/></process>{root}</definitions>'
    )


def said(reference: str) -> str:
    return MESSAGE.format(f' messageRef="{reference}"' if reference else "")


def throws(reference: str = "") -> str:
    return f'<endEvent id="x" name="full">{said(reference)}</endEvent>'


def waits(reference: str = "") -> str:
    return f'<startEvent id="y" name="load  is there">{said(reference)}</startEvent>'


def names(definitions: Definitions) -> dict[str, str]:
    nodes = [node for process in definitions.processes for node in process.body.walk()]
    return {node.id: topic.qualified for node in nodes for topic, _ in node.topics()}


ROOT = '<message id="M" name="mine"/><message id="N" name="yours"/>'


@pytest.mark.parametrize(
    ("sends", "receives", "flow", "topic"),
    [
        (throws(), waits(), "", "/load_is_there"),
        (throws("M"), waits(), "", "/mine"),
        (throws(), waits("N"), "", "/yours"),
        (throws("M"), waits("N"), "", "/yours"),
        (throws(), waits(), ' messageRef="N"', "/yours"),
        ('<sendTask id="x"/>', waits(), "", "/load_is_there"),
        ('<sendTask id="x"/>', '<receiveTask id="y"/>', "", "/y"),
        ('<sendTask id="x"/>', '<receiveTask id="y" messageRef="N"/>', "", "/yours"),
    ],
)
def test_both_ends_have_the_topic_of_the_receiver(sends: str, receives: str, flow: str, topic: str) -> None:
    definitions = read_text(team(sends, receives, flow, ROOT), file="m.bpmn")
    assert names(definitions) == {"x": topic, "y": topic}
    parts = [read_bytes(part.source, file=part.filename) for part in split(definitions)]
    assert {**names(parts[0]), **names(parts[1])} == {"x": topic, "y": topic}


def test_a_message_gets_no_id_that_the_file_has() -> None:
    definitions = read_text(team(throws(), waits(), root='<message id="y_message" name="other"/>'))
    assert names(definitions) == {"x": "/load_is_there", "y": "/load_is_there"}


def test_a_message_that_is_not_what_the_receiver_waits_for_is_warned_of() -> None:
    found = check(read_text(team(throws("M"), waits("N"), root=ROOT), file="m.bpmn"))
    texts = [one.text for one in found if one.level == "warning"]
    assert "sends M to y, which waits for N: it is sent as N" in texts


def test_robots_talk_along_it(tmp_path: Path) -> None:
    path = tmp_path / "team.bpmn"
    waiting = '<startEvent id="q"/><receiveTask id="y"/><sequenceFlow id="h" sourceRef="q" targetRef="y"/>'
    path.write_text(team(throws(), waiting), encoding="utf-8")
    result = Scenario.load(path, duration=5).run()
    assert [(robot.name, robot.completed, robot.failed) for robot in result.robots] == [
        ("Digger", 1, 0),
        ("Truck", 1, 0),
    ]


@pytest.mark.parametrize(
    ("source", "target"), [("pa", "y"), ("x", "pb"), ("pa", "pb"), ("s", "y"), ("x", "z"), ("y", "x")]
)
def test_one_that_does_not_join_two_messages_has_no_effect(source: str, target: str) -> None:
    text = team(throws("M"), waits("N"), root=ROOT).replace('"x" targetRef="y"', f'"{source}" targetRef="{target}"')
    definitions = read_text(text, file="m.bpmn")
    assert names(definitions) == {"x": "/mine", "y": "/yours"}
    told = "has no effect: a message flow joins an element that sends a message with one that receives it"
    assert (told in [one.text for one in check(definitions)]) is True
