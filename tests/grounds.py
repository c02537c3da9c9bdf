"""A world with its scheduler and middleware, to be driven by topics from a test."""

from __future__ import annotations

from typing import Any

from fame.clock import SECOND, Scheduler
from fame.middleware import messages
from fame.middleware.interface import LATCHED, SIGNAL
from fame.middleware.local import LocalMiddleware
from sim2d.config import WorldConfig
from sim2d.world import World

OPEN: list[World] = []
"""The worlds that the tests have made, for ``tests/conftest.py`` to close."""


class Ground:
    """`hear` and `say` are a node outside of all robots."""

    def __init__(self, config: WorldConfig | dict[str, Any], seed: int = 1) -> None:
        self.scheduler = Scheduler()
        self.middleware = LocalMiddleware(self.scheduler)
        self.world = World(config, seed=seed, scheduler=self.scheduler, middleware=self.middleware)
        OPEN.append(self.world)
        self._node = self.middleware.node("test")
        self._started = False
        self._publishers: dict[str, Any] = {}

    def hear(self, topic: str, kind: str, *, latched: bool = False) -> list[Any]:
        """The list that the messages of a topic are appended to."""
        heard: list[Any] = []
        self._node.subscription(topic, kind, heard.append, LATCHED if latched else SIGNAL)
        return heard

    def say(self, topic: str, kind: str, fields: Any) -> None:
        """Publish now."""
        if topic not in self._publishers:
            self._publishers[topic] = self._node.publisher(topic, kind)
        self._publishers[topic].publish(messages.create(kind, fields))

    def drive(self, speed: float, turn_rate: float = 0.0, robot: str = "REX") -> None:
        """Command a velocity (m/s, rad/s)."""
        twist = {"linear": {"x": speed}, "angular": {"z": turn_rate}}
        self.say(f"/{robot}/cmd_vel", "geometry_msgs/msg/Twist", twist)

    def run(self, until: float) -> None:
        """Go on until this simulated second."""
        if not self._started:
            self._started = True
            self.world.start()
        self.scheduler.run(round(until * SECOND))


def ground(seed: int = 1, **changes: Any) -> Ground:
    """A ground of 6 x 4 m with REX at (1, 2) looking along x; `changes` add to it, `rex` to the robot."""
    rex = {"type": "car", "at": [1, 2], **changes.pop("rex", {})}
    robots = {"REX": rex, **changes.pop("robots", {})}
    return Ground({"size": [6, 4], **changes, "robots": robots}, seed)
