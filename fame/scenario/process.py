"""The common part of FAME's processes: a scheduler on the wall clock, middleware, signals, orderly shutdown."""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

from fame.clock import SECOND, WallScheduler
from fame.config.loader import find_object, registered
from fame.errors import ConfigError, FameError
from fame.middleware.interface import EndpointWarning, Middleware
from fame.robot.events import Event
from fame.rooms import DDS_RELAYED, MIDDLEWARES, load
from fame.scenario.service_manager import Notifier

_ENDING = 3
"""Maximum time for stopping a component (s), longer than the grace period of scripts."""
BACKENDS = tuple(MIDDLEWARES)
"""FAME's own backends between processes; packages add others (docs/extending.md). `fame run` also has ``local``."""
GROUP = "fame.middleware"
"""Group of the entry points by which packages add backends."""
PARENT = "FAME_PARENT"
"""Environment variable with the process id of the FAME process that started this one and displays its output. When the
parent is gone, this process ends."""

_EVENT, _WARNING = "fame_event", "fame_warning"
"""The keys of events and warnings in the lines of a child."""


class ScriptWarning(NamedTuple):
    """A Python warning, as a rule of a script: the model file and the line (1-based) in it, and what it says."""

    file: str
    line: int
    text: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.text}"


def is_child() -> bool:
    """Return whether another FAME process started this one and displays its output."""
    return PARENT in os.environ


_forked_by: list[int] = []


def forked(parent: int) -> None:
    """Note that this process was forked by another one, and is to end with it."""
    _forked_by[:] = [parent]


def orphaned() -> bool:
    """Return whether the FAME process that started this one has ended."""
    parent = os.environ.get(PARENT, "")
    parents = _forked_by or ([int(parent)] if parent.isdecimal() else [])
    return any(os.getppid() != each for each in parents)


def encode_event(event: Event) -> str:
    """Return the line that a child prints for an event, so that its parent need not read a sentence."""
    return json.dumps({_EVENT: [event.time, event.robot, event.element, event.what, str(event.detail)]})


def encode_warning(warning: ScriptWarning) -> str:
    """Return the line that a child prints for a warning: its parent knows the file that the line came from."""
    return json.dumps({_WARNING: warning})


def _print_warning(message: Warning | str, category: type[Warning], filename: str, lineno: int, *_: object) -> None:
    warning = ScriptWarning(filename, lineno, f"{category.__name__}: {message}")
    with suppress(OSError):  # the parent has gone
        print(encode_warning(warning), file=sys.stderr, flush=True)


def decode_line(line: str) -> Event | ScriptWarning | None:
    """Return the event or warning that a child printed; None for any other line."""
    if not line.startswith("{"):
        return None
    try:
        fields = json.loads(line)
        if _WARNING in fields:
            file, number, text = fields[_WARNING]
            return ScriptWarning(str(file), int(number), str(text))
        time, robot, element, what, detail = fields[_EVENT]
        return Event(int(time), str(robot), 0, 0, str(element), str(what), str(detail))
    except (ValueError, TypeError, KeyError, RecursionError):
        return None


def event_text(event: Event) -> str:
    """Return the line that people read: simulated or wall-clock time (s), robot, element, what happened."""
    place = f"{event.robot}: {event.element}" if event.element else event.robot
    return f"{event.time / SECOND:9.1f} s   {place}: {event.detail}"


class Router(str):
    """A network that Zenoh reaches through routers: their addresses, or the path of its configuration file."""


class Component(Protocol):
    """The component that a process runs: an engine, a world, a splitter ..."""

    def close(self) -> None:
        """Close all endpoints at once."""


@runtime_checkable
class _Leaving(Protocol):
    """A component that takes time to end, as an engine whose scripts still leave."""

    def stop(self) -> bool:
        """Begin to stop; return whether more time is needed and `stop` should be called again."""


def scheduler_for(backend: str) -> WallScheduler:
    """Return the wall clock for a backend: it waits for the data of the backend itself."""
    from fame.middleware.data_scheduler import DataScheduler

    return DataScheduler()


def connect(
    backend: str,
    scheduler: WallScheduler,
    network: str | None = None,
    on_warning: Callable[[EndpointWarning], object] | None = None,
    *,
    crowd: int = 0,
    relay: socket.socket | None = None,
) -> Middleware:
    """Return the middleware of a process; with `crowd`, of one of so many that were started together.

    With `relay`, its participant is in the process at the other end (`fame.middleware.dds.relay`).

    Raises UnavailableError if its packages are not installed, and ConfigError for a network that is not of its kind.
    """
    if network is not None and isinstance(network, Router) != (backend == "zenoh"):
        routed = "Zenoh reaches other machines through routers: --router ADDRESS, not --network"
        raise ConfigError(routed if backend == "zenoh" else "--router and --zenoh-config need --middleware zenoh")
    if relay is not None:
        relayed: Middleware = load(DDS_RELAYED)(scheduler, relay, on_warning)
        return relayed
    crowded = {"crowd": crowd} if backend == "zenoh" else {}
    if backend in MIDDLEWARES:
        make = load(MIDDLEWARES[backend])
    elif (place := registered(GROUP).get(backend)) is not None:
        make = find_object(place, Path())
    else:
        raise ConfigError(f"expected middleware {' or '.join(BACKENDS)}, got {backend!r}")
    made: Middleware = make(scheduler, network=network, on_warning=on_warning, **crowded)
    return made


_ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
"""The signals that ask a process to end. SIGHUP comes when its terminal has gone."""


@contextmanager
def signals_call(handler: Callable[..., object]) -> Iterator[None]:
    """Call `handler` for each signal that asks the process to end, while the block lasts.

    A signal that was ignored when the process started (``nohup``) stays ignored.
    """
    former: dict[int, Any] = {number: signal.getsignal(number) for number in _ENDS}
    taken = [number for number, action in former.items() if action != signal.SIG_IGN]
    for number in taken:
        signal.signal(number, handler)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, former[number])


def run_until_signal(scheduler: WallScheduler) -> None:
    """Run until a signal asks to end, or until the FAME process that started this one has ended."""
    with signals_call(lambda *_: scheduler.stop()):
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
    build: Callable[[WallScheduler, Middleware], Component],
    on_warning: Callable[[EndpointWarning], object] | None = None,
    *,
    crowd: int = 0,
    relay: socket.socket | None = None,
) -> None:
    """Build a component and run it until a signal asks to end; then, or after an error, stop it safely and close it.

    `on_warning` is called with each warning of the middleware. `crowd`, `relay`: as for `connect`. The traceback of an
    unexpected error goes to stderr, which is the log of such a process.
    """
    if is_child():
        warnings.showwarning = _print_warning  # type: ignore[assignment]
    scheduler = scheduler_for(backend)
    middleware = connect(backend, scheduler, network, on_warning, crowd=crowd, relay=relay)
    try:
        component, manager = build(scheduler, middleware), Notifier(scheduler)
        with signals_call(lambda *_: scheduler.stop()):
            try:
                manager.ready()
                _watch_parent(scheduler)
                scheduler.run()
            except FameError:
                raise
            except Exception:
                import traceback

                with suppress(OSError):
                    traceback.print_exc()
                raise
            finally:
                manager.stopping()
                _end(component, scheduler)
    finally:
        middleware.close()


def _end(component: Component, scheduler: WallScheduler) -> None:
    """Stop and close a component: it is closed, and its last messages go out, whatever fails before."""
    until = scheduler.now + _ENDING * SECOND
    try:
        while isinstance(component, _Leaving) and component.stop() and scheduler.now < until:
            scheduler.run(scheduler.now + SECOND // 50)
    finally:
        try:
            component.close()
        finally:
            scheduler.run(scheduler.now + SECOND // 10)
