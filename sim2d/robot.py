"""The interface between the world and its robots, and the registry of robot types.

A robot is constructed with its configuration and the world: it adds its bodies to the physics space and its nodes to
the middleware. Then the world calls, in the order of the file, `move` before each step of the physics and `sense` after
it. A robot communicates only by topics, services and actions in its own namespace, like its real counterpart.

The `type:` of a robot in a world file is the name of a built-in type, a name registered by an installed package as an
entry point of the group ``fame.robots``, or a class as ``module:Class`` or ``file.py:Class``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, Protocol

from fame.config.loader import find_object, registered
from fame.config.values import Point
from fame.dataclasses import dataclass
from fame.errors import ConfigError
from fame.middleware.interface import AnyMessage, QoS
from fame.text import suggestion

if TYPE_CHECKING:
    import numpy as np
    import pymunk

    from fame.clock import Scheduler
    from fame.middleware.interface import Middleware
    from sim2d.ground import Weeds
    from sim2d.warehouse import Parcels


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
        """Return the place at a distance (m) in front of it."""
        return self.x + distance * math.cos(self.heading), self.y + distance * math.sin(self.heading)


class TopicCommand(NamedTuple):
    """A message to publish: `topic` is relative to the robot's namespace."""

    topic: str
    type: str
    fields: Mapping[str, Any]


class Cone(NamedTuple):
    """The cone of a range sensor: its pose, opening angle (rad), and length of free ground that it saw (m)."""

    pose: Pose
    field_of_view: float
    length: float


class Workpiece(NamedTuple):
    """A workpiece of an arm: a polygon in the arm's frame, m, or a line if it is not `closed`.

    `kind`: a ``fixture`` stays where it is, a ``part`` is handled or made, a ``cut`` goes through it.
    """

    kind: Literal["fixture", "part", "cut"]
    corners: Sequence[Point]
    closed: bool = True


class Appearance(NamedTuple):
    """The appearance of a robot at an instant, for drawings.

    altitude   m above the ground
    led        ``off`` or a name of `robots.equipment.COLOURS`
    cone       what its range sensor saw last, if it has one
    footprint  the radius (m) of the ground that its camera sees, 0 without a camera
    blade      the radius (m) of its turning blade, else 0
    cargo      whether it carries a parcel
    charge     state of charge of its battery, 0 to 1; 1 without a battery
    limb       an arm's joints and tool from above, in its own frame, m
    jaws       opening of its gripper, m; negative without a gripper
    workpieces what an arm works on
    note       what its body does, in a few words
    """

    pose: Pose
    altitude: float = 0.0
    led: str = "off"
    cone: Cone | None = None
    footprint: float = 0.0
    blade: float = 0.0
    cargo: bool = False
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
    """The world as seen by a robot. `step` in s; `map` is a nav_msgs/msg/OccupancyGrid of the known obstacles.

    `docks` are the poses of robots that are docked at chargers.
    """

    space: pymunk.Space
    scheduler: Scheduler
    middleware: Middleware
    map: AnyMessage
    weeds: Weeds
    parcels: Parcels
    docks: Mapping[str, Pose]
    step: float

    def random(self, robot: str, sensor: str) -> np.random.Generator:
        """Return the random generator of one sensor."""

    def charging(self, place: Point) -> float:
        """Return the power (W) of the chargers at a place."""


class SimulatedRobot(Protocol):
    """A robot of any type. `outline` has its corners in its own frame, m: x forward, y left.

    SAFE_STATE      commands published to it when its mission has ended, for whatever reason
    SAFE_SUSPENDED  the same while its mission is suspended
    FAULTS          kinds of faults that can be injected
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
        """Its true pose."""

    @property
    def appearance(self) -> Appearance:
        """Its true appearance."""

    @property
    def status(self) -> Mapping[str, Any]:
        """The entries of its type in the world's summary, besides its pose; JSON-serialisable."""

    def start(self) -> None:
        """Publish latched topics once, before the first step."""

    def move(self, now: int, duration: float) -> None:
        """Apply forces to its bodies for one step of `duration` s that begins at `now` (ns)."""

    def sense(self, now: int, count: int) -> None:
        """Publish the measurements that are due after step number `count`."""

    def fault(self, kind: str) -> None:
        """Inject one of `FAULTS`, permanently. Raises ConfigError for another."""

    def close(self) -> None:
        """Close its nodes."""


def period(rate: float, step: float) -> int:
    """Return the number of steps (s) per period of a rate (Hz), rounded, at least 1."""
    return max(1, math.floor(1 / (rate * step) + 0.5))


def rectangle(length: float, width: float) -> tuple[Point, ...]:
    """Return the corners of a rectangular outline, m: x forward, y left."""
    x, y = length / 2, width / 2
    return (x, y), (-x, y), (-x, -y), (x, -y)


def body_of(space: pymunk.Space, start: Pose, outline: Sequence[Point], mass: float) -> tuple[pymunk.Body, pymunk.Poly]:
    """Add a body of `mass` kg to the space; return it and its shape, whose filter excludes the body itself."""
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


GROUP = "fame.robots"
"""Group of the entry points by which packages register robot types."""
BUILT_IN = {
    "car": "robots.vehicles:Car",
    "carrier": "robots.vehicles:Carrier",
    "drone": "robots.drone:Drone",
    "mh5": "robots.arm.mh5:Cutter",
    "tractor": "robots.vehicles:Tractor",
    "ur5e": "robots.arm.ur5e:UR5e",
}
"""The robot types that come with FAME, as entry points."""


def robot_types() -> dict[str, str]:
    """Return all registered types, each with its ``module:Class``."""
    return {**registered(GROUP), **BUILT_IN}


def robot_class(type: str, folder: Path = Path()) -> type[SimulatedRobot]:
    """Return the class of a robot type; ``file.py:Class`` is relative to `folder`. Raises ConfigError."""
    place = type if ":" in type else robot_types().get(type)
    if place is None:
        raise ConfigError(f"expected a robot type, got {type!r}; {_registered(type)}")
    found = find_object(place, folder)
    missing = list(_missing(found))
    if missing:
        raise ConfigError(f"expected a class of robots (sim2d.robot), got {type!r}, which has no {', '.join(missing)}")
    return found  # type: ignore[no-any-return]


def absolute(type: str, folder: Path) -> str:
    """Return a type that is valid in another folder: a ``file.py:Class`` with the absolute path of its file."""
    file, colon, name = type.rpartition(":")
    return f"{(folder / file).resolve()}:{name}" if colon and file.endswith(".py") else type


def _registered(type: str) -> str:
    """A suggestion for an unknown type: the closest one, or all types."""
    known = suggestion(type, robot_types())
    return known if known.endswith("?") else f"{known}, module:Class, file.py:Class"


def _missing(found: object) -> Iterator[str]:
    """The required members that an object lacks."""
    for name in ("Parameters", "SAFE_STATE", "SAFE_SUSPENDED", "FAULTS", "move", "sense", "close"):
        if not hasattr(found, name):
            yield name
