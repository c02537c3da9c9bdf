"""Services within one process: a request and its response are two entries of the scheduler, one after the other."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from fame.middleware import messages
from fame.middleware.errors import second_service, unanswered, unavailable
from fame.middleware.interface import Message, respond

if TYPE_CHECKING:
    from fame.middleware.local import LocalNode


class LocalService:
    """What answers requests. `name` is the full name. There is one service of a name at a time."""

    def __init__(self, node: LocalNode, name: str, type: str, handler: Callable[[Message], Any]) -> None:
        self.node, self.name, self.type, self._handler = node, name, type, handler
        self.request_type, self.response_type = messages.service(type)
        offered = node.middleware.services.setdefault(name, self)
        if offered is not self:
            raise second_service(name, offered.node.full_name, type)

    def answer(self, request: Message, tell: Callable[[Message], object]) -> None:
        """Tell the response. Raises MessageError if what the handler gave does not fit the type."""
        respond(self._handler(request), lambda response: tell(messages.create(self.response_type, response)))

    def close(self) -> None:
        if self.node.middleware.services.get(self.name) is self:
            del self.node.middleware.services[self.name]
            self.node.ends.remove(self)


class LocalClient:
    """What asks a service. See `fame.middleware.interface.Client`."""

    def __init__(self, node: LocalNode, name: str, type: str) -> None:
        self.node, self.name, self.type = node, name, type
        self.request_type, _ = messages.service(type)

    @property
    def available(self) -> bool:
        """Whether somebody offers the service now."""
        return self.name in self.node.middleware.services

    def call(self, request: Any, callback: Callable[[Message], object]) -> None:
        """Send a request. Raises MessageError if it does not fit, or if nobody offers the service with this type."""
        service = self.node.middleware.services.get(self.name)
        if service is None or service.request_type != self.request_type:
            offered = () if service is None else (service.request_type.removesuffix("_Request"),)
            raise unavailable(self.name, self.request_type, offered)
        message = messages.create(self.request_type, request)
        self.node.middleware.scheduler.soon(partial(self._ask, service, message, callback))

    def close(self) -> None:
        if self in self.node.ends:
            self.node.ends.remove(self)

    def _ask(self, service: LocalService, request: Message, callback: Callable[[Message], object]) -> None:
        middleware = self.node.middleware
        if middleware.services.get(self.name) is service:
            service.answer(request, lambda said: middleware.scheduler.soon(partial(self._hand_over, said, callback)))
        else:
            middleware.warn(unanswered(self.name, self.node.full_name))

    def _hand_over(self, response: Message, callback: Callable[[Message], object]) -> None:
        if self in self.node.ends:
            callback(response)
