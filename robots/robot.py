"""What the world asks of a robot, and what a robot may ask of the world.

A robot is made with its configuration and its surroundings: it puts its bodies into the space and its nodes into the
middleware. From then on the world calls, in the order of the file, `move` before each step of the physics and `sense`
after it. A robot obeys and publishes topics in its own namespace, as its real counterpart would; nobody else tells it
anything.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol

from fame.middleware.interface import QoS

if TYPE_CHECKING:
    import numpy as np
    import pymunk

    from fame.clock import Scheduler
    from fame.middleware.interface import Middleware
    from sim2d.config import RobotConfig
    from sim2d.grid import Grid


MEASUREMENT = QoS(depth=10)
"""The QoS of sensor topics: reliable, so that subscribers of either reliability match."""


class Pose(NamedTuple):
    """A place in the world, m, and a heading, rad counter-clockwise from x."""

    x: float
    y: float
    heading: float


class Command(NamedTuple):
    """A message to publish: `topic` is relative to the robot's namespace."""

    topic: str
    type: str
    fields: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Cone:
    """What a range sensor covers: its place, the angle it opens (rad), and how far it saw free ground (m)."""

    pose: Pose
    field_of_view: float
    length: float


class Surroundings(Protocol):
    """The world as a robot meets it. `step` in s; `grid` is the map of the known obstacles."""

    space: pymunk.Space
    scheduler: Scheduler
    middleware: Middleware
    grid: Grid
    step: float

    def random(self, robot: str, sensor: str) -> np.random.Generator:
        """The generator of one sensor."""


class Robot(Protocol):
    """A robot of any type. `outline` is its corners in its own frame, m: x ahead, y to the left."""

    Parameters: ClassVar[type[Any]]
    SAFE_STATE: ClassVar[tuple[Command, ...]]

    name: str
    type: str
    body: pymunk.Body
    outline: tuple[tuple[float, float], ...]

    def __init__(self, config: RobotConfig, world: Surroundings) -> None: ...

    @property
    def pose(self) -> Pose:
        """Where it truly is."""

    @property
    def led(self) -> str:
        """The colour that its LED shows: `off` or a name of `robots.led.COLOURS`."""

    @property
    def cone(self) -> Cone | None:
        """What its range sensor saw last, if it has one."""

    def start(self) -> None:
        """Publish what is said once."""

    def move(self, now: int, duration: float) -> None:
        """Push the bodies for one step of `duration` s that begins at `now` (ns)."""

    def sense(self, now: int, count: int) -> None:
        """Publish what the sensors measure after step number `count`, if it is their turn."""

    def close(self) -> None:
        """Leave the middleware."""
