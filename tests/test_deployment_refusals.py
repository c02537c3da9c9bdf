"""What a robot refuses, and that it goes on as before: envelopes, texts and models that are none."""

import dataclasses
import json
import time
from pathlib import Path

import pytest
from check_drawing import alone, call, data, given, row
from deployment_field import TEAM, Field, definitions, made, patrol, process

import fame
from fame import deploy
from fame.clock import SECOND
from fame.deploy.envelope import AHEAD
from fame.middleware import messages
from fame.middleware.interface import LATCHED, EndpointWarning


def test_of_two_engines_of_one_robot_the_younger_leaves():
    field = Field()
    elder = field.add("A", wall_time=lambda: 10.0)
    field.pass_time(1)
    field.add("A", wall_time=lambda: 11.0)
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
        {"team": ["A", "bad name!"]},
        {"team": [5, None]},
        {"team": ["A"] * 10_001},
        {"promises": {"/go": "nobody"}},
        {"promises": {"no name": "publisher"}},
        {"issued": 10**400},
        {"issued": float("nan")},
        {"born": -1},
        {"deployment": "d" * 1001},
    ],
    ids=lambda change: str(change)[:40],
)
def test_an_envelope_that_is_not_as_it_has_to_be_is_refused_and_harms_nobody(change):
    field = Field("A", "B")
    sent = field.deploy(TEAM)
    said = json.loads(sent.envelopes["A"].to_json()) | {"deployment": "d9", "sequence": 9} | change
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


def test_a_sequence_far_ahead_of_the_clock_is_refused_and_takes_no_numbers_from_later_ones():
    field = Field("A", "B")
    field.deploy(TEAM)
    said = json.loads(made(field, TEAM, "d9", 9).envelopes["A"].to_json())
    field.send("A", json.dumps(said | {"sequence": 2**53 - 1}))
    field.pass_time(0.1)
    assert (field.said[-1].answer, field.said[-1].state) == ("refused", "running")
    assert "are the clocks set?" in field.said[-1].reason
    assert not field.deploy(TEAM, "d2", 2).failed


def test_a_sequence_as_far_ahead_as_is_accepted_leaves_room_for_later_ones():
    field = Field("A", "B")
    ahead = round((time.time() + AHEAD) * 1e6)
    assert not field.deploy(TEAM, "d1", ahead).failed
    assert not field.deploy(TEAM, "d2", 2).failed


@pytest.mark.parametrize("state", ["ready", "waiting"])
def test_a_report_of_a_sequence_far_ahead_moves_no_sender(state):
    field = Field("A", "B")
    liar = field.middleware.node("liar").publisher("/A/bpmn_status", deploy.STRING, LATCHED)
    report = {"robot": "A", "state": state, "sequence": 2**53 - 1}
    liar.publish(messages.create(deploy.STRING, json.dumps(report)))
    sent = field.deploy(TEAM)
    assert (sent.failed, sent.sequence) == (False, 1)


def test_a_report_that_is_none_harms_no_deployment():
    field = Field("A", "B")
    node = field.middleware.node("liar")
    for robot in "AB":
        liar = node.publisher(f"/{robot}/bpmn_status", deploy.STRING)
        for text in (
            "",
            "[" * 100_000,
            '{"robot": 1, "state": 2}',
            '{"robot": "A", "state": "x", "waits": [1]}',
            '{"robot": "A", "state": "ready", "born": "x"}',
            '{"robot": "A", "state": "ready", "offers": [1, 2]}',
            '{"robot": "A", "state": "ready", "now": 1e400}',
            '{"robot": "A", "state": "ready", "waits": [{"element": "x", "since": 1' + "0" * 400 + "}]}",
        ):
            liar.publish(messages.create(deploy.STRING, text))
    assert not field.deploy(TEAM).failed


@pytest.mark.parametrize(
    "plan",
    [
        {"elements": [1]},
        {"variables": {"x": 1}},
        {"elements": {"c": {"to": [{}]}}},
        {"variables": {"mark": {"rename": {}}}},
    ],
    ids=str,
)
@pytest.mark.parametrize("preview", [False, True])
def test_a_plan_of_any_form_ends_no_engine(plan, preview):
    field = Field("A")
    field.send("A", patrol(1))
    field.pass_time(0.1)
    model = patrol(2)
    change = {"hash": deploy.model_hash(model.encode()), "model": model, "migrate": True, "preview": preview}
    field.send(
        "A", deploy.Envelope(deployment="d9", sequence=9, robot="A", phase="load", plan=plan, **change).to_json()
    )
    field.pass_time(0.1)
    assert field.said[-1].answer in ("ready", "previewed", "refused")
    assert field.variables("A") == {"mark": 1}


def test_a_value_of_any_depth_is_no_obstacle_to_a_migration():
    field = Field("A")
    field.send("A", patrol(1).replace("mark = 1", "mark = 1\nfor _ in range(40): mark = [mark]"))
    field.pass_time(0.1)
    model = patrol(2)
    change = {"hash": deploy.model_hash(model.encode()), "model": model, "migrate": True, "preview": True}
    field.send("A", deploy.Envelope(deployment="d9", sequence=9, robot="A", phase="load", **change).to_json())
    field.pass_time(0.1)
    assert (field.said[-1].answer, field.said[-1].reason) == ("previewed", "")
    assert deploy.Report.from_json(json.dumps(dataclasses.asdict(field.said[-1]))) is not None


@pytest.mark.parametrize("token", [{}, {"element": "a"}, {"others": ["x"]}], ids=str)
def test_a_report_of_any_form_ends_no_sender(token):
    field = Field("A")
    said = field.person.publisher("/B/bpmn_status", deploy.STRING, LATCHED)
    sent = made(field, TEAM, "d1", 1)
    sent.begin()
    report = deploy.Report(robot="B", state="ready", deployment="d1", answer="ready", migration={"tokens": [token]})
    field.scheduler.after(SECOND, lambda: said.publish(messages.create(deploy.STRING, report.to_json())))
    field.pass_time(5)
    assert (sent.done, sent.failed) == (True, True)
    assert "its report: it could not be handled" in sent.robots["B"].reason


@pytest.mark.parametrize(("cutoff", "answer"), [("-5", "refused"), ("5", "started")])
def test_a_robot_judges_a_monitor_by_the_files_that_it_has_itself(cutoff: str, answer: str, tmp_path: Path) -> None:
    port = "{Topic: %s, Field: [data], MessageType: std_msgs/msg/Float64}"
    ports = f"Inputs: {{In: {port % 'a'}}}\nOutputs: {{Out: {port % 'b'}}}\n"
    (tmp_path / "unit.yaml").write_text(f"{ports}Processor: {{Class: LowPass, Parameters: {{cutoff: {cutoff}}}}}\n")
    field = Field("A", files=tmp_path)
    monitored = data("it", configuration="unit.yaml") + row(call("t", "ProcessingUnit", given("t", "it")))
    field.send("A", alone(monitored))
    field.pass_time(0.1)
    (report,) = [said for said in field.said if said.answer]
    assert report.answer == answer
    assert ("does not start: " in report.reason) is (answer == "refused")


def test_an_error_that_nobody_foresaw_is_a_refusal(monkeypatch):
    field = Field("A")
    monkeypatch.setattr(field.engines["A"]._verifier, "verify_deployment", lambda envelope: 1 / 0)
    monkeypatch.setattr(field.engines["A"]._tasks, "_check", lambda request: 1 / 0)
    field.send("A", patrol(1))
    task = field.person.publisher("/A/bpmn_task", deploy.STRING)
    task.publish(messages.create(deploy.STRING, '{"id": "t1", "element": "x"}'))
    field.pass_time(0.1)
    reason = "it could not be handled: ZeroDivisionError: division by zero"
    assert [(report.answer, report.reason) for report in field.said[-2:]] == [("refused", reason)] * 2


APART = "/go: /B/fame_engine receives nothing from /A/fame_engine: type: they have different definitions of t/msg/T"


@pytest.fixture
def mismatched(monkeypatch: pytest.MonkeyPatch) -> Field:
    """Robots of which the middleware says soon that A's topic is not connected to the end that B has."""
    field = Field("A", "B")
    ends = field.middleware
    monkeypatch.setattr(ends, "connecting", lambda node: ["/go"] if node.namespace == "A" else [])
    warning = EndpointWarning("/go", APART.partition(": ")[2], "mismatch")
    field.scheduler.after(SECOND, lambda: ends.warn(warning))
    return field


def test_ends_of_a_team_that_do_not_match_refuse_its_deployment_as_soon_as_that_is_known(mismatched: Field) -> None:
    for number, most in ((1, 1.2), (2, 3.2)):  # what was known before may be outdated for a moment
        sent = mismatched.prepare(TEAM, f"d{number}", number)
        sent.begin()
        mismatched.pass_time(most)
        assert str(sent.robots["A"]) == f"A: refused: {APART}"
        assert sent.failed


def test_one_of_somebody_else_is_said_in_the_answer(mismatched: Field) -> None:
    sent = mismatched.prepare(TEAM.replace('<participant id="B" name="B" processRef="pb"/>', ""))
    sent.begin()
    mismatched.pass_time(1.5)
    assert str(sent.robots["A"]) == f"A: started: {APART}"


def test_what_the_middleware_says_of_others_refuses_nothing(mismatched: Field) -> None:
    for said in (("/go: /C/fame_engine receives nothing", "mismatch"), ("/A/fame_engine has lost a message", "lost")):
        mismatched.middleware.warnings.append(EndpointWarning("/go", *said))
    mismatched.middleware.warn = lambda warning: None  # what the field would say soon
    sent = mismatched.prepare(TEAM)
    sent.begin()
    mismatched.pass_time(8)
    assert "receives" not in str(sent.robots["A"])
    assert "lost" not in str(sent.robots["A"])
