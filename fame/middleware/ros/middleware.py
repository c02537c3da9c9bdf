"""The backend: a context of rclpy with its nodes, and one executor for all of them.

The executor spins in a thread of its own; its callbacks only enter actions in the scheduler, in whose thread everything
else happens. Arguments after ``--ros-args`` on the command line (parameters, remappings) hold for every node.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from functools import partial

from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from fame.clock import WallScheduler
from fame.errors import ConfigError
from fame.middleware.interface import TopicInfo, resolve
from fame.middleware.qos import compatible
from fame.middleware.ros.nodes import RosNode, RosPublisher
from fame.middleware.ros.translation import from_profile, owner
from fame.middleware.wire_base import NAMING, WireMiddleware

_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_EVERYWHERE = ("/rosout", "/parameter_events")
"""Topics that every node of ROS has; the graph leaves them out."""


class RosMiddleware(WireMiddleware):
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
        super().__init__(scheduler, network, on_warning)
        confine(network)
        self.context = Context()
        try:
            self.context.init(ros_arguments(sys.argv), domain_id=domain)
            self.executor = SingleThreadedExecutor(context=self.context)
            hidden = {"enable_rosout": False, "start_parameter_services": False}
            self._observer = Node(f"_fame_{os.getpid()}", context=self.context, **hidden)
        except Exception as error:  # rclpy raises what its C++ gives it
            text = " ".join(str(error).split())
            raise ConfigError(f"ROS 2 does not start: {text}") from None
        self.executor.add_node(self._observer)
        self._thread = threading.Thread(target=self._spin, name="ros", daemon=True)
        self._thread.start()

    @property
    def use_sim_time(self) -> bool:
        """Whether the parameter of that name says that time is that of ``/clock``."""
        return bool(self._observer.get_parameter("use_sim_time").value)

    def node(self, name: str, namespace: str = "") -> RosNode:
        """A new node. Several may have the same name, as in ROS. Raises ConfigError if ROS refuses the name."""
        return RosNode(self, name, namespace.strip("/"))

    def graph(self) -> list[TopicInfo]:
        """Every topic that has an end, in the order of names; but those that every node of ROS has."""
        topics = dict(self._observer.get_topic_names_and_types())
        return [self._info(name, topics[name]) for name in sorted(topics) if name not in _EVERYWHERE]

    def namespaces(self) -> list[str]:
        """The namespaces of all nodes, hidden ones apart."""
        found = {space.strip("/") for name, space in self._observer.get_node_names_and_namespaces() if name[0] != "_"}
        return sorted(found - {""})

    def leave(self) -> None:
        self._observer.destroy_node()  # ROS leaves the domain with the last node of a context
        self.context.try_shutdown()
        self._thread.join()
        self.executor.shutdown(timeout_sec=0)  # who still waits for a response waits in vain

    # ---- for nodes and their ends ------------------------------------------------------------------------------------

    def mismatched(self, topic: str) -> None:
        """Ends of a topic do not match, which rclpy says without saying which: find out when nodes have names."""
        self.scheduler.after(NAMING, partial(self._report, topic))

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

    def hearers(self, end: RosPublisher) -> int:
        """How many subscriptions there are that can hear a publisher."""
        return sum(
            other.topic_type == end.type and compatible(end.qos, from_profile(other.qos_profile)) is None
            for other in self._observer.get_subscriptions_info_by_topic(end.topic)
        )

    def _info(self, topic: str, types: list[str]) -> TopicInfo:
        writers = self._observer.get_publishers_info_by_topic(topic)
        readers = self._observer.get_subscriptions_info_by_topic(topic)
        return TopicInfo(topic, tuple(sorted(types)), tuple(map(owner, writers)), tuple(map(owner, readers)))

    def _report(self, topic: str) -> None:
        if self.closed:
            return
        own = {node.full_name for node in self.nodes}
        for writer in self._observer.get_publishers_info_by_topic(topic):
            for reader in self._observer.get_subscriptions_info_by_topic(topic):
                ends = owner(writer), owner(reader)
                mismatch = compatible(from_profile(writer.qos_profile), from_profile(reader.qos_profile))
                if mismatch is not None and own.intersection(ends) and ends[0] != ends[1]:
                    self.warn(f"{topic}: {ends[1]} hears nothing from {ends[0]}: {mismatch}")

    def _spin(self) -> None:
        while self.context.ok():
            try:
                self.executor.spin()
            except InvalidHandle:
                pass  # an end was closed while rclpy was about to ask it
            except ExternalShutdownException:
                return  # the context was shut down
            except Exception as error:  # rclpy raises what its C++ gives it, and stops; a robot must not go deaf
                self.warn(f"ROS 2: {error}")


def ros_arguments(words: list[str]) -> list[str]:
    """What of a command line is for ROS: from ``--ros-args`` on.

    >>> ros_arguments(["fame", "engine", "REX", "--ros-args", "-p", "use_sim_time:=true"])
    ['--ros-args', '-p', 'use_sim_time:=true']
    """
    return words[words.index("--ros-args") :] if "--ros-args" in words else []


def confine(network: str | None) -> None:
    """Let ROS look for others on this machine only, or on the network. It reads that from the environment."""
    if network is None:
        os.environ[_RANGE] = "LOCALHOST"
    elif os.environ.get(_RANGE, "LOCALHOST") in ("LOCALHOST", "OFF"):
        os.environ[_RANGE] = "SUBNET"
    os.environ.pop("ROS_LOCALHOST_ONLY", None)  # that of earlier distributions, which would overrule it
