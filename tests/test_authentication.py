"""Where keys are used, nobody believes a report that its robot's engine did not sign."""

import json
from dataclasses import replace

import pytest

pytest.importorskip("cryptography", reason="cryptography is not installed: pip install 'fame-robots[dds]'")

from deployment_field import TEAM, Field, kill, made, patrol

import fame
from fame.bpmn.reader import read_text
from fame.cli import main
from fame.deploy import STATUS_QOS, STRING, Deployment, EngineNode, LateJoiners, Report
from fame.deploy.authentication import GONE, Diagram, ReportReader
from fame.deploy.fields import values
from fame.deploy.leader_election import SplitterStatus
from fame.deploy.options import DeploymentOptions
from fame.deploy.requests import TaskClient, TaskRequest
from fame.deploy.sender import Sender
from fame.deploy.signing import (
    ANOTHER_RUN,
    Identity,
    new_identity,
    new_keys,
    read_identity,
    read_private,
    read_trusted,
    sign,
)
from fame.deploy.splitter_node import SplitterNode
from fame.middleware import messages
from fame.middleware.interface import LATCHED, Node

NOW = 1_000_000.0


@pytest.fixture
def keys(tmp_path):
    secret, public = new_keys(tmp_path / "team")
    return read_private(secret), read_trusted([public])


def proved(keys, tmp_path, robot: str) -> Identity:
    new_identity(robot, keys[0], tmp_path / f"{robot}.key")
    return read_identity(tmp_path / f"{robot}.key", robot)


class Guarded(Field):
    """Robots that trust a key, some with an identity; the wall clock goes with the scheduler's."""

    def __init__(self, keys, *robots: str, identities=()) -> None:
        self.keys, self.identities = keys, dict(identities)
        super().__init__(*robots)

    def time(self) -> float:
        return NOW + self.scheduler.now / 1e9

    def add(self, name: str, **options) -> EngineNode:
        identity = self.identities.get(name)
        return super().add(name, trusted=self.keys[1], identity=identity, wall_time=self.time, **options)

    def prepare(self, text: str, id: str = "d1", sequence: int = 1, **options) -> Deployment:
        return super().prepare(text, id, sequence, key=self.keys[0], wall_time=self.time, **options)

    def forge(self, report: Report, by: Identity | None = None) -> Node:
        """Say it in the name of a robot, signed by somebody else or nobody."""
        if by is not None:
            report = replace(report, key=by.key, voucher=by.voucher)
            report = replace(report, signature=sign(values(report), by.private))
        node = self.middleware.node("stranger")
        node.publisher(f"/{report.robot}/bpmn_status", STRING, LATCHED).publish(
            messages.create(STRING, report.to_json())
        )
        return node


# ---- what a sender believes ------------------------------------------------------------------------------------------


def forged_answers(field: Guarded, robot: str, by: Identity | None) -> None:
    """Whatever is said to a robot, somebody answers for it."""

    def answer(message) -> None:
        said = json.loads(message.data)
        word = {"load": "ready", "start": "started"}.get(said["phase"])
        if word:
            field.forge(Report(robot=robot, state="ready", deployment="d1", answer=word, time=1.0), by)

    field.middleware.node("stranger").subscription(f"/{robot}/bpmn_process", STRING, answer)


def test_unsigned_answers_for_a_robot_that_is_not_there_deploy_nothing(keys):
    field = Guarded(keys, "A")
    field.forge(Report(robot="B", state="waiting"))
    forged_answers(field, "B", None)
    sent = field.deploy(TEAM, robots=["A", "B"])
    assert (sent.failed, sent.robots["B"].reason) == (True, "did not answer within 10 s")
    assert field.engines["A"].running is None


def test_unsigned_refusals_keep_no_deployment_from_happening(keys):
    field = Guarded(keys, "A", "B")
    field.forge(Report(robot="B", state="running", deployment="d1", answer="refused"))
    assert not field.deploy(TEAM).failed


def test_two_engines_that_say_that_they_are_one_robot_and_cannot_prove_it_are_sent_nothing(keys):
    field = Guarded(keys, "A", "B")
    field.forge(Report(robot="B", state="waiting"), Identity.new())
    sent = field.deploy(TEAM)
    assert sent.failed
    assert "two engines say that they are B" in sent.robots["B"].reason
    assert sent.robots["A"].reason == "was not asked yet because of B"
    assert field.engines["A"].running is None


def test_a_robot_that_proves_its_name_is_believed_whoever_else_speaks(keys, tmp_path):
    field = Guarded(keys, "A", "B", identities={"B": proved(keys, tmp_path, "B")})
    stranger = Identity.new()
    field.forge(Report(robot="B", state="waiting", born=5), stranger)
    forged_answers(field, "B", stranger)
    assert not field.deploy(TEAM).failed
    assert field.engines["B"].deployed == "d1"


def test_a_voucher_counts_for_its_robot_and_of_a_trusted_key_alone(keys, tmp_path):
    other = read_private(new_keys(tmp_path / "other")[0])
    new_identity("B", other, tmp_path / "B.key")
    for identity in (proved(keys, tmp_path, "C"), read_identity(tmp_path / "B.key", "B")):
        field = Guarded(keys, "A", "B")
        field.forge(Report(robot="B", state="waiting"), identity)
        assert field.deploy(TEAM).failed


# ---- what an engine believes -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("by", [None, Identity.new()], ids=["unsigned", "by a stranger"])
def test_a_stranger_ends_no_engine_that_trusts_keys_and_keeps_none_from_starting(keys, by):
    notes = []
    field = Guarded(keys, "A", "B")
    field.engines["A"].close()
    stranger = field.forge(Report(robot="A", state="running", born=1), by)
    field.add("A", on_report=notes.append)
    field.pass_time(3)
    assert field.engines["A"].state == "waiting"
    stranger.close()
    assert not field.deploy(TEAM).failed
    field.forge(Report(robot="A", state="running", born=2), by)
    field.pass_time(3)
    assert field.engines["A"].state == "running"
    assert "cannot tell it from a stranger" in notes[0].detail


def test_of_two_engines_that_prove_one_name_the_younger_leaves_unless_it_runs_something(keys, tmp_path):
    identity = proved(keys, tmp_path, "A")
    field = Guarded(keys, identities={"A": identity})
    field.add("A")
    field.pass_time(1)
    field.add("A")
    with pytest.raises(fame.FameError, match="there is an engine 'A' already"):
        field.pass_time(1)
    field = Guarded(keys, "A", "B", identities={"A": identity})
    assert not field.deploy(TEAM).failed
    field.forge(Report(robot="A", state="running", born=round((NOW - 1) * 1e9), time=13.0), identity)
    field.pass_time(1)
    assert field.engines["A"].state == "running"


def test_what_an_older_run_of_the_engine_said_is_no_proof_that_it_is_there(keys, tmp_path):
    identity = proved(keys, tmp_path, "A")
    field = Guarded(keys, "A", identities={"A": identity})
    field.forge(Report(robot="A", state="running", born=round((NOW - 100) * 1e9), time=60.0), identity)
    field.pass_time(2)
    assert field.engines["A"].state == "waiting"


def test_an_older_engine_without_keys_does_not_end_one_that_runs_something():
    field = Field("A")
    field.send("A", patrol(1))
    field.pass_time(1)
    end = field.middleware.node("stranger").publisher("/A/bpmn_status", STRING, LATCHED)
    end.publish(messages.create(STRING, Report(robot="A", state="running", born=1).to_json()))
    field.pass_time(1)
    assert field.engines["A"].state == "running"


def one_that_holds(keys, identities):
    """A is ready for d1 and hears of nothing: its sender is gone, and so is the engine of B, but not its key."""
    field = Guarded(keys, "A", "B", identities=identities)
    text = TEAM.replace('name="go"', 'name="~/go"')
    made_by = field.prepare(text)
    made_by._send = lambda robot, envelope, send=made_by._send: send(robot, envelope) if robot == "A" else None
    made_by.begin()
    field.pass_time(0.5)
    assert field.engines["A"].state == "ready"
    kill(made_by)
    field.engines["B"].close()
    field.pass_time(6)
    return field


@pytest.mark.parametrize("answer", ["started", "aborted", "asking"])
@pytest.mark.parametrize("by", [None, Identity.new()], ids=["unsigned", "by a stranger"])
def test_a_robot_that_holds_believes_the_engines_alone_for_which_its_deployment_vouched(keys, answer, by):
    field = one_that_holds(keys, {})
    field.forge(Report(robot="B", state="running", deployment="d1", answer=answer, deployed="d1", time=1e6), by)
    field.pass_time(3)
    assert field.engines["A"].state == "holding"


@pytest.mark.parametrize(("later", "state"), [(1, "running"), (-1, "holding")])
def test_a_robot_that_holds_believes_a_later_engine_with_the_same_key(keys, tmp_path, later, state):
    identity = proved(keys, tmp_path, "B")
    field = one_that_holds(keys, {"B": identity})
    born = field.engines["B"].born + later
    field.forge(Report(robot="B", state="running", born=born, deployment="d1", answer="started", time=1e6), identity)
    field.pass_time(3)
    assert field.engines["A"].state == state


def test_robots_that_trust_keys_decide_together_when_their_sender_is_gone(keys):
    field = Guarded(keys, "A", "B")
    sent = field.prepare(TEAM)
    words = []
    send = sent._send
    sent._send = lambda robot, envelope: words.append(robot) if envelope.phase == "start" else send(robot, envelope)
    sent.begin()
    field.pass_time(0.5)
    kill(sent)
    sent.node.close()
    assert {engine.state for engine in field.engines.values()} == {"ready"}
    send_to_a = made(field, TEAM, "x", 1).node.publisher("/A/bpmn_process", STRING)
    envelope = replace(sent._envelope("A", "start"), issued=field.time(), born=field.engines["A"].born)
    envelope = replace(envelope, signature=sign(values(envelope), keys[0]))
    send_to_a.publish(messages.create(STRING, envelope.to_json()))
    field.pass_time(8)
    assert [engine.deployed for engine in field.engines.values()] == ["d1", "d1"]


# ---- one reader over time -------------------------------------------------------------------------------------------


def said(robot: str, state: str, by: Identity, **fields) -> str:
    report = replace(Report(robot=robot, state=state, **fields), key=by.key, voucher=by.voucher)
    return replace(report, signature=sign(values(report), by.private)).to_json()


def test_an_older_report_is_not_believed_again():
    engine = Identity.new()
    reader = ReportReader("A", signed=True)
    assert reader.read(said("A", "waiting", engine, born=1, time=1.0))
    assert reader.read(said("A", "running", engine, born=1, time=2.0))
    assert reader.read(said("A", "waiting", engine, born=1, time=1.0)) is None


def test_another_engine_is_believed_when_the_first_one_is_silent_for_long_enough():
    reader = ReportReader("A", signed=True, patience=GONE)
    first, second = Identity.new(), Identity.new()
    assert reader.read(said("A", "waiting", first), 0.0)
    assert reader.read(said("A", "waiting", second), 1.0) is None
    assert reader.rival
    assert reader.read(said("A", "waiting", second), GONE + 0.1)


def test_what_was_signed_for_another_robot_or_changed_is_not_believed():
    engine = Identity.new()
    assert ReportReader("B", signed=True).read(said("A", "waiting", engine)) is None
    changed = json.loads(said("A", "waiting", engine)) | {"state": "running"}
    assert ReportReader("A", signed=True).read(json.dumps(changed)) is None


def test_a_forged_robot_that_waits_is_not_supplied(keys):
    field = Guarded(keys, "A", "B")
    assert not field.deploy(TEAM).failed
    sent = []
    sender = Sender("test", field.scheduler, field.middleware, DeploymentOptions(key=keys[0]))
    sender.send = lambda *arguments, **more: sent.append(arguments)
    late_joiners = LateJoiners(read_text(TEAM, file="team.bpmn"), sender)
    field.pass_time(1)
    for by in (None, Identity.new()):
        field.forge(Report(robot="A", state="waiting", time=1e6), by)
        field.pass_time(2)
    assert sent == []
    late_joiners.close()


# ---- tasks and diagrams ----------------------------------------------------------------------------------------------

TASK = (
    '<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" targetNamespace="t"><process id="A">'
    '<startEvent id="s"/><userTask id="ask"/><sequenceFlow id="f" sourceRef="s" targetRef="ask"/></process>'
    "</definitions>"
)


def asked(field: Guarded, key) -> list[Report]:
    answers: list[Report] = []
    asking = TaskClient(
        "A", TaskRequest(id="one", element="ask"), node=field.middleware.node("somebody"), scheduler=field.scheduler,
        answered=answers.append, key=key, wall_time=field.time,
    )  # fmt: skip
    field.pass_time(2)
    asking.close()
    return answers


def test_what_somebody_did_counts_if_a_trusted_key_signed_it(keys, tmp_path):
    field = Guarded(keys, "A")
    assert not field.deploy(TASK).failed
    heard = []
    field.person.subscription("/A/bpmn_task", STRING, heard.append)
    assert [answer.reason[:10] for answer in asked(field, None)] == ["not signed"]
    stranger = read_private(new_keys(tmp_path / "stranger")[0])
    assert "not signed by a key" in asked(field, stranger)[0].reason
    assert [answer.answer for answer in asked(field, keys[0])] == ["completed"]
    changed = json.loads(heard[-1].data) | {"id": "two"}
    end = field.middleware.node("stranger").publisher("/A/bpmn_task", STRING)
    end.publish(messages.create(STRING, json.dumps(changed)))
    field.pass_time(0.1)
    assert (field.said[-1].answer, field.said[-1].deployment) == ("refused", "two")


def test_what_was_signed_for_the_engine_before_is_signed_again():
    field, answers = Field("A"), []
    assert not field.deploy(TASK).failed
    asking = TaskClient(
        "A", TaskRequest(id="one", element="ask"), node=field.middleware.node("somebody"), scheduler=field.scheduler,
        answered=answers.append,
    )  # fmt: skip
    refusal = Report(robot="A", state="running", deployment="one", answer="refused", reason=ANOTHER_RUN, time=1.0)
    asking._on_status(messages.create(STRING, refusal.to_json()))
    assert (answers, asking.trouble) == ([], ANOTHER_RUN)
    field.pass_time(2)
    asking.close()
    assert [one.answer for one in answers] == ["completed"]


def spread(field: Guarded, text: str) -> None:
    end = field.middleware.node("person").publisher("/collaboration_diagram", STRING)
    end.publish(messages.create(STRING, text))
    field.pass_time(8)


def test_a_splitter_with_keys_takes_signed_diagrams_alone_and_each_once(keys, tmp_path):
    field = Guarded(keys, "A", "B")
    told = []
    splitter = SplitterNode(
        scheduler=field.scheduler,
        middleware=field.middleware,
        trusted=keys[1],
        log=told.append,
        options=DeploymentOptions(key=keys[0], wall_time=field.time),
    )
    spread(field, TEAM)
    stranger = read_private(new_keys(tmp_path / "stranger")[0])
    spread(field, Diagram.of(TEAM, purpose="deploy", now=field.time(), key=stranger).to_json())
    spread(field, Diagram.of(TEAM, purpose="deployed", now=field.time(), key=keys[0]).to_json())
    spread(field, Diagram.of(TEAM, purpose="deploy", now=field.time() - 301, key=keys[0]).to_json())
    spread(field, Diagram.of(TEAM, purpose="deploy", now=splitter.born / 1e9 - 1, key=keys[0]).to_json())
    reasons = [text for text in told if text.startswith("refused")]
    assert [reason.split(":")[1].split(";")[0] for reason in reasons] == [
        " not signed",
        " not signed by a key that this robot trusts (a team of fame run trusts its --key)",
        " the signature belongs to another message",
        " signed 301 s ago",
        " signed before this splitter began",
    ]
    assert field.engines["A"].running is None
    text = Diagram.of(TEAM, purpose="deploy", now=field.time(), key=keys[0]).to_json()
    spread(field, text)
    assert [engine.state for engine in field.engines.values()] == ["running", "running"]
    spread(field, text)
    assert "replay" in told[-1]
    latched = []
    field.person.subscription("/fame_splitter/deployed", STRING, latched.append, STATUS_QOS)
    field.pass_time(1)
    assert json.loads(latched[0].data)["purpose"] == "deployed"
    splitter.close()


@pytest.mark.parametrize("signed", [False, True])
def test_a_splitter_with_keys_leaves_the_role_to_an_older_one_that_signs(keys, signed):
    field = Guarded(keys)
    options = DeploymentOptions(key=keys[0], wall_time=field.time)
    splitter = SplitterNode(scheduler=field.scheduler, middleware=field.middleware, options=options, trusted=keys[1])
    end = field.middleware.node("other").publisher("/fame_splitter", STRING, LATCHED)
    for _ in range(6):
        role = SplitterStatus(born=1, state="idle").signed(keys[0] if signed else None, field.time())
        end.publish(messages.create(STRING, role.to_json()))
        field.pass_time(1)
    assert (splitter.state == "standby") is signed
    for _ in range(40):  # recorded, and said again
        end.publish(messages.create(STRING, role.to_json()))
        field.pass_time(1)
    assert splitter.state == "idle"
    splitter.close()


@pytest.mark.parametrize(
    "text", ["[]", "null", '{"born": 1}', '{"born": 1, "state": []}', '{"born": 1e400}', "[" * 9999]
)
def test_what_is_no_word_of_a_splitter_is_none(text):
    assert SplitterStatus.from_json(text) is None


# ---- the commands ----------------------------------------------------------------------------------------------------


def test_identities_and_signed_diagrams_are_made_by_fame_keys(tmp_path, capsys):
    assert main(["keys", "new", str(tmp_path / "team")]) == 0
    key = ["--key", str(tmp_path / "team.key")]
    assert main(["keys", "robot", str(tmp_path / "REX"), *key]) == 0
    assert read_identity(tmp_path / "REX.key", "REX").voucher
    with pytest.raises(fame.ConfigError, match="is the identity of robot 'REX', not of 'DINGO'"):
        read_identity(tmp_path / "REX.key", "DINGO")
    with pytest.raises(fame.ConfigError, match="is not an identity"):
        read_identity(tmp_path / "team.key", "REX")
    (tmp_path / "team.bpmn").write_text(TEAM)
    capsys.readouterr()
    assert main(["keys", "diagram", str(tmp_path / "team.bpmn"), *key]) == 0
    assert json.loads(json.loads(capsys.readouterr().out)["data"])["model"] == TEAM
    assert main(["keys", "robot", str(tmp_path / "REX"), *key]) == 2
    assert "never overwritten" in capsys.readouterr().err
    assert main(["keys", "robot", "DINGO"]) == 2
    assert "needs --key" in capsys.readouterr().err
    assert main(["engine", "REX", "--identity", str(tmp_path / "REX.key")]) == 2
    assert "--identity needs --trust" in capsys.readouterr().err
