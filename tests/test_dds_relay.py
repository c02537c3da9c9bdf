"""One participant for several engines: what becomes of the others when one ends, or does not take what comes.

What each of them can do is in the contract of the middleware (``dds relay``).
"""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from bpmn_text import document
from middleware_contract import DOMAIN, TIMEOUT, RelayWorld, needs

from fame.clock import SECOND
from fame.errors import ConfigError, FameError
from fame.middleware import messages
from fame.middleware.interface import LATCHED, DeferredResponse, QoS

pytestmark = [needs("cyclonedds"), pytest.mark.dds]
TEXT, INT, TRIGGER = "std_msgs/msg/String", "std_msgs/msg/Int32", "std_srvs/srv/Trigger"
MISSION = document(
    '<collaboration id="C"><participant id="A" name="ROBOT" processRef="p"/></collaboration>'
    '<process id="p"><startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="wait"/><userTask id="wait"/>'
    '<sequenceFlow id="g" sourceRef="wait" targetRef="e"/><endEvent id="e"/></process>'
)


@pytest.fixture
def here() -> Iterator[RelayWorld]:
    made = RelayWorld()
    yield made
    made.close()


def end(world: RelayWorld, middleware: Any) -> None:
    """End an engine as a signal does that nobody can catch: its socket closes, and it says nothing."""
    middleware.closed = True
    middleware.link.close()
    world.middlewares.remove(middleware)


def test_others_see_one_participant_with_the_nodes_of_all_engines(here: RelayWorld) -> None:
    from fame.middleware.dds import DdsMiddleware

    for name in ("A", "B", "C"):
        here.node("fame_engine", name).publisher("bpmn_status", TEXT)
    outside = DdsMiddleware(here.scheduler, domain=DOMAIN)
    try:
        owners = {f"/{name}/bpmn_status": (f"/{name}/fame_engine",) for name in ("A", "B", "C")}
        here.until(lambda: {info.name: info.publishers for info in outside.graph()} == owners)
        assert len({endpoint.participant for endpoint in outside.participant.discovery.all_endpoints()} - {
            outside.participant.discovery.participant
        }) == 1  # fmt: skip
    finally:
        outside.close()


def test_an_engine_that_is_killed_has_left_and_what_it_was_asked_is_lost(here: RelayWorld) -> None:
    server = here.node("fame_engine", "A")
    server.service("reset", TRIGGER, lambda request: DeferredResponse())
    killed = here.middlewares[-1]
    node = here.node("fame_engine", "B")
    client, lost = node.client("/A/reset", TRIGGER), list[str]()
    here.until(lambda: client.available)
    client.call(None, lambda response: lost.append("answered"), partial(lost.append, "lost"))
    end(here, killed)
    here.until(lambda: lost)
    assert lost == ["lost"]
    here.until(lambda: here.middlewares[-1].node_names() == ["/B/fame_engine"])
    assert not client.available


def test_an_engine_that_takes_nothing_holds_up_nobody_and_gets_the_last_when_it_goes_on(here: RelayWorld) -> None:
    goes_on, late, said = threading.Event(), list[int](), list[int]()
    sender = here.node("sender", "C").publisher("/x", TEXT, QoS(depth=10))
    here.node("listener", "B").subscription("/x", TEXT, lambda message: said.append(len(message.data)))
    here.node("_listener", "A").subscription("/x", TEXT, lambda message: late.append(len(message.data)), QoS(depth=10))
    here.connect("/x")
    hangs = here.middlewares[-1]
    known, hangs.entities = hangs.entities, Halting(goes_on)  # its reading thread stops, as in a stopped process
    try:
        for number in range(200):  # far more than its socket holds
            sender.publish(messages.create(TEXT, "x" * (50_000 + number)))
            here.until(lambda number=number: len(said) == number + 1)
        assert late == []
    finally:
        hangs.entities = known
        goes_on.set()
    here.until(lambda: late and late[-1] == 50_199)
    assert late == sorted(late)
    assert len(late) < 100
    assert any("/A/_listener lost" in text for text in hangs.losses())


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("moved", [False, True], ids=["another", "killed"])
def test_an_engine_says_that_its_participant_may_have_lost_more(here: RelayWorld, moved: bool) -> None:
    """Of a sender that numbers nothing, and before the process that has the participant was killed."""
    seen: list[int] = []
    listener = here.node("listener", "B")
    listener.subscription("/x", INT, lambda message: seen.append(message.data), QoS(depth=10))
    sender = here.node("sender", "C").publisher("/x", INT, QoS(depth=100))
    here.connect("/x")
    if moved:
        cut(here, 0)
        here.until(lambda: len(here.relay.engines) == 1)
        here.connect("/x")
    else:
        (there,) = (end for engine in here.relay.engines for node in engine.nodes for end in node.subscriptions)
        there.uncounted = True
    for number in range(30):
        sender.publish(messages.create(INT, number))
    here.arrive()
    here.until(lambda: 29 in seen)
    assert [text for each in here.middlewares for text in each.losses()] == [
        f"/x: /B/listener lost at least {30 - len(seen)} messages, which came faster than it takes them or not at all"
    ]


class Halting(dict[int, Any]):
    """The endpoints of an engine that takes nothing until it goes on."""

    def __init__(self, goes_on: threading.Event) -> None:
        self._goes_on = goes_on

    def get(self, *arguments: Any) -> None:
        self._goes_on.wait()


def test_a_type_that_only_the_engine_has_read_is_one_for_all(here: RelayWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    from fame.middleware.dds.relay import RelayedEngine

    unknown, defined = {"relay_msgs/msg/Weed"}, list[Any]()
    messages.register("geometry_msgs/Point place\nint32 KIND=1\nint32 height 3", "relay_msgs/msg/Weed")
    monkeypatch.setattr(RelayedEngine, "knows", lambda self, type: type not in unknown)
    define = RelayedEngine.define
    monkeypatch.setattr(RelayedEngine, "define", lambda self, types: (defined.extend(types), define(self, types)))
    got = list[Any]()
    sender = here.node("a", "A").publisher("/weed", "relay_msgs/msg/Weed")
    here.node("b", "B").subscription("/weed", "relay_msgs/msg/Weed", got.append)
    here.connect("/weed")
    sender.publish(messages.create("relay_msgs/msg/Weed", {"place": {"x": 2.0}}))
    here.until(lambda: got)
    assert (got[0].place.x, got[0].height) == (2.0, 3)
    assert [name for name, *_ in defined] == ["relay_msgs/msg/Weed", "geometry_msgs/msg/Point"] * 2


# ---- the link ends ---------------------------------------------------------------------------------------------------


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """All others are found within 50 ms."""
    monkeypatch.setattr("fame.middleware.dds.relay._QUIET", SECOND // 20)


def cut(world: RelayWorld, number: int) -> None:
    """End the link of an engine, as when that process is killed: what it had for the engine is gone before."""
    gone = threading.Event()
    world._there.soon(world.relay.engines[number].close)
    world._there.soon(gone.set)
    assert gone.wait(TIMEOUT)


@pytest.mark.usefixtures("quick")
def test_an_engine_whose_link_ends_goes_on_with_a_participant_of_its_own(here: RelayWorld) -> None:
    node, got, late, asked, answers = here.node("fame_engine", "A"), *([] for _ in range(4))
    publisher, latched = node.publisher("/x", TEXT), node.publisher("/map", TEXT, LATCHED)
    node.service("reset", TRIGGER, asked.append)
    slow, calls = here.node("slow", "C"), node.client("/C/slow", TRIGGER)
    slow.service("slow", TRIGGER, lambda request: DeferredResponse())
    other = here.node("fame_engine", "B")
    other.subscription("/x", TEXT, lambda message: got.append(message.data))
    here.connect("/x")
    latched.publish(messages.create(TEXT, "field"))
    here.until(lambda: calls.available)
    calls.call(None, answers.append, lambda: answers.append("lost"))
    cut(here, 0)
    publisher.publish(messages.create(TEXT, "halt"))  # waits until the subscription is found again
    here.until(lambda: got == ["halt"])
    here.until(lambda: answers == ["lost"])
    other.subscription("/map", TEXT, lambda message: late.append(message.data), LATCHED)
    here.until(lambda: late == ["field"])
    client = other.client("/A/reset", TRIGGER)
    here.until(lambda: client.available)
    client.call(None, asked.append)
    here.until(lambda: len(asked) == 2)
    assert here.middlewares[-1].node_names() == ["/A/fame_engine", "/B/fame_engine", "/C/slow"]
    assert len(here.relay.engines) == 2


@pytest.mark.usefixtures("quick")
def test_an_engine_whose_starter_has_ended_stops_when_it_can_be_heard(
    here: RelayWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    got = list[str]()
    publisher = here.node("fame_engine", "A").publisher("/x", TEXT)
    here.node("robot", "A").subscription("/x", TEXT, lambda message: got.append(message.data))
    here.connect("/x")
    monkeypatch.setattr("os.getppid", lambda: 1)
    cut(here, 0)
    here.scheduler.run(here.scheduler.now + 30 * SECOND)  # it stops by itself
    publisher.publish(messages.create(TEXT, "halt"))
    here.until(lambda: got == ["halt"])


def test_an_engine_that_cannot_join_the_domain_again_stops_and_says_why(
    here: RelayWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise ConfigError("cannot join DDS domain 7")

    node = here.node("a", "A")
    monkeypatch.setattr("fame.middleware.dds.relayed.Relay", refuse)
    cut(here, 0)
    here.scheduler.run(here.scheduler.now + 30 * SECOND)
    with pytest.raises(FameError, match="this engine has ended, and cannot join DDS domain 7"):
        node.publisher("/x", INT)


@pytest.mark.usefixtures("quick")
def test_an_engine_that_is_stopped_leaves_after_the_lease_unless_it_goes_on(
    here: RelayWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fame.middleware.dds.relay.lease", lambda default: default / 30)
    for name in "AB":
        here.node("fame_engine", name)
    first, second = here.relay.engines
    for engine, stopped in ((first, True), (second, True), (second, False)):
        here._there.soon(partial(engine.on_stopped, stopped))
    here.until(lambda: here.relay.engines == [second])
    here.until(lambda: here.middlewares[1].node_names() == ["/A/fame_engine", "/B/fame_engine"])  # A goes on
    assert here.relay.engines == [second]


def test_a_burst_arrives_whole(here: RelayWorld) -> None:
    got = list[int]()
    sender = here.node("sender", "C").publisher("/x", INT, QoS(depth=100))
    here.node("listener", "B").subscription("/x", INT, lambda message: got.append(message.data), QoS(depth=100))
    here.connect("/x")
    for number in range(100):
        sender.publish(messages.create(INT, number))
    here.until(lambda: len(got) == 100)
    assert got == list(range(100))


# ---- in processes ----------------------------------------------------------------------------------------------------


@pytest.fixture
def engines(here: RelayWorld) -> Iterator[subprocess.Popen[bytes]]:
    """Two engines of cars, which have been found."""
    words = (sys.executable, "-m", "fame", "engine", "R_1", "R_2", "--type", "car", "--insecure")
    environment = {"ROS_DOMAIN_ID": str(DOMAIN), "FAME_LEASE": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    process = subprocess.Popen(words, env=os.environ | environment, process_group=0, stderr=subprocess.PIPE)
    here.node("fame_view")
    here.until(lambda: present(here) == {"/R_1/fame_engine", "/R_2/fame_engine"})
    for _ in range(2):
        assert b"waits for its process" in process.stderr.readline()  # type: ignore[union-attr]
    yield process
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


def present(world: RelayWorld) -> set[str]:
    return {name for name in world.middlewares[0].node_names() if name.startswith("/R_")}


@pytest.mark.processes
def test_a_stopped_process_is_gone_after_the_lease_and_back_when_it_goes_on(
    here: RelayWorld, engines: subprocess.Popen[bytes]
) -> None:
    first = int(Path(f"/proc/{engines.pid}/task/{engines.pid}/children").read_text().split()[0])
    os.kill(first, signal.SIGSTOP)
    here.until(lambda: present(here) == {"/R_2/fame_engine"})
    os.kill(first, signal.SIGCONT)
    here.until(lambda: present(here) == {"/R_1/fame_engine", "/R_2/fame_engine"})
    engines.send_signal(signal.SIGINT)
    assert engines.wait(timeout=30) == 0


@pytest.mark.processes
def test_engines_whose_starter_is_killed_bring_their_robots_to_the_safe_state(
    here: RelayWorld, engines: subprocess.Popen[bytes]
) -> None:
    stopped = dict.fromkeys(("R_1", "R_2"), 0)

    def stop(robot: str, message: Any) -> None:
        stopped[robot] += message.linear.x == 0

    node, deployed = here.middlewares[0].nodes[0], dict[str, str]()
    for robot in stopped:
        node.subscription(f"/{robot}/cmd_vel", "geometry_msgs/msg/Twist", partial(stop, robot))
        node.subscription(
            f"/{robot}/bpmn_status", TEXT, lambda message, robot=robot: deployed.update({robot: message.data})
        )
        publisher = node.publisher(f"/{robot}/bpmn_process", TEXT)
        here.until(publisher.matched)
        publisher.publish(messages.create(TEXT, MISSION.replace("ROBOT", robot)))
    here.until(lambda: len(deployed) == 2 and all('"running"' in report for report in deployed.values()))
    stopped.update(R_1=0, R_2=0)
    engines.kill()
    here.until(lambda: all(stopped.values()))
    here.until(lambda: not present(here))
