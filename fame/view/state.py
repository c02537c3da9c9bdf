"""The state of a run at an instant: that of each robot (`fame.robot.robot_state`), and of the world.

The page changes its own in the same way, with numbers for ids (page/store.js): both are tried with the cases of
tests/page/state_cases.json.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from fame.dataclasses import dataclass, field
from fame.robot.robot_state import RobotState

WHATS: tuple[str, ...] = ("start", "enter", "leave", "take", "cancel", "fail", "end", "log", "report", "answer")
"""Kinds of events; an event has the number of its kind."""
START, ENTER, LEAVE, TAKE, CANCEL, FAIL, END = range(7)


class WaitCircle(NamedTuple):
    """Robots (names) that wait for each other: that, and what can end it, in words."""

    robots: Sequence[str]
    text: str


@dataclass(slots=True)
class RunState:
    """The state of a run at an instant.

    robots   number of a robot -> its state
    circles  number of a robot -> the robots that wait for each other, it among them
    poses    number of a robot -> its last pose
    world    name -> what changed
    """

    robots: dict[int, RobotState] = field(default_factory=dict)
    circles: dict[int, WaitCircle] = field(default_factory=dict)
    poses: dict[int, Mapping[str, Any]] = field(default_factory=dict)
    world: dict[str, Any] = field(default_factory=dict)

    def robot(self, number: int) -> RobotState:
        """Return the state of a robot, which is empty at first."""
        return self.robots.get(number) or self.robots.setdefault(number, RobotState())
