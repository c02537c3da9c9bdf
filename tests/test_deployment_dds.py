"""What comes over DDS on `bpmn_process`: of any type, any size and any bytes. Each participant is one of its own."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.importorskip("cyclonedds", reason="Cyclone DDS is not installed: pip install 'fame-robots[dds]'")

from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.topic import Topic
from deployment_field import patrol
from middleware_contract import DOMAIN, WallWorld, dds_world

from fame import deploy
from fame.deploy import EngineNode, Report
from fame.middleware import messages
from fame.middleware.dds import wire
from fame.middleware.interface import QoS

pytestmark = pytest.mark.dds
PROCESS = "/A/bpmn_process"
LAUGHS = "".join('<!ENTITY l{} "{}">'.format(n, f"&l{n - 1};" * 10) for n in range(1, 10))


class Field:
    """An engine, and somebody who talks to it and hears what it says."""

    def __init__(self) -> None:
        self.world: WallWorld = dds_world(apart=True)
        self.world.node("person")
        self.world.node("robot")
        person, robot = self.world.middlewares
        self.engine = EngineNode("A", scheduler=self.world.scheduler, middleware=robot)
        self.person = person.nodes[0]
        self.said: list[Report] = []
        self.person.subscription("/A/bpmn_status", deploy.STRING, self._hear, deploy.STATUS_QOS)

    def _hear(self, message) -> None:
        report = Report.from_json(message.data)
        assert report is not None
        self.said.append(report)

    def publisher(self, **qos):
        publisher = self.person.publisher(PROCESS, deploy.STRING, QoS(**qos))
        self.world.connect(PROCESS)
        return publisher

    def answer(self, answer: str) -> Report:
        """The next answer of that kind."""
        found: list[Report] = []
        self.world.until(lambda: found.extend(said for said in self.said if said.answer == answer) or found)
        self.said = [said for said in self.said if said is not found[0]]
        return found[0]

    def variables(self) -> dict:
        assert self.engine.running is not None
        return self.engine.running.instances[-1].variables


@pytest.fixture
def field() -> Iterator[Field]:
    made = Field()
    yield made
    made.engine.close()
    made.world.close()


@pytest.mark.long
def test_a_plain_publisher_of_any_quality_of_service_is_heard_and_what_is_refused_leaves_the_old_one_running(field):
    field.publisher(depth=10, durability="transient_local").publish(messages.create(deploy.STRING, patrol(1)))
    assert field.answer("started").hash == deploy.model_hash(patrol(1).encode())
    publisher = field.publisher()
    laughs = f'<!DOCTYPE x [<!ENTITY l0 "ha">{LAUGHS}]>' + patrol(2).replace('name="stop"', 'name="&l9;"')
    for text, reason in [
        (laughs, "DOCTYPE"),
        (patrol(2).replace("mark = 2", "#" * 50_000_000), "at most"),
        ("\x01\x02\x03", "neither"),
    ]:
        publisher.publish(messages.create(deploy.STRING, text))
        assert reason in field.answer("refused").reason
    assert field.variables() == {"mark": 1}


def test_a_message_of_another_type_and_bytes_that_are_none_are_refused_on_the_status_topic(field):
    field.publisher().publish(messages.create(deploy.STRING, patrol(1)))
    field.answer("started")
    wrong = field.person.middleware.node("wrong")
    for publisher in list(field.person.publishers):
        publisher.close()
    wrong.publisher(PROCESS, "std_msgs/msg/Int64")
    assert "std_msgs/msg/Int64" in field.answer("refused").reason
    participant = DomainParticipant(DOMAIN)
    qos = Qos(Policy.Reliability.Reliable(10**9), Policy.DataRepresentation(use_cdrv0_representation=True))
    type = wire.declared(deploy.STRING, False)
    writer = DataWriter(participant, Topic(participant, wire.dds_topic(PROCESS), type), qos)
    field.world.until(writer.get_matched_subscriptions)
    for _ in range(2):  # the same again is refused again
        writer.write(type(b"\x00\x01\x00\x00\x04\x00\x00\x00\xff\xfe\xfd\x00"))
        assert "dropped a message" in field.answer("refused").reason
    assert field.variables() == {"mark": 1}


def test_of_a_burst_the_newest_is_what_runs(field):
    publisher = field.publisher()
    for mark in range(10):
        publisher.publish(messages.create(deploy.STRING, patrol(mark)))
    field.world.until(lambda: field.engine.running is not None and field.variables() == {"mark": 9})
    answer = field.answer("started")
    while answer.hash != deploy.model_hash(patrol(9).encode()):
        answer = field.answer("started")


def test_a_task_that_is_too_long_is_refused_before_it_is_read(field):
    tasks = field.person.publisher("/A/bpmn_task", deploy.STRING)
    field.world.connect("/A/bpmn_task")
    tasks.publish(messages.create(deploy.STRING, "x" * 1_000_001))
    assert "at most 1000000 are accepted" in field.answer("refused").reason
