"""A node of rclpy on Fast DDS, for `test_fastdds`: ``python fastdds_child.py DOMAIN``. It knows nothing of FAME.

It answers on /answer what it hears on /ask, with as many characters; offers a service and an action; says on /answer
if a goal was cancelled, and what markers say; has a client of a service of FAME's; and ends after a minute.
"""

from __future__ import annotations

import os
import sys
import time
from typing import Any

import rclpy
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import SetBool
from test_msgs.action import Fibonacci
from visualization_msgs.msg import MarkerArray

STEP = 0.05  # s


class Stranger(Node):
    def __init__(self) -> None:
        super().__init__("stranger", namespace="/OTHER")
        self._answer = self.create_publisher(String, "/answer", 10)
        self.create_subscription(String, "/ask", self._hear, 10)
        self.create_subscription(MarkerArray, "/mission_markers", self._show, 10)
        self.create_service(SetBool, "twice", self._twice)
        self._client = self.create_client(SetBool, "/REX/ours")
        self._server = ActionServer(
            self,
            Fibonacci,
            "count",
            self._count,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
        )

    def _hear(self, message: Any) -> None:
        self._answer.publish(String(data="b" * len(message.data)))

    def _show(self, array: Any) -> None:
        self._answer.publish(
            String(data=" ".join(f"{one.ns} {one.header.frame_id} {one.text}" for one in array.markers))
        )

    def _twice(self, request: Any, response: Any) -> Any:
        response.success, response.message = True, str(request.data) * 2
        return response

    def _count(self, goal: Any) -> Any:
        numbers = [0]
        while len(numbers) < goal.request.order and not goal.is_cancel_requested:
            numbers.append(numbers[-1] + 1)
            goal.publish_feedback(Fibonacci.Feedback(sequence=numbers))
            time.sleep(STEP)
        if goal.is_cancel_requested:
            goal.canceled()
            self._answer.publish(String(data="cancelled"))
        else:
            goal.succeed()
        return Fibonacci.Result(sequence=numbers)


def main() -> None:
    rclpy.init(domain_id=int(sys.argv[1]))
    node, executor = Stranger(), MultiThreadedExecutor(4)
    executor.add_node(node)
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.1)
    os._exit(0)  # rclpy waits for threads that wait for goals


if __name__ == "__main__":
    main()
