"""Publishers, subscriptions, services and clients of rclpy, with its types, messages and quality of service.

Messages cross as CDR: topics hand over the bytes as they are, services go through rclpy's own (de)serialization. So
there is one way to write a field, that of `fame.middleware.codec`.

rclpy delivers a node's messages to itself: each subscription keeps what publishers of its own node have sent to it, and
drops the echo (`fame.middleware.self_echo_filter`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cache, partial
from importlib import import_module
from itertools import count
from typing import TYPE_CHECKING, Any

from rclpy.callback_groups import CallbackGroup, ReentrantCallbackGroup
from rclpy.context import Context
from rclpy.duration import Duration, Infinite
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import InvalidHandle
from rclpy.executors import Executor
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.task import Future

from fame.clock import SECOND
from fame.dataclasses import dataclass
from fame.errors import MessageError, MissingTypeError
from fame.middleware import codec
from fame.middleware.errors import mismatch_warning
from fame.middleware.interface import ENGINE, UNKNOWN_NODE, AnyMessage, QoS, resolve
from fame.middleware.qos import compatible, one_deeper
from fame.middleware.self_echo_filter import EchoFilter
from fame.middleware.wire_endpoints import WireClient, WirePublisher, WireService, WireSubscription

if TYPE_CHECKING:
    from fame.middleware.ros.middleware import RosNode

# ---- types, messages, quality of service -----------------------------------------------------------------------------

_OF_ACTIONS = {"SendGoal": "SendGoalService", "GetResult": "GetResultService", "FeedbackMessage": "FeedbackMessage"}
"""Where the class of an action (``NavigateToPose``) has the types that its topics and services carry."""


@cache
def ros_class(name: str) -> Any:
    """rclpy's class of a message or service type. Raises MissingTypeError if the sourced ROS does not have it.

    ``pkg/action/Name_SendGoal`` and the like are parts of an action, as `fame.middleware.actions` names them.
    """
    package, kind, short = name.split("/")
    action, _, part = short.rpartition("_")
    try:
        module = import_module(f"{package}.{kind}")
        if kind == "action":
            return getattr(getattr(module, action).Impl, _OF_ACTIONS[part])
        return getattr(module, short)
    except (ImportError, AttributeError):
        text = f"this ROS does not have it: install or build its package ({package}), and source it"
        raise MissingTypeError(text, type=name) from None


def to_ros(message: AnyMessage, kind: Any) -> Any:
    """Return a message as one of rclpy's class `kind`."""
    return deserialize_message(codec.serialize(message), kind)


def from_ros(message: Any, type: str) -> AnyMessage:
    """Return a message of rclpy as one of ours."""
    return codec.deserialize(serialize_message(message), type)


def profile(qos: QoS) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy[qos.history.upper()],
        depth=qos.depth,
        reliability=ReliabilityPolicy[qos.reliability.upper()],
        durability=DurabilityPolicy[qos.durability.upper()],
        liveliness=LivelinessPolicy[qos.liveliness.upper()],
        deadline=_duration(qos.deadline),
        lifespan=_duration(qos.lifespan),
        liveliness_lease_duration=_duration(qos.lease_duration),
    )


def from_profile(found: QoSProfile) -> QoS:
    """Return the policies by which an endpoint matches others."""
    return QoS(
        reliability="best_effort" if found.reliability == ReliabilityPolicy.BEST_EFFORT else "reliable",
        durability="transient_local" if found.durability == DurabilityPolicy.TRANSIENT_LOCAL else "volatile",
        deadline=_seconds(found.deadline),
        liveliness="manual_by_topic" if found.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC else "automatic",
        lease_duration=_seconds(found.liveliness_lease_duration),
    )


class RosEndpoint:
    """An endpoint of any process, as `fame.middleware.qos.mismatch` takes it."""

    def __init__(self, info: Any) -> None:
        self.type: str = info.topic_type
        self.type_hash: str = ""  # most middlewares of ROS connect endpoints whatever the hashes are
        self.qos: QoS = from_profile(info.qos_profile)


def owner(end: Any) -> str:
    """Return the full name of the node of an endpoint of the graph (rclpy's TopicEndpointInfo)."""
    if end.node_name == UNKNOWN_NODE.strip("/"):
        return UNKNOWN_NODE  # its namespace is of the same kind
    return resolve(end.node_name, end.node_namespace.strip("/"))


def _duration(seconds: float | None) -> Duration:
    return Infinite if seconds is None else Duration(nanoseconds=round(seconds * SECOND))


def _seconds(time: Duration) -> float | None:
    """None if there is no bound; ROS says that as infinite, and as 0 too."""
    return time.nanoseconds / SECOND if 0 < time.nanoseconds < Infinite.nanoseconds else None


# ---- endpoints -------------------------------------------------------------------------------------------------------

_MAX_BATCH = 100
"""Number of messages that are taken in a row if the history is not bounded."""
_SERVICES = QoSProfile(depth=1000)
"""As in `fame.middleware.dds.endpoints`: reliable, volatile, with more than the 10 that a burst exceeds."""
_POLL = SECOND // 10
"""How often a client that waits for a response checks whether its service is still there (ns)."""


class _Polled(CallbackGroup):  # type: ignore[misc]
    """Subscriptions that the executor leaves alone."""

    def can_execute(self, entity: Any) -> bool:
        return False

    beginning_execution = can_execute

    def ending_execution(self, entity: Any) -> None:
        pass


class SubscriptionWaiter:
    """Waits for messages in the thread of a `DataScheduler`.

    The executor of rclpy looks through all entities of all nodes for each message that comes, and takes one. Here the
    wait set holds nothing but subscriptions, and each takes all that has come for it.
    """

    def __init__(self, context: Context) -> None:
        self._context, self._guard = context, GuardCondition(None, None, context=context)
        self._actions: dict[Any, Callable[[], object]] = {}
        self._wait_set: Any = None

    def add(self, end: Any, action: Callable[[], object]) -> None:
        """Call `action` when messages have come for a subscription of rclpy."""
        self._actions[end] = action
        self._wait_set = None

    def remove(self, end: Any) -> None:
        self._actions.pop(end, None)
        self._wait_set = None

    def wait(self, timeout: int) -> None:
        if self._wait_set is None:
            self._wait_set = rclpy_implementation.WaitSet(len(self._actions), 1, 0, 0, 0, 0, self._context.handle)
        wait_set = self._wait_set
        wait_set.clear_entities()
        wait_set.add_guard_condition(self._guard.handle)
        for end in self._actions:
            wait_set.add_subscription(end.handle)
        wait_set.wait(timeout)
        ready = set(wait_set.get_ready_entities("subscription"))
        for end in [end for end in self._actions if end.handle.pointer in ready] if ready else ():
            if end in self._actions:  # else another one has closed it
                self._actions[end]()

    def wake(self) -> None:
        with suppress(InvalidHandle):  # closed by another thread
            self._guard.trigger()

    def close(self) -> None:
        self._wait_set = None
        self._guard.destroy()


@dataclass(frozen=True, slots=True)
class RosHandle:
    """A node of rclpy, its executor, and what to call with the name of a topic whose endpoints do not match.

    `waiter` waits for the messages to its subscriptions; without it, the executor does.
    """

    node: Node
    executor: Executor
    on_mismatch: Callable[[str], object]
    waiter: SubscriptionWaiter | None


class RosPublisher(WirePublisher):
    """A publisher. `history` is what late subscriptions get."""

    def __init__(self, node: RosNode, topic: str, type: str, qos: QoS) -> None:
        ros = node.handle
        super().__init__(node, ros.node.resolve_topic_name(topic), type, qos)
        self._ros = ros
        events = PublisherEventCallbacks(
            incompatible_qos=lambda event: ros.on_mismatch(self.topic), use_default_callbacks=False
        )
        self._end = ros.node.create_publisher(ros_class(self.type), topic, profile(qos), event_callbacks=events)
        depth = (None if qos.history == "keep_all" else qos.depth) if qos.durability == "transient_local" else 0
        self.history: deque[bytes] = deque(maxlen=depth)

    def publish(self, message: AnyMessage) -> None:
        data = self.pack(message)
        for subscription in self.node.subscriptions:
            subscription.expect_echo(self, (data,))
        self.history.append(data)
        self._end.publish(data)

    def subscriber_count(self) -> int:
        return int(self._end.get_subscription_count())

    def matched(self) -> bool:
        own = sum(other.matches(self) for other in self.node.subscriptions)
        return bool(self._end.get_subscription_count() > own)

    def release(self) -> None:
        self._ros.node.destroy_publisher(self._end)


class RosSubscription(WireSubscription):
    """A subscription.

    ROS does not report messages that are dropped from the queue below rclpy. So that queue holds one message more and
    is emptied when the first has come: drops from the queue of this class are counted, with the losses that rclpy
    reports.
    """

    def __init__(
        self,
        node: RosNode,
        topic: str,
        type: str,
        callback: Callable[[AnyMessage], object],
        qos: QoS,
    ) -> None:
        ros = node.handle
        super().__init__(node, ros.node.resolve_topic_name(topic), type, callback, qos)
        self._ros, self._echoes = ros, EchoFilter()
        if qos.durability == "transient_local":
            for publisher in node.publishers:
                self.expect_echo(publisher, publisher.history)
        self._batch = _MAX_BATCH if qos.history == "keep_all" else qos.depth
        events = SubscriptionEventCallbacks(
            incompatible_qos=lambda event: ros.on_mismatch(self.topic),
            message_lost=self._on_lost,
            use_default_callbacks=False,
        )
        self._end: Any = None
        self.uncounted = True  # ROS does not tell what it drops from its own queue
        self._end = ros.node.create_subscription(
            ros_class(self.type),
            topic,
            self._on_data,
            profile(one_deeper(qos)),
            callback_group=_Polled() if ros.waiter is not None else None,
            event_callbacks=events,
            raw=True,
        )
        if ros.waiter is not None:
            for handler in self._end.event_handlers:  # these are for the executor nevertheless
                handler.callback_group = ros.node.default_callback_group
                ros.node.default_callback_group.add_entity(handler)
            ros.waiter.add(self._end, self._take_all)

    def matches(self, publisher: RosPublisher) -> bool:
        """Return whether it is connected to a publisher of its own node."""
        return publisher.topic == self.topic and compatible(publisher.qos, self.qos) is None

    def expect_echo(self, publisher: RosPublisher, sent: Iterable[bytes]) -> None:
        """Drop these messages, which a publisher of its own node sends."""
        if self.matches(publisher):
            self._echoes.expect(publisher, sent, self.node.middleware.scheduler.now)

    def deliver(self, data: bytes) -> None:
        if self.qos.acknowledged:  # ROS does not tell who sends: what FAME's engines send comes in another way
            self._warn_of_others()
        elif not self._echoes.take(data, self.node.middleware.scheduler.now):
            super().deliver(data)

    def _warn_of_others(self) -> None:
        """Warn of publishers that are not engines, from which nothing is received."""
        infos = (info for info in self.node.middleware.graph() if info.name == self.topic)
        others = {name for info in infos for name in info.publishers if not name.endswith(f"/{ENGINE}")}
        for name in sorted(others):
            reason = "over ROS, acknowledged signals are caught from engines of FAME only"
            self.node.middleware.warn(mismatch_warning(self.topic, self.node.full_name, name, reason))

    def matched(self) -> bool:
        return bool(self._end.get_publisher_count() > sum(map(self.matches, self.node.publishers)))

    def release(self) -> None:
        if self._ros.waiter is not None:
            self._ros.waiter.remove(self._end)
        self._ros.node.destroy_subscription(self._end)

    def _on_data(self, data: bytes) -> None:
        """Take what waits in ROS. In the executor's thread."""
        self.enqueue(data)
        if self._end is not None:  # else it is being made
            self._take_all()
        self.schedule()

    def _take_all(self) -> None:
        with self._end.handle:
            for _ in range(self._batch + 1):
                taken = self._end.handle.take_message(self._end.msg_type, self._end.raw)
                if taken is None:
                    break
                self.enqueue(taken[0])
        self.schedule()

    def _on_lost(self, event: Any) -> None:
        """In the executor's thread."""
        if self.counts_losses:
            self.count_lost(event.total_count_change)


class RosService(WireService):
    """A service. See `fame.middleware.interface.Service`.

    rclpy calls back in its executor's thread and accepts a coroutine: it waits there while the handler runs in the
    scheduler. Responses are sent one after the other: rclpy resumes coroutines that wait in no order.
    """

    def __init__(self, node: RosNode, name: str, type: str, handler: Callable[[AnyMessage], Any]) -> None:
        ros = node.handle
        super().__init__(node, ros.node.resolve_service_name(name), type, handler)
        self._ros, self._class = ros, ros_class(self.request_type.removesuffix("_Request"))
        self._responses: deque[tuple[Any, Any]] = deque()
        group = ReentrantCallbackGroup()  # a deferred response does not keep other requests to the node waiting
        self._end = ros.node.create_service(
            self._class, name, self._on_request, qos_profile=_SERVICES, callback_group=group
        )

    def release(self) -> None:
        self._ros.node.destroy_service(self._end)

    async def _on_request(self, request: Any, response: Any) -> Any:
        """In the executor's thread."""
        scheduler, future = self.node.middleware.scheduler, Future(executor=self._ros.executor)
        scheduler.soon(partial(self._answer, request, future))
        result = await future
        scheduler.soon(self._on_sent)
        return result

    def _answer(self, request: Any, future: Any) -> None:
        def send(response: AnyMessage) -> None:
            self._responses.append((future, to_ros(response, self._class.Response)))
            if len(self._responses) == 1:
                self._send()

        if not self.closed:
            self.handle(from_ros(request, self.request_type), send)

    def _send(self) -> None:
        future, response = self._responses[0]
        future.set_result(response)
        self._ros.executor.wake()

    def _on_sent(self) -> None:
        self._responses.popleft()
        if self._responses:
            self._send()


class RosClient(WireClient):
    """A client. See `fame.middleware.interface.Client`."""

    def __init__(self, node: RosNode, name: str, type: str) -> None:
        ros = node.handle
        super().__init__(node, ros.node.resolve_service_name(name), type)
        self._ros, self._class = ros, ros_class(self.request_type.removesuffix("_Request"))
        try:
            self._end = ros.node.create_client(self._class, name, qos_profile=_SERVICES)
        except RuntimeError as error:  # Fast DDS: a process knows one type of a service
            offers = node.middleware.offers(self.name)
            raise self.unavailable(offers) if offers else MessageError(f"{self.name}: {error}", type=type) from None
        self._servers: list[int] = []
        self._numbers = count(1)
        self._polls = False

    @property
    def available(self) -> bool:
        """Whether a node offers the service now."""
        return not self.closed and bool(self._end.service_is_ready())

    def servers(self) -> frozenset[int]:
        """Return the servers, as numbers. ROS only counts them: of one that has left, this takes
        it that it was the oldest."""
        there = self._ros.node.count_services(self.name)
        del self._servers[: max(0, len(self._servers) - there)]
        self._servers += [next(self._numbers) for _ in range(there - len(self._servers))]
        return frozenset(self._servers)

    def send(self, request: AnyMessage) -> Any:
        scheduler = self.node.middleware.scheduler
        future = self._end.call_async(to_ros(request, self._class.Request))
        future.add_done_callback(lambda done: scheduler.soon(partial(self._on_done, done)))
        self._start_polling()
        return future

    def insist(self, request: Any, callback: Callable[[AnyMessage], object]) -> None:
        super().insist(request, callback)
        self._start_polling()

    def release(self) -> None:
        self._ros.node.destroy_client(self._end)

    def _on_done(self, future: Any) -> None:
        if not self.closed:
            self.pending.respond(future, from_ros(future.result(), self.response_type))

    def _start_polling(self) -> None:
        if not self._polls:
            self._polls = True
            self.node.middleware.scheduler.after(_POLL, self._check)

    def _check(self) -> None:
        """Check whether servers have come or left, as long as a request waits for its response."""
        self._polls = not self.closed and bool(self.pending or self.insistent)
        if self._polls:
            self.node.middleware.scheduler.after(_POLL, self._check)
            self.on_servers_changed()
