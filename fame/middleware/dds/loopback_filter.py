"""Loopback that is loopback: the sockets of a domain take nothing that comes from another machine.

Cyclone sends over the interface that it is told, but listens on all of them (eclipse-cyclonedds/cyclonedds, issue
1923): whoever reaches the machine could put samples on our topics, models to be run among them. So the sockets are tied
to the loopback device here, from outside; that needs no privilege on Linux from 5.7 on, and none on macOS.
"""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Callable, Iterator

_FIRST_PORT, _PORTS = 7400, 250
"""The first port of domain 0, and how many a domain has (DDSI-RTPS 2.5, section 9.6.2)."""

_BIND_TO_DEVICE = 25  # <asm-generic/socket.h>
_IP_BOUND_IF = 25  # <netinet/in.h> of macOS


def _linux(end: socket.socket) -> None:
    end.setsockopt(socket.SOL_SOCKET, _BIND_TO_DEVICE, b"lo\0")


def _macos(end: socket.socket) -> None:
    end.setsockopt(socket.IPPROTO_IP, _IP_BOUND_IF, socket.if_nametoindex("lo0"))


_TIES: dict[str, Callable[[socket.socket], None]] = {"linux": _linux, "darwin": _macos}
"""Platform -> what ties a socket to loopback."""


def confine(domain: int) -> bool:
    """Tie the sockets that this process has in a domain to loopback; whether that was possible."""
    tie = _TIES.get(sys.platform)
    if tie is None:
        return False
    try:
        for end in sockets(domain):
            with end:
                tie(end)
    except OSError:
        return False
    return True


def sockets(domain: int) -> Iterator[socket.socket]:
    """A duplicate of each UDP socket of this process on a port of the domain, to be closed by the caller."""
    first = _FIRST_PORT + _PORTS * domain
    for entry in os.listdir("/dev/fd"):
        try:
            number = os.dup(int(entry))
        except OSError:
            continue  # it was that of the listing
        try:
            end = socket.socket(fileno=number)
        except OSError:
            os.close(number)  # no socket
            continue
        if (
            end.type == socket.SOCK_DGRAM
            and end.family == socket.AF_INET
            and end.getsockname()[1] - first in range(_PORTS)
        ):
            yield end
        else:
            end.close()
