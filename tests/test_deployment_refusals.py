"""What a robot refuses, and that it goes on as before: envelopes, texts and models that are none."""

import json

import pytest
from deployment_field import TEAM, Field, definitions, patrol, process

import fame
from fame import deployment
from fame.deployment import EngineNode
from fame.middleware import messages


def test_of_two_engines_of_one_robot_the_younger_leaves():
    field = Field()
    elder = EngineNode("A", scheduler=field.scheduler, middleware=field.middleware, wall_time=lambda: 10.0)
    field.pass_time(1)
    EngineNode("A", scheduler=field.scheduler, middleware=field.middleware, wall_time=lambda: 11.0)
    with pytest.raises(fame.FameError, match="there is an engine 'A' already"):
        field.pass_time(1)
    assert elder.state == "waiting"


@pytest.mark.parametrize(
    "change",
    [
        {"robot": 5},
        {"model": ["x"]},
        {"sequence": 1.5},
        {"sequence": -2},
        {"sequence": 10**30},
        {"phase": "run"},
        {"promises": 3},
        {"team": {"a": 1}},
        {"phase": "dance"},
        {"deployment": None},
        {"colour": "red"},
        {"model": "\ud800"},
        {"hash": True},
    ],
    ids=str,
)
def test_an_envelope_that_is_not_as_it_has_to_be_is_refused_and_harms_nobody(change):
    field = Field("A", "B")
    sent = field.deploy(TEAM)
    said = json.loads(sent.standings["A"].envelope.to_json()) | {"deployment": "d9", "sequence": 9} | change
    field.send("A", json.dumps(said))
    field.pass_time(0.1)
    assert (field.said[-1].answer, field.said[-1].state) == ("refused", "running")


@pytest.mark.parametrize("text", ["[" * 100_000, '{"fame": 1, "robot": ' * 10_000, "null", "[]", "0", '"'])
def test_any_text_is_answered(text):
    field = Field("A")
    field.send("A", text)
    field.pass_time(0.1)
    assert field.answers() == ["refused"]


def test_a_mark_of_byte_order_before_a_model_does_no_harm():
    field = Field("A")
    field.send("A", "\ufeff" + patrol(1))
    field.pass_time(0.1)
    assert field.variables("A") == {"mark": 1}


def nested(levels: int) -> str:
    """A process of sub-processes in each other."""
    return definitions(
        process("p", "".join(f'<subProcess id="s{n}">' for n in range(levels)) + "</subProcess>" * levels)
    )


@pytest.mark.parametrize(
    "text",
    [
        nested(240),
        nested(100_000),
        patrol(2).replace("mark = 2", "x = " + "-" * 100_000 + "1"),
        patrol(2).replace("mark = 2", "x = " + " + ".join("1" * 100_000)),
        patrol(2).replace('name="stop"', 'name="&xxe;"').replace("<definitions", '<!DOCTYPE x SYSTEM "x"><definitions'),
    ],
    ids=["240 levels", "100000 levels", "signs", "sums", "external entity"],
)
def test_a_model_that_nothing_can_be_made_of_is_refused_and_leaves_nothing_behind(text):
    field = Field("A")
    field.send("A", patrol(1))
    field.pass_time(0.1)
    nodes = len(field.middleware.nodes)
    field.send("A", text)
    field.pass_time(0.1)
    assert (field.said[-1].answer, field.said[-1].state) == ("refused", "running")
    assert field.variables("A") == {"mark": 1}
    assert len(field.middleware.nodes) == nodes


def test_a_report_that_is_none_harms_no_deployment():
    field = Field("A", "B")
    node = field.middleware.node("liar")
    for robot in "AB":
        liar = node.publisher(f"/{robot}/bpmn_status", deployment.STRING)
        for text in (
            "",
            "[" * 100_000,
            '{"robot": 1, "state": 2}',
            '{"robot": "A", "state": "x", "waits": [1]}',
            '{"robot": "A", "state": "ready", "born": "x"}',
        ):
            liar.publish(messages.create(deployment.STRING, text))
    assert not field.deploy(TEAM).failed
