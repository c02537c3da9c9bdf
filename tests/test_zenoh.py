"""Zenoh: what is on the wire is what rmw_zenoh writes, processes find each other, and bad peers do no harm."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from domains import DOMAIN
from free_ports import free_port

pytest.importorskip("zenoh", reason="Zenoh is not installed: pip install 'fame-robots[zenoh]'")

import zenoh
from middleware_contract import WallWorld, needs, zenoh_world

from fame import cpython
from fame.clock import SECOND, WallScheduler
from fame.cpython import keep_thread_state
from fame.errors import ConfigError, MessageError
from fame.middleware import codec
from fame.middleware.interface import LATCHED, SENSOR_DATA, QoS, TopicInfo, known_topics
from fame.middleware.messages import create
from fame.middleware.zenoh import ZenohMiddleware, endpoints, session, tokens
from fame.middleware.zenoh.session import locators

pytestmark = pytest.mark.zenoh

ROOT = Path(__file__).parent.parent
TEXT, SET_BOOL = "std_msgs/msg/String", "std_srvs/srv/SetBool"
MEETING = 7448 + DOMAIN


@pytest.fixture
def here() -> Iterator[WallWorld]:
    made = zenoh_world(apart=True)
    yield made
    made.close()


# ---- the words of rmw_zenoh ------------------------------------------------------------------------------------------

TALKER = (
    "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MP/%/%/talker/%chatter/std_msgs::msg::dds_::String_/"
    "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18/::,10:,:,:,,"
)
"""The example of rmw_zenoh's design document."""


def test_the_token_of_a_ros_publisher_is_read_and_written_as_ros_does() -> None:
    talker = tokens.read_token(TALKER)
    assert talker is not None
    assert (talker.node, talker.namespace, talker.name, talker.type) == ("/talker", "", "/chatter", TEXT)
    assert (talker.kind, talker.qos) == (tokens.PUBLISHER, QoS(depth=10))
    assert codec.type_hash(TEXT) == talker.type_hash
    node = tokens.node_token(2, "aac3178e146ba6f1fc6e6a4085e77f21", 0, "", "talker")
    assert node == "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/talker"
    made = tokens.endpoint_token(node, tokens.PUBLISHER, 10, "/chatter", TEXT, talker.type_hash, talker.qos)
    assert made == TALKER


@pytest.mark.parametrize(
    ("qos", "text"),
    [
        (QoS(depth=7), "::,7:,:,:,,"),
        (SENSOR_DATA, "2::,5:,:,:,,"),
        (LATCHED, ":1:,1:,:,:,,"),
        (QoS(history="keep_all", depth=1), "::2,1:,:,:,,"),
        (QoS(depth=1, deadline=0.5, lifespan=2.25, liveliness="manual_by_topic", lease_duration=3.0),
         "::,1:0,500000000:2,250000000:3,3,0"),
    ],
)  # fmt: skip
def test_quality_of_service_is_the_text_that_ros_writes(qos: QoS, text: str) -> None:
    assert tokens.qos_text(qos) == text
    assert tokens.read_qos(text) == qos


def test_what_a_token_leaves_out_is_the_default_of_ros() -> None:
    assert tokens.read_qos("::,:,:,:,,") == QoS(depth=42)
    assert tokens.read_qos("1:2:1,9:9223372036,854775807:0,0:,:1,9223372036,854775807") == QoS(depth=9)


@pytest.mark.parametrize(
    "token",
    ["", "@ros2_lv/0", "other/0/a/0/0/NN/%/%/n", "@ros2_lv/0/a/0/0/XX/%/%/n", "@ros2_lv/0/a/0/1/MP/%/%/n",
     TALKER.replace("::,10:,:,:,,", "nonsense"), TALKER.replace(",10:", ",ten:"), TALKER + "x" * 3000],
)  # fmt: skip
def test_what_is_no_token_of_ros_is_nothing(token: str) -> None:
    assert tokens.read_token(token) is None


def test_an_attachment_is_number_time_and_gid() -> None:
    gid = tokens.gid_of(TALKER)
    data = tokens.Attachment(1, 1_700_000_000_123_456_789, gid).pack()
    assert data == (1).to_bytes(8, "little") + (1_700_000_000_123_456_789).to_bytes(8, "little") + b"\x10" + gid
    assert tokens.read_attachment(data) == (1, 1_700_000_000_123_456_789, gid)
    for wrong in (b"", data[:-1], data + b"\0", data[:16] + b"\x0f" + data[17:]):
        with pytest.raises(MessageError, match=f"expected an attachment of 33 bytes as ROS has it, got {len(wrong)}"):
            tokens.read_attachment(wrong)


def test_the_gid_of_an_endpoint_is_the_hash_of_its_token() -> None:
    import xxhash

    low, high = (
        number.to_bytes(8, "little") for number in divmod(xxhash.xxh3_128_intdigest(TALKER.encode()), 2**64)[::-1]
    )
    assert tokens.gid_of(TALKER) == low + high


@pytest.mark.parametrize(
    ("type", "hash"),
    [
        (SET_BOOL, "RIHS01_abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a"),
        ("std_srvs/srv/Trigger", "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"),
    ],
)
def test_the_hash_of_a_service_is_that_of_jazzy(type: str, hash: str) -> None:
    assert codec.service_hash(type) == hash


def test_the_hashes_of_an_action_are_those_of_jazzy() -> None:
    from fame.middleware.messages import register

    register("int32 order\n---\nint32[] sequence\n---\nint32[] sequence", "example_interfaces/action/Fibonacci")
    assert codec.service_hash("example_interfaces/action/Fibonacci_SendGoal").startswith("RIHS01_d1a57fb2a4afe8c21e34")
    assert codec.service_hash("example_interfaces/action/Fibonacci_GetResult").startswith("RIHS01_1b0de0d5d29dc955d92f")


# ---- an implementation that is not ours ------------------------------------------------------------------------------


class Sdk:
    """The process of `zenoh_sdk_child`."""

    def __init__(self) -> None:
        words = [sys.executable, str(ROOT / "tests" / "zenoh_sdk_child.py"), str(MEETING), str(DOMAIN)]
        path = os.pathsep.join((str(ROOT), *sys.path))
        self.process = subprocess.Popen(
            words, env=os.environ | {"PYTHONPATH": path}, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()

    def ask(self, what: str) -> str:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{what}\n")
        self.process.stdin.flush()
        return self.line()

    def close(self) -> None:
        self.process.kill()
        self.process.communicate()


@pytest.mark.processes
@needs("zenoh_ros2_sdk")
def test_a_node_of_another_implementation_talks_to_ours_and_ours_to_it(here: WallWorld) -> None:
    node = here.node("engine", "REX")
    publisher = node.publisher("/to_sdk", TEXT, QoS(depth=3))
    node.publisher("/map", TEXT, LATCHED).publish(create(TEXT, "of the field"))
    heard: list[str] = []
    node.subscription("/from_sdk", TEXT, lambda message: heard.append(message.data))
    node.service("/fame_switch", SET_BOOL, lambda request: {"success": request.data, "message": "done"})
    client, answers = node.client("/sdk_switch", SET_BOOL), list[Any]()
    sdk = Sdk()
    try:
        assert sdk.line() == "ready"
        here.until(lambda: client.available)
        here.until(lambda: heard == ["map of the field"])  # from before it came
        here.connect("/to_sdk", "/from_sdk")
        publisher.publish(create(TEXT, "hello ß"))
        here.until(lambda: heard[1:] == ["hello ß"])
        client.call({"data": True}, answers.append)
        here.until(lambda: answers)
        assert (answers[0].success, answers[0].message) == (True, "sdk: done")
        middleware = here.middlewares[0]
        assert {"/SDK/echo", "/REX/engine"} <= set(middleware.node_names())
        topics = {topic.name: topic for topic in middleware.graph()}
        assert topics["/from_sdk"].types == (TEXT,)
        assert topics["/from_sdk"].publishers == ("/SDK/echo",)
        here.until(lambda: middleware.offers("/REX/engine/set_parameters_atomically"))  # the last one
        types: list[str] = []
        threading.Thread(target=lambda: types.append(sdk.ask("parameters"))).start()  # our node answers meanwhile
        here.until(lambda: types)
        assert types == ["[1, 0]"]
        shown = sdk.ask("graph")
        assert "'/REX/engine'" in shown
        assert f"/to_sdk={TEXT}" in shown
        assert "'/REX/engine/list_parameters'" in shown
        assert "'/fame_switch', '/sdk_switch']" in shown
        assert "::,3:,:,:,," in shown
    finally:
        sdk.close()
    here.until(lambda: "/SDK/echo" not in middleware.node_names())


# ---- finding each other ----------------------------------------------------------------------------------------------


def test_another_process_takes_over_where_all_meet(here: WallWorld) -> None:
    here.node("first")
    second, third = here.node("second"), here.node("third")
    here.until(lambda: all(len(middleware.node_names()) == 3 for middleware in here.middlewares))
    here.middlewares.pop(0).close()
    here.until(lambda: all(middleware.node_names() == ["/second", "/third"] for middleware in here.middlewares))
    heard: list[str] = []
    third.subscription("/x", TEXT, lambda message: heard.append(message.data))
    publisher = second.publisher("/x", TEXT)
    here.connect("/x")
    publisher.publish(create(TEXT, "without the first"))
    here.until(lambda: heard == ["without the first"])
    here.until(lambda: any(middleware._meeting for middleware in here.middlewares))
    here.node("fourth")
    here.until(lambda: all(len(middleware.node_names()) == 3 for middleware in here.middlewares))


def test_a_crowd_meets_in_one_process_and_talks_through_it(here: WallWorld) -> None:
    here.node("hall")
    first, second = (ZenohMiddleware(here.scheduler, domain=DOMAIN, crowd=2) for _ in range(2))
    here.middlewares += [first, second]
    here.until(lambda: str(here.middlewares[0].id) in map(str, first.session.info.routers_zid()))
    assert not list(first.session.info.peers_zid()) + list(second.session.info.peers_zid())
    heard: list[str] = []
    second.node("listener").subscription("/x", TEXT, lambda message: heard.append(message.data))
    publisher = first.node("talker").publisher("/x", TEXT)
    here.until(publisher.matched)
    here.until(lambda: publisher.publish(create(TEXT, "through the hall")) or bool(heard))
    assert set(heard) == {"through the hall"}


def test_one_of_a_crowd_learns_of_all_nodes_and_of_the_topics_that_it_has_to_do_with(here: WallWorld) -> None:
    talker, hall = here.node("talker", "B"), here.middlewares[0]
    for topic in ("status", "/A/order", "/found", "/elsewhere"):
        talker.publisher(topic, TEXT)
    listener = here.node("listener", "B")
    listener.subscription("/C/status", TEXT, lambda message: None)
    member = ZenohMiddleware(here.scheduler, domain=DOMAIN, crowd=2)
    here.middlewares.append(member)
    robot = member.node("robot", "A")
    robot.subscription("/found", TEXT, lambda message: None)

    def names(topics: Iterable[TopicInfo]) -> list[str]:
        return [info.name for info in topics]

    own = ["/A/order", "/found"]
    here.until(lambda: (member.namespaces(), names(known_topics(member))) == (["A", "B"], own))
    assert names(known_topics(member, ["/*/status"], publishers=True)) == ["/A/order", "/B/status", "/found"]
    assert names(known_topics(hall)) == names(hall.graph())
    assert names(member.graph()) == ["/A/order", "/B/status", "/C/status", "/elsewhere", "/found"]


@pytest.mark.parametrize("crowd", [0, 2])
def test_a_server_that_left_unnoticed_is_forgotten_when_a_request_has_no_response(here: WallWorld, crowd: int) -> None:
    """Of a hundred sessions that declare a subscriber while a token leaves, three to eight keep it."""
    here.node("hall").service("/there", SET_BOOL, lambda request: None)
    asker = ZenohMiddleware(here.scheduler, domain=DOMAIN, crowd=crowd)
    here.middlewares.append(asker)
    there, gone = (asker.node("asker").client(name, SET_BOOL) for name in ("/there", "/gone"))
    here.until(lambda: there.available)
    node, type_hash = tokens.node_token(DOMAIN, "5ee", 1, "", "gone"), codec.service_hash(SET_BOOL)
    for name in ("/there", "/gone"):
        token = tokens.endpoint_token(node, tokens.SERVICE, 1, name, SET_BOOL, type_hash, QoS(depth=10))
        asker.entities.add(tokens.entity(token))
    told: list[str] = []
    gone.call(None, lambda response: told.append("answered"), lambda: told.append("lost"))
    there.call(None, lambda response: told.append("answered"), lambda: told.append("lost"))
    here.until(lambda: len(told) == 2)
    assert told == ["answered", "lost"]
    assert not gone.available
    assert there.available
    asker.doubt("/there")
    here.until(lambda: len(asker.offers("/there")) == 1)


def test_a_crowd_and_a_busy_machine_have_a_longer_lease(monkeypatch: pytest.MonkeyPatch) -> None:
    def leases(load: float) -> list[int]:
        monkeypatch.setattr(os, "getloadavg", lambda: (load * (os.cpu_count() or 1), 0.0, 0.0))
        return [value for crowd in (0, 2, 100) for value in session._confined(crowd).values()]

    assert leases(0.2) == [10_000, 10_000, 100_000]
    assert leases(3.0) == [30_000, 30_000, 100_000]
    assert leases(60.0) == [50_000, 50_000, 100_000]


@pytest.mark.processes
def test_publishers_with_history_come_and_go_while_their_own_process_listens() -> None:
    """In a process of its own: what this is about is that nobody waits for ever."""
    done = subprocess.run(
        [sys.executable, "-c", COMING_AND_GOING, str(DOMAIN)],
        env=os.environ | {"PYTHONPATH": os.pathsep.join((str(ROOT), *sys.path))},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (done.stdout, done.returncode) == ("done\n", 0), done


COMING_AND_GOING = """
import sys, threading
from fame.middleware.data_scheduler import DataScheduler
from fame.middleware.interface import LATCHED
from fame.middleware.messages import create
from fame.middleware.zenoh import ZenohMiddleware

TEXT = "std_msgs/msg/String"
scheduler = DataScheduler()
mine, other = (ZenohMiddleware(each, domain=int(sys.argv[1])) for each in (scheduler, DataScheduler()))
mine.node("listener").subscription("/x", TEXT, lambda message: None, LATCHED)
flood, over = other.node("other").publisher("/x", TEXT, LATCHED), threading.Event()

def publish() -> None:
    while not over.is_set():
        flood.publish(create(TEXT, "x"))

thread = threading.Thread(target=publish)
thread.start()
for _ in range(100):
    node = mine.node("short")
    node.publisher("/x", TEXT, LATCHED)
    scheduler.run(scheduler.now + 1_000_000)
    node.close()
over.set()
thread.join()
mine.close()
other.close()
print("done")
"""


def test_domains_do_not_hear_each_other(here: WallWorld) -> None:
    here.node("a").publisher("/x", TEXT)
    other = ZenohMiddleware(here.scheduler, domain=DOMAIN + 1)
    other.node("b").subscription("/x", TEXT, print)
    here.settle()
    assert other.node_names() == ["/b"]
    assert here.middlewares[0].node_names() == ["/a"]
    other.close()


def test_nothing_listens_beyond_loopback(here: WallWorld) -> None:
    here.node("a")
    here.node("b")
    assert all(middleware.confined for middleware in here.middlewares)
    tables = [Path(f"/proc/self/net/{name}").read_text().splitlines()[1:] for name in ("tcp", "tcp6")]
    listening = [line.split() for table in tables for line in table]
    inodes = {os.readlink(f"/proc/self/fd/{name}") for name in os.listdir("/proc/self/fd") if _is_link(name)}
    ours = {words[1] for words in listening if words[3] == "0A" and f"socket:[{words[9]}]" in inodes}
    assert ours
    assert {address.split(":")[0] for address in ours} == {"0100007F"}  # 127.0.0.1


def _is_link(name: str) -> bool:
    return os.path.islink(f"/proc/self/fd/{name}")


# ---- routers ---------------------------------------------------------------------------------------------------------


class Router:
    """A ``fame router`` on loopback."""

    def __init__(self, port: int, *words: str) -> None:
        line = [sys.executable, "-m", "fame", "router", "--port", str(port), *words]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join((str(ROOT), *sys.path))}
        self.process = subprocess.Popen(line, env=environment, stderr=subprocess.PIPE, text=True)
        assert self.process.stderr is not None
        assert "Ctrl-C ends it" in self.process.stderr.readline()

    def kill(self) -> None:
        self.process.kill()
        self.process.communicate()


def through(scheduler: WallScheduler, router: str) -> ZenohMiddleware:
    return ZenohMiddleware(scheduler, domain=DOMAIN, network=router)


def run_until(scheduler: WallScheduler, holds: Any) -> None:
    deadline = scheduler.now + 60 * SECOND
    while not holds():
        assert scheduler.now < deadline
        scheduler.run(scheduler.now + SECOND // 100)


@pytest.mark.processes
def test_a_router_says_that_the_other_one_does_not_answer() -> None:
    port = free_port()
    router = Router(free_port(), "--connect", f"127.0.0.1:{port}")
    try:
        assert router.process.stderr is not None
        said = router.process.stderr.readline()
    finally:
        router.kill()
    assert said == f"fame: warning: no router answers at tcp/127.0.0.1:{port}; it keeps trying\n"


@pytest.mark.processes
def test_a_router_that_dies_keeps_nobody_from_talking_and_one_that_comes_back_brings_the_others() -> None:
    port, scheduler, heard = free_port(), WallScheduler(), list[str]()
    router = Router(port)
    team = [through(scheduler, f"127.0.0.1:{port}") for _ in range(2)]
    try:
        assert not any(middleware.confined for middleware in team)
        team[1].node("b").subscription("/x", TEXT, lambda message: heard.append(message.data))
        publisher = team[0].node("a").publisher("/x", TEXT)
        run_until(scheduler, publisher.matched)
        router.kill()
        publisher.publish(create(TEXT, "without a router"))
        run_until(scheduler, lambda: heard == ["without a router"])
        router = Router(port)
        team.append(through(scheduler, f"127.0.0.1:{port}"))
        team[2].node("c").subscription("/x", TEXT, lambda message: heard.append(message.data))
        run_until(scheduler, lambda: publisher.subscriber_count() == 2)
        publisher.publish(create(TEXT, "again"))
        run_until(scheduler, lambda: heard == ["without a router", "again", "again"])
    finally:
        for middleware in team:
            middleware.close()
        router.kill()


@pytest.mark.processes
def test_two_routers_connect_their_machines() -> None:
    ports, scheduler, heard = [free_port(), free_port()], WallScheduler(), list[str]()
    routers = [Router(ports[0]), Router(ports[1], "--connect", f"127.0.0.1:{ports[0]}")]
    team = [through(scheduler, f"127.0.0.1:{port}") for port in ports]
    try:
        team[1].node("b").subscription("/x", TEXT, lambda message: heard.append(message.data))
        publisher = team[0].node("a").publisher("/x", TEXT)
        run_until(scheduler, publisher.matched)
        run_until(scheduler, lambda: heard or publisher.publish(create(TEXT, "far away")))
    finally:
        for middleware in team:
            middleware.close()
        for router in routers:
            router.kill()


def test_addresses_of_routers() -> None:
    assert locators("10.0.0.7, depot:7450") == ["tcp/10.0.0.7:7447", "tcp/depot:7450"]
    assert locators("tls/depot.example:7447") == ["tls/depot.example:7447"]


def test_a_configuration_file_that_zenoh_refuses_is_named(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text("{ mode: 'captain' }")
    with pytest.raises(ConfigError, match=f"{file}: expected a configuration of Zenoh"):
        ZenohMiddleware(WallScheduler(), domain=DOMAIN, network=str(file))


# ---- peers that do wrong ---------------------------------------------------------------------------------------------


@pytest.fixture
def stranger(here: WallWorld) -> Iterator[Any]:
    """A session of Zenoh that follows no rule; `here` has a node /a with a subscription to /x."""
    here.heard = []  # type: ignore[attr-defined]
    here.node("a").subscription("/x", TEXT, lambda message: here.heard.append(message.data))  # type: ignore[attr-defined]
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", '["tcp/127.0.0.1:0"]')
    config.insert_json5("connect/endpoints", f'["tcp/127.0.0.1:{MEETING}"]')
    session = zenoh.open(config)
    yield session
    session.close()


def key(type_hash: str = "") -> str:
    return tokens.topic_key(DOMAIN, "/x", TEXT, type_hash or codec.type_hash(TEXT))


def token_of(number: int, **changes: str) -> str:
    node = tokens.node_token(DOMAIN, "5ee", number, "", changes.get("node", "stranger"))
    type_hash = changes.get("type_hash", codec.type_hash(TEXT))
    return tokens.endpoint_token(node, tokens.PUBLISHER, number, "/x", TEXT, type_hash, QoS(depth=1))


def test_garbage_attachments_and_garbage_messages_are_dropped_with_a_warning(here: WallWorld, stranger: Any) -> None:
    middleware, good = here.middlewares[0], tokens.attachment(1, bytes(16))
    for data, attached in ((b"x", None), (b"x", b"nonsense"), (b"\xff" * 40, good), (b"", good)):
        stranger.put(key(), data, attachment=attached)
    stranger.put(key(), codec.serialize(create(TEXT, "fine")), attachment=good)
    here.until(lambda: here.heard == ["fine"])  # type: ignore[attr-defined]
    (warning,) = [str(text) for text in middleware.warnings]
    assert warning == "/x: dropped a message: expected an attachment of 33 bytes as ROS has it, got 0 bytes"
    assert middleware.losses() == ["/x: /a could not read 3 more messages"]


def test_threads_of_zenoh_keep_their_state(here: WallWorld, stranger: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    local, made, calls = threading.local(), list[int](), list[int]()

    def kept() -> None:
        keep_thread_state()
        calls.append(threading.get_ident())
        if not hasattr(local, "known"):  # it is gone with the state of the thread
            made.append(threading.get_ident())
            local.known = True

    monkeypatch.setattr(endpoints, "keep_thread_state", kept)
    for _ in range(20):
        stranger.put(key(), codec.serialize(create(TEXT, "x")), attachment=tokens.attachment(1, bytes(16)))
    here.until(lambda: len(here.heard) == 20)  # type: ignore[attr-defined]
    assert len(calls) == 20
    assert sorted(made) == sorted(set(calls))


def test_a_thread_that_has_the_number_of_one_that_ended_keeps_its_state_too(monkeypatch: pytest.MonkeyPatch) -> None:
    kept: list[int] = []
    monkeypatch.setattr(cpython, "_API", SimpleNamespace(PyGILState_Ensure=lambda: kept.append(threading.get_ident())))
    for _ in range(3):
        thread = threading.Thread(target=lambda: [keep_thread_state() for _ in range(2)])
        thread.start()
        thread.join()
    assert len(kept) == 3, kept


def test_a_publisher_with_another_definition_of_the_type_is_not_heard_and_named(here: WallWorld, stranger: Any) -> None:
    wrong = f"RIHS01_{'0' * 64}"
    stranger.liveliness().declare_token(token_of(1, type_hash=wrong))
    stranger.put(key(wrong), codec.serialize(create(TEXT, "no")), attachment=tokens.attachment(1, bytes(16)))
    here.until(lambda: here.warnings)
    assert list(map(str, here.warnings)) == [
        f"/x: /a receives nothing from /stranger: type: they have different definitions of {TEXT}"
    ]
    assert here.heard == []  # type: ignore[attr-defined]


def test_humble_writes_no_hash(here: WallWorld, stranger: Any) -> None:
    stranger.liveliness().declare_token(token_of(1, type_hash="TypeHashNotSupported"))
    here.until(lambda: here.warnings)
    assert "different definitions" in str(here.warnings[0])


def test_a_flood_of_tokens_ends_with_its_session_and_harms_nobody(here: WallWorld, stranger: Any) -> None:
    middleware = here.middlewares[0]
    made = [stranger.liveliness().declare_token(token_of(number, node=f"n{number}")) for number in range(800)]
    made += [stranger.liveliness().declare_token(f"@ros2_lv/{DOMAIN}/junk/{number}") for number in range(200)]
    here.until(lambda: len(middleware.graph()[0].publishers) == 800)
    publisher = here.node("b").publisher("/x", TEXT)
    here.connect("/x")
    publisher.publish(create(TEXT, "still here"))
    here.until(lambda: here.heard == ["still here"])  # type: ignore[attr-defined]
    stranger.close()
    here.until(lambda: middleware.graph()[0].publishers == ("/b",))


def test_the_graph_does_not_grow_without_bound(here: WallWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    from fame.middleware.zenoh import middleware as module

    monkeypatch.setattr(module, "_MAX_ENTITIES", 2)
    graph = module.Graph(lambda: None)
    added = [graph.add(tokens.entity(token_of(number))) for number in range(4)]
    assert added == [True, True, False, False]
    graph.remove(token_of(0))
    assert graph.add(tokens.entity(token_of(3)))


@pytest.mark.processes
def test_a_router_with_passwords_lets_in_who_knows_one(tmp_path: Path) -> None:
    port, scheduler = free_port(), WallScheduler()
    (tmp_path / "users.txt").write_text("rex:secret\n")

    def file(name: str, password: str, more: str = "") -> str:
        path = tmp_path / f"{name}.json5"
        auth = f'transport: {{auth: {{usrpwd: {{user: "rex", password: "{password}"{more}}}}}}}'
        path.write_text(f'{{{auth}, connect: {{endpoints: ["tcp/127.0.0.1:{port}"]}}}}')
        return str(path)

    users = f', dictionary_file: "{tmp_path / "users.txt"}"'
    config = tmp_path / "router.json5"
    config.write_text(f'{{transport: {{auth: {{usrpwd: {{user: "rex", password: "secret"{users}}}}}}}}}')
    router = Router(port, "--zenoh-config", str(config))
    friend, stranger = (through(scheduler, file(name, name)) for name in ("secret", "guess"))
    try:
        run_until(scheduler, lambda: list(friend.session.info.routers_zid()))
        scheduler.run(scheduler.now + SECOND)
        assert list(stranger.session.info.routers_zid()) == []
    finally:
        for middleware in (friend, stranger):
            middleware.close()
        router.kill()


def test_that_more_may_be_lost_of_a_history_than_its_numbers_show_is_said(here: WallWorld) -> None:
    seen: list[str] = []
    qos = QoS(durability="transient_local", depth=5)
    publisher = here.node("a").publisher("/x", TEXT, qos)
    for number in range(50):
        publisher.publish(create(TEXT, str(number)))
    here.node("b").subscription("/x", TEXT, lambda message: seen.append(message.data), qos)
    here.connect("/x")
    here.until(lambda: "49" in seen)
    for number in range(50, 1000):
        publisher.publish(create(TEXT, str(number)))
    here.until(lambda: "999" in seen)
    (text,) = here.middlewares[-1].losses()
    assert text.startswith("/x: /b lost at least ")
