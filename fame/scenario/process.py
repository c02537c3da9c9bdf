"""What a process of FAME does: its scheduler on the wall clock, its middleware, and a part that is built on both."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from typing import Protocol

from fame.clock import SECOND, WallScheduler
from fame.errors import ConfigError
from fame.middleware.interface import EndpointWarning, Middleware

BACKENDS = ("dds", "ros")
_ENDING = 3
"""How long a part may take to stop (s): more than the grace of scripts."""
PARENT = "FAME_PARENT"
"""In the environment of a process: the pid of the one that started it, shows how it goes, and without which it ends."""


def is_child() -> bool:
    """Whether another process of FAME started this one, and shows how it goes."""
    return PARENT in os.environ


def orphaned() -> bool:
    """Whether the process that started this one as its child is no more."""
    parent = os.environ.get(PARENT)
    return parent is not None and parent.isdecimal() and os.getppid() != int(parent)


class Part(Protocol):
    """What a process holds."""

    def stop(self) -> bool:
        """Begin to end; whether it is not yet over, and should be asked again in a moment."""

    def close(self) -> None:
        """Leave, whatever goes on."""


def scheduler_for(backend: str) -> WallScheduler:
    """The wall clock that suits a backend: that of DDS waits for data itself. Raises UnavailableError."""
    if backend == "dds":
        from fame.middleware.dds import DdsScheduler

        return DdsScheduler()
    return WallScheduler()


def connect(
    backend: str,
    scheduler: WallScheduler,
    network: str | None = None,
    on_warning: Callable[[EndpointWarning], object] | None = None,
) -> Middleware:
    """The middleware of a process. Raises UnavailableError for one that is not installed."""
    if backend == "dds":
        from fame.middleware.dds import DdsMiddleware

        return DdsMiddleware(scheduler, network=network, on_warning=on_warning)
    if backend == "ros":
        from fame.middleware.ros import RosMiddleware

        return RosMiddleware(scheduler, network=network, on_warning=on_warning)
    raise ConfigError(f"middleware {backend!r}: it is {' or '.join(BACKENDS)}")


def run_until_told(scheduler: WallScheduler) -> None:
    """Work until SIGINT or SIGTERM, or until the process is gone that started this one as its child."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: scheduler.stop())
    _watch_parent(scheduler)
    scheduler.run()


def _watch_parent(scheduler: WallScheduler) -> None:
    if orphaned():
        scheduler.stop()
    else:
        scheduler.after(SECOND, lambda: _watch_parent(scheduler))


def serve(
    backend: str,
    network: str | None,
    build: Callable[[WallScheduler, Middleware], Part],
    on_warning: Callable[[EndpointWarning], object] | None = None,
) -> None:
    """Build a part and let it live until SIGINT or SIGTERM; then close it safely.

    `on_warning` is called with what its middleware warns of.
    """
    scheduler = scheduler_for(backend)
    middleware = connect(backend, scheduler, network, on_warning)
    try:
        part = build(scheduler, middleware)
        try:
            run_until_told(scheduler)
        finally:
            until = scheduler.now + _ENDING * SECOND
            while part.stop() and scheduler.now < until:
                scheduler.run(scheduler.now + SECOND // 50)
            part.close()
            scheduler.run(scheduler.now + SECOND // 10)  # what was said last still goes out
    finally:
        middleware.close()
