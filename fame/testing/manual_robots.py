"""Robots whose behaviours and values a test controls: real engines, nodes and topics, driven as in an exploration.

What takes time is a step that ends when the test says so. Where `fame.check.explore` knows no value, neither does the
robot: a `fame.check.explore.values.Unknown` stands in for it, and what is decided on it is decided by the test.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from fame.bpmn.pools import Pool
from fame.check.explore.abstraction import Abstraction
from fame.check.explore.canonical import stimuli
from fame.check.explore.host import ExplorationHost
from fame.check.explore.values import Unknown, Values
from fame.clock import Scheduler
from fame.engine import UNDEFINED, Engine, Instance, compile_program
from fame.engine.host import Host
from fame.engine.state import Trail, Wait
from fame.errors import FameError
from fame.middleware import messages
from fame.middleware.interface import AnyMessage, QoS, resolve
from fame.middleware.network import Network, NetworkConfig, RobotChannel
from fame.robot import RobotNode


class HeldNetwork(Network):
    """A network whose messages arrive when somebody says so. `mail`: (sender, receiver, topic, arrival), in order.

    topics   those whose messages are held; all others arrive at once
    """

    def __init__(self, scheduler: Scheduler, topics: frozenset[str]) -> None:
        super().__init__(NetworkConfig(), 0, scheduler)
        self.mail: list[tuple[str, str, str, Callable[[], object]]] = []
        self._topics = topics

    def channel(self, sender: str, receiver: str, topic: str, qos: QoS) -> RobotChannel | None:
        """Return the way to the mail, for topics that are held."""
        _, direct, name = topic.partition("/bpmn_message/")
        shared = f"/{name}" if direct else topic
        held = sender and receiver and sender != receiver and shared in self._topics
        return _HeldChannel(self, sender, receiver, shared) if held else None

    def take(self, receiver: str, topic: str) -> Callable[[], object] | None:
        """Take the first message for a robot on a topic out of the mail."""
        for place, (_, other, name, arrive) in enumerate(self.mail):
            if (other, name) == (receiver, topic):
                del self.mail[place]
                return arrive
        return None


class _HeldChannel(RobotChannel):
    """The way of messages from one robot to another into the mail."""

    def __init__(self, network: HeldNetwork, sender: str, receiver: str, topic: str) -> None:
        self._mail, self._place = network.mail, (sender, receiver, topic)

    def send(self, deliver: Callable[[], object]) -> None:
        self._mail.append((*self._place, deliver))


class _HeldEngine(Engine):
    """An engine that takes messages of which parts are unknown. `twins`: message on the wire -> what it stands for."""

    twins: dict[int, tuple[AnyMessage, Any]]

    def deliver(self, topic: str, message: Any) -> None:
        super().deliver(topic, self.twins[id(message)][1] if id(message) in self.twins else message)


class StandInHost(ExplorationHost):
    """The host of one robot's engine: texts as an exploration computes them, all else as the robot's node does it.

    decided  element -> decisions about unknown values there, in order; further ones alternate
    twins    shared by all robots, see `_HeldEngine`
    """

    engine: _HeldEngine
    node: RobotNode
    twins: dict[int, tuple[AnyMessage, Any]]

    def __init__(self, node: RobotNode, abstract: Abstraction, values: Values, pool: Pool, robots: tuple[str, ...],
                 twins: dict[int, tuple[AnyMessage, Any]]) -> None:  # fmt: skip
        self.node, self.twins = node, twins
        self.decided: defaultdict[str, deque[int]] = defaultdict(deque)
        self._choices: defaultdict[str, int] = defaultdict(int)
        super().__init__(node.name, abstract, values, robots, ordered=False)
        self.kept = abstract.kept[pool.name].__contains__

    def load(self, abstract: Abstraction, pool: Pool) -> None:
        """Compile the process for the engine of the node, and make its endpoints. Raises ModelError, MessageError."""
        definitions, host = self.node.mission.definitions, self._as_host()
        process = abstract.process(definitions, pool.process)
        program = compile_program(process, host=host, library=abstract.find, file=definitions.file, observed=True)
        catches = [node.catch.topic for node in program.nodes if node.catch is not None]
        self.own_topics: frozenset[str] = frozenset(topic for topic in catches if topic)
        engine = _HeldEngine(program, host, self.new_variables)
        engine.twins, self.engine = self.twins, engine
        self.node.attach(engine)
        self.node.load()

    def _as_host(self) -> Host:
        return self

    @property
    def place(self) -> str:
        """The element whose text is being computed: what it decides is decided for this robot."""
        return self._place

    @place.setter
    def place(self, element: str) -> None:
        self._place = element
        self.values.choose = self.choose

    # ---- decisions ---------------------------------------------------------------------------------------------------

    def choose(self, ways: int) -> int:
        """Return one of several ways: as the test decided, else each in turn."""
        decided = self.decided[self.place]
        if decided:
            return min(decided.popleft(), ways - 1)
        self._choices[self.place] += 1
        return self._choices[self.place] % ways

    # ---- steps -------------------------------------------------------------------------------------------------------

    def under_way(self, elements: frozenset[str]) -> list[Wait]:
        """Return the steps under way at some elements."""
        return [wait for wait in stimuli(self.engine).scripts.values() if wait.node.id in elements]

    def block(self, wait: Wait) -> None:
        """Let a step never end."""
        self.engine.waits.pop(wait.key).started = False

    # ---- messages ----------------------------------------------------------------------------------------------------

    def publish(self, topic: str, value: Any) -> Any:
        _, message = self._message(topic, value)
        use = self.types[topic]
        endpoints = self.node.endpoints
        publisher = endpoints.publisher(resolve(topic, self.node.namespace), use.type)
        publisher.publish(self.on_the_wire(use.type, value, message))
        return message

    def send(self, topic: str, value: Any, robot: Any) -> None:
        _, message = self._message(topic, value)
        if not isinstance(robot, str):
            robot = self.robots[self.choose(len(self.robots))]
        plain = self.on_the_wire(self.types[topic].type, value, message)
        self.node.endpoints.direct.send(topic, plain, robot)

    def on_the_wire(self, type: str, value: Any, stands_for: Any) -> AnyMessage:
        """Return a message without unknown values, that stands for another one."""
        try:
            plain = messages.create(type, None if value is UNDEFINED or _has_unknown(value) else value)
        except FameError:
            plain = messages.create(type)
        if _has_unknown(plain):
            plain = messages.create(type)
        if stands_for is not plain:
            self.twins[id(plain)] = plain, stands_for
        return plain

    def from_outside(self, topic: str) -> None:
        """A message of which nothing is known comes from outside of the team."""
        self.engine.deliver(topic, self.values.value(self.blank(topic)))

    # ---- what the node does ------------------------------------------------------------------------------------------

    def set_timer(self, key: int, kind: str, text: str) -> None:
        try:
            self.node.host.set_timer(key, kind, text)
        except ValueError:  # computed from something unknown
            self.node.host.set_timer(key, "duration", "PT1S")

    def cancel_timer(self, key: int) -> None:
        self.node.host.cancel_timer(key)

    def make_safe(self, reason: str) -> None:
        self.node.host.make_safe(reason)

    def observe(self, trail: Trail) -> None:
        self.node.host.observe(trail)

    def begun(self, instance: Instance) -> None:
        self.node.host.begun(instance)

    def ended(self, instance: Instance) -> None:
        self.node.host.ended(instance)

    def report(self, element: str, text: str) -> None:
        self.node.host.report(element, text)


def _has_unknown(value: Any) -> bool:
    """Whether something in a message or payload is unknown."""
    if is_dataclass(value):
        return any(_has_unknown(getattr(value, field.name)) for field in fields(value))
    if isinstance(value, list | tuple):
        return any(map(_has_unknown, value))
    if isinstance(value, dict):
        return any(map(_has_unknown, value.values()))
    return isinstance(value, Unknown)


def stand_ins(
    nodes: Mapping[str, RobotNode], cast: Mapping[str, Pool], abstract: Abstraction
) -> dict[str, StandInHost]:
    """Return the hosts of a team whose nodes have no process yet. Raises ModelError, MessageError."""
    values, twins, robots = Values(), dict[int, tuple[AnyMessage, Any]](), tuple(cast)
    hosts = {robot: StandInHost(node, abstract, values, cast[robot], robots, twins) for robot, node in nodes.items()}
    for robot, host in hosts.items():
        host.load(abstract, cast[robot])
    return hosts
