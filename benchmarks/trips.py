"""Round trips of a String between two processes: the bare middleware beside FAME on it, in turns.

Shared by ``dds.py`` and ``zenoh_trips.py``, which have the end without FAME. Rounds of the two alternate, so that both
meet the same noise; the ratio is that of the medians.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from statistics import median
from typing import Any

from fame.clock import WallScheduler
from fame.middleware.data_scheduler import DataScheduler
from fame.middleware.messages import create

DOMAIN = 1 + os.getpid() % 100
TEXT = "std_msgs/msg/String"
ROUNDS, TRIPS = 6, 1500
PAYLOAD = "x" * 32
Trips = Callable[[int], list[int]]
"""Makes round trips, one after the other, and returns how long each took (ns)."""
Connect = Callable[[WallScheduler, int], Any]
"""Makes the middleware of a scheduler in a domain."""


class Asker:
    """The end of FAME that asks: a callback for each pong, which sends the next ping."""

    def __init__(self, connect: Connect, domain: int) -> None:
        self.scheduler = DataScheduler()
        middleware = connect(self.scheduler, domain)
        node = middleware.node("asker")
        self.publisher = node.publisher("/ping", TEXT)
        node.subscription("/pong", TEXT, self.hear)
        assert not middleware.wait_matched(["/ping", "/pong"], 20)

    def trips(self, number: int) -> list[int]:
        self.left, self.taken = number, list[int]()
        self.send()
        self.scheduler.run()
        return self.taken

    def send(self) -> None:
        self.began = time.perf_counter_ns()
        self.publisher.publish(create(TEXT, PAYLOAD))

    def hear(self, message: Any) -> None:
        self.taken.append(time.perf_counter_ns() - self.began)
        self.left -= 1
        if self.left:
            self.send()
        else:
            self.scheduler.stop()


def echo(connect: Connect, domain: int) -> None:
    """The other process of "fame"."""
    scheduler = DataScheduler()
    node = connect(scheduler, domain).node("echo")
    node.subscription("/ping", TEXT, node.publisher("/pong", TEXT).publish)
    scheduler.run()


def compare(file: str, bare: Callable[[], Trips], connect: Connect) -> None:
    """Print the times of both, a JSON line for each. `file` run with ``bare DOMAIN`` or ``fame DOMAIN`` is the echo."""
    echoes = [
        subprocess.Popen([sys.executable, file, kind, str(DOMAIN + n)]) for n, kind in enumerate(("bare", "fame"))
    ]
    try:
        trips: dict[str, Trips] = {"bare": bare(), "fame": Asker(connect, DOMAIN + 1).trips}
        time.sleep(1)  # the other side has to know of the match too
        times: dict[str, list[int]] = {kind: [] for kind in trips}
        for number in range(ROUNDS + 1):
            for kind, trip in trips.items():
                taken = trip(TRIPS if number else TRIPS // 5)
                times[kind] += taken if number else []  # the first round warms up
    finally:
        for process in echoes:
            process.kill()
            process.wait()
    medians = {kind: median(taken) / 1000 for kind, taken in times.items()}
    for kind, taken in times.items():
        tail = sorted(taken)[len(taken) * 99 // 100] / 1000
        print(json.dumps({"case": f"round trip, {kind}", "median_us": round(medians[kind]), "p99_us": round(tail)}))
    print(json.dumps({"case": "fame / bare", "ratio": round(medians["fame"] / medians["bare"], 2)}))
