"""What our layers cost on top of Zenoh: round trips of a String between two processes. One JSON line per case.

"bare" is Zenoh with its own channel of samples, read in the main thread, with nothing of FAME in it; "fame" is a
publisher and a subscription of `ZenohMiddleware` at both ends. Rounds of the two alternate, so that both meet the same
noise; the ratio is that of the medians.
Run as ``python benchmarks/zenoh_trips.py``; loopback only.
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

from fame.middleware.data_scheduler import DataScheduler
from fame.middleware.messages import create
from fame.middleware.zenoh import ZenohMiddleware
from fame.middleware.zenoh.session import open_session

DOMAIN = 1 + os.getpid() % 100
TEXT = "std_msgs/msg/String"
ROUNDS, TRIPS = 6, 1500
PAYLOAD = "x" * 32
CDR = b"\0\1\0\0" + (len(PAYLOAD) + 1).to_bytes(4, "little") + PAYLOAD.encode() + b"\0"
Trips = Callable[[int], list[int]]
"""Makes round trips, one after the other, and returns how long each took (ns)."""


class Bare:
    """One end without FAME: writes `out`, waits for `back`."""

    def __init__(self, domain: int, out: str, back: str) -> None:
        self.session = open_session(domain, None)
        self.publisher = self.session.declare_publisher(f"{domain}/{out}")
        self.subscriber: Any = self.session.declare_subscriber(f"{domain}/{back}")

    def trips(self, number: int) -> list[int]:
        taken = []
        for _ in range(number):
            began = time.perf_counter_ns()
            self.publisher.put(CDR)
            self.subscriber.recv()
            taken.append(time.perf_counter_ns() - began)
        return taken


def echo_bare(domain: int) -> None:
    """The other process of "bare"."""
    end = Bare(domain, "pong", "ping")
    while True:
        end.publisher.put(end.subscriber.recv().payload)


def echo_fame(domain: int) -> None:
    """The other process of "fame"."""
    scheduler = DataScheduler()
    node = ZenohMiddleware(scheduler, domain=domain).node("echo")
    node.subscription("/ping", TEXT, node.publisher("/pong", TEXT).publish)
    scheduler.run()


def bare() -> Trips:
    end = Bare(DOMAIN, "ping", "pong")
    while not end.publisher.matching_status.matching:
        time.sleep(0.01)
    return end.trips


class Asker:
    """The end of "fame" that asks: a callback for each pong, which sends the next ping."""

    def __init__(self) -> None:
        self.scheduler = DataScheduler()
        middleware = ZenohMiddleware(self.scheduler, domain=DOMAIN + 1)
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


ECHOES = {"bare": echo_bare, "fame": echo_fame}


def main() -> None:
    echoes = [subprocess.Popen([sys.executable, __file__, kind, str(DOMAIN + n)]) for n, kind in enumerate(ECHOES)]
    try:
        trips: dict[str, Trips] = {"bare": bare(), "fame": Asker().trips}
        time.sleep(1)  # the other side has to know of the match too
        times: dict[str, list[int]] = {kind: [] for kind in trips}
        for number in range(ROUNDS + 1):
            for kind, trip in trips.items():
                taken = trip(TRIPS if number else TRIPS // 5)
                times[kind] += taken if number else []  # the first round warms up
    finally:
        for echo in echoes:
            echo.kill()
            echo.wait()
    for kind, taken in times.items():
        print(
            json.dumps(
                {
                    "case": kind,
                    "median_us": median(taken) / 1000,
                    "p99_us": sorted(taken)[len(taken) * 99 // 100] / 1000,
                }
            )
        )
    print(json.dumps({"case": "fame / bare", "ratio": round(median(times["fame"]) / median(times["bare"]), 2)}))


if __name__ == "__main__":
    if len(sys.argv) > 1:
        ECHOES[sys.argv[1]](int(sys.argv[2]))
    else:
        main()
