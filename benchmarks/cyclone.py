"""What `fame.middleware.dds.cyclone` buys, which uses private parts of cyclonedds.

Two times each, in microseconds: with cyclonedds' own interface, and with ours. The policies are those of a publisher;
one of 100 readers has data each time, and whoever waits is to know which. Loopback only.
Run as ``python benchmarks/cyclone.py``.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

from cyclonedds.core import DDSStatus, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.qos import _CQos
from trips import DOMAIN

from fame.clock import SECOND
from fame.middleware.dds.cyclone import KeyedWaitSet, policies_at
from fame.middleware.dds.domain import open_domain
from fame.middleware.dds.wire import Entities, declared, to_dds, type_hash
from fame.middleware.interface import QoS

TYPE = "std_msgs/msg/String"
READERS, ROUNDS = 100, 300


def microseconds(action: Callable[[int], object]) -> float:
    """The median of what a call takes; it gets the number of the round."""
    taken = []
    for number in range(ROUNDS):
        began = time.perf_counter_ns()
        action(number)
        taken.append(time.perf_counter_ns() - began)
    return statistics.median(taken) / 1000


def policies() -> tuple[float, float]:
    pointer = _CQos.qos_to_cqos(to_dds(QoS(), type_hash(TYPE), writes=True))
    return microseconds(lambda _: _CQos.cqos_to_qos(pointer)), microseconds(lambda _: policies_at(pointer))


def waiting() -> tuple[float, float]:
    domain = open_domain(DOMAIN, None)
    participant = DomainParticipant(DOMAIN)
    entities = Entities(participant, DOMAIN)
    readers = [entities.reader(f"rt/x{number}", TYPE, QoS(), "") for number in range(READERS)]
    writers = [entities.writer(f"rt/x{number}", TYPE, QoS(), "") for number in range(READERS)]
    theirs, ours = WaitSet(participant), KeyedWaitSet(participant)
    message = declared(TYPE, False)(b"\0\1\0\0\2\0\0\0x\0")
    for number, reader in enumerate(readers):
        reader.set_status_mask(DDSStatus.DataAvailable)
        theirs.attach(reader)
        ours.attach(reader, number)

    def ask_each(_: int) -> None:
        theirs.wait(SECOND)
        found = [reader for reader in readers if reader.take_status(DDSStatus.DataAvailable)]
        assert len(found) == 1
        found[0].take()

    def know(_: int) -> None:
        (key,) = ours.wait(SECOND)
        assert readers[key].take_status(DDSStatus.DataAvailable)
        readers[key].take()

    def written(wait: Callable[[int], None]) -> Callable[[int], None]:
        def action(number: int) -> None:
            writers[number % READERS].write(message)
            wait(number)

        return action

    result = microseconds(written(ask_each)), microseconds(written(know))
    del domain
    return result


if __name__ == "__main__":
    for name, (theirs, ours) in {"policies of an endpoint": policies(), f"one of {READERS} readers": waiting()}.items():
        print(f"{name:24} cyclonedds {theirs:8.1f} us   here {ours:8.1f} us   {theirs / ours:5.1f} times")
