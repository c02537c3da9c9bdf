"""An action server for tests: it drives as far as its goal says, step by step."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from fame.middleware.actions import OUTCOMES, ActionServer, ServerGoal
from fame.middleware.interface import Node
from fame.middleware.messages import register_files

DRIVE = "farm_msgs/action/Drive"
register_files(Path(__file__).with_name("ros_workspace"))


def skip_without_drive(backend: str) -> None:
    """ROS knows the types of packages that are built and sourced."""
    if "ros" in backend:
        pytest.importorskip("farm_msgs.action", reason="farm_msgs is not built: make test-ros")


class Server:
    """The action ``drive`` of a node. `step` moves all goals by a metre; `refuse` says which to reject.

    `obeys`: whether it cancels goals; False: it refuses, None: it says that it does, and does not.
    """

    def __init__(self, node: Node, name: str = "drive") -> None:
        self.refuse: Callable[[float], bool] = lambda distance: distance < 0
        self.goals: dict[bytes, list[float]] = {}  # id -> wanted, driven
        self.on_goal: Callable[[], object] = lambda: None
        self.cancelled: list[bytes] = []
        self.obeys: bool | None = True
        self._accepted: dict[bytes, ServerGoal] = {}
        self.server = ActionServer(
            node, name, DRIVE, self._begin, self._cancel, lambda goal: not self.refuse(goal.distance)
        )

    def step(self) -> None:
        for id, (wanted, driven) in list(self.goals.items()):
            self.goals[id][1] = driven + 1
            self._accepted[id].feedback({"remaining": wanted - driven - 1})
            if driven + 1 >= wanted:
                self.end(id, 4)

    def end(self, id: bytes, status: int) -> None:
        _, driven = self.goals.pop(id)
        self._accepted[id].end(OUTCOMES[status], {"driven": driven})

    def _begin(self, goal: ServerGoal) -> None:
        self._accepted[goal.id] = goal
        self.goals[goal.id] = [goal.message.distance, 0.0]
        self.on_goal()

    def _cancel(self, goal: ServerGoal) -> bool | None:
        self.cancelled.append(goal.id)
        if self.obeys:
            self.end(goal.id, 5)
        return self.obeys
