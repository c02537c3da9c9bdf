"""Services and clients."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.task import Future

from fame.clock import SECOND
from fame.errors import MessageError
from fame.middleware import messages
from fame.middleware.interface import Message, respond
from fame.middleware.ros.translation import from_ros, ros_class, to_ros

if TYPE_CHECKING:
    from fame.middleware.ros.nodes import RosNode

_LOOK = SECOND // 10
"""How often a client that waits looks whether its service is still there (ns)."""


class RosService:
    """What answers requests. See `fame.middleware.interface.Service`.

    rclpy asks in its executor's thread and may be given a coroutine: it waits there while the handler runs in the
    scheduler, and for nobody else.
    """

    def __init__(self, node: RosNode, name: str, type: str, handler: Callable[[Message], Any]) -> None:
        self.node, self.name, self.type, self._handler = node, name, type, handler
        self._request_type, self._response_type = messages.service(type)
        for _, owner in node.middleware.offers(name):
            raise MessageError(f"the service {name} is offered by {owner} already", type=type)
        self._class = ros_class(self._request_type.removesuffix("_Request"))
        self._closed = False
        self._end = node.ros.create_service(self._class, name, self._asked)

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self.node.services.remove(self)
            self.node.ros.destroy_service(self._end)

    async def _asked(self, request: Any, response: Any) -> Any:
        """In the executor's thread."""
        answer = Future(executor=self.node.middleware.executor)
        self.node.middleware.scheduler.soon(partial(self._answer, request, answer))
        return await answer

    def _answer(self, request: Any, answer: Any) -> None:
        def tell(said: Any) -> None:
            answer.set_result(to_ros(messages.create(self._response_type, said), self._class.Response))
            self.node.middleware.executor.wake()

        if not self._closed:
            respond(self._handler(from_ros(request, self._request_type)), tell)


class RosClient:
    """What asks a service. See `fame.middleware.interface.Client`."""

    def __init__(self, node: RosNode, name: str, type: str) -> None:
        self.node, self.name, self.type = node, name, type
        self._request_type, self._response_type = messages.service(type)
        self._class = ros_class(self._request_type.removesuffix("_Request"))
        self._closed = False
        self._waiting: dict[Any, Callable[[Message], object]] = {}
        self._end = node.ros.create_client(self._class, name)

    @property
    def available(self) -> bool:
        """Whether somebody offers the service now."""
        return not self._closed and bool(self._end.service_is_ready())

    def call(self, request: Any, callback: Callable[[Message], object]) -> None:
        """Send a request. Raises MessageError if it does not fit, or if nobody offers the service with this type."""
        offered = [type for type, _ in self.node.middleware.offers(self.name)]
        if offered and f"{offered[0]}_Request" != self._request_type:
            raise MessageError(f"the service {self.name} is of type {offered[0]}", type=self.type)
        if not self.available:
            raise MessageError(f"nobody offers the service {self.name}: wait until it is available", type=self.type)
        message = messages.create(self._request_type, request)
        future = self._end.call_async(to_ros(message, self._class.Request))
        self._waiting[future] = callback
        future.add_done_callback(lambda done: self.node.middleware.scheduler.soon(partial(self._hear, done)))
        self.node.middleware.scheduler.after(_LOOK, self._look)

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._waiting.clear()
            self.node.services.remove(self)
            self.node.ros.destroy_client(self._end)

    def _hear(self, future: Any) -> None:
        callback = self._waiting.pop(future, None)
        if callback is not None:
            callback(from_ros(future.result(), self._response_type))

    def _look(self) -> None:
        """If the service has left, those who wait for it wait in vain."""
        if self._waiting and self.available:
            self.node.middleware.scheduler.after(_LOOK, self._look)
        elif self._waiting:
            self._waiting.clear()
            self.node.middleware.warn(f"{self.name}: the service was closed before it answered {self.node.full_name}")
