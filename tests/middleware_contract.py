"""The backends that the contract of `fame.middleware.interface` is tested on, each behind the same few words.

``local`` is simulated time in one process. ``dds`` has all nodes in one participant and a scheduler that waits in DDS;
``dds apart`` has each node in a participant of its own, so that everything between two of them goes through discovery,
and a plain scheduler. ``zenoh`` and ``zenoh apart`` are the same with sessions of Zenoh, ``ros`` and ``ros apart`` with
rclpy and its contexts, where it is installed. In ``zenoh crowd`` no session learns of all endpoints.
"""

from __future__ import annotations

import importlib.util
import socket
import threading
import time
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, Protocol

import pytest
from domains import DOMAIN

from fame.clock import SECOND, Scheduler, WallScheduler
from fame.middleware.data_scheduler import DataScheduler
from fame.middleware.interface import Middleware, Node
from fame.middleware.local import LocalMiddleware

TIMEOUT = 30.0
_SLICE = SECOND // 200
_QUIET = SECOND // 20


def needs(module: str) -> Any:
    return pytest.mark.skipif(importlib.util.find_spec(module) is None, reason=f"{module} is not installed")


BACKENDS = [
    "local",
    pytest.param("dds", marks=[needs("cyclonedds"), pytest.mark.dds]),
    pytest.param("dds apart", marks=[needs("cyclonedds"), pytest.mark.dds]),
    pytest.param("dds relay", marks=[needs("cyclonedds"), pytest.mark.dds]),
    pytest.param("zenoh", marks=[needs("zenoh"), pytest.mark.zenoh]),
    pytest.param("zenoh apart", marks=[needs("zenoh"), pytest.mark.zenoh, pytest.mark.long]),
    pytest.param("zenoh crowd", marks=[needs("zenoh"), pytest.mark.zenoh, pytest.mark.long]),
    pytest.param("ros", marks=[needs("rclpy"), pytest.mark.ros]),
    pytest.param("ros apart", marks=[needs("rclpy"), pytest.mark.ros]),
]


class World(Protocol):
    """A backend at work. `warnings` are those of all its middlewares."""

    scheduler: Scheduler
    warnings: list[str]

    def node(self, name: str, namespace: str = "", part: str = "") -> Node: ...

    def connect(self, *topics: str) -> None:
        """Wait until all ends of the topics are connected, and each publisher knows every subscription."""

    def until(self, condition: Callable[[], object]) -> None:
        """Run until the condition holds; fail if it never does."""

    def settle(self) -> None:
        """Run until nothing more is to be expected."""

    def arrive(self) -> None:
        """Wait until what was published waits at its subscriptions, without running."""

    def close(self) -> None: ...


class LocalWorld:
    """Simulated time: everything that is due has happened when the scheduler has nothing left."""

    def __init__(self) -> None:
        self.scheduler = Scheduler()
        self.middleware = LocalMiddleware(self.scheduler)

    @property
    def warnings(self) -> list[str]:
        return list(map(str, self.middleware.warnings))

    def node(self, name: str, namespace: str = "", part: str = "") -> Node:
        return self.middleware.node(name, namespace, part)

    def connect(self, *topics: str) -> None:
        pass

    def until(self, condition: Callable[[], object]) -> None:
        self.scheduler.run()
        assert condition()

    def settle(self) -> None:
        self.scheduler.run()

    def arrive(self) -> None:
        pass

    def close(self) -> None:
        self.middleware.close()


class WallWorld:
    """The wall clock. `make` gives a middleware; `apart` gives each node one of its own."""

    def __init__(self, scheduler: WallScheduler, make: Callable[..., Any], *, apart: bool = False) -> None:
        self.scheduler = scheduler
        self.warnings: list[str] = []
        self.middlewares: list[Any] = []
        self._make, self._apart = make, apart

    def node(self, name: str, namespace: str = "", part: str = "") -> Node:
        if self._apart or not self.middlewares:
            self.middlewares.append(self._make(self.scheduler, on_warning=self._warn))
        node: Node = self.middlewares[-1].node(name, namespace, part)
        return node

    def connect(self, *topics: str) -> None:
        for middleware in self.middlewares:
            assert middleware.wait_matched(topics, TIMEOUT) == []
        nodes = [node for middleware in self.middlewares for node in middleware.nodes]
        deadline = time.monotonic() + TIMEOUT
        for publisher in (end for node in nodes for end in node.publishers if end.topic in topics):
            others = [end for node in nodes if node is not publisher.node for end in node.subscriptions]
            expected = sum(end.topic == publisher.topic for end in others)
            while publisher.subscriber_count() < expected:  # it may have found one of them, and not the others
                assert time.monotonic() < deadline, f"{publisher.topic}: not all of {expected} subscriptions found"
                time.sleep(_SLICE / SECOND)

    def until(self, condition: Callable[[], object]) -> None:
        deadline = self.scheduler.now + round(TIMEOUT * SECOND)
        while not condition():
            assert self.scheduler.now < deadline, f"waited {TIMEOUT} s; warnings: {self.warnings}"
            self.scheduler.run(until=self.scheduler.now + _SLICE)

    def settle(self) -> None:
        self.scheduler.run(until=self.scheduler.now + _QUIET)

    def arrive(self) -> None:
        time.sleep(_QUIET / SECOND)

    def close(self) -> None:
        for middleware in self.middlewares:
            middleware.close()

    def _warn(self, warning: object) -> None:
        text = str(warning)
        if text not in self.warnings:
            self.warnings.append(text)


def world(backend: str) -> World:
    """A new world of a backend."""
    if backend == "local":
        return LocalWorld()
    if backend == "zenoh crowd":
        return CrowdWorld()
    if backend == "dds relay":
        return RelayWorld()
    apart = backend.endswith("apart")
    return {"dds": dds_world, "ros": ros_world, "zenoh": zenoh_world}[backend.split()[0]](apart=apart)


def dds_world(*, apart: bool) -> WallWorld:
    from fame.middleware.dds import DdsMiddleware, DdsScheduler

    def make(scheduler: WallScheduler, **options: Any) -> Middleware:
        return DdsMiddleware(scheduler, domain=DOMAIN, **options)

    return WallWorld(WallScheduler() if apart else DdsScheduler(), make, apart=apart)


def ros_world(*, apart: bool) -> WallWorld:
    from fame.middleware.ros import RosMiddleware

    scheduler = WallScheduler() if apart else DataScheduler()
    return WallWorld(scheduler, partial(RosMiddleware, domain=DOMAIN), apart=apart)


def zenoh_world(*, apart: bool) -> WallWorld:
    from fame.middleware.zenoh import ZenohMiddleware

    scheduler = WallScheduler() if apart else DataScheduler()
    return WallWorld(scheduler, partial(ZenohMiddleware, domain=DOMAIN), apart=apart)


class CrowdWorld(WallWorld):
    """Each node in a session of its own, all of a crowd that meets in another process's session: here one more."""

    def __init__(self) -> None:
        from fame.middleware.zenoh import ZenohMiddleware
        from fame.middleware.zenoh.session import take_over

        super().__init__(WallScheduler(), partial(ZenohMiddleware, domain=DOMAIN, crowd=2), apart=True)
        self._hall: Any = take_over(DOMAIN, 2)

    def close(self) -> None:
        super().close()
        self._hall.close()


class RelayWorld(WallWorld):
    """Each node in a middleware of its own, all on one participant, which another process has: here a thread."""

    def __init__(self) -> None:
        from fame.middleware.dds import DdsScheduler
        from fame.middleware.dds.relay import Relay
        from fame.middleware.dds.relayed import RelayedMiddleware

        self._there = DdsScheduler()
        self.relay = Relay(self._there, domain=DOMAIN)
        self._thread = threading.Thread(target=self._there.run)

        def make(scheduler: WallScheduler, **options: Any) -> Middleware:
            here, there = socket.socketpair()
            self._there.soon(partial(self.relay.serve, there))
            return RelayedMiddleware(scheduler, here, **options)

        super().__init__(DdsScheduler(), make, apart=True)  # as an engine has it, though it has no waiter
        self._thread.start()

    def close(self) -> None:
        super().close()
        if self._thread.is_alive():
            self._there.stop()
            self._thread.join()
            self.relay.close()


def middlewares(world: World) -> Iterable[Any]:
    """The middlewares of a world: each of them must show the same graph."""
    return world.middlewares if isinstance(world, WallWorld) else [world.middleware]  # type: ignore[attr-defined]
