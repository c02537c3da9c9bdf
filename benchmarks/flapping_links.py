"""The longest silence between machines whose links come and go, over Zenoh with a router on each.

Three network namespaces on a switch, a router and a process in each; every process sends 250 messages of 1.5 kB a
second and receives those of the others. The link of one of the two machines without the base station's router is taken
down for up to 4 s, then all are up for up to 8 s. With connections that end after 3 s of silence, two routers connect
again while one is still closing the old connection, and then pass nothing on until the link breaks once more
(eclipse-zenoh/zenoh, issue 1886); with a lease longer than gaps, connections outlive them. One JSON line per lease.
``python -m benchmarks.flapping_links [SEED [SECONDS [LEASE ...]]]`` (root; it makes the namespaces itself).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from contextlib import ExitStack
from random import Random

from tests.networked_machines import ADDRESSES, machines

TALK = """
import sys, time
from fame.middleware.zenoh.session import open_session
session, me, last, longest = open_session(0, "127.0.0.1"), sys.argv[1], {}, 0.0
def hear(sample):
    global longest
    now, name = time.monotonic(), str(sample.key_expr)
    if now - last.get(name, now) > longest:
        longest = now - last[name]
        print(f"{longest:.1f}", flush=True)
    last[name] = now
subscriptions = [session.declare_subscriber(f"talk/{other}", hear) for other in "012" if other != me]
publisher = session.declare_publisher(f"talk/{me}")
while True:
    publisher.put("x" * 1500)
    time.sleep(0.004)
"""


def longest_silence(seed: int, seconds: float, lease: str) -> float:
    """How long at most nothing came from one machine to another (s)."""
    random, environment = Random(f"flapping {seed}"), os.environ | {"FAME_LEASE": lease}

    def begin(*command: str) -> subprocess.Popen[str]:
        """Start a process, which is killed at the end."""
        made = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment)
        running.callback(made.communicate)
        running.callback(made.kill)
        return made

    with machines(3) as place, ExitStack() as running:
        for number, address in enumerate(ADDRESSES):
            others = ["--connect", ADDRESSES[0]] if number else []
            fame = (sys.executable, "-m", "fame", "router", "--network", address, *others)
            router = begin(*place.inside(number, *fame))
            assert router.stdout is not None
            assert "Ctrl-C" in router.stdout.readline()
        talkers = [begin(*place.inside(number, sys.executable, "-c", TALK, str(number))) for number in range(3)]
        time.sleep(3)
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            time.sleep(random.uniform(1, 8))
            number = random.randrange(1, 3)
            place.set("down", number)
            time.sleep(random.uniform(0.5, 4))
            place.set("up", number)
        time.sleep(20)
        for talker in talkers:
            talker.kill()
        return max(float(line) for talker in talkers for line in talker.stdout or ())


def main(words: list[str]) -> None:
    seed, seconds = int(words[0]) if words else 1, float(words[1]) if len(words) > 1 else 120.0
    for lease in words[2:] or ("3", "40"):
        print(json.dumps({"seed": seed, "lease_s": lease, "longest_silence_s": longest_silence(seed, seconds, lease)}),
              flush=True)  # fmt: skip


if __name__ == "__main__":
    main(sys.argv[1:])
