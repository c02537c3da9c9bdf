"""One participant for several engines: what becomes of the others when one ends, or does not take what comes.

What each of them can do is in the contract of the middleware (``dds relay``).
"""

import socket
import threading
from collections.abc import Iterator
from functools import partial
from typing import Any

import pytest
from middleware_contract import DOMAIN, RelayWorld, needs

from fame.errors import FameError
from fame.middleware import messages
from fame.middleware.interface import DeferredResponse, QoS

pytestmark = [needs("cyclonedds"), pytest.mark.dds]
TEXT, INT, TRIGGER = "std_msgs/msg/String", "std_msgs/msg/Int32", "std_srvs/srv/Trigger"


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
    ends, hangs.ends = hangs.ends, Halting(goes_on)  # the thread that reads stands still, as that of a stopped process
    try:
        for number in range(200):  # far more than its socket holds
            sender.publish(messages.create(TEXT, "x" * (50_000 + number)))
            here.until(lambda number=number: len(said) == number + 1)
        assert late == []
    finally:
        hangs.ends = ends
        goes_on.set()
    here.until(lambda: late and late[-1] == 50_199)
    assert late == sorted(late)
    assert len(late) < 100
    assert any("/A/_listener lost" in text for text in hangs.losses())


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


def test_an_engine_whose_participant_has_ended_stops_and_says_why(here: RelayWorld) -> None:
    node = here.node("a", "A")
    (engine,) = here.relay.engines
    engine.link._end.shutdown(socket.SHUT_RDWR)  # as if that process had been killed
    here.scheduler.run(here.scheduler.now + 30 * 10**9)  # it stops by itself
    with pytest.raises(FameError, match="the process that started this engine has ended"):
        node.publisher("/x", INT)
