"""Which peers and routers a session connects to.

Without a network everything stays on loopback, without multicast and without a router: the first process of a domain
listens at a port of 127.0.0.1 that follows from the domain. The others connect to it, learn of each other by gossip,
and connect directly. When the first one ends, another one listens there in its place (`take_over`), for those who come
later. It does so by a second session: Zenoh cannot add a listener to a session, and a session that waits for a port
cannot close.

The session that listens there is a router of Zenoh, and the others gossip with it alone: if all told all others of
everybody, discovery would cost each of them the square of their number.

Of a `crowd`, each session has one connection only, to the router: with connections from each to each, a hundred
processes on a machine would have 4950, and no time for anything else. Then everything goes through that router.

Machines are connected by routers: ``fame router``, `zenohd` or rmw_zenoh's `rmw_zenohd`, one on each machine. The
sessions of a machine connect to its router, which says to each who else is there; what is for another machine goes
through the routers. A session never listens on the network itself.

A configuration file of Zenoh (JSON5 or YAML) is put on top: what differs in it from Zenoh's defaults holds.
"""

from __future__ import annotations

import json
import socket
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import zenoh

from fame.errors import ConfigError
from fame.middleware.interface import MAX_MESSAGE_SIZE
from fame.middleware.wire_base import lease, load_of_machine

ROUTER_PORT = 7447
"""Where routers of Zenoh listen."""
_FIRST_PORT = 7448
"""The port of domain 0, for processes without a router."""
_HEADERS = 1_000_000
"""What a message may have around its data (bytes)."""

_RETRY = {"period_init_ms": 200, "period_max_ms": 2000, "period_increase_factor": 2}
_LEASE = "transport/link/tx/lease"
_SETTINGS: dict[str, Any] = {
    "scouting/multicast/enabled": False,
    "scouting/delay": 200,  # ms that the first process of a domain waits for others
    "connect/timeout_ms": -1,
    "connect/exit_on_failure": False,
    "connect/retry": _RETRY,
    "timestamping/enabled": True,  # histories need it
    _LEASE: 3000,  # ms after which a machine that fell silent is gone, as over DDS
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 100_000,  # us, as over DDS
    "transport/link/rx/max_message_size": MAX_MESSAGE_SIZE + _HEADERS,
    "transport/unicast/accept_pending": 1000,
    "transport/shared_memory/enabled": False,  # two threads in each process, and 16 MB of a /dev/shm that may be small
}
_CLIENT: dict[str, Any] = {"connect/timeout_ms": 10_000, "connect/exit_on_failure": True}
"""A client is nothing without its router: Zenoh waits for it before the session is there."""
_MEMBER: dict[str, Any] = {"mode": "client", "connect/timeout_ms": 300_000, "connect/exit_on_failure": True}
"""One of a crowd: its router may be in a process that starts at the same time, on a machine with much to do."""
_LEASE_HERE, _LEASE_PER_MEMBER = 10.0, 1.0
"""The lease on one machine, and for each of a crowd (s). Connections end with their process; what is silent for a while
may only have to wait for its turn: one that is given up connects again, and all that it has is told to all again."""
_PEER: dict[str, Any] = {
    "mode": "peer",
    "scouting/gossip/autoconnect_strategy": {
        "peer": {"to_router": "always", "to_peer": "greater-zid"}
    },  # once, not twice
    "scouting/gossip/target": {"router": ["router", "peer"], "peer": ["router"]},
    "listen/endpoints": ["tcp/127.0.0.1:0"],
}


def open_session(domain: int, network: str | None, *, crowd: int = 0) -> zenoh.Session:
    """Return a session for the processes of a domain; with `crowd`, for one of so many of this machine.

    `network` None keeps everything on this machine, without a router. Else it names routers, as `locators` takes them,
    or it is the path of a configuration file, which names them. Raises ConfigError.
    """
    kind = _MEMBER if crowd else _PEER
    if network is None:
        alone = None if crowd else take_over(domain)
        return alone or _open(_SETTINGS | _confined(crowd) | kind | {"connect/endpoints": [_meeting_point(domain)]})
    file = configuration_file(network)
    routers = [f"tcp/127.0.0.1:{ROUTER_PORT}"] if file else locators(network)
    return _open(_SETTINGS | kind | {"connect/endpoints": routers}, file)


def take_over(domain: int, crowd: int = 0) -> zenoh.Session | None:
    """Return a session that listens where processes of the domain meet, a `crowd` among them; None
    if another process does."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", _FIRST_PORT + domain))
        except OSError:
            return None
    try:
        here = {"mode": "router", "listen/endpoints": [_meeting_point(domain)]}
        return _open(_SETTINGS | _confined(crowd) | _PEER | here)
    except ConfigError:
        return None  # another process was faster


def _confined(crowd: int) -> dict[str, Any]:
    """The settings of sessions of one machine."""
    return {_LEASE: round(1000 * max(_LEASE_HERE * load_of_machine(), _LEASE_PER_MEMBER * crowd))}


def open_router(listen: Iterable[str], others: Iterable[str], file: Path | None = None) -> zenoh.Session:
    """Return a router that listens at some addresses, and connects to other routers. Raises ConfigError."""
    ends = {"mode": "router", "listen/endpoints": list(listen), "connect/endpoints": list(others)}
    return _open(_SETTINGS | ends | {"scouting/delay": 0}, file)


def locators(text: str) -> list[str]:
    """Addresses of routers, with commas between them, as Zenoh takes them.

    >>> locators("10.0.0.7,depot:7450"), locators("tls/depot.example:7447"), locators("[fd00::1]")
    (['tcp/10.0.0.7:7447', 'tcp/depot:7450'], ['tls/depot.example:7447'], ['tcp/[fd00::1]:7447'])
    """
    return [_locator(word.strip()) for word in text.split(",") if word.strip()]


def configuration_file(network: str) -> Path | None:
    """Return the file, if `network` is the path of one."""
    return Path(network) if network.startswith("/") else None


def _meeting_point(domain: int) -> str:
    return f"tcp/127.0.0.1:{_FIRST_PORT + domain}"


def _locator(text: str) -> str:
    if "/" in text:
        return text
    port = text.rpartition("]")[2].rpartition(":")
    return f"tcp/{text}" if port[1] else f"tcp/{text}:{ROUTER_PORT}"


def _open(settings: dict[str, Any], file: Path | None = None) -> zenoh.Session:
    config = zenoh.Config()
    settings = settings | {_LEASE: round(1000 * lease(settings[_LEASE] / 1000))}
    more = dict(_settings_of(file)) if file is not None else {}
    if more.get("mode") == "client":
        settings = settings | _CLIENT
    for key, value in (settings | more).items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise ConfigError(f"Zenoh refuses {key}: {_text(error)}", file=str(file or "")) from None
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise ConfigError(f"Zenoh does not start: {_text(error)}", file=str(file or "")) from None


def _settings_of(file: Path) -> Iterator[tuple[str, Any]]:
    """What a configuration file sets, by path (``transport/link/tls/...``). Raises ConfigError."""
    try:
        given = json.loads(str(zenoh.Config.from_file(file)))
    except zenoh.ZError as error:
        raise ConfigError(f"expected a configuration of Zenoh: {_text(error)}", file=str(file)) from None
    yield from _differences(given, _defaults(), "")


def _differences(given: Any, default: Any, path: str) -> Iterator[tuple[str, Any]]:
    if given == default:
        return
    if isinstance(given, dict) and isinstance(default, dict):
        for key, value in given.items():
            yield from _differences(value, default.get(key), f"{path}/{key}" if path else key)
    else:
        yield path, given


@cache
def _defaults() -> Any:
    return json.loads(str(zenoh.Config()))


def _text(error: Exception) -> str:
    """What Zenoh says, in one line, without the places in its sources."""
    return str(error).split(" at /")[0].strip()
