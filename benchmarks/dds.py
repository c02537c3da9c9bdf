"""What our layers cost on top of Cyclone DDS: round trips of a String between two processes. One JSON line per case.

"bare" is Cyclone with its own struct class and a WaitSet in the main thread, with nothing of FAME in it; "fame" is a
publisher and a subscription of `DdsMiddleware` on a `DdsScheduler`, at both ends. Rounds of the two alternate, so that
both meet the same noise; the ratio is that of the medians. Run as ``python benchmarks/dds.py``; loopback only.
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

from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from fame.clock import SECOND
from fame.middleware.dds import DdsMiddleware, DdsScheduler
from fame.middleware.dds.domain import open_domain
from fame.middleware.messages import create

DOMAIN = 1 + os.getpid() % 100
TEXT = "std_msgs/msg/String"
ROUNDS, TRIPS = 6, 1500
PAYLOAD = "x" * 32
Trips = Callable[[int], list[int]]
"""Makes round trips, one after the other, and returns how long each took (ns)."""

String: Any = make_idl_struct("String_", "std_msgs.msg.dds_.String_", {"data": str})


class Bare:
    """One end without FAME: writes `out`, waits for `back`."""

    def __init__(self, domain: int, out: str, back: str) -> None:
        self.domain = open_domain(domain, None)
        participant = DomainParticipant(domain)
        qos = Qos(
            Policy.Reliability.Reliable(SECOND),
            Policy.History.KeepLast(100),
            Policy.DataRepresentation(use_cdrv0_representation=True),
        )
        self.writer = DataWriter(participant, Topic(participant, f"rt{out}", String), qos)
        self.reader = DataReader(participant, Topic(participant, f"rt{back}", String), qos)
        self.waitset = WaitSet(participant)
        self.waitset.attach(ReadCondition(self.reader, ViewState.Any | SampleState.Any | InstanceState.Any))

    def wait(self) -> Any:
        while True:
            self.waitset.wait(SECOND)
            for sample in self.reader.take(1):
                if sample.sample_info.valid_data:
                    return sample

    def trips(self, number: int) -> list[int]:
        taken = []
        for _ in range(number):
            began = time.perf_counter_ns()
            self.writer.write(String(PAYLOAD))
            self.wait()
            taken.append(time.perf_counter_ns() - began)
        return taken


def echo_bare(domain: int) -> None:
    """The other process of "bare"."""
    end = Bare(domain, "/pong", "/ping")
    while True:
        end.writer.write(String(end.wait().data))


def echo_fame(domain: int) -> None:
    """The other process of "fame"."""
    scheduler = DdsScheduler()
    node = DdsMiddleware(scheduler, domain=domain).node("echo")
    node.subscription("/ping", TEXT, node.publisher("/pong", TEXT).publish)
    scheduler.run()


def bare() -> Trips:
    end = Bare(DOMAIN, "/ping", "/pong")
    while not (end.writer.get_matched_subscriptions() and end.reader.get_matched_publications()):
        time.sleep(0.01)
    return end.trips


class Asker:
    """The end of "fame" that asks: a callback for each pong, which sends the next ping."""

    def __init__(self) -> None:
        self.scheduler = DdsScheduler()
        middleware = DdsMiddleware(self.scheduler, domain=DOMAIN + 1)
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
    medians = {kind: median(taken) / 1000 for kind, taken in times.items()}
    for kind, taken in times.items():
        tail = sorted(taken)[len(taken) * 99 // 100] / 1000
        print(json.dumps({"case": f"round trip, {kind}", "median_us": round(medians[kind]), "p99_us": round(tail)}))
    print(json.dumps({"case": "fame / bare", "ratio": round(medians["fame"] / medians["bare"], 2)}))


ECHOES: dict[str, Callable[[int], None]] = {"bare": echo_bare, "fame": echo_fame}

if __name__ == "__main__":
    if sys.argv[1:]:
        ECHOES[sys.argv[1]](int(sys.argv[2]))
    else:
        main()
