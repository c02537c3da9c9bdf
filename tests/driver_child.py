"""An action server in a process of its own, for `test_servers_that_fail`: ``python driver_child.py MIDDLEWARE DOMAIN``.

It is a server from the first byte that it reads. Its robot drives one step for each further one. What happens it says
on stdout. It ends with its stdin.
"""

from __future__ import annotations

import os
import sys
from typing import Any

from action_server import Server

from fame.clock import SECOND, WallScheduler


def main(middleware: str, domain: int) -> None:
    make: Any
    if middleware == "dds":
        from fame.middleware.dds import DdsMiddleware as make
    else:
        from fame.middleware.zenoh import ZenohMiddleware as make
    print("loaded", flush=True)
    os.read(0, 1)
    scheduler = WallScheduler()
    made = make(scheduler, domain=domain)
    server = Server(made.node("driver", "REX"))
    server.on_goal = lambda: print("goal", flush=True)
    os.set_blocking(0, False)
    print("ready", flush=True)
    cancelled = 0
    while True:
        scheduler.run(until=scheduler.now + SECOND // 50)
        for _ in server.cancelled[cancelled:]:
            print("cancelled", flush=True)
        cancelled = len(server.cancelled)
        try:
            read = os.read(0, 1)
        except BlockingIOError:
            continue
        if not read:
            break
        server.step()
    made.close()


main(sys.argv[1], int(sys.argv[2]))
