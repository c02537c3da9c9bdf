"""A person in a test who has taken a robot over: steers it, then lets its mission continue."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fame.clock import SECOND, Entry, Kind
from fame.errors import ConfigError
from fame.middleware import messages
from fame.middleware.interface import resolve

if TYPE_CHECKING:
    from fame.testing.mission import MissionUnderTest

TWIST = "geometry_msgs/msg/Twist"
_COMMANDS = SECOND // 10
"""Time between two commands of a person who steers (ns)."""


class TakenOver:
    """A robot whose mission is suspended, steered by `who` until one of the methods lets it continue.

    Elements are named by label or id. What the robot refuses raises MissionError.
    """

    def __init__(self, mission: MissionUnderTest, robot: str, who: str) -> None:
        self._mission, self._robot, self._who = mission, robot, who
        self._suspension = mission.node(robot).suspension
        self._lease = f"{who} at {mission.now} s"
        self._suspension.take_over(who, self._lease)
        self._next: Entry = mission.run.scheduler.after(SECOND, self._hold_on, Kind.TIMER)
        mission.settle()

    @property
    def is_held(self) -> bool:
        """Whether this person still steers."""
        return self._suspension.holder == self._who

    def steer(self, speed: float = 0.0, turn: float = 0.0, *, seconds: float) -> None:
        """Command a speed (m/s) and a turn rate (rad/s) for some simulated seconds, then nothing."""
        mission = self._mission
        publisher = mission.outside.publisher(resolve("cmd_vel_manual", mission.node(self._robot).namespace), TWIST)
        twist = messages.create(TWIST, {"linear": {"x": speed}, "angular": {"z": turn}})
        for _ in range(max(1, round(seconds * SECOND / _COMMANDS))):
            publisher.publish(twist)
            mission.advance(_COMMANDS / SECOND)

    def resume(self) -> None:
        """Let the mission continue: activities begin again with their variables."""
        self._suspension.go_on(self._who, self._lease)
        self.lose()

    def restart(self, element: str) -> None:
        """Let the mission continue with an element, as a drawn call activity, from its beginning."""
        self._mission.node(self._robot).restart(self._at(element), who=self._who)
        self.resume()

    def skip(self, element: str) -> None:
        """Let the mission continue behind an element, without its results."""
        self._mission.node(self._robot).skip(self._at(element), who=self._who)
        self.resume()

    def fail(self, element: str) -> None:
        """Let the mission continue with the error ``taken_over`` of an element."""
        self._mission.node(self._robot).fail(self._at(element), self._lease, who=self._who)
        self.lose()

    def lose(self) -> None:
        """Let go, or lose the connection: the lease ends after a while, the mission stays suspended."""
        self._next.cancel()
        self._mission.settle()

    def _hold_on(self) -> None:
        """Prolong the lease each second, until another person ends it."""
        if self.is_held:
            self._suspension.take_over(self._who, self._lease)
            self._next = self._mission.run.scheduler.after(SECOND, self._hold_on, Kind.TIMER)

    def _at(self, element: str) -> str:
        """The id of an element with a token. Raises ConfigError."""
        ids = self._mission.elements.find(self._robot, element)
        there = [id for id in sorted(ids) if self._mission.is_at(self._robot, frozenset({id}))]
        if not there:
            raise ConfigError(f"{self._robot}: no token is at {element!r}")
        return there[0]
