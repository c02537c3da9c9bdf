"""Machines, as network namespaces on a switch, and links to it that go down and come back."""

import os
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

INTERFACE = "link0"
"""The interface of each machine."""
ADDRESSES = "10.77.1.1", "10.77.1.2", "10.77.1.3"


def forbidden() -> str:
    """Why this user cannot make network namespaces; empty if it can."""
    if os.name != "posix" or os.geteuid():
        return "network namespaces need root"
    veth = ["unshare", "-n", "ip", "link", "add", "probe0", "type", "veth"]
    tried = subprocess.run(veth, capture_output=True, check=False)
    return "no veth between network namespaces" if tried.returncode else ""


@dataclass(frozen=True)
class Machines:
    """`pids` are processes inside of the namespaces."""

    pids: tuple[int, ...]

    def inside(self, number: int, *command: str) -> list[str]:
        """A command on a machine (from 0 on)."""
        return ["nsenter", "-t", str(self.pids[number]), "-n", *command]

    def address(self) -> None:
        """Give the interface of each its address, and take it up."""
        for number, pid in enumerate(self.pids):
            _do(pid, f"ip addr add {ADDRESSES[number]}/24 dev {INTERFACE} && ip link set {INTERFACE} up")

    def set(self, state: str, number: int = 0) -> None:
        """Take the link of a machine ``down``, or ``up``."""
        subprocess.run(self.inside(number, "ip", "link", "set", INTERFACE, state), check=True)


@contextmanager
def machines(count: int, *, wired: bool = True) -> Iterator[Machines]:
    """Make machines, at most three, and a switch to which they are `wired`; they end with the block."""
    holders = [subprocess.Popen(["unshare", "-n", "cat"], stdin=subprocess.PIPE) for _ in range(count + 1)]
    try:
        pids = [holder.pid for holder in holders]
        own = os.readlink("/proc/self/ns/net")
        while any(os.readlink(f"/proc/{pid}/ns/net") == own for pid in pids):
            time.sleep(0.01)
        switch, made = pids.pop(), Machines(tuple(pids))
        _do(switch, "ip link add switch type bridge && ip link set switch up")
        for number, pid in enumerate(pids):
            _do(pid, "ip link set lo up")
            if not wired:
                continue
            port = f"port{number}"
            veth = ["ip", "link", "add", INTERFACE, "netns", str(pid), "type", "veth", "peer", "name", port]
            subprocess.run([*veth, "netns", str(switch)], check=True)
            _do(switch, f"ip link set {port} master switch && ip link set {port} up")
        if wired:
            made.address()
        yield made
    finally:
        for holder in holders:
            holder.kill()
            holder.wait()
            if holder.stdin is not None:
                holder.stdin.close()


def _do(pid: int, command: str) -> None:
    subprocess.run(["nsenter", "-t", str(pid), "-n", "sh", "-c", command], check=True)
