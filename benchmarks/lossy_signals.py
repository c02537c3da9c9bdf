"""Acknowledged signals over a link that delays and loses packets: how many a second arrive once, in order?

Two network namespaces, each with a TAP device; a program between them passes every frame on after `--delay` s, except
those that it loses, as the kernel has no netem here. A throws signals of 100 bytes on one side, B keeps them on the
other. One JSON line per middleware, loss and rate: how many of them B has accepted, what A has reported as not
acknowledged, how long A took to throw them (on a busy machine longer than asked for), and when B had the last one. Run
as ``python -m benchmarks.lossy_signals [--seconds S] [MIDDLEWARE ...]`` (root; it makes the namespaces itself).
"""

from __future__ import annotations

import argparse
import ctypes
import fcntl
import heapq
import json
import os
import re
import select
import struct
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from random import Random
from typing import Any

from benchmarks.roaming import engine, model
from tests.networked_machines import INTERFACE, machines

CASES = (0.0, 200), (0.05, 100), (0.05, 200), (0.2, 50)
"""Share of the packets that are lost, and signals a second."""
DELAY = 0.2
SETTLING = 3.0
"""For how long a receiver waits for what would come twice, at the end (s)."""
CONTROL = Path("/proc/sys/net/ipv4/tcp_congestion_control")
THROW = 'type="std_msgs/msg/String" payload="${text}" delivery="acknowledged"'
_TUNSETIFF, _TAP, _WITHOUT_INFO, _NAMESPACE = 0x400454CA, 0x0002, 0x1000, 0x40000000


def tap(pid: int) -> int:
    """Make the interface of a machine a TAP device; return its file descriptor."""
    with open(f"/proc/{pid}/ns/net") as namespace:
        if ctypes.CDLL(None, use_errno=True).setns(namespace.fileno(), _NAMESPACE):
            raise OSError(ctypes.get_errno(), "setns")
    device = os.open("/dev/net/tun", os.O_RDWR)
    fcntl.ioctl(device, _TUNSETIFF, struct.pack("16sH", INTERFACE.encode(), _TAP | _WITHOUT_INFO))
    return device


def link(pids: list[int], loss: float, delay: float, seed: int) -> None:
    """Pass frames on between two machines, late, until the process ends."""
    ends = [tap(pid) for pid in pids]
    print("ready", flush=True)
    random, late, number = Random(seed), list[tuple[float, int, int, bytes]](), 0
    while True:
        wait = max(0.0, late[0][0] - time.monotonic()) if late else None
        for end in select.select(ends, [], [], wait)[0]:
            frame = os.read(end, 65536)
            if random.random() >= loss:
                number += 1
                heapq.heappush(late, (time.monotonic() + delay, number, ends[end == ends[0]], frame))
        while late and late[0][0] <= time.monotonic():
            _, _, end, frame = heapq.heappop(late)
            with suppress(OSError):  # the other interface is not up yet
                os.write(end, frame)


def run(middleware: str, loss: float, rate: int, seconds: float, seed: int) -> dict[str, Any]:
    """One run."""
    signals = round(rate * seconds)
    with machines(2, wired=False) as pair:
        words = [sys.executable, "-m", "benchmarks.lossy_signals", "--link", *map(str, pair.pids), str(loss)]
        between = subprocess.Popen([*words, str(DELAY), str(seed)], stdout=subprocess.PIPE, text=True)
        made = []
        try:
            assert between.stdout is not None
            between.stdout.readline()
            pair.address()
            command = [sys.executable, "-m", "benchmarks.lossy_signals", "--engine"]
            made = [
                subprocess.Popen(
                    pair.inside(place, *command, robot, middleware, str(signals), str(rate)),
                    stdout=subprocess.PIPE,
                    stderr=subprocess.PIPE,
                    text=True,
                )
                for place, robot in enumerate("AB")
            ]
            assert made[0].stdout is not None
            began = time.monotonic()
            deployed = json.loads(made[0].stdout.readline())
            begun = time.monotonic()
            told, _ = made[1].communicate(timeout=seconds + 400)
            took = time.monotonic() - begun
            made[0].terminate()
            threw, said = made[0].communicate()
        finally:
            for process in (*made, between):
                process.kill()
                process.communicate()
    counts = json.loads(told)
    reported = sum(
        int(many or 1) for many in re.findall(r"has not acknowledged (?:number \d+|(\d+) of the numbers)", said)
    )
    return {
        "middleware": middleware, "loss": loss, "delay_s": DELAY, "rate": rate, "signals": signals,
        "deployed": deployed, "tcp": CONTROL.read_text().strip(), "after_s": round(begun - began, 1),
        "kept": len(counts),
        "thrown_in_s": round(json.loads(threw), 1), "last_after_s": round(took - SETTLING, 1),
        "once_and_in_order": counts == sorted(set(counts)), "reported": reported,
    }  # fmt: skip


def main() -> None:
    """Run the cases, or be a part of one."""
    match sys.argv[1:]:
        case ["--link", first, second, loss, delay, seed]:
            link([int(first), int(second)], float(loss), float(delay), int(seed))
        case ["--engine", robot, middleware, signals, rate]:
            text = model(int(signals), THROW, int(rate), "int(count)")
            engine(robot, middleware, text, int(signals), silence=20.0)
        case _:
            parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
            parser.add_argument("middlewares", nargs="*", default=["dds", "zenoh"], metavar="MIDDLEWARE")
            parser.add_argument("--seconds", type=float, default=30.0)
            parser.add_argument("--seed", type=int, default=1)
            parser.add_argument("--case", nargs=2, type=float, metavar=("LOSS", "RATE"))
            given = parser.parse_args()
            for middleware in given.middlewares:
                for loss, rate in [given.case] if given.case else CASES:
                    found = run(middleware, loss, int(rate), given.seconds, given.seed)
                    print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main()
