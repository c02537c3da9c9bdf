"""An action server of rclpy alone, as those of Nav2 are in their processes, for `test_servers_that_fail`.

It is a server from the first byte that it reads, and drives one step for each further one, as ``driver_child.py``.
"""

from __future__ import annotations

import os
from threading import Semaphore, Thread
from typing import Any

import rclpy
from farm_msgs.action import Drive
from rclpy.action import ActionServer, CancelResponse
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node

STEPS = Semaphore(0)


def drive(goal: Any) -> Any:
    """Drive as far as a goal says, unless it is cancelled."""
    print("goal", flush=True)
    driven = 0.0
    while driven < goal.request.distance:
        stepped = STEPS.acquire(timeout=0.02)
        if goal.is_cancel_requested:
            goal.canceled()
            print("cancelled", flush=True)
            return Drive.Result(driven=driven)
        if stepped:
            driven += 1
            goal.publish_feedback(Drive.Feedback(remaining=goal.request.distance - driven))
    goal.succeed()
    return Drive.Result(driven=driven)


def main() -> None:
    print("loaded", flush=True)
    os.read(0, 1)
    rclpy.init()
    node = Node("driver", namespace="REX")
    server = ActionServer(node, Drive, "drive", drive, cancel_callback=lambda goal: CancelResponse.ACCEPT)
    executor = MultiThreadedExecutor(4)
    executor.add_node(node)
    Thread(target=executor.spin, daemon=True).start()
    print("ready", flush=True)
    while os.read(0, 1):
        STEPS.release()
    server.destroy()
    os._exit(0)


main()
