"""DDS: what ROS 2 sees of us on the wire, and what other processes do to us. Everything on loopback."""

from __future__ import annotations

import gc
import json
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("cyclonedds")

from cyclonedds import builtin
from cyclonedds.core import DDSException, Entity, GuardCondition
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct, types
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos, _CQos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from dds_child import FAREWELLS, TEXT
from middleware_contract import DOMAIN, TIMEOUT, WallWorld, dds_world

from fame.clock import SECOND, Kind, Scheduler
from fame.errors import ConfigError, MessageError, UnavailableError
from fame.middleware import codec, messages
from fame.middleware.dds import DdsMiddleware, DdsScheduler, cyclone, domain, wire
from fame.middleware.dds.domain import configuration, sockets
from fame.middleware.interface import LATCHED, SENSOR_DATA, UNKNOWN_NODE, EndpointWarning, QoS
from fame.middleware.messages import create
from fame.middleware.wire_base import WarningsOnce, domain_id

pytestmark = pytest.mark.dds
MILLISECOND = SECOND // 1000
INT = "std_msgs/msg/Int64"
WIRE = Path(__file__).resolve().parents[2] / "shared" / "data" / "ros2_jazzy_wire" / "samples.json"


@pytest.fixture
def here() -> Iterator[WallWorld]:
    """Each node in a participant of its own."""
    world = dds_world(apart=True)
    yield world
    world.close()


@pytest.fixture
def child(request: pytest.FixtureRequest) -> Iterator[subprocess.Popen[bytes]]:
    """The process of `dds_child`; its parameter is its lease (s)."""
    script = Path(__file__).with_name("dds_child.py")
    environment = os.environ | {"PYTHONPATH": str(script.parents[1]), "FAME_LEASE": getattr(request, "param", "3")}
    process = subprocess.Popen([sys.executable, "-W", "error", str(script), str(DOMAIN)], env=environment)
    yield process
    process.kill()
    process.wait()


def wait(condition: Callable[[], Any]) -> Any:
    """What the condition gives as soon as it is true."""
    deadline = time.monotonic() + TIMEOUT
    while not (result := condition()):
        assert time.monotonic() < deadline
        time.sleep(0.002)
    return result


def losses(here: WallWorld) -> list[str]:
    return [text for middleware in here.middlewares for text in middleware.losses()]


# ---- as ROS 2 sees it: plain Cyclone, with types of its own ---------------------------------------------------------


@pytest.fixture
def stranger(here: WallWorld) -> DomainParticipant:
    """A participant that knows nothing of us."""
    here.node("keeps_the_domain_open")
    return DomainParticipant(DOMAIN)


RELIABLE = Qos(
    Policy.Reliability.Reliable(10**8),
    Policy.History.KeepLast(10),
    Policy.DataRepresentation(use_cdrv0_representation=True),
)
String = make_idl_struct("String_", "std_msgs.msg.dds_.String_", {"data": str})
Gid = make_idl_struct("Gid_", "rmw_dds_common.msg.dds_.Gid_", {"data": types.array[types.uint8, 16]})
NodeInfo = make_idl_struct(
    "NodeEntitiesInfo_",
    "rmw_dds_common.msg.dds_.NodeEntitiesInfo_",
    {
        "node_namespace": types.bounded_str[256],
        "node_name": types.bounded_str[256],
        "reader_gid_seq": types.sequence[Gid],
        "writer_gid_seq": types.sequence[Gid],
    },
)
Info = make_idl_struct(
    "ParticipantEntitiesInfo_",
    "rmw_dds_common.msg.dds_.ParticipantEntitiesInfo_",
    {"gid": Gid, "node_entities_info_seq": types.sequence[NodeInfo]},
)


def test_topics_and_types_have_the_names_of_ros_and_structs_understand_blobs(
    here: WallWorld, stranger: DomainParticipant
) -> None:
    seen: list[Any] = []
    node = here.node("us", "REX")
    node.subscription("chatter", TEXT, seen.append)
    publisher = node.publisher("/answer", TEXT)
    writer = DataWriter(stranger, Topic(stranger, "rt/REX/chatter", String), RELIABLE)
    reader = DataReader(stranger, Topic(stranger, "rt/answer", String), RELIABLE)
    here.connect("/REX/chatter", "/answer")
    wait(writer.get_matched_subscriptions)
    wait(reader.get_matched_publications)
    for text in ("", "a", "größer"):
        writer.write(String(text))
        publisher.publish(create(TEXT, text))
    here.until(lambda: len(seen) == 3)
    assert [message.data for message in seen] == ["", "a", "größer"]
    assert [sample.data for sample in reader.take(10)] == ["", "a", "größer"]


def test_endpoints_carry_type_hashes_and_participants_their_enclave(
    here: WallWorld, stranger: DomainParticipant
) -> None:
    here.node("us").publisher("/answer", TEXT, LATCHED)
    endpoints = builtin.BuiltinDataReader(stranger, builtin.BuiltinTopicDcpsPublication)
    found: dict[str, Any] = {}
    wait(lambda: found.update({end.topic_name: end for end in endpoints.take(100)}) or "rt/answer" in found)
    assert found["rt/answer"].type_name == "std_msgs::msg::dds_::String_"
    assert found["rt/answer"].qos[Policy.Userdata].data == f"typehash={codec.type_hash(TEXT)};numbered=2;".encode()
    assert found["ros_discovery_info"].type_name == "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"
    data = found["ros_discovery_info"].qos[Policy.Userdata].data
    assert data == b"typehash=RIHS01_91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e;"
    participants = builtin.BuiltinDataReader(stranger, builtin.BuiltinTopicDcpsParticipant).take(100)
    ours = next(one for one in participants if one.key == found["rt/answer"].participant_key)
    assert ours.qos[Policy.Userdata].data == b"enclave=/;"


def test_ros_discovery_info_says_which_endpoints_belong_to_which_node(
    here: WallWorld, stranger: DomainParticipant
) -> None:
    node = here.node("us", "REX")
    publisher, subscription = node.publisher("/x", TEXT), node.subscription("/y", TEXT, print)
    kept = Qos(Policy.Durability.TransientLocal, Policy.History.KeepAll, base=RELIABLE)
    reader = DataReader(stranger, Topic(stranger, "ros_discovery_info", Info), kept)
    ours = here.middlewares[-1].participant.discovery.participant
    latest: dict[bytes, Any] = {}

    def nodes() -> list[tuple[str, str, list[bytes], list[bytes]]]:
        latest.update({bytes(info.gid.data): info for info in reader.take(100)})
        return [
            (info.node_namespace, info.node_name, _gids(info.reader_gid_seq), _gids(info.writer_gid_seq))
            for info in (latest[ours].node_entities_info_seq if ours in latest else [])
        ]

    wait(lambda: nodes() == [("/REX", "us", [subscription.gid], [publisher.gid])])
    publisher.close()
    wait(lambda: nodes() == [("/REX", "us", [subscription.gid], [])])
    node.close()
    wait(lambda: nodes() == [] and ours in latest)


def _gids(sequence: Any) -> list[bytes]:
    return [bytes(gid.data) for gid in sequence]


def test_nodes_of_others_are_known_by_what_they_say_of_themselves(here: WallWorld, stranger: DomainParticipant) -> None:
    us = here.middlewares[0]
    writer = DataWriter(stranger, Topic(stranger, "rt/answer", String), RELIABLE)
    here.until(lambda: [info.publishers for info in us.graph()] == [(UNKNOWN_NODE,)])
    kept = Qos(Policy.Durability.TransientLocal, base=RELIABLE)
    teller = DataWriter(stranger, Topic(stranger, "ros_discovery_info", Info), kept)
    entry = NodeInfo("/DINGO/arm", "gripper", [], [Gid(list(writer.guid.bytes))])
    teller.write(Info(Gid(list(stranger.guid.bytes)), [entry]))
    here.until(lambda: [info.publishers for info in us.graph()] == [("/DINGO/arm/gripper",)])
    assert us.namespaces() == ["DINGO/arm"]
    stranger.__del__()
    here.until(lambda: (us.graph(), us.namespaces()) == ([], []))


def test_heartbeats_ask_before_a_closing_publisher_has_lingered() -> None:
    for network in (None, "eth0"):
        text = configuration(network)
        asks, lingers = (
            int(re.search(rf"<{name}[^>]*>(\d+)ms", text)[1]) for name in ("HeartbeatInterval", "WriterLingerDuration")
        )
        assert asks < lingers


@pytest.mark.long
def test_every_type_can_be_declared(here: WallWorld, stranger: DomainParticipant) -> None:
    kinds = [(name, header) for name in messages.types() for header in (False, True)]
    topics = [Topic(stranger, "rt/x", wire.declared(*kind)) for kind in kinds]
    assert [topic.typename for topic in topics] == [wire.dds_type(name) for name, _ in kinds]


@pytest.mark.long
@pytest.mark.skipif(not WIRE.exists(), reason="needs samples.json of ros2_jazzy_wire")
def test_what_real_ros_writes_passes_cyclone_unchanged(stranger: DomainParticipant) -> None:
    topics = []  # kept: Cyclone crashes when types are declared after others were deleted (`fame.middleware.dds.wire`)
    for number, sample in enumerate(json.loads(WIRE.read_text())["samples"]):
        topics.append(topic := Topic(stranger, f"rt/t{number}", wire.declared(sample["type"], False)))
        writer, reader = DataWriter(stranger, topic, RELIABLE), DataReader(stranger, topic, RELIABLE)
        data = bytes.fromhex(sample["cdr"])
        writer.write(topic.data_type(data))
        (taken,) = reader.take(2)
        assert taken.data.rstrip(b"\0") == data.rstrip(b"\0")
        assert codec.deserialize(taken.data, sample["type"]) == codec.deserialize(data, sample["type"])


def test_a_request_has_two_numbers_before_its_fields_and_the_response_the_same(
    here: WallWorld, stranger: DomainParticipant
) -> None:
    here.node("gripper").service("/grip", "std_srvs/SetBool", lambda request: {"success": request.data})
    numbers = {"guid": types.uint64, "sequence_number": types.int64}
    asked = make_idl_struct("Q", "std_srvs.srv.dds_.SetBool_Request_", numbers | {"data": bool})
    told = make_idl_struct("R", "std_srvs.srv.dds_.SetBool_Response_", numbers | {"success": bool, "message": str})
    quality = Qos(Policy.Userdata(b"clientid=1.2.3;"), base=RELIABLE)
    writer = DataWriter(stranger, Topic(stranger, "rq/gripRequest", asked), quality)
    reader = DataReader(stranger, Topic(stranger, "rr/gripReply", told), quality)
    wait(writer.get_matched_subscriptions)
    wait(reader.get_matched_publications)
    writer.write(asked(guid=2**63 + 5, sequence_number=7, data=True))
    answers: list[Any] = []
    here.until(lambda: answers.extend(reader.take(2)) or answers)
    assert [(one.guid, one.sequence_number, one.success) for one in answers] == [(2**63 + 5, 7, True)]


def test_participants_that_discover_at_the_same_time_do_not_mix_up_what_they_see() -> None:
    """Each has a thread of its own, and all of cyclonedds' getters write to the same places."""
    usual, switch = QoS(), sys.getswitchinterval()
    other = QoS("best_effort", "transient_local", deadline=2.0, liveliness="manual_by_topic", lease_duration=0.5)
    wrong: list[QoS] = []

    def read(expected: QoS) -> None:
        policies = _CQos.qos_to_cqos(wire.to_dds(expected, "typehash=x;", writes=True))
        for _ in range(3000):
            found, _ = cyclone.policies_at(policies)
            if found != expected:
                wrong.append(found)
        _CQos.cqos_destroy(policies)

    threads = [threading.Thread(target=read, args=(qos,)) for qos in (usual, other)]
    sys.setswitchinterval(1e-6)
    try:
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(switch)
    assert wrong == []


def test_a_version_of_cyclonedds_without_what_is_used_is_refused_by_name() -> None:
    with pytest.raises(UnavailableError, match=r"cyclonedds \S+ has no Entity._gone: pip install cyclonedds==11.0.1"):
        cyclone.check_version(((Entity, ("__del__", "_gone")),))


def test_a_reader_of_discovery_without_the_conversion_that_is_replaced_is_refused(stranger: DomainParticipant) -> None:
    reader = builtin.BuiltinDataReader(stranger, builtin.BuiltinTopicDcpsParticipant)
    del reader._cqos_conv
    with pytest.raises(UnavailableError, match=r"cyclonedds \S+ has no BuiltinDataReader._cqos_conv"):
        cyclone.read_policies(reader)


def test_a_wait_set_raises_for_an_entity_that_is_deleted_or_not_attached(stranger: DomainParticipant) -> None:
    waitset = cyclone.KeyedWaitSet(stranger)
    deleted, other = GuardCondition(stranger), GuardCondition(stranger)
    cyclone.delete(deleted)
    with pytest.raises(DDSException, match="attaching to a wait set"):
        waitset.attach(deleted, 1)
    with pytest.raises(DDSException, match="detaching from a wait set"):
        waitset.detach(other)
    waitset.attach(other, 2)
    other.set(True)
    assert waitset.wait(0) == [2]
    waitset.detach(other)
    assert waitset.wait(0) == []
    waitset.close()


# ---- what goes wrong -------------------------------------------------------------------------------------------------


def test_bytes_that_are_no_message_are_dropped_and_reported(here: WallWorld, stranger: DomainParticipant) -> None:
    seen: list[Any] = []
    here.node("a").subscription("/x", TEXT, seen.append)
    publisher = here.node("b").publisher("/x", TEXT)
    here.connect("/x")
    writer = DataWriter(stranger, Topic(stranger, "rt/x", wire.declared(TEXT, False)), RELIABLE)
    wait(writer.get_matched_subscriptions)
    writer.write(writer.data_type(b"\0\1\0\0\4\0\0\0\xff\xfe\xfd\0"))  # passes Cyclone, but is no UTF-8
    publisher.publish(create(TEXT, "good"))
    here.until(lambda: seen and here.warnings)  # in any order: they come from two writers
    assert [message.data for message in seen] == ["good"]
    (warning,) = here.warnings
    assert warning.startswith("/x: dropped a message: std_msgs/msg/String: cannot read 12 bytes of CDR")
    assert losses(here) == []
    for _ in range(3):
        writer.write(writer.data_type(b"\0\1\0\0\5\0\0\0\xff\xfe\xfd\xfc\0\0\0\0"))
    publisher.publish(create(TEXT, "again"))
    here.until(lambda: losses(here) == ["/x: /a could not read 3 more messages"] and len(seen) == 2)
    assert here.warnings == [warning]


@pytest.mark.parametrize("name", ["/weed found", "/2fast", "/a//b", "/ümlaut"])
def test_a_name_that_ros_2_refuses_is_refused(here: WallWorld, name: str) -> None:
    node = here.node("a")
    with pytest.raises(MessageError, match=re.escape(f"{name}: ROS 2 refuses this name")):
        node.publisher(name, TEXT)
    with pytest.raises(MessageError, match=re.escape(f"{name}: ROS 2 refuses this name")):
        node.client(name, "std_srvs/Trigger")


def test_a_name_that_is_longer_than_ros_2_allows_is_refused_and_the_longest_is_taken(here: WallWorld) -> None:
    node = here.node("a")
    node.publisher("/" + "x" * 246, TEXT)
    for length in (247, 70_000):
        with pytest.raises(MessageError, match=f"a name of {length + 1} characters"):
            node.subscription("/" + "x" * length, TEXT, print)


def test_a_field_that_was_given_what_it_cannot_hold_is_refused_when_published(here: WallWorld) -> None:
    publisher = here.node("a").publisher("/x", INT)
    message = create(INT)
    message.data = "one"
    with pytest.raises(MessageError, match="std_msgs/msg/Int64: data: expected an integer"):
        publisher.publish(message)


def test_topics_without_a_counterpart_are_named_when_waiting_is_over(here: WallWorld) -> None:
    node, other = here.node("a"), here.node("b")
    node.publisher("/alone", INT)
    node.publisher("/own", INT)
    node.subscription("/own", INT, print)
    node.publisher("/both", INT)
    other.subscription("/both", INT, print)
    middleware = here.middlewares[0]
    assert middleware.wait_matched(["/both", "/not_ours"], TIMEOUT) == []
    assert middleware.wait_matched(["/alone", "/both", "/own"], 0.02) == ["/alone", "/own"]


def test_a_subscriber_may_come_while_subscribers_are_counted(here: WallWorld) -> None:
    publisher, other = here.node("a").publisher("/x", TEXT), here.node("b")
    other.subscription("/x", TEXT, print)
    here.connect("/x")
    writer = publisher._writer  # type: ignore[attr-defined]
    ask = writer._get_matched_subscriptions

    def ask_late(*words: Any) -> int:
        """Asked for how many there were a moment ago: one has come."""
        if words[2] == 1:
            other.subscription("/x", TEXT, print)
            wait(lambda: ask(words[0], None, 0) == 2)
        return int(ask(*words))

    writer._get_matched_subscriptions = ask_late
    assert publisher.subscriber_count() == 2  # type: ignore[attr-defined]


def test_a_message_older_than_its_lifespan_is_not_kept_for_late_comers(here: WallWorld) -> None:
    seen: list[int] = []
    publisher = here.node("a").publisher("/map", INT, QoS(durability="transient_local", lifespan=0.05))
    publisher.publish(create(INT, 1))
    time.sleep(0.06)
    here.node("b").subscription("/map", INT, lambda message: seen.append(message.data), LATCHED)
    here.until(lambda: publisher.publish(create(INT, 2)) or seen)
    assert {*seen} == {2}


# ---- domains and networks --------------------------------------------------------------------------------------------


def test_the_domain_is_that_of_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    assert (domain_id(), domain_id(7)) == (0, 7)
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    assert (domain_id(), domain_id(7)) == (42, 7)
    for wrong in ("233", "-1", "one", "1.0", "9" * 30, "000000001234"):
        monkeypatch.setenv("ROS_DOMAIN_ID", wrong)
        with pytest.raises(ConfigError, match=f"ROS_DOMAIN_ID: expected a domain from 0 to 232, got '{wrong}'"):
            domain_id()


def test_a_process_without_a_socket_is_not_bound_to_loopback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(domain, "sockets", lambda number: iter(()))
    assert domain.bind_to_loopback(0) is False


def test_after_many_warnings_the_last_one_says_that_there_may_be_others() -> None:
    told: list[EndpointWarning] = []
    scheduler = Scheduler()
    warn = WarningsOnce(scheduler, told.append)
    for number in range(1100):
        warn(EndpointWarning(f"/x{number}", "is not read", "dropped"))
    scheduler.run(0)
    assert len(warn.kept) == len(told) == 1001
    assert told[-1].text == "after 1000 warnings no others are kept"


def test_nodes_of_another_domain_do_not_exist(here: WallWorld) -> None:
    elsewhere = DdsMiddleware(here.scheduler, domain=DOMAIN + 1)
    elsewhere.node("a", "THERE").publisher("/x", INT)
    here.node("b", "HERE").publisher("/x", INT)
    time.sleep(0.05)
    assert (here.middlewares[0].node_names(), elsewhere.node_names()) == (["/HERE/b"], ["/THERE/a"])
    elsewhere.close()


@pytest.mark.skipif(sys.platform != "linux", reason="asks the Linux kernel")
def test_nothing_is_heard_but_over_loopback(here: WallWorld) -> None:
    here.node("a")
    devices = []
    for end in sockets(DOMAIN):
        with end:
            devices.append(end.getsockopt(socket.SOL_SOCKET, 25, 16))  # SO_BINDTODEVICE
    assert devices == [b"lo\0"] * 2
    assert here.middlewares[0].confined


def test_where_sockets_cannot_be_tied_to_loopback_the_domain_does_not_count_as_confined(
    here: WallWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "platform", "another")
    middleware = DdsMiddleware(here.scheduler, domain=DOMAIN + 1)
    assert not middleware.confined
    middleware.close()


def test_the_network_opens_only_where_it_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CYCLONEDDS_URI", "<Discovery/>")
    assert 'address="127.0.0.1" multicast="false"' in configuration(None)
    assert not configuration(None).endswith("<Discovery/>")
    assert 'NetworkInterface name="eth0"/' in configuration("eth0")
    assert 'NetworkInterface address="10.0.0.7"/' in configuration("10.0.0.7")
    assert configuration("eth0").endswith(",<Discovery/>")


def test_an_interface_that_is_not_there_is_refused(here: WallWorld, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ConfigError, match=f"domain {DOMAIN + 1} on no_such_interface"):
        DdsMiddleware(here.scheduler, domain=DOMAIN + 1, network="no_such_interface")
    here.node("a")
    with pytest.raises(ConfigError, match="open in this process already, on another network"):
        DdsMiddleware(here.scheduler, domain=DOMAIN, network="no_such_interface")


# ---- the scheduler that waits in DDS ---------------------------------------------------------------------------------


@pytest.fixture
def resting() -> Iterator[WallWorld]:
    """All nodes in one participant, and a scheduler that waits for its data."""
    world = dds_world(apart=False)
    world.node("us")
    yield world
    world.close()


def test_timers_run_in_their_order_while_it_waits_for_data(resting: WallWorld) -> None:
    scheduler, fired = resting.scheduler, list[int]()
    for delay in (30, 10, 20):
        due = scheduler.now + delay * MILLISECOND
        scheduler.at(due, lambda due=due, delay=delay: fired.append(delay if scheduler.now >= due else -delay))
    scheduler.run(until=scheduler.now + 40 * MILLISECOND)
    assert fired == [10, 20, 30]


def test_other_threads_wake_it(resting: WallWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fame.middleware.data_scheduler._MAX_WAIT", 60 * SECOND)
    scheduler, seen = resting.scheduler, threading.Event()
    began = time.monotonic()

    def wake() -> None:
        scheduler.soon(seen.set)
        seen.wait(TIMEOUT)
        scheduler.stop()

    threading.Timer(0.02, wake).start()
    scheduler.run()
    assert seen.is_set()
    assert time.monotonic() - began < TIMEOUT


def test_a_signal_stops_it(resting: WallWorld) -> None:
    began = time.monotonic()
    previous = signal.signal(signal.SIGUSR1, lambda *_: resting.scheduler.stop())
    threading.Timer(0.02, lambda: os.kill(os.getpid(), signal.SIGUSR1)).start()
    resting.scheduler.run()
    signal.signal(signal.SIGUSR1, previous)
    assert time.monotonic() - began < TIMEOUT


def test_messages_come_through_while_there_is_always_something_due(resting: WallWorld) -> None:
    scheduler, seen = resting.scheduler, list[Any]()
    resting.middlewares[0].node("reader").subscription("/x", INT, seen.append)
    publisher = resting.middlewares[0].node("writer").publisher("/x", INT)

    def busy() -> None:
        scheduler.soon(busy if not seen else scheduler.stop, Kind.TIMER)

    publisher.publish(create(INT, 1))
    busy()
    scheduler.after(5 * SECOND, scheduler.stop)
    scheduler.run()
    assert seen == [create(INT, 1)]


def test_it_is_a_plain_scheduler_before_and_after_its_middleware() -> None:
    scheduler, seen = DdsScheduler(), list[int]()
    scheduler.soon(lambda: seen.append(1))
    scheduler.run(until=scheduler.now)
    middleware = DdsMiddleware(scheduler, domain=DOMAIN)
    waiter = scheduler.waiter
    assert waiter is not None
    scheduler.soon(middleware.close)
    scheduler.soon(lambda: seen.append(2))
    scheduler.run(until=scheduler.now + MILLISECOND)
    assert (scheduler.waiter, seen) == (None, [1, 2])
    waiter.wake()  # as another thread does that had seen it before


# ---- coming and going ------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_after_many_deployments_everything_is_where_it_was(here: WallWorld) -> None:
    node, other = here.node("engine", "REX"), here.node("world")
    other.subscription("/a", TEXT, id)

    def deploy() -> None:
        publisher = node.publisher("/a", TEXT)
        ends: list[Any] = [
            publisher,
            node.subscription("/a", TEXT, id),
            node.subscription("/b", "nav_msgs/Odometry", id),
            node.service("/s", "std_srvs/Trigger", lambda request: None),
            node.client("/s", "std_srvs/Trigger"),
        ]
        publisher.publish(create(TEXT))
        for end in ends:
            end.close()
        here.scheduler.run(until=here.scheduler.now)

    def present() -> tuple[list[int], int, int, list[int]]:
        gc.collect()
        topics = [len(middleware.graph()) for middleware in here.middlewares]
        ends = [len(middleware.participant.discovery.endpoints) for middleware in here.middlewares]
        return topics, threading.active_count(), len(Entity._entities), ends

    deploy()
    last = [f"/{name}/set_parameters_atomically" for name in ("REX/engine", "world")]
    here.until(lambda: all(middleware.offers(name) for middleware in here.middlewares for name in last))
    here.until(lambda: present()[0] == [1, 1])
    before = present()
    for _ in range(50):
        deploy()
    here.until(lambda: present() == before)


def test_whoever_leaves_leaves_its_types_to_others_of_the_process(here: WallWorld) -> None:
    here.node("staying")
    for topic, type in (("/a", "nav_msgs/msg/Path"), ("/b", "nav_msgs/msg/Odometry")):
        here.node(topic[1:]).publisher(topic, type)
    staying, *leaving = here.middlewares
    for middleware in reversed(leaving):
        middleware.close()
    assert staying.participant.entities.types >= {"nav_msgs/msg/Path", "nav_msgs/msg/Odometry"}


def test_a_middleware_that_closed_leaves_no_thread_and_is_gone_for_the_others(here: WallWorld) -> None:
    here.node("staying")
    threads = threading.active_count()
    here.node("leaving").publisher("/x", TEXT)
    here.until(lambda: "/leaving" in here.middlewares[0].node_names())
    here.middlewares.pop().close()
    here.until(lambda: here.middlewares[0].node_names() == ["/staying"])
    assert here.middlewares[0].graph() == []
    assert threading.active_count() == threads


# ---- other processes -------------------------------------------------------------------------------------------------


@pytest.mark.processes
@pytest.mark.parametrize("child", ["100"], indirect=True)  # so long is one there that says no farewell
def test_a_process_that_just_ends_has_said_everything_and_is_gone_at_once(
    here: WallWorld, child: subprocess.Popen[bytes]
) -> None:
    heard: list[str] = []
    kept: list[str] = []
    node = here.node("parent")
    ask = node.publisher("/ask", TEXT)
    node.subscription("/answer", TEXT, lambda message: heard.append(message.data))
    node.subscription("/map", TEXT, lambda message: kept.append(message.data), LATCHED)
    client = node.client("/OTHER/twice", "std_srvs/SetBool")
    here.connect("/ask", "/answer", "/map")
    here.until(lambda: kept and client.available)
    client.call(True, lambda response: heard.append(response.message))
    here.until(lambda: heard == ["TrueTrue"])
    ask.publish(create(TEXT, "weed"))
    here.until(lambda: heard == ["TrueTrue", "WEED"])
    here.until(lambda: here.middlewares[0].node_names() == ["/OTHER/child", "/parent"])
    assert kept == ["here be dragons"]
    heard.clear()
    ask.publish(create(TEXT, "leave"))
    here.until(lambda: len(heard) == FAREWELLS)
    assert (child.wait(), heard) == (0, [str(number) for number in range(FAREWELLS)])
    here.until(lambda: here.middlewares[0].node_names() == ["/parent"])


@pytest.fixture
def together() -> Iterator[WallWorld]:
    """One participant, whose data only the scheduler takes: no other thread does in between."""
    world = dds_world(apart=False)
    yield world
    world.close()


def test_that_more_may_be_lost_of_a_publisher_that_has_sent_before_is_said(together: WallWorld) -> None:
    here, seen = together, list[int]()
    publisher = here.node("a").publisher("/x", INT)
    publisher.publish(create(INT, -1))
    here.node("b").subscription("/x", INT, lambda message: seen.append(message.data), QoS(depth=10))
    here.connect("/x")
    for number in range(100):
        publisher.publish(create(INT, number))
    here.until(lambda: 99 in seen)
    assert seen == [*range(90, 100)]
    text = "/x: /b lost at least 1 messages, which came faster than it takes them or not at all"
    assert losses(here) == [text]


def test_a_subscription_that_joins_late_has_lost_nothing(here: WallWorld) -> None:
    seen: list[int] = []
    publisher = here.node("a").publisher("/x", INT, QoS(durability="transient_local"))
    for number in range(50):
        publisher.publish(create(INT, number))
    for name, durability in (("b", "volatile"), ("c", "transient_local")):
        qos = QoS(durability=durability)
        here.node(name).subscription("/x", INT, lambda message: seen.append(message.data), qos)
    here.connect("/x")
    publisher.publish(create(INT, 50))
    publisher.publish(create(INT, 51))
    here.until(lambda: seen.count(51) == 2)
    assert losses(here) == []


def test_that_more_may_be_lost_of_a_publisher_that_numbers_nothing_is_said(together: WallWorld) -> None:
    here, seen = together, list[str]()

    def work(message: Any) -> None:
        seen.append(message.data)
        for number in range(100 if message.data == "begin" else 0):
            writer.write(String(str(number)))

    here.node("b").subscription("/x", TEXT, work, QoS(depth=10))
    stranger = DomainParticipant(DOMAIN)
    writer = DataWriter(stranger, Topic(stranger, "rt/x", String), RELIABLE)
    here.connect("/x")
    wait(writer.get_matched_subscriptions)
    writer.write(String("begin"))
    here.until(lambda: "99" in seen)
    assert seen == ["begin", *map(str, range(90, 100))]
    text = "/x: /b lost at least 1 messages, which came faster than it takes them or not at all"
    assert losses(here) == [text]


@pytest.mark.processes
def test_a_process_that_is_killed_is_gone_when_its_lease_is_over_and_garbage_before_that_does_no_harm(
    here: WallWorld, child: subprocess.Popen[bytes]
) -> None:
    raw: list[Any] = []
    node = here.node("parent")
    node.subscription("/raw", TEXT, raw.append, SENSOR_DATA)
    here.connect("/raw")
    here.until(lambda: "/OTHER/child" in here.middlewares[0].node_names())
    (writer,) = (end for end in here.middlewares[0].participant.discovery.on_topic("rt/raw") if end.writes)
    for number, data in enumerate(GARBAGE, 1):
        _forge(writer.gid, number, data)
    _forge(writer.gid, len(GARBAGE) + 1, b"\0\1\0\0\4\0\0\0abc\0")
    here.until(lambda: raw)
    assert [message.data for message in raw] == ["abc"]
    child.kill()
    here.until(lambda: here.middlewares[0].node_names() == ["/parent"])
    here.until(lambda: [end for info in here.middlewares[0].graph() for end in info.publishers] == [])


GARBAGE = [
    b"",
    b"\0",
    b"\0\1\0\0",
    b"\0\1\0\0\xff\xff\xff\xffabc\0",
    b"\0\1\0\0\4\0\0\0abcd",
    b"\xff" * 64,
    bytes(range(256)),
]


def _forge(writer: bytes, number: int, data: bytes) -> None:
    """Send a sample in the name of a writer, as whoever wants to can: one RTPS DATA submessage, to all own sockets."""
    body = struct.pack("<HH4s4siI", 0, 16, bytes(4), writer[12:], 0, 1000 + number) + data
    packet = b"RTPS\2\1\1\x10" + writer[:12] + struct.pack("<BBH", 0x15, 0x05, len(body)) + body
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for index in range(0, 121):
            sender.sendto(packet, ("127.0.0.1", 7411 + 250 * DOMAIN + 2 * index))
