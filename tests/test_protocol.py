"""Messages between two versions of FAME: what only tells is read without what is unknown; else it is refused."""

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from deployment_field import Field, patrol as patrol_of

from fame import deploy
from fame.cli.fleet import doctor
from fame.cli.robots import rows
from fame.deploy import Envelope, Report
from fame.deploy.authentication import ReportReader
from fame.deploy.envelope import PROCESS_QOS, read_report
from fame.deploy.requests import TaskClient, TaskRequest
from fame.log.clocks import ClockAnswer
from fame.middleware import messages
from fame.version import PROTOCOL, current

NEWER = PROTOCOL + 1
OF_1: dict[str, Any] = {
    "bpmn_status": """robot state hash deployed candidate sequence deployment answer reason problem migration instances
        started completed failed elements ahead waits more_waits untaken offers absent warnings error errors incidents
        suspended now born time key voucher signature""",
    "bpmn_process": """fame deployment sequence robot phase hash model promises matching silence team engines receivers
        migrate plan preview who again begun proof born issued signature""",
    "bpmn_task": "id element values act to lease who robot born issued signature",
}
OF_1 = {topic: set(names.split()) for topic, names in OF_1.items()}
"""The fields of FAME 0.2, which refuses a message with any other one. They stay until no robot runs it any more."""


def patrol(mark: int) -> str:
    return patrol_of(mark).replace('id="p"', 'id="A"')


class Wire(Field):
    """A robot, and what is sent to it and by it, as JSON."""

    def __init__(self, *robots: str) -> None:
        super().__init__(*robots)
        self.sent: dict[str, list[dict[str, Any]]] = {topic: [] for topic in OF_1}
        for topic, found in self.sent.items():

            def note(message, found=found) -> None:
                found.append(json.loads(message.data))

            qos = deploy.STATUS_QOS if topic == "bpmn_status" else PROCESS_QOS
            self.middleware.node("watcher").subscription(f"/A/{topic}", deploy.STRING, note, qos)

    def ask(self, act: str, element: str = "") -> tuple[list[Report], TaskClient]:
        answers: list[Report] = []
        node = self.middleware.node("desk")
        request = TaskRequest(id="r1", element=element, act=act)
        client = TaskClient("A", request, node=node, scheduler=self.scheduler, answered=answers.append)
        self.pass_time(2)
        client.close()
        node.close()
        return answers, client


def test_a_robot_of_fame_0_2_can_read_all_that_is_sent():
    field = Wire("A")
    field.deploy(patrol(1))
    field.deploy(patrol(2), "d2", 2, migrate=True)
    field.ask("suspend")
    field.ask("note")
    for topic, sent in field.sent.items():
        assert sent
        assert {name for each in sent for name in each} - OF_1[topic] <= {"fame"}
    suspended = [each["suspended"] for each in field.sent["bpmn_status"] if each["suspended"]]
    assert suspended
    assert all(each.keys() == {"by", "since", "holder"} for each in suspended)


def test_every_message_has_the_number_of_its_protocol():
    field = Wire("A")
    field.deploy(patrol(1))
    field.ask("suspend")
    assert {each["fame"] for each in field.sent["bpmn_process"]} == {PROTOCOL}
    assert {each.get("fame", 1) for each in field.sent["bpmn_task"]} == {PROTOCOL}
    said = [report for report in field.said if not report.deployment]
    assert {(report.protocol, report.said["fame"]) for report in said} == {(PROTOCOL, current())}


def test_a_robot_of_protocol_1_is_not_told_the_number_of_a_request():
    field = Wire()
    status = field.person.publisher("/A/bpmn_status", deploy.STRING, deploy.STATUS_QOS)
    status.publish(messages.create(deploy.STRING, Report(robot="A", state="running").to_json()))
    _, client = field.ask("suspend")
    assert field.sent["bpmn_task"]
    assert all(each.keys() == OF_1["bpmn_task"] for each in field.sent["bpmn_task"])
    assert client.trouble.startswith("A runs an older FAME (protocol 1); this speaks")


def test_an_envelope_of_a_newer_fame_is_refused_by_the_name_of_its_field_and_the_sender_is_told(monkeypatch):
    field = Field("A")
    old = Envelope.to_json
    monkeypatch.setattr(
        Envelope, "to_json", lambda self: json.dumps({**json.loads(old(self)), "fame": NEWER, "unless": "ended"})
    )
    sent = field.deploy(patrol(1))
    assert sent.robots["A"].state == "refused"
    here = f"this robot runs FAME {current()} (protocol {PROTOCOL})"
    assert sent.robots["A"].reason.startswith(f"field 'unless' of protocol {NEWER} is unknown: {here}; update it")
    assert field.engines["A"].running is None


def test_a_request_of_a_newer_fame_is_refused_by_the_name_of_its_field_and_the_person_is_told(monkeypatch):
    field = Wire("A")
    field.deploy(patrol(1))
    old = TaskRequest.to_json
    monkeypatch.setattr(
        TaskRequest, "to_json", lambda self: json.dumps({**json.loads(old(self)), "fame": NEWER, "once": True})
    )
    (answer, *_), _ = field.ask("suspend")
    assert answer.answer == "refused"
    assert answer.reason.startswith(f"field 'once' of protocol {NEWER} is unknown: this robot runs FAME")
    assert not field.engines["A"].running.suspension.by


def test_what_a_report_of_a_newer_fame_says_besides_is_ignored():
    said = json.loads(Report(robot="A", state="running", waits=({"element": "t", "for": "x"},)).to_json())
    said |= {"mood": "fine", "migration": {"state": {"protocol": NEWER, "fame": "9.1"}, "more": 1}}
    said["waits"][0]["colour"] = "red"
    report = read_report(json.dumps(said))
    assert (report.state, report.protocol) == ("running", NEWER)
    text = f"A runs FAME 9.1 (protocol {NEWER}); this speaks {PROTOCOL}: update FAME here, or the FAME of A"
    assert report.differs == text
    assert text in [row[6] for row in rows("A", report)]


def test_the_signature_of_a_report_holds_with_what_is_unknown_in_it_and_not_without():
    pytest.importorskip("cryptography", reason="cryptography is not installed: pip install 'fame-robots[dds]'")
    from fame.deploy.signing import Identity, sign

    engine = Identity.new()
    said = {**json.loads(Report(robot="A", state="running", key=engine.key).to_json()), "mood": "fine"}
    said["signature"] = sign(said, engine.private)
    assert ReportReader("A", signed=True).read(json.dumps(said)) is not None
    del said["mood"]
    assert ReportReader("A", signed=True).read(json.dumps(said)) is None


def answering(field: Field, says: Callable[[dict[str, Any]], str]) -> None:
    """Stand in for a robot A, which says something to each envelope."""
    end = field.person.publisher("/A/bpmn_status", deploy.STRING, deploy.STATUS_QOS)

    def answer(message) -> None:
        end.publish(messages.create(deploy.STRING, says(json.loads(message.data))))

    field.person.subscription("/A/bpmn_process", deploy.STRING, answer)


def test_a_sender_says_what_an_older_robot_refused_to_nobody():
    field = Field()
    reason = "neither a .bpmn text nor an envelope (field 'matching'): '{'"
    answering(field, lambda said: Report(robot="A", state="waiting", answer="refused", reason=reason).to_json())
    sent = field.deploy(patrol(1), robots=["A"])
    assert sent.robots["A"].state == "silent"
    assert sent.robots["A"].reason == (
        f"did not answer; it refused a message: {reason}; A runs an older FAME (protocol 1); this speaks {PROTOCOL}: "
        "update A, or use what an older FAME has"
    )


def test_a_sender_says_that_it_cannot_read_what_a_robot_says():
    field = Field()
    said = json.loads(Report(robot="A", state="waiting").to_json()) | {"state": "asleep"}
    answering(field, lambda envelope: json.dumps(said))
    sent = field.deploy(patrol(1), robots=["A"])
    assert str(sent.robots["A"]) == "A: silent: its status cannot be read (field 'state')"


@pytest.mark.parametrize(
    ("answer", "text", "mend"),
    [
        ({"fame": "0.2.0"}, f"runs FAME 0.2.0 (protocol 1); this speaks {PROTOCOL}", "update REX, or use what"),
        ({}, f"runs an older FAME (protocol 1); this speaks {PROTOCOL}", "update REX, or use what an older FAME has"),
        ({"fame": "9.0", "protocol": NEWER}, f"runs FAME 9.0 (protocol {NEWER}); this speaks {PROTOCOL}", "update"),
    ],
)
def test_the_doctor_says_which_protocol_a_robot_speaks(answer, text, mend):
    found = list(doctor.answered("REX", ClockAnswer(1000, 0, answer)))[-1]
    assert (found.verdict, found.text) == ("warning", text)
    assert found.mend.startswith(mend)


def test_a_model_of_a_newer_fame_that_says_nothing_new_is_deployed():
    field = Field("A")
    model = patrol(3)
    envelope = Envelope(deployment="d1", sequence=1, robot="A", phase="load", hash=deploy.model_hash(model.encode()))
    for each in (replace(envelope, model=model), replace(envelope, phase="start")):
        field.send("A", json.dumps({**json.loads(each.to_json()), "fame": NEWER}))
        field.pass_time(0.5)
    assert field.variables("A")["mark"] == 3
