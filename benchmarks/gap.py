"""What survives when the link between two machines is down for a while: numbered messages, 100 a second.

Two network namespaces with a veth pair, taken down and up by ``ip link set``. What is counted: the messages that were
published while the link was down and have arrived 10 s after it is up again, and those of the whole run.
Run as ``python -m benchmarks.gap`` (root; it makes the namespaces itself).
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

from fame.clock import SECOND, WallScheduler
from fame.middleware import messages
from fame.middleware.interface import QoS
from fame.scenario.process import Router, connect
from tests.networked_machines import ADDRESSES, INTERFACE, machines

TYPE = "std_msgs/msg/Int32"
DEPTH = 1000
PORT = 7447
BEFORE, AFTER, EVERY = 3.0, 10.0, 0.01
"""s"""
_KEPT: list[object] = []


def end(role: str, backend: str, durability: str, gap: str) -> None:
    """The process at one end: prints when the link may go down, and what it has received."""
    scheduler, number = WallScheduler(), int(role == "receive")
    network: str = INTERFACE
    if backend == "zenoh":
        from fame.middleware.zenoh import open_router

        others = [f"tcp/{ADDRESSES[0]}:{PORT}"] if number else []
        _KEPT.append(open_router([f"tcp/127.0.0.1:{PORT}", f"tcp/{ADDRESSES[number]}:{PORT}"], others, None))
        network = Router("127.0.0.1")
    middleware = connect(backend, scheduler, network)
    qos = QoS(durability="transient_local" if durability == "transient_local" else "volatile", depth=DEPTH)
    received: list[int] = []
    if role == "receive":
        middleware.node("receiver").subscription("/count", TYPE, lambda message: received.append(message.data), qos)
        scheduler.run(round((BEFORE + float(gap) + AFTER + 15) * SECOND))
        print(json.dumps(received), flush=True)
        return
    publisher = middleware.node("sender").publisher("/count", TYPE, qos)
    while not publisher.subscriber_count():
        scheduler.run(scheduler.now + SECOND // 10)
    scheduler.run(scheduler.now + SECOND)
    print("begin", flush=True)
    begun = time.monotonic()
    for count in range(round((BEFORE + float(gap) + AFTER) / EVERY)):
        publisher.publish(messages.create(TYPE, count))
        scheduler.run(scheduler.now + max(0, round((begun + (count + 1) * EVERY - time.monotonic()) * SECOND)))
    scheduler.run(scheduler.now + 20 * SECOND)


def case(backend: str, durability: str, gap: float) -> dict[str, object]:
    """One run."""
    with machines(2) as pair:
        command = [sys.executable, "-m", "benchmarks.gap", "end"]
        more = [backend, durability, str(gap)]
        send = subprocess.Popen(pair.inside(0, *command, "send", *more), stdout=subprocess.PIPE, text=True)
        receive = subprocess.Popen(pair.inside(1, *command, "receive", *more), stdout=subprocess.PIPE, text=True)
        assert send.stdout is not None
        assert receive.stdout is not None
        assert send.stdout.readline() == "begin\n"
        time.sleep(BEFORE)
        pair.set("down")
        time.sleep(gap)
        pair.set("up")
        received = json.loads(receive.stdout.readline())
        for process in (send, receive):
            process.kill()
            process.wait()
    first, last = round((BEFORE + 0.2) / EVERY), round((BEFORE + gap - 0.2) / EVERY)
    sent = round((BEFORE + gap + AFTER) / EVERY)
    during = sum(first <= count < last for count in set(received))
    return {
        "middleware": backend, "durability": durability, "gap_s": gap, "sent": sent, "received": len(set(received)),
        "twice": len(received) - len(set(received)), "in_order": received == sorted(received),
        "of_the_gap_%": round(100 * during / (last - first)),
    }  # fmt: skip


def main() -> None:
    """Print one JSON line per case."""
    for backend in ("dds", "zenoh"):
        for durability in ("volatile", "transient_local"):
            for gap in (1.0, 8.0, 20.0):
                print(json.dumps(case(backend, durability, gap)), flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["end"]:
        end(*sys.argv[2:])
    else:
        sys.path.insert(0, str(Path(__file__).parent))
        main()
