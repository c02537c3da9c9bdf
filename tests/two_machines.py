"""Two machines, as network namespaces, and a link between them that goes down and comes back."""

import os
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

INTERFACE = "link0"
"""The interface of each machine."""
ADDRESSES = "10.77.1.1", "10.77.1.2"


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

    pids: tuple[int, int]

    def inside(self, number: int, *command: str) -> list[str]:
        """A command on a machine (0 or 1)."""
        return ["nsenter", "-t", str(self.pids[number]), "-n", *command]

    def set(self, state: str) -> None:
        """Take the link ``down``, or ``up``."""
        subprocess.run(self.inside(0, "ip", "link", "set", INTERFACE, state), check=True)


@contextmanager
def two_machines() -> Iterator[Machines]:
    """Make both; they end with the block."""
    holders = [subprocess.Popen(["unshare", "-n", "cat"], stdin=subprocess.PIPE) for _ in ADDRESSES]
    try:
        pids = holders[0].pid, holders[1].pid
        own = os.readlink("/proc/self/ns/net")
        while any(os.readlink(f"/proc/{pid}/ns/net") == own for pid in pids):
            time.sleep(0.01)
        veth = ["ip", "link", "add", INTERFACE, "netns", str(pids[0]), "type", "veth", "peer", "name", INTERFACE]
        subprocess.run([*veth, "netns", str(pids[1])], check=True)
        machines = Machines(pids)
        for number, address in enumerate(ADDRESSES):
            up = f"ip addr add {address}/24 dev {INTERFACE} && ip link set {INTERFACE} up && ip link set lo up"
            subprocess.run(machines.inside(number, "sh", "-c", up), check=True)
        yield machines
    finally:
        for holder in holders:
            holder.kill()
            holder.wait()
            if holder.stdin is not None:
                holder.stdin.close()
