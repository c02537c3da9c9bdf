"""What the world asks of a robot, and what a robot may ask of the world.

A robot is made with its configuration and its surroundings: it puts its bodies into the space and its nodes into the
middleware. From then on the world calls, in the order of the file, `move` before each step of the physics and `sense`
after it. A robot obeys and publishes topics in its own namespace, as its real counterpart would; nobody else tells it
anything.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, Protocol

from fame.config.values import Point
from fame.middleware.interface import Message, QoS

if TYPE_CHECKING:
    import numpy as np
    import pymunk

    from fame.clock import Scheduler
    from fame.middleware.interface import Middleware
    from sim2d.ground import Weeds


MEASUREMENT = QoS(depth=10)
"""The QoS of sensor topics: reliable, so that subscribers of either reliability match."""

ROBOT = 1
"""The collision type of robots' shapes."""


class Pose(NamedTuple):
    """A place in the world, m, and a heading, rad counter-clockwise from x."""

    x: float
    y: float
    heading: float

    def ahead(self, distance: float) -> Point:
        """The place so far (m) in front of it."""
        return self.x + distance * math.cos(self.heading), self.y + distance * math.sin(self.heading)


class TopicCommand(NamedTuple):
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


class Workpiece(NamedTuple):
    """Something that an arm works on: a polygon in the arm's own frame, m, or a line if it is not `closed`.

    `kind`: a ``fixture`` stays where it is, a ``part`` is handled or made, a ``cut`` goes through it.
    """

    kind: Literal["fixture", "part", "cut"]
    corners: Sequence[Point]
    closed: bool = True


class Appearance(NamedTuple):
    """How a robot looks at an instant, for those who draw it.

    altitude   m above the ground
    led        ``off`` or a name of `robots.equipment.COLOURS`
    cone       what its range sensor saw last, if it has one
    footprint  the radius (m) of the ground that its camera sees, 0 if it sees none
    blade      the radius (m) of its blade, 0 unless that turns
    charge     what is left in its battery, 0 to 1; always 1 if it has none
    limb       an arm's joints and tool from above, in its own frame, m
    jaws       how far its gripper is open, m; negative if it has none
    workpieces what an arm works on
    note       what its body does, in a few words
    """

    pose: Pose
    altitude: float = 0.0
    led: str = "off"
    cone: Cone | None = None
    footprint: float = 0.0
    blade: float = 0.0
    charge: float = 1.0
    limb: Sequence[Point] = ()
    jaws: float = -1.0
    workpieces: Sequence[Workpiece] = ()
    note: str = ""


@dataclass(frozen=True, slots=True)
class RobotConfig:
    """A robot: its type, the class that makes it, its parameters, and where it starts.

    `at` in m, `heading` in rad, counter-clockwise from x; `path` is its key in the file.
    """

    name: str
    type: str
    make: Callable[[RobotConfig, RobotWorld], SimulatedRobot]
    at: Point
    heading: float
    parameters: Any
    path: str = ""


class RobotWorld(Protocol):
    """The world as a robot meets it. `step` in s; `map` is a nav_msgs/msg/OccupancyGrid of the known obstacles."""

    space: pymunk.Space
    scheduler: Scheduler
    middleware: Middleware
    map: Message
    weeds: Weeds
    step: float

    def random(self, robot: str, sensor: str) -> np.random.Generator:
        """The generator of one sensor."""

    def charging(self, place: Point) -> float:
        """What a battery at a place gets from chargers, W."""


class SimulatedRobot(Protocol):
    """A robot of any type. `outline` is its corners in its own frame, m: x ahead, y to the left.

    SAFE_STATE      what is published to it when its mission has ended, however that was
    SAFE_SUSPENDED  the same while its mission is suspended
    FAULTS          what can break
    """

    Parameters: ClassVar[type[Any]]
    SAFE_STATE: ClassVar[tuple[TopicCommand, ...]]
    SAFE_SUSPENDED: ClassVar[tuple[TopicCommand, ...]]
    FAULTS: ClassVar[tuple[str, ...]]

    name: str
    type: str
    body: pymunk.Body
    outline: tuple[Point, ...]

    def __init__(self, config: RobotConfig, world: RobotWorld) -> None: ...

    @property
    def pose(self) -> Pose:
        """Where it truly is."""

    @property
    def appearance(self) -> Appearance:
        """How it truly looks."""

    @property
    def status(self) -> Mapping[str, Any]:
        """What a summary tells of it besides its place, fit for JSON."""

    def start(self) -> None:
        """Publish what is said once."""

    def move(self, now: int, duration: float) -> None:
        """Push the bodies for one step of `duration` s that begins at `now` (ns)."""

    def sense(self, now: int, count: int) -> None:
        """Publish what the sensors measure after step number `count`, if it is their turn."""

    def fault(self, kind: str) -> None:
        """Break one of `FAULTS`, for good."""

    def close(self) -> None:
        """Leave the middleware."""


def period(rate: float, step: float) -> int:
    """How many steps (s) of the world make one period of a rate (Hz): the whole number nearest to it."""
    return max(1, math.floor(1 / (rate * step) + 0.5))


def rectangle(length: float, width: float) -> tuple[Point, ...]:
    """The corners of a body, m: x ahead, y to the left."""
    x, y = length / 2, width / 2
    return (x, y), (-x, y), (-x, -y), (x, -y)


def body_of(space: pymunk.Space, start: Pose, outline: Sequence[Point], mass: float) -> tuple[pymunk.Body, pymunk.Poly]:
    """A body of `mass` kg in the space, and its shape. The filter of the shape leaves out the body itself."""
    import pymunk

    body = pymunk.Body(mass, pymunk.moment_for_poly(mass, outline))
    body.position = start.x, start.y
    body.angle = start.heading
    shape = pymunk.Poly(body, outline)
    shape.friction = 0.5
    shape.collision_type = ROBOT
    shape.filter = pymunk.ShapeFilter(group=len(space.bodies) + 1)
    space.add(body, shape)
    return body, shape
