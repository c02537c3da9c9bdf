"""What our layers cost on top of Cyclone DDS: round trips of a String between two processes. One JSON line per case.

"bare" is Cyclone with its own struct class and a WaitSet in the main thread, with nothing of FAME in it; "fame" is a
publisher and a subscription of `DdsMiddleware` on a `DdsScheduler`, at both ends. Run as ``python benchmarks/dds.py``;
loopback only.
"""

from __future__ import annotations

import sys
import time
from typing import Any

from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from trips import DOMAIN, PAYLOAD, Trips, compare, echo

from fame.clock import SECOND, WallScheduler
from fame.middleware.dds import DdsMiddleware
from fame.middleware.dds.domain import open_domain

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


def bare() -> Trips:
    end = Bare(DOMAIN, "/ping", "/pong")
    while not (end.writer.get_matched_subscriptions() and end.reader.get_matched_publications()):
        time.sleep(0.01)
    return end.trips


def echo_bare(domain: int) -> None:
    """The other process of "bare"."""
    end = Bare(domain, "/pong", "/ping")
    while True:
        end.writer.write(String(end.wait().data))


def connect(scheduler: WallScheduler, domain: int) -> DdsMiddleware:
    return DdsMiddleware(scheduler, domain=domain)


if __name__ == "__main__":
    if sys.argv[1:2] == ["bare"]:
        echo_bare(int(sys.argv[2]))
    elif sys.argv[1:]:
        echo(connect, int(sys.argv[2]))
    else:
        compare(__file__, bare, connect)
