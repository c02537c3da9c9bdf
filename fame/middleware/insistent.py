"""Requests that are sent again whenever a server comes, until one responds, such as to cancel what it may still do."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Set
from functools import partial
from itertools import count
from typing import Any

from fame.clock import SECOND, Scheduler
from fame.middleware.interface import Client

_MOST = 100
"""How many requests of a client are kept; then the oldest one is given up."""
_AFTER = (0, SECOND, 4 * SECOND)
"""When a request is sent after servers have changed (ns): one that has come back may have to find this client first."""


class InsistentRequests:
    """For backends: those of one client. The backend calls `on_servers_changed`."""

    def __init__(self, client: Client, scheduler: Scheduler) -> None:
        self._client, self._scheduler = client, scheduler
        self._open: dict[int, tuple[Any, Callable[[Any], object]]] = {}
        self._servers: Set[Hashable] = frozenset()
        self._numbers = count()

    def __len__(self) -> int:
        return len(self._open)

    def add(self, request: Any, servers: Set[Hashable], callback: Callable[[Any], object]) -> None:
        """Send a request, now if a server is there; `servers` are those that are there now."""
        number, self._servers = next(self._numbers), servers
        self._open[number] = request, callback
        if len(self._open) > _MOST:
            del self._open[next(iter(self._open))]
        self._send(number)

    def on_servers_changed(self, servers: Set[Hashable]) -> None:
        """Send the requests without response again, if these servers are others than before."""
        if servers != self._servers:
            self._servers = servers
            for number in self._open:
                for delay in _AFTER:
                    self._scheduler.after(delay, partial(self._send, number))

    def clear(self) -> None:
        self._open.clear()

    def _send(self, number: int) -> None:
        if number in self._open and self._client.available:
            self._client.call(self._open[number][0], partial(self._respond, number))

    def _respond(self, number: int, response: Any) -> None:
        if number in self._open:
            self._open.pop(number)[1](response)
