"""What our layers cost on top of Zenoh: round trips of a String between two processes. One JSON line per case.

"bare" is Zenoh with its own channel of samples, read in the main thread, with nothing of FAME in it; "fame" is a
publisher and a subscription of `ZenohMiddleware` at both ends. Rounds of the two alternate, so that both meet the same
noise; the ratio is that of the medians.
Run as ``python benchmarks/zenoh_trips.py``; loopback only.
"""

from __future__ import annotations

import sys
import time
from typing import Any

from trips import DOMAIN, PAYLOAD, Trips, compare, echo

from fame.clock import WallScheduler
from fame.middleware.zenoh import ZenohMiddleware
from fame.middleware.zenoh.session import open_session

CDR = b"\0\1\0\0" + (len(PAYLOAD) + 1).to_bytes(4, "little") + PAYLOAD.encode() + b"\0"


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


def bare() -> Trips:
    end = Bare(DOMAIN, "ping", "pong")
    while not end.publisher.matching_status.matching:
        time.sleep(0.01)
    return end.trips


def echo_bare(domain: int) -> None:
    """The other process of "bare"."""
    end = Bare(domain, "pong", "ping")
    while True:
        end.publisher.put(end.subscriber.recv().payload)


def connect(scheduler: WallScheduler, domain: int) -> ZenohMiddleware:
    return ZenohMiddleware(scheduler, domain=domain)


if __name__ == "__main__":
    if sys.argv[1:2] == ["bare"]:
        echo_bare(int(sys.argv[2]))
    elif sys.argv[1:]:
        echo(connect, int(sys.argv[2]))
    else:
        compare(__file__, bare, connect)
