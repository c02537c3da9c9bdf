"""A deployment and a mission over a network that delays and loses: DDS and Zenoh, a table.

The kernel's netem is not everywhere, so each middleware gets what can be had without it:

dds     Cyclone's own `XmitLossiness`: 2 % of all packets sent are dropped; no delay
zenoh   each process reaches the router through a relay of this program, which delays everything by 50 ms each way and
        holds back each segment of 1460 bytes with a probability of 2 % for 200 ms, with all behind it: what TCP makes
        of a lost segment (RFC 6298)

Two engines get a process and exchange signals there and back, one after the other. Run as
``python benchmarks/lossy_network.py [dds] [zenoh]``; everything stays on loopback.
"""

from __future__ import annotations

import asyncio
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import distributed
from distributed import ROOT, _trips

from fame.bpmn.reader import read_text
from fame.scenario.process import Router

DELAY, LOSS, RETRANSMISSION, SEGMENT = 0.05, 0.02, 0.2, 1460
TRIPS = 30
LOSSY = (
    "<CycloneDDS><Domain><General><AllowMulticast>false</AllowMulticast></General>"
    "<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>60</MaxAutoParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers></Discovery>'
    "<Internal><Test><XmitLossiness>20</XmitLossiness></Test></Internal></Domain></CycloneDDS>"
)


async def _pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, chance: random.Random) -> None:
    """Pass on what comes, late, in order."""
    queue: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()

    async def send() -> None:
        while True:
            due, data = await queue.get()
            await asyncio.sleep(max(0.0, due - time.monotonic()))
            writer.write(data)
            if not data:
                writer.close()
                return

    sending, last = asyncio.create_task(send()), 0.0
    while data := await reader.read(SEGMENT):
        lost = RETRANSMISSION if chance.random() < LOSS else 0.0
        last = max(last, time.monotonic() + DELAY + lost)  # nothing overtakes
        queue.put_nowait((last, data))
    queue.put_nowait((last, b""))
    await sending


async def relay(port: int, to: int) -> None:
    """A bad network between two ports of 127.0.0.1."""
    chance = random.Random(1)

    async def connect(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        there = await asyncio.open_connection("127.0.0.1", to)
        await asyncio.gather(_pump(reader, there[1], chance), _pump(there[0], writer, chance), return_exceptions=True)

    server = await asyncio.start_server(connect, "127.0.0.1", port)
    await server.serve_forever()


@contextmanager
def over_dds() -> Iterator[tuple[Any, list[str]]]:
    os.environ["CYCLONEDDS_URI"] = LOSSY
    yield "lo", ["--network", "lo", "--insecure"]
    del os.environ["CYCLONEDDS_URI"]


@contextmanager
def over_zenoh() -> Iterator[tuple[Any, list[str]]]:
    port = 7400 + os.getpid() % 40
    router = subprocess.Popen([sys.executable, "-m", "fame", "router", "--port", str(port)])
    relaying = subprocess.Popen([sys.executable, __file__, "relay", str(port + 100), str(port)])
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "through_the_relay.json5")
        file.write_text(f'{{mode: "client", connect: {{endpoints: ["tcp/127.0.0.1:{port + 100}"]}}}}')
        time.sleep(2)
        yield Router(file), ["--zenoh-config", str(file), "--insecure"]
    for process in (router, relaying):
        process.terminate()
        process.wait()


def measure(middleware: str, over: Callable[[], Any]) -> None:
    distributed.MIDDLEWARE[:] = [middleware]
    with over() as (network, words):
        distributed.REACH[:] = words
        distributed.NETWORK[:] = [network]
        with distributed.field("A", "B") as team:
            model = distributed.PING_PONG.replace(str(distributed.TRIPS), str(TRIPS))
            deployed = team.deploy(read_text(model, file="ping_pong.bpmn"))
            began = time.monotonic()
            taken = _trips(team, TRIPS)
            ended = time.monotonic() - began
    row = {"middleware": middleware, "found_s": round(team.found, 2), "deployment_s": round(deployed, 2)}
    print(json.dumps(row | {"mission_s": round(ended, 2), "round_trips": len(taken)}), flush=True)


NETWORKS: dict[str, Callable[[], Any]] = {"dds": over_dds, "zenoh": over_zenoh}

if __name__ == "__main__":
    if sys.argv[1:2] == ["relay"]:
        asyncio.run(relay(*map(int, sys.argv[2:])))
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    for name in sys.argv[1:] or NETWORKS:
        measure(name, NETWORKS[name])
