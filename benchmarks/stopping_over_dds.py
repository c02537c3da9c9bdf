"""One run of `interpretation.py` over DDS on the wall clock: world and controller are processes of their own.

    python benchmarks/stopping_over_dds.py world SPEED FRICTION SEED
    python benchmarks/stopping_over_dds.py direct|interpreted SPEED

The world begins when it is connected to a controller, and that drives on the first range it hears, so that all runs
begin alike. When the car stands again the world prints the distance left (cm); the controller prints the CPU time (s)
of its run when its input is closed.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from functools import partial
from typing import Any

import interpretation

from fame.clock import SECOND
from fame.middleware.dds import DdsMiddleware, DdsScheduler

_ENDS = "/car/range", "/car/cmd_vel"
_PATIENCE = 20.0
"""s until a run that does not end has failed."""


def world(speed: float, friction: float, seed: int) -> None:
    """The world's part: prints the distance left."""
    scheduler = DdsScheduler()
    middleware = DdsMiddleware(scheduler)
    made = interpretation.world(friction, seed, scheduler, middleware)
    missing = middleware.wait_matched(_ENDS, _PATIENCE)
    if missing:
        sys.exit(f"nobody is connected to {', '.join(missing)}")
    fastest, stands = [0.0], [0.0]

    def watch(_: Any) -> None:
        motion = abs(made.robots["car"].body.velocity)
        fastest[0] = max(fastest[0], motion)
        stands[0] = stands[0] + made.step if fastest[0] > 0.9 * speed and motion < 1e-6 else 0.0
        if stands[0] > 0.5:
            scheduler.stop()

    made.watchers.append(watch)
    made.start()
    scheduler.run(scheduler.now + round(_PATIENCE * SECOND))
    print(interpretation.distance_left(made))
    made.close()
    middleware.close()


def controller(way: str, speed: float) -> None:
    """The controller's part: prints its CPU time."""
    scheduler = DdsScheduler()
    middleware = DdsMiddleware(scheduler)
    start = interpretation.controller(way, scheduler, middleware, speed)
    begun: list[float] = []

    def first(_: Any) -> None:
        if not begun:
            begun.append(time.process_time())
            start()

    middleware.node("starter", "car").subscription("range", interpretation.RANGE, first)
    threading.Thread(target=lambda: (sys.stdin.read(), scheduler.stop()), daemon=True).start()
    scheduler.run()
    print(time.process_time() - begun[0])
    middleware.close()


def run(way: str, speed: float, friction: float, seed: int) -> tuple[float, float]:
    """Both parts. Returns the distance left (cm) and the CPU time (s) of the controller."""
    environment = os.environ | {"ROS_DOMAIN_ID": str(1 + os.getpid() % 100)}
    begin = partial(subprocess.Popen, env=environment, stdout=subprocess.PIPE, stdin=subprocess.PIPE, text=True)
    parts = [begin([sys.executable, __file__, *map(str, said)]) for said in
             (("world", speed, friction, seed), (way, speed))]  # fmt: skip
    try:
        left, spent = (float(json.loads(part.communicate(timeout=2 * _PATIENCE)[0])) for part in parts)
    finally:
        for part in parts:
            part.kill()
            part.wait()
    return left, spent


if __name__ == "__main__":
    part, *values = sys.argv[1:]
    if part == "world":
        world(float(values[0]), float(values[1]), int(values[2]))
    else:
        controller(part, float(values[0]))
