"""An action server out of services and a topic, as ROS 2's are: it drives as far as it is told, step by step."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fame.middleware.interface import DeferredResponse, Node, QoS
from fame.middleware.messages import create, register_files

DRIVE = "farm_msgs/action/Drive"
register_files(Path(__file__).with_name("ros_workspace"))


def skip_without_drive(backend: str) -> None:
    """ROS knows the types of packages that are built and sourced."""
    if "ros" in backend:
        pytest.importorskip("farm_msgs.action", reason="farm_msgs is not built: make test-ros")


class Server:
    """The action ``drive`` of a node. `step` moves all goals by a metre; `refuse` says which to reject."""

    def __init__(self, node: Node, name: str = "drive") -> None:
        self.refuse: Callable[[float], bool] = lambda distance: distance < 0
        self.goals: dict[bytes, list[float]] = {}  # id -> wanted, driven
        self.cancelled: list[bytes] = []
        self._results: dict[bytes, DeferredResponse] = {}
        self._feedback = node.publisher(f"{name}/_action/feedback", f"{DRIVE}_FeedbackMessage", QoS(depth=10))
        node.service(f"{name}/_action/send_goal", f"{DRIVE}_SendGoal", self._goal)
        node.service(f"{name}/_action/get_result", f"{DRIVE}_GetResult", self._result)
        node.service(f"{name}/_action/cancel_goal", "action_msgs/srv/CancelGoal", self._cancel)

    def step(self) -> None:
        for id, (wanted, driven) in list(self.goals.items()):
            self.goals[id][1] = driven + 1
            said = {"goal_id": {"uuid": id}, "feedback": {"remaining": wanted - driven - 1}}
            self._feedback.publish(create(f"{DRIVE}_FeedbackMessage", said))
            if driven + 1 >= wanted:
                self.end(id, 4)

    def end(self, id: bytes, status: int) -> None:
        _, driven = self.goals.pop(id)
        self._later(id).respond({"status": status, "result": {"driven": driven}})

    def _goal(self, request: Any) -> Any:
        if self.refuse(request.goal.distance):
            return None
        self.goals[bytes(request.goal_id.uuid)] = [request.goal.distance, 0.0]
        return {"accepted": True}

    def _result(self, request: Any) -> DeferredResponse:
        return self._later(bytes(request.goal_id.uuid))

    def _cancel(self, request: Any) -> Any:
        id = bytes(request.goal_info.goal_id.uuid)
        self.cancelled.append(id)
        self.end(id, 5)
        return {"goals_canceling": [{"goal_id": {"uuid": id}}]}

    def _later(self, id: bytes) -> DeferredResponse:
        return self._results.setdefault(id, DeferredResponse())
