"""What `fame doctor` says of an installation: its extras, shared memory, and whether a message gets through."""

from __future__ import annotations

import re
import shutil
import socket
from collections import defaultdict
from collections.abc import Iterator
from importlib import metadata
from typing import TYPE_CHECKING, Literal, NamedTuple

from fame.rooms import install

if TYPE_CHECKING:
    from fame.clock import WallScheduler
    from fame.middleware.interface import Middleware

_SHARED = 64_000_000
"""Bytes of shared memory that the processes of a campaign need at least."""
_PATIENCE = 5.0
"""For how long a message on loopback is waited for (s)."""


class Finding(NamedTuple):
    """The result of a check of the installation, and how to mend it. ``absent``: only those who want it miss it."""

    check: str
    verdict: Literal["ok", "absent", "warning", "wrong", "not known"]
    text: str
    mend: str = ""


def extras() -> Iterator[Finding]:
    """Yield for each extra whether its packages are installed, and for what it is."""
    from fame.imports import PURPOSES

    packages = defaultdict[str, list[str]](list)
    try:
        required = metadata.requires("fame-robots") or ()
    except metadata.PackageNotFoundError:
        yield Finding("extras", "not known", "FAME is not installed by pip, so which packages it needs is not known")
        return
    for each in required:
        if match := re.match(r"([\w.-]+).*extra == ['\"](\w+)", each):
            packages[match[2]].append(match[1])
    for extra, purpose in PURPOSES.items():
        found = {name: version(name) for name in packages[extra]}
        if all(found.values()):
            text = ", ".join(f"{name} {number}" for name, number in found.items())
            yield Finding(extra, "ok", f"{purpose}: {text}")
        else:
            lacking = ", ".join(name for name, number in found.items() if not number)
            yield Finding(extra, "absent", f"{purpose}: {lacking} not installed", install(extra))


def version(name: str) -> str:
    """Return the version of a package; empty if it is not installed."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def shared_memory(folder: str = "/dev/shm") -> Finding:
    """Return whether processes can share memory and locks, as those of a campaign do."""
    from multiprocessing import Lock

    try:
        Lock()
        free = shutil.disk_usage(folder).free
    except (OSError, ImportError) as error:
        return Finding("shared memory", "wrong", f"{folder}: {error}", f"mount -t tmpfs tmpfs {folder}")
    if free < _SHARED:
        text = f"{free / 1e6:.0f} MB are free in {folder}: processes of campaigns may fail"
        return Finding("shared memory", "warning", text, "docker run --shm-size=1g, or remove what is left there")
    return Finding("shared memory", "ok", f"{free / 1e6:.0f} MB are free in {folder}")


def router_port(port: int = 7447) -> Finding:
    """Return whether a router of Zenoh could open its port here."""
    with socket.socket() as opened:
        try:
            opened.bind(("", port))
        except OSError as error:
            return Finding(
                "ports", "ok", f"{port}, that of fame router, is taken ({error.strerror}): by one that runs?"
            )
    return Finding("ports", "ok", f"{port}, that of fame router, is free")


def loopback(scheduler: WallScheduler, first: Middleware, second: Middleware) -> Finding:
    """Return whether a message of one participant reaches another one of this machine."""
    from fame.cli.network import wait_until
    from fame.middleware import messages

    got: list[object] = []
    topic, type = "/_fame_doctor", "std_msgs/msg/String"
    second.node("_fame_doctor_there").subscription(topic, type, got.append)
    publisher = first.node("_fame_doctor_here").publisher(topic, type)
    if wait_until(scheduler, publisher.subscriber_count, _PATIENCE):
        publisher.publish(messages.create(type, "FAME"))
        wait_until(scheduler, lambda: got, _PATIENCE)
    if got:
        return Finding("loopback", "ok", "a message from one participant to another arrived")
    text = f"no message between two participants of this machine within {_PATIENCE:g} s"
    return Finding("loopback", "wrong", text, "ip link set lo up; no firewall on loopback; the same ROS_DOMAIN_ID")
