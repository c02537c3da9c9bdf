"""A bad network between two machines: a process that passes on UDP packets late, twice or not at all.

It runs in a network namespace of its own, makes two others that are connected with it, each by a veth pair, and carries
Ethernet frames between them. It says the process ids by which they can be entered, reads ``loss duplicates delay`` (two
shares, and the longest delay in s) from each line of its standard input, and ends with it.
"""

from __future__ import annotations

import heapq
import itertools
import os
import random
import select
import socket
import subprocess
import sys
import time

INTERFACE = "robot0"
"""Of each machine."""
_ALL, _OUTGOING = 0x0003, 4  # ETH_P_ALL, PACKET_OUTGOING
_IP, _UDP = b"\x08\x00", 17


def _machine(number: int) -> tuple[int, socket.socket]:
    """Make a namespace with an interface; the process in it, and the other end of its wire."""
    process = subprocess.Popen(["unshare", "-n", "cat"], stdin=subprocess.PIPE)  # which ends with this process
    time.sleep(0.5)
    end, pid = f"end{number}", str(process.pid)
    inside = f"ip addr add 10.77.0.{number}/24 dev {INTERFACE} && ip link set {INTERFACE} up && ip link set lo up"
    for command in (
        ["ip", "link", "add", end, "type", "veth", "peer", "name", INTERFACE, "netns", pid],
        ["ip", "link", "set", end, "up"],
        ["nsenter", "-t", pid, "-n", "sh", "-c", inside],
    ):
        subprocess.run(command, check=True)
    wire = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(_ALL))
    wire.bind((end, 0))
    _KEPT.append(process)
    return process.pid, wire


_KEPT: list[subprocess.Popen[bytes]] = []


def _without_checksum(frame: bytes) -> bytes | None:
    """A frame with a UDP packet, whose checksum the sender has left to its device; None if it has something else."""
    if frame[12:14] != _IP or frame[23] != _UDP:
        return None
    udp = 14 + 4 * (frame[14] & 15)
    if int.from_bytes(frame[20:22], "big") & 0x1FFF:  # a later fragment has no header
        return frame
    return frame[: udp + 6] + b"\0\0" + frame[udp + 8 :]


def main() -> None:
    """Pass on what comes until standard input ends."""
    machines = [_machine(1), _machine(2)]
    (first, one), (second, other) = machines
    print(first, second, flush=True)
    opposite, chance, order = {one: other, other: one}, random.Random(1), itertools.count()
    loss, duplicates, delay = 0.0, 0.0, 0.0
    late: list[tuple[float, int, socket.socket, bytes]] = []
    while True:
        wait = max(0.0, late[0][0] - time.monotonic()) if late else None
        for ready in select.select([one, other, sys.stdin], [], [], wait)[0]:
            if ready is sys.stdin:
                if not (line := os.read(0, 1000)):
                    return
                loss, duplicates, delay = map(float, line.decode().strip().rpartition("\n")[2].split())
                continue
            frame, address = ready.recvfrom(70_000)
            if address[2] == _OUTGOING:
                continue
            packet = _without_checksum(frame)
            copies = 1 if packet is None else (chance.random() >= loss) * (1 + (chance.random() < duplicates))
            for _ in range(copies):
                due = time.monotonic() + (0 if packet is None else chance.uniform(0, delay))
                heapq.heappush(late, (due, next(order), opposite[ready], packet or frame))
        while late and late[0][0] <= time.monotonic():
            _, _, to, frame = heapq.heappop(late)
            to.send(frame)


if __name__ == "__main__":
    main()
