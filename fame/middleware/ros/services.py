"""Services and clients."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future

from fame.clock import SECOND
from fame.middleware import messages
from fame.middleware.interface import Message, respond
from fame.middleware.ros.translation import from_ros, ros_class, to_ros
from fame.middleware.wire_base import ClientEnd, ServiceEnd

if TYPE_CHECKING:
    from fame.middleware.ros.nodes import RosNode

_LOOK = SECOND // 10
"""How often a client that waits looks whether its service is still there (ns)."""


class RosService(ServiceEnd):
    """What answers requests. See `fame.middleware.interface.Service`.

    rclpy asks in its executor's thread and may be given a coroutine: it waits there while the handler runs in the
    scheduler. Responses leave one after the other: rclpy takes up coroutines that wait in no order.
    """

    def __init__(self, node: RosNode, name: str, type: str, handler: Callable[[Message], Any]) -> None:
        super().__init__(node, node.ros.resolve_service_name(name), type)
        self.check_offer()
        self._handler, self._class = handler, ros_class(self.request_type.removesuffix("_Request"))
        self._responses: deque[tuple[Any, Any]] = deque()
        group = ReentrantCallbackGroup()  # a response that is not known yet keeps nobody else of the node waiting
        self._end = node.ros.create_service(self._class, name, self._asked, callback_group=group)

    def leave(self) -> None:
        self.node.ros.destroy_service(self._end)

    async def _asked(self, request: Any, response: Any) -> Any:
        """In the executor's thread."""
        middleware = self.node.middleware
        answer = Future(executor=middleware.executor)
        middleware.scheduler.soon(partial(self._answer, request, answer))
        said = await answer
        middleware.scheduler.soon(self._left)
        return said

    def _answer(self, request: Any, answer: Any) -> None:
        def tell(said: Any) -> None:
            self._responses.append((answer, to_ros(messages.create(self.response_type, said), self._class.Response)))
            if len(self._responses) == 1:
                self._send()

        if not self.closed:
            respond(self._handler(from_ros(request, self.request_type)), tell)

    def _send(self) -> None:
        answer, response = self._responses[0]
        answer.set_result(response)
        self.node.middleware.executor.wake()

    def _left(self) -> None:
        self._responses.popleft()
        if self._responses:
            self._send()


class RosClient(ClientEnd):
    """What asks a service. See `fame.middleware.interface.Client`."""

    def __init__(self, node: RosNode, name: str, type: str) -> None:
        super().__init__(node, node.ros.resolve_service_name(name), type)
        self._class = ros_class(self.request_type.removesuffix("_Request"))
        self._waiting: dict[Any, Callable[[Message], object]] = {}
        self._end = node.ros.create_client(self._class, name)

    @property
    def available(self) -> bool:
        """Whether somebody offers the service now."""
        return not self.closed and bool(self._end.service_is_ready())

    def call(self, request: Any, callback: Callable[[Message], object]) -> None:
        """Send a request. Raises MessageError if it does not fit, or if nobody offers the service with this type."""
        message = self.request(request)
        future = self._end.call_async(to_ros(message, self._class.Request))
        self._waiting[future] = callback
        future.add_done_callback(lambda done: self.node.middleware.scheduler.soon(partial(self._hear, done)))
        self.node.middleware.scheduler.after(_LOOK, self._look)

    def leave(self) -> None:
        self._waiting.clear()
        self.node.ros.destroy_client(self._end)

    def _hear(self, future: Any) -> None:
        callback = self._waiting.pop(future, None)
        if callback is not None:
            callback(from_ros(future.result(), self.response_type))

    def _look(self) -> None:
        """If the service has left, those who wait for it wait in vain."""
        if self._waiting and self.available:
            self.node.middleware.scheduler.after(_LOOK, self._look)
        elif self._waiting:
            self._waiting.clear()
            self.give_up()
