"""A robot in a process of its own, for `test_dds`: ``python dds_child.py DOMAIN``.

It answers on /answer what it hears on /ask. To "leave" it answers fifty times, and ends as any program does: without
closing anything. It never outlives its parent's patience.
"""

from __future__ import annotations

import sys
from functools import partial
from typing import Any

from fame.clock import SECOND, WallScheduler
from fame.middleware.dds import DdsMiddleware
from fame.middleware.interface import LATCHED, SENSOR_DATA
from fame.middleware.messages import create

TEXT = "std_msgs/msg/String"
FAREWELLS = 50


def main(domain: int) -> None:
    scheduler = WallScheduler()
    node = DdsMiddleware(scheduler, domain=domain).node("child", "OTHER")
    answer = node.publisher("/answer", TEXT)

    def hear(message: Any) -> None:
        if message.data == "leave":
            for number in range(FAREWELLS):
                answer.publish(create(TEXT, str(number)))
            scheduler.stop()
        else:
            answer.publish(create(TEXT, message.data.upper()))

    node.subscription("/ask", TEXT, hear)
    node.publisher("/raw", TEXT, SENSOR_DATA)
    node.publisher("/map", TEXT, LATCHED).publish(create(TEXT, "here be dragons"))
    node.service("twice", "std_srvs/SetBool", lambda request: {"message": str(request.data) * 2})
    scheduler.after(30 * SECOND, partial(sys.exit, "nobody told me to leave"))
    scheduler.run()


if __name__ == "__main__":
    main(int(sys.argv[1]))
