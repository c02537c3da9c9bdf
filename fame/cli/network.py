"""Options of the commands that communicate with other processes, middleware and network."""

from __future__ import annotations

import ipaddress
import os
from argparse import ArgumentTypeError, Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.cli.arguments import BackendNames, Parser
from fame.cli.output import note
from fame.errors import ConfigError, FameError

if TYPE_CHECKING:
    from fame.clock import WallScheduler
    from fame.middleware.interface import EndpointWarning, Middleware
    from fame.middleware.simulated_time import Lockstep
    from fame.middleware.wire_base import WireNode


def guard(arguments: Namespace, trusted: Sequence[Any], option: str) -> Callable[[Middleware], None]:
    """Raise FameError if others can send code to a process unasked: now, or by what is returned, once it is connected.

    `option` names what would keep them away.
    """
    open_to_all = FameError(
        "others can reach this process, and a topic that carries code must not be open by accident: "
        f"give {option}, or --insecure to take what anybody sends"
    )
    guarded = bool(trusted or arguments.insecure)
    if arguments.network is not None and not guarded:
        raise open_to_all

    def check(middleware: Middleware) -> None:
        if not (guarded or middleware.confined):  # loopback is asked for, and the platform does not keep it
            raise open_to_all

    return check


def wait_until(scheduler: WallScheduler, condition: Callable[[], object], seconds: float) -> bool:
    """Run until a condition holds, for some `seconds` at most. Returns whether it holds."""
    until = scheduler.now + round(seconds * 1e9)
    while not condition() and scheduler.now < until:
        scheduler.run(min(until, scheduler.now + _POLL))
    return bool(condition())


_POLL = 20_000_000
"""Interval in which `wait_until` looks (ns)."""


def add_network(parser: Parser, *, here: bool = True) -> None:
    """``--middleware``, ``--localhost`` and ``--network``. `here`: they are for this machine."""
    parser.add_argument(
        "--middleware", choices=BackendNames(), metavar="dds|zenoh|ros", default="dds",
        help="dds (default) or zenoh: compatible with ROS 2, which need not be installed; ros: through rclpy, which "
        "also receives the arguments after --ros-args",
    )  # fmt: skip
    reach = parser.add_mutually_exclusive_group()
    reach.add_argument(
        "--localhost", dest="network", action="store_const", const=None, help="this machine only (the default)"
    )
    reach.add_argument(
        "--network", type=interface if here else str, metavar="IFACE",
        help="use this network interface (name or address), in the domain ROS_DOMAIN_ID",
    )  # fmt: skip
    reach.add_argument(
        "--router", dest="network", type=router, metavar="ADDRESS",
        help="Zenoh: connect through this router, such as 127.0.0.1, 10.0.0.7:7447 or tls/depot:7447 (see fame router)",
    )  # fmt: skip
    reach.add_argument(
        "--zenoh-config", dest="network", type=zenoh_config, metavar="FILE",
        help="Zenoh: a configuration file of Zenoh (JSON5), for routers, TLS, user and password",
    )  # fmt: skip


def interface(text: str) -> str:
    """Return the name or address of a network interface of this machine."""
    with suppress(ValueError):
        address = ipaddress.ip_address(text)
        if _is_here(address):
            return str(address)
    names = _interfaces()
    if text not in names:
        raise ArgumentTypeError(f"expected one of {', '.join(names)}, or an address of this machine, got {text!r}")
    return text


def _interfaces() -> list[str]:
    import socket

    return [name for _, name in socket.if_nameindex()]


def interface_of(name: str) -> str | None:
    """Return the name of the network interface that has a name or an address; None if it is not found."""
    if name in _interfaces():
        return name
    with suppress(ValueError):
        address = ipaddress.ip_address(name)
        if address.is_loopback:
            return "lo"
        known = addresses_4() if address.version == 4 else _addresses_6()
        return known.get(address)
    return None


def addresses_4() -> dict[ipaddress.IPv4Address | ipaddress.IPv6Address, str]:
    """Return the IPv4 addresses of this machine, and the name of the interface of each."""
    import fcntl
    import socket
    import struct
    from array import array

    size = struct.calcsize("16sPPP")  # of struct ifreq <linux/if.h>
    room = array("B", bytes(256 * size))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end, suppress(OSError):
        asked = struct.pack("iP", len(room), room.buffer_info()[0])
        length = struct.unpack("iP", fcntl.ioctl(end, _GET_ADDRESSES, asked))[0]
        rows = [room[at : at + size].tobytes() for at in range(0, length, size)]
        return {ipaddress.IPv4Address(row[20:24]): row[:16].split(b"\0")[0].decode().split(":")[0] for row in rows}
    return {}


_GET_ADDRESSES = 0x8912  # SIOCGIFCONF of <linux/sockios.h>
_INET6 = Path("/proc/net/if_inet6")


def _addresses_6() -> dict[ipaddress.IPv4Address | ipaddress.IPv6Address, str]:
    """The same, of IPv6."""
    rows = [line.split() for line in _INET6.read_text().splitlines()] if _INET6.exists() else []
    return {ipaddress.IPv6Address(bytes.fromhex(row[0])): row[-1] for row in rows}


def router(text: str) -> str:
    """Addresses of Zenoh's routers."""
    from fame.scenario.process import Router

    if not text.strip(" ,") or text.startswith("/"):
        raise ArgumentTypeError(f"expected an address such as 10.0.0.7 or tcp/10.0.0.7:7447, got {text!r}")
    return Router(text)


def zenoh_config(text: str) -> str:
    """Return the path of a configuration file of Zenoh."""
    from fame.scenario.process import Router

    file = Path(text).resolve()
    if not file.is_file():
        raise ArgumentTypeError(f"there is no file {text!r}")
    return Router(file)


def _is_here(address: ipaddress.IPv4Address | ipaddress.IPv6Address) -> bool:
    """Whether an interface of this machine has the address."""
    import socket

    family = socket.AF_INET if address.version == 4 else socket.AF_INET6
    with socket.socket(family, socket.SOCK_DGRAM) as end, suppress(OSError):
        end.bind((str(address), 0))
        return not address.is_unspecified
    return False


@contextmanager
def connected(arguments: Namespace) -> Iterator[tuple[WallScheduler, Middleware]]:
    """A scheduler and a middleware for a command that makes one request."""
    from fame.scenario import connect, scheduler_for

    scheduler = scheduler_for(arguments.middleware)
    middleware = connect(arguments.middleware, scheduler, arguments.network)
    try:
        yield scheduler, middleware
    finally:
        middleware.close()


def note_ready(text: str) -> None:
    """Print that the command is ready and how to end it, unless another FAME process started it."""
    from fame.scenario.process import is_child

    if not is_child():
        note(f"{text}; Ctrl-C ends it")


def note_warning(warning: EndpointWarning) -> None:
    """Print a warning of the middleware."""
    note(f"fame: warning: {warning}")


def lockstep(middleware: Middleware, holds: Callable[[WireNode], bool]) -> Lockstep:
    """Return the lockstep of the nodes that `holds` accepts. Raises ConfigError for other backends."""
    from fame.middleware.simulated_time import Lockstep
    from fame.middleware.wire_base import WireMiddleware

    if not isinstance(middleware, WireMiddleware) or not middleware.lockstep:
        raise ConfigError("--lockstep needs --middleware dds or zenoh")
    return Lockstep(middleware, holds)


def person() -> str:
    """Return the user of this command as ``user@host``, unverified."""
    import getpass

    try:
        user = getpass.getuser()
    except (OSError, KeyError, ImportError):  # no name for this user id
        user = "unknown"
    return f"{user}@{os.uname().nodename}"
