"""The DDS domain to join, and its network interface.

The domain is that of ROS: `ROS_DOMAIN_ID`, 0 if it is not set. Without an interface everything stays on loopback,
without multicast: participants discover each other at 127.0.0.1, up to 121 of them per domain. Only the argument opens
the network. Then, and only then, CYCLONEDDS_URI is read too (peers where multicast is switched off, buffers).

Cyclone sends over the interface that it is given, but listens on all of them (eclipse-cyclonedds/cyclonedds, issue
1923): every host that reaches the machine could publish on our topics, including models to be executed. So the sockets
of a loopback domain are bound to the loopback device afterwards, which needs no privilege on Linux from 5.7 on, nor on
macOS.
"""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Callable, Iterator
from weakref import WeakValueDictionary

from cyclonedds.core import DDSException
from cyclonedds.domain import Domain

from fame.errors import ConfigError
from fame.middleware.interface import MAX_MESSAGE_SIZE
from fame.middleware.wire_base import lease

_FIRST_PORT, _PORTS = 7400, 250
"""The first port of domain 0, and how many a domain has (DDSI-RTPS 2.5, section 9.6.2)."""

_BIND_TO_DEVICE = 25  # <asm-generic/socket.h>
_IP_BOUND_IF = 25  # <netinet/in.h> of macOS
LEASE = 3.0
_SHARED = f"""
<Internal>
  <MaxSampleSize>{MAX_MESSAGE_SIZE} B</MaxSampleSize>
  <WriterLingerDuration>200ms</WriterLingerDuration>
</Internal>
"""
"""A killed participant counts as gone after the lease (ROS 2 leaves it at 10 s). One that was only stopped is found
again when it announces itself next: Cyclone does so every 30 s, here each lease, at least every 3 s. A closing
publisher lingers for readers that have not acknowledged everything: Cyclone's 1 s would add up over many publishers if
one reader is dead. Fragments of a message above the maximum size are not assembled."""

_LOOPBACK = """
<General>
  <Interfaces><NetworkInterface address="127.0.0.1" multicast="false"/></Interfaces>
  <AllowMulticast>false</AllowMulticast>
</General>
<Discovery>
  <ParticipantIndex>auto</ParticipantIndex>
  <MaxAutoParticipantIndex>120</MaxAutoParticipantIndex>
  <Peers><Peer address="127.0.0.1"/></Peers>
</Discovery>
<Internal><HeartbeatInterval>150ms</HeartbeatInterval></Internal>
"""
_NETWORK = """
<General><Interfaces><NetworkInterface {}/></Interfaces></General>
<Internal><HeartbeatInterval minsched="5ms">10ms</HeartbeatInterval></Internal>
"""
"""What a network loses is sent again when a heartbeat asks. On loopback hardly anything is lost, and heartbeats are
rare: while processes find each other, each of them sends those of five writers to all others. They come before a
closing publisher has lingered."""
_open: WeakValueDictionary[int, Domain] = WeakValueDictionary()
"""The domains of this process. Each stays open while it is referenced."""
_configurations: dict[int, str] = {}
"""The configuration of each of them."""
_confined: dict[int, bool] = {}
"""Whether each of them receives nothing from other machines."""


def configuration(network: str | None) -> str:
    """Cyclone's configuration for loopback only (None), or for an interface: its name (``eth0``) or its address."""
    after = lease(LEASE)
    times = f"<LeaseDuration>{after:g}s</LeaseDuration><SPDPInterval>{min(after, LEASE):g}s</SPDPInterval>"
    discovery = f"<Discovery>{times}</Discovery>"
    own = _LOOPBACK if network is None else _NETWORK.format(_interface(network))
    document = f"<CycloneDDS><Domain>{''.join((own + _SHARED).splitlines())}{discovery}</Domain></CycloneDDS>"
    more = os.environ.get("CYCLONEDDS_URI", "") if network is not None else ""
    return f"{document},{more}" if more else document


def open_domain(number: int, network: str | None) -> Domain:
    """Return the domain, opened with the configuration of `network` if this process has not opened it yet.

    It closes with its last user. Raises ConfigError if it is open on another network, or does not exist.
    """
    wanted = configuration(network)
    domain = _open.get(number)
    if domain is None:
        try:
            domain = Domain(number, wanted)
        except DDSException as error:
            raise ConfigError(f"cannot open DDS domain {number} on {network or 'loopback'}: {error}") from None
        _open[number], _configurations[number] = domain, wanted
        _confined[number] = network is None and bind_to_loopback(number)  # before the first participant is made
    if _configurations[number] != wanted:
        raise ConfigError(f"DDS domain {number} is open in this process already, on another network than {network}")
    return domain


def confined(number: int) -> bool:
    """Return whether an open domain receives nothing from other machines: on loopback, where the platform allows it."""
    return _confined[number]


def _interface(network: str) -> str:
    import ipaddress
    from xml.sax.saxutils import quoteattr

    try:
        ipaddress.ip_address(network)
    except ValueError:
        return f"name={quoteattr(network)}"
    return f"address={quoteattr(network)}"


# ---- sockets bound to loopback ---------------------------------------------------------------------------------------


def _linux(end: socket.socket) -> None:
    end.setsockopt(socket.SOL_SOCKET, _BIND_TO_DEVICE, b"lo\0")


def _macos(end: socket.socket) -> None:
    end.setsockopt(socket.IPPROTO_IP, _IP_BOUND_IF, socket.if_nametoindex("lo0"))


_BIND: dict[str, Callable[[socket.socket], None]] = {"linux": _linux, "darwin": _macos}
"""Platform -> the function that binds a socket to loopback."""


def bind_to_loopback(domain: int) -> bool:
    """Bind the sockets that this process has in a domain to loopback. Returns whether all are, and there are some."""
    bind = _BIND.get(sys.platform)
    if bind is None:
        return False
    bound = 0
    try:
        for end in sockets(domain):
            with end:
                bind(end)
            bound += 1
    except OSError:
        return False
    return bound > 0


def sockets(domain: int) -> Iterator[socket.socket]:
    """Yield a duplicate of each UDP socket of this process on a port of the domain, to be closed by the caller."""
    first = _FIRST_PORT + _PORTS * domain
    for entry in os.listdir("/dev/fd"):
        try:
            number = os.dup(int(entry))
        except OSError:
            continue  # the one of the listing
        try:
            end = socket.socket(fileno=number)
        except OSError:
            os.close(number)  # not a socket
            continue
        if (
            end.type == socket.SOCK_DGRAM
            and end.family == socket.AF_INET
            and end.getsockname()[1] - first in range(_PORTS)
        ):
            yield end
        else:
            end.close()
