"""The car: a small differential-drive vehicle with an ultrasonic sensor at its nose and an LED.

Obeys `cmd_vel` and `led`, publishes `odom`, `range` and, once for all, `map`; its planner answers `goal_pose` with
`plan`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

from fame.middleware import messages
from fame.middleware.interface import LATCHED
from robots.drive import Drive, DriveParameters
from robots.led import Led
from robots.odometer import Odometer, OdometerParameters
from robots.planner import Planner, PlannerParameters
from robots.robot import Command, Cone, Pose
from robots.ultrasonic import Ultrasonic, UltrasonicParameters

if TYPE_CHECKING:
    from robots.robot import Surroundings
    from sim2d.config import RobotConfig


@dataclass(frozen=True, slots=True)
class CarParameters(DriveParameters):
    """What a world file may say of a car."""

    odom: OdometerParameters = field(default=OdometerParameters())
    range: UltrasonicParameters = field(default=UltrasonicParameters())
    planner: PlannerParameters = field(default=PlannerParameters())


class Car:
    """A robot of type ``car`` (`robots.robot.Robot`)."""

    Parameters: ClassVar[type[Any]] = CarParameters
    SAFE_STATE: ClassVar[tuple[Command, ...]] = (Command("cmd_vel", "geometry_msgs/msg/Twist", {}),)

    def __init__(self, config: RobotConfig, world: Surroundings) -> None:
        p: CarParameters = config.parameters
        self.name, self.type = config.name, config.type
        self._node = node = world.middleware.node("robot", config.name)
        self._drive = drive = Drive(world.space, Pose(*config.at, config.heading), p)
        self.body, self.outline = drive.body, drive.outline
        self._led = Led(node)
        self._odometer = Odometer(node, p.odom, world.random(config.name, "odom"))
        self._ultrasonic = Ultrasonic(
            node, p.range, world.random(config.name, "range"), world.space, drive.filter, p.length / 2
        )
        self._every = _every(p.odom.rate, world.step), _every(p.range.rate, world.step)
        self._map, self._grid = node.publisher("map", "nav_msgs/msg/OccupancyGrid", LATCHED), world.grid
        self._planner_node = world.middleware.node("planner", config.name)
        self._planner = Planner(self._planner_node, p.planner, drive.radius)
        node.subscription("cmd_vel", "geometry_msgs/msg/Twist", lambda twist: drive.command(twist, world.scheduler.now))

    @property
    def pose(self) -> Pose:
        return self._drive.pose

    @property
    def led(self) -> str:
        return self._led.colour

    @property
    def cone(self) -> Cone:
        return self._ultrasonic.cone(self.pose)

    def start(self) -> None:
        self._map.publish(messages.create("nav_msgs/msg/OccupancyGrid", self._grid.fields()))

    def move(self, now: int, duration: float) -> None:
        self._drive.move(now, duration)

    def sense(self, now: int, count: int) -> None:
        odom, range_ = self._every
        if count % odom == 0:
            self._odometer.measure(now, self._drive.pose, self._drive.twist)
        if count % range_ == 0:
            self._ultrasonic.measure(now, self._drive.pose)

    def close(self) -> None:
        self._planner_node.close()
        self._node.close()


def _every(rate: float, step: float) -> int:
    """How many steps of the world make one period: the whole number nearest to it."""
    return max(1, math.floor(1 / (rate * step) + 0.5))
