"""What all ground vehicles have: a drive, odometry, an ultrasonic sensor at the nose, the map, and a path planner.

Obeys `cmd_vel`, publishes `odom`, `range` and, once for all, `map`; its planner answers `goal_pose` with `plan`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

from fame.errors import ConfigError
from fame.middleware.interface import LATCHED
from fame.text import suggestion
from robots.drive import Drive, DriveParameters
from robots.odometer import Odometer, OdometerParameters
from robots.planner import Planner, PlannerParameters
from robots.robot import Command, Look, Pose, period
from robots.ultrasonic import Ultrasonic, UltrasonicParameters

if TYPE_CHECKING:
    from robots.robot import Surroundings
    from sim2d.config import RobotConfig

STOP = Command("cmd_vel", "geometry_msgs/msg/Twist", {})


@dataclass(frozen=True, slots=True)
class VehicleParameters(DriveParameters):
    """What a world file may say of a ground vehicle."""

    odom: OdometerParameters = field(default=OdometerParameters())
    range: UltrasonicParameters = field(default=UltrasonicParameters())
    planner: PlannerParameters = field(default=PlannerParameters())


class Vehicle:
    """A `robots.robot.Robot` that drives; types add what else they have."""

    Parameters: ClassVar[type[Any]] = VehicleParameters
    SAFE_STATE: ClassVar[tuple[Command, ...]] = (STOP,)
    SAFE_SUSPENDED: ClassVar[tuple[Command, ...]] = SAFE_STATE
    FAULTS: ClassVar[tuple[str, ...]] = ("range", "wheels")

    def __init__(self, config: RobotConfig, world: Surroundings) -> None:
        p: VehicleParameters = config.parameters
        self.name, self.type = config.name, config.type
        self.node = node = world.middleware.node("robot", config.name)
        self.drive = drive = Drive(world.space, Pose(*config.at, config.heading), p)
        self.body, self.outline = drive.body, drive.outline
        self._odometer = Odometer(node, p.odom, world.random(config.name, "odom"))
        self._ultrasonic = Ultrasonic(
            node, p.range, world.random(config.name, "range"), world.space, drive.filter, p.length / 2
        )
        self._odom_every, self._range_every = period(p.odom.rate, world.step), period(p.range.rate, world.step)
        self._map, self._map_publisher = world.map, node.publisher("map", "nav_msgs/msg/OccupancyGrid", LATCHED)
        self._planner_node = world.middleware.node("planner", config.name)
        self._planner = Planner(self._planner_node, p.planner, drive.radius)
        node.subscription("cmd_vel", "geometry_msgs/msg/Twist", lambda twist: drive.command(twist, world.scheduler.now))

    @property
    def pose(self) -> Pose:
        return self.drive.pose

    @property
    def look(self) -> Look:
        pose = self.pose
        return Look(pose, cone=self._ultrasonic.cone(pose))

    @property
    def status(self) -> Mapping[str, Any]:
        return {}

    def start(self) -> None:
        self._map_publisher.publish(self._map)

    def move(self, now: int, duration: float) -> None:
        self.drive.move(now, duration)

    def sense(self, now: int, count: int) -> None:
        odom, range_ = not count % self._odom_every, not count % self._range_every
        if not (odom or range_):
            return
        pose = self.pose
        if odom:
            self._odometer.measure(now, pose, self.drive.motion)
        if range_:
            self._ultrasonic.measure(now, pose)

    def fault(self, kind: str) -> None:
        check_fault(self.name, self.type, kind, self.FAULTS)
        if kind == "range":
            self._ultrasonic.fails = True
        else:
            self.drive.blocked = True

    def close(self) -> None:
        self._planner_node.close()
        self.node.close()


def check_fault(name: str, type: str, kind: str, known: tuple[str, ...]) -> None:
    """Raise ConfigError if a robot has no such fault."""
    if kind not in known:
        raise ConfigError(f"found the fault {kind!r} for {name}, a {type}; {suggestion(kind, known)}")
