"""The backend: a context of rclpy with its nodes, and one executor for all of them.

The executor spins in a thread of its own; its callbacks only enter actions in the scheduler, in whose thread everything
else happens. Arguments after ``--ros-args`` on the command line (parameters, remappings) hold for every node.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, ClassVar

from rcl_interfaces.msg import SetParametersResult
from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter

from fame.clock import SECOND, WallScheduler
from fame.errors import ConfigError
from fame.middleware.data_scheduler import DataScheduler
from fame.middleware.errors import mismatch_warning
from fame.middleware.interface import SIGNAL, EndpointWarning, QoS, TopicInfo, resolve
from fame.middleware.qos import compatible, mismatch
from fame.middleware.ros.endpoints import (
    RosClient,
    RosEndpoint,
    RosHandle,
    RosPublisher,
    RosService,
    RosSubscription,
    SubscriptionWaiter,
    from_profile,
    owner,
)
from fame.middleware.simulated_time import CLOCK
from fame.middleware.wire_base import NAMING_DELAY, EndpointClasses, WireMiddleware, WireNode
from fame.middleware.wire_endpoints import Callback

_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_LOOK = SECOND
"""How often topics of several types are looked for (ns): rclpy does not report endpoints of different types."""
_OF_EVERY_NODE = ("/rosout", "/parameter_events")
"""Topics that every node of ROS has; the graph leaves them out."""


class RosMiddleware(WireMiddleware):
    """Nodes of rclpy. `warnings` are for the user; `on_warning` is called with each of them in the scheduler.

    `domain` None is ROS_DOMAIN_ID. `network` None confines discovery to this machine; anything else opens it, on the
    interfaces that the configuration of ROS's own middleware names. Raises ConfigError if ROS refuses.
    """

    confined: bool = False
    """False even without a network: only discovery is confined, not the sockets."""
    nodes: list[RosNode]
    offers_parameters: bool = False

    def __init__(
        self,
        scheduler: WallScheduler,
        *,
        domain: int | None = None,
        network: str | None = None,
        on_warning: Callable[[EndpointWarning], object] | None = None,
    ) -> None:
        super().__init__(scheduler, network, on_warning)
        confine(network)
        self.context: Context = Context()
        try:
            self.context.init(ros_arguments(sys.argv), domain_id=domain)
            self.executor: SingleThreadedExecutor = SingleThreadedExecutor(context=self.context)
            hidden = {"enable_rosout": False, "start_parameter_services": False}
            self.observer: Node = Node(f"_fame_{os.getpid()}", context=self.context, **hidden)
        except Exception as error:  # rclpy raises what its C++ gives it
            text = " ".join(str(error).split())
            raise ConfigError(f"ROS 2 does not start: {text}") from None
        self.executor.add_node(self.observer)
        self.waiter: SubscriptionWaiter | None = None
        if isinstance(scheduler, DataScheduler) and scheduler.waiter is None:
            scheduler.waiter = self.waiter = SubscriptionWaiter(self.context)
        self._mixed: dict[str, tuple[int, int]] = {}
        self._thread = threading.Thread(target=self._spin, name="ros", daemon=True)
        self._thread.start()
        scheduler.after(_LOOK, self._look)

    @property
    def use_sim_time(self) -> bool:
        """Whether the parameter of that name says that time is that of ``/clock``."""
        return bool(self.observer.get_parameter("use_sim_time").value)

    def keep_clock(self, parameters: Sequence[Any]) -> SetParametersResult:
        """Refuse to change the clock of a process: what runs in it was begun by the other one."""
        follows = self.follows_clock()
        wrong = any(each.name == "use_sim_time" and bool(each.value) is not follows for each in parameters)
        text = "use_sim_time is decided when the process starts: --use-sim-time, or --ros-args -p use_sim_time:=true"
        return SetParametersResult(successful=not wrong, reason=text if wrong else "")

    def node(self, name: str, namespace: str = "", part: str = "") -> RosNode:
        """Make a node. Several may have the same name, as in ROS. Raises ConfigError if ROS refuses the name.

        Hidden nodes (``_name``) need none of their own: their endpoints are those of the observer.
        """
        return RosNode(self, name, namespace.strip("/"), part)

    def shared(self, name: str, namespace: str, part: str) -> Node | None:
        """Return the node of rclpy that a new node shares: that of the other parts, or the observer; else None."""
        if name.startswith("_"):
            return self.observer
        requested = name, namespace
        return next((node.ros for node in self.nodes if part and node.part and node.requested == requested), None)

    def graph(self) -> list[TopicInfo]:
        """Return every topic that has an endpoint, in the order of names; without those that every node of ROS has."""
        topics = dict(self.observer.get_topic_names_and_types())
        return [self._info(name, topics[name]) for name in sorted(topics) if name not in _OF_EVERY_NODE]

    def namespaces(self) -> list[str]:
        """Return the namespaces of all nodes but hidden ones."""
        nodes = self.observer.get_node_names_and_namespaces()
        return sorted({space.strip("/") for name, space in nodes if name[0] != "_"} - {""})

    def node_names(self) -> list[str]:
        nodes = self.observer.get_node_names_and_namespaces()
        return sorted(resolve(name, space.strip("/")) for name, space in nodes if name[0] != "_")

    def offers(self, service: str) -> list[tuple[str, str]]:
        observer, found = self.observer, []
        for name, space in observer.get_node_names_and_namespaces():
            try:
                services = dict(observer.get_service_names_and_types_by_node(name, space))
            except Exception:  # the node has left: rclpy's own NodeNameNonExistentError, or its C++'s
                continue
            found += [(type, resolve(name, space.strip("/"))) for type in services.get(service, ())]
        return found

    def matching_subscriptions(self, publisher: RosPublisher) -> int:
        return sum(
            other.topic_type == publisher.type and compatible(publisher.qos, from_profile(other.qos_profile)) is None
            for other in self.observer.get_subscriptions_info_by_topic(publisher.topic)
        )

    def release(self) -> None:
        if isinstance(self.scheduler, DataScheduler) and self.waiter is not None:
            self.scheduler.waiter = None
            self.waiter.close()
        self.observer.destroy_node()  # ROS leaves the domain with the last node of a context
        self.context.try_shutdown()
        self._thread.join()
        self.executor.shutdown(timeout_sec=0)  # coroutines that wait for a response end

    def on_mismatch(self, topic: str) -> None:
        """Find out which endpoints of a topic do not match, once nodes have names: rclpy does not say which."""
        self.scheduler.after(NAMING_DELAY, partial(self._report, topic))

    def _info(self, topic: str, types: list[str]) -> TopicInfo:
        writers = self.observer.get_publishers_info_by_topic(topic)
        readers = self.observer.get_subscriptions_info_by_topic(topic)
        offered = tuple(RosEndpoint(writer).qos for writer in writers)
        return TopicInfo(topic, tuple(sorted(types)), tuple(map(owner, writers)), tuple(map(owner, readers)), offered)

    def _look(self) -> None:
        """Report topics that have several types, whenever the number of their endpoints has changed."""
        if self.closed:
            return
        count, topics = self.observer, self.observer.get_topic_names_and_types()
        mixed = {
            name: (count.count_publishers(name), count.count_subscribers(name)) for name, types in topics if types[1:]
        }
        for topic in [topic for topic, ends in mixed.items() if self._mixed.get(topic) != ends]:
            self.on_mismatch(topic)
        self._mixed = mixed
        self.scheduler.after(_LOOK, self._look)

    def _report(self, topic: str) -> None:
        if self.closed:
            return
        own = {node.full_name for node in self.nodes}
        for writer in self.observer.get_publishers_info_by_topic(topic):
            for reader in self.observer.get_subscriptions_info_by_topic(topic):
                nodes = owner(reader), owner(writer)
                reason = mismatch(RosEndpoint(writer), RosEndpoint(reader))
                if reason is not None and own.intersection(nodes) and nodes[0] != nodes[1]:
                    self.warn(mismatch_warning(topic, *nodes, reason))

    def _spin(self) -> None:
        while self.context.ok():
            try:
                self.executor.spin()
            except InvalidHandle:
                pass  # an endpoint was closed while rclpy was about to use it
            except ExternalShutdownException:
                return  # the context was shut down
            except Exception as error:  # rclpy raises what its C++ gives it, and stops; a robot must not go deaf
                self.warn(EndpointWarning("", f"ROS 2: {error}", "backend"))


class RosNode(WireNode):
    """A node of rclpy, which is `ros`."""

    publishers: list[RosPublisher]
    subscriptions: list[RosSubscription]
    services: list[RosService | RosClient]
    endpoint_classes: ClassVar[EndpointClasses] = EndpointClasses(RosPublisher, RosSubscription, RosService, RosClient)

    def __init__(self, middleware: RosMiddleware, name: str, namespace: str, part: str) -> None:
        self.requested: tuple[str, str] = name, namespace
        self.ros: Node = middleware.shared(name, namespace, part) or self._made(middleware, name, namespace)
        self._is_own = self.ros is not middleware.observer
        super().__init__(middleware, *_names(self.ros) if self._is_own else (name, namespace), part)
        self.handle: RosHandle = RosHandle(self.ros, middleware.executor, middleware.on_mismatch, middleware.waiter)

    def _made(self, middleware: RosMiddleware, name: str, namespace: str) -> Node:
        try:
            made = Node(
                name,
                namespace=f"/{namespace}",
                context=middleware.context,
                enable_rosout=False,  # nothing is logged by way of ROS
            )
        except Exception as error:  # rclpy raises what its C++ gives it
            text = " ".join(str(error).split())
            raise ConfigError(f"ROS 2 refuses a node /{namespace}/{name}: {text}") from None
        if namespace and (given := made.get_namespace()) != f"/{namespace}":
            made.destroy_node()
            raise ConfigError(
                f"the namespace of robot {namespace} is its name, but ROS arguments or a launch file make it {given}: "
                "take __ns, namespace= or PushRosNamespace away"
            )
        made.add_on_set_parameters_callback(middleware.keep_clock)
        middleware.executor.add_node(made)
        return made

    def subscription(self, topic: str, type: str, callback: Callback, qos: QoS = SIGNAL) -> Any:
        made = super().subscription(topic, type, callback, qos)
        if made.topic == CLOCK and self._is_own:  # its parameter says what it follows
            self.ros.set_parameters([Parameter("use_sim_time", value=True)])
        return made

    def close(self) -> None:
        """Close all endpoints. Does nothing the second time."""
        if self in self.middleware.nodes:
            super().close()
            if self._is_own and not self.others():
                self.handle.executor.remove_node(self.ros)
                self.ros.destroy_node()


def _names(node: Node) -> tuple[str, str]:
    """Name and namespace of a node of rclpy, which remappings may have changed."""
    return node.get_name(), node.get_namespace().strip("/")


def ros_arguments(words: list[str]) -> list[str]:
    """Return the ROS arguments of a command line: from ``--ros-args`` on.

    >>> ros_arguments(["fame", "engine", "REX", "--ros-args", "-p", "use_sim_time:=true"])
    ['--ros-args', '-p', 'use_sim_time:=true']
    """
    return words[words.index("--ros-args") :] if "--ros-args" in words else []


def confine(network: str | None) -> None:
    """Confine the discovery of ROS to this machine, or open it to the network, by environment variables."""
    if network is None:
        os.environ[_RANGE] = "LOCALHOST"
    elif os.environ.get(_RANGE, "LOCALHOST") in ("LOCALHOST", "OFF"):
        os.environ[_RANGE] = "SUBNET"
    os.environ.pop("ROS_LOCALHOST_ONLY", None)  # the variable of earlier distributions, which takes precedence
