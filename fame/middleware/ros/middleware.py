"""The backend: a context of rclpy with its nodes, and one executor for all of them.

The executor spins in a thread of its own; its callbacks only enter actions in the scheduler, in whose thread everything
else happens. Arguments after ``--ros-args`` on the command line (parameters, remappings) hold for every node.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import partial
from xml.sax.saxutils import quoteattr

from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from fame.clock import SECOND, WallScheduler
from fame.errors import ConfigError, MessageError
from fame.middleware.interface import TopicInfo, resolve
from fame.middleware.qos import compatible
from fame.middleware.ros.nodes import RosNode, RosPublisher, RosSubscription
from fame.middleware.ros.translation import from_profile

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_INTERFACE = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name={}/></Interfaces></General></Domain></CycloneDDS>"
)
_EVERYWHERE = ("/rosout", "/parameter_events")
"""Topics that every node of ROS has; the graph leaves them out."""
_NAMING = SECOND // 5
"""How long after an end the name of its node may come (ns)."""
_LOOK = 0.002
"""How often `wait_matched` looks (s)."""


class RosMiddleware:
    """Nodes of rclpy. `warnings` collects what a person should know; `on_warning` is told of each in the scheduler.

    `domain` None is ROS_DOMAIN_ID. `network` None confines discovery to this machine; anything else opens it, on the
    interfaces that the configuration of ROS's own middleware names. Raises ConfigError if ROS refuses.
    """

    confined = False
    """Discovery is confined, not the sockets: what carries code must not rely on it."""

    def __init__(
        self,
        scheduler: WallScheduler,
        *,
        domain: int | None = None,
        network: str | None = None,
        on_warning: Callable[[str], object] | None = None,
    ) -> None:
        self.scheduler, self.network = scheduler, network
        self.warnings: list[str] = []
        self.nodes: list[RosNode] = []
        self._on_warning, self._warning, self._closed = on_warning, threading.Lock(), False
        confine(network)
        self.context = Context()
        try:
            self.context.init(ros_arguments(sys.argv), domain_id=domain)
            self.executor = SingleThreadedExecutor(context=self.context)
            hidden = {"enable_rosout": False, "start_parameter_services": False}
            self._observer = Node(f"_fame_{os.getpid()}", context=self.context, **hidden)
        except Exception as error:  # rclpy raises what its C++ gives it
            raise ConfigError(f"ROS 2 does not start: {error}") from None
        self.executor.add_node(self._observer)
        self._thread = threading.Thread(target=self._spin, name="ros", daemon=True)
        self._thread.start()

    @property
    def use_sim_time(self) -> bool:
        """Whether the parameter of that name says that time is that of ``/clock``."""
        return bool(self._observer.get_parameter("use_sim_time").value)

    def node(self, name: str, namespace: str = "") -> RosNode:
        """A new node. Several may have the same name, as in ROS."""
        node = RosNode(self, name, namespace.strip("/"))
        self.nodes.append(node)
        return node

    def graph(self) -> list[TopicInfo]:
        """Every topic that has an end, in the order of names; but those that every node of ROS has."""
        topics = dict(self._observer.get_topic_names_and_types())
        return [self._info(name, topics[name]) for name in sorted(topics) if name not in _EVERYWHERE]

    def connecting(self, node: RosNode) -> list[str]:
        """Topics on which a node publishes to somebody who is there and does not hear it yet."""
        return [end.topic for end in node.publishers if end.subscribers() < self._hearers(end)]

    def namespaces(self) -> list[str]:
        """The namespaces of all nodes, hidden ones apart."""
        found = {space.strip("/") for name, space in self._observer.get_node_names_and_namespaces() if name[0] != "_"}
        return sorted(found - {""})

    def unmatched(self, topics: Iterable[str]) -> list[str]:
        """Which of the topics (full names) have an own end that no end of another node is connected to."""
        return [topic for topic in topics if not all(end.matched() for end in self._own_ends(topic))]

    def wait_matched(self, topics: Iterable[str], timeout: float) -> list[str]:
        """Block until the topics are matched, at most `timeout` s. Returns those that are not, as `unmatched`."""
        waiting, deadline = list(topics), time.monotonic() + timeout
        while (waiting := self.unmatched(waiting)) and time.monotonic() < deadline:
            time.sleep(_LOOK)
        return waiting

    def close(self) -> None:
        """Leave. Does nothing the second time."""
        if self._closed:
            return
        for node in list(self.nodes):
            node.close()
        self._closed = True
        self.executor.shutdown()
        self._thread.join()
        self._observer.destroy_node()
        self.context.try_shutdown()

    def warn(self, text: str) -> None:
        """Record a warning, unless it is recorded already."""
        with self._warning:
            if text in self.warnings:
                return
            self.warnings.append(text)
        if self._on_warning is not None:
            self.scheduler.soon(partial(self._on_warning, text))

    # ---- for nodes and their ends ------------------------------------------------------------------------------------

    def check(self, topic: str, type: str) -> None:
        """Raise MessageError if a node of this process uses the topic with another type."""
        users = [end for end in self._own_ends(topic) if end.type != type]
        if users:
            names = ", ".join(dict.fromkeys(end.node.full_name for end in users))
            raise MessageError(f"topic {topic} is in use with {users[0].type}, by {names}: it has one type", type=type)

    def mismatched(self, topic: str) -> None:
        """Ends of a topic do not match, which rclpy says without saying which: find out when nodes have names."""
        self.scheduler.after(_NAMING, partial(self._report, topic))

    def offers(self, service: str) -> list[tuple[str, str]]:
        """Type and node of each service of that name."""
        observer, found = self._observer, []
        for name, space in observer.get_node_names_and_namespaces():
            try:
                services = dict(observer.get_service_names_and_types_by_node(name, space))
            except Exception:  # it left meanwhile: rclpy's own NodeNameNonExistentError, or its C++'s
                continue
            found += [(type, resolve(name, space.strip("/"))) for type in services.get(service, ())]
        return found

    def _hearers(self, end: RosPublisher) -> int:
        """How many subscriptions there are that can hear a publisher."""
        others = self._observer.get_subscriptions_info_by_topic(end.topic)
        return sum(compatible(end.qos, from_profile(other.qos_profile)) is None for other in others)

    def _info(self, topic: str, types: list[str]) -> TopicInfo:
        writers = self._observer.get_publishers_info_by_topic(topic)
        readers = self._observer.get_subscriptions_info_by_topic(topic)
        return TopicInfo(topic, tuple(sorted(types)), tuple(map(_owner, writers)), tuple(map(_owner, readers)))

    def _report(self, topic: str) -> None:
        if self._closed:
            return
        own = {node.full_name for node in self.nodes}
        for writer in self._observer.get_publishers_info_by_topic(topic):
            for reader in self._observer.get_subscriptions_info_by_topic(topic):
                ends = _owner(writer), _owner(reader)
                mismatch = compatible(from_profile(writer.qos_profile), from_profile(reader.qos_profile))
                if mismatch is not None and own.intersection(ends) and ends[0] != ends[1]:
                    self.warn(f"{topic}: {ends[1]} hears nothing from {ends[0]}: {mismatch}")

    def _own_ends(self, topic: str) -> Iterator[RosPublisher | RosSubscription]:
        for node in self.nodes:
            yield from (end for end in node.publishers if end.topic == topic)
            yield from (end for end in node.subscriptions if end.topic == topic)

    def _spin(self) -> None:
        with suppress(ExternalShutdownException):  # the context was shut down
            self.executor.spin()


def ros_arguments(words: list[str]) -> list[str]:
    """What of a command line is for ROS: from ``--ros-args`` on, up to ``--``.

    >>> ros_arguments(["fame", "engine", "REX", "--ros-args", "-p", "use_sim_time:=true"])
    ['--ros-args', '-p', 'use_sim_time:=true']
    """
    return words[words.index("--ros-args") :] if "--ros-args" in words else []


def confine(network: str | None) -> None:
    """Let ROS look for others on this machine only, or on the network. It reads that from the environment."""
    if network is None:
        os.environ[RANGE] = "LOCALHOST"
    elif os.environ.get(RANGE, "LOCALHOST") in ("LOCALHOST", "OFF"):
        os.environ[RANGE] = "SUBNET"
    os.environ.pop("ROS_LOCALHOST_ONLY", None)  # that of earlier distributions, which would overrule it
    if network is not None and os.environ.get("RMW_IMPLEMENTATION") == "rmw_cyclonedds_cpp":
        os.environ.setdefault("CYCLONEDDS_URI", _INTERFACE.format(quoteattr(network)))


def _owner(end: object) -> str:
    """The full name of an endpoint's node."""
    return resolve(end.node_name, end.node_namespace.strip("/"))  # type: ignore[attr-defined]
