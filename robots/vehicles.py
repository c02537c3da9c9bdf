"""Ground vehicles: a drive, odometry, an ultrasonic sensor at the nose, the map, and a path planner.

All obey `cmd_vel`, publish `odom`, `range` and, once, `map`; their planner answers `goal_pose` with `plan`.

car      small, with an LED: obeys `led` too
tractor  a field robot with a blade under it and a battery: obeys `blade_force`, publishes `battery_state`. With an
         empty battery it brakes and its blade stands still
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

from fame.config.parameters import parameter
from fame.errors import ConfigError
from fame.middleware.interface import LATCHED
from fame.text import suggestion
from robots.drive import FRICTION, Drive, DriveParameters
from robots.equipment import DRAIN_RATE, Battery, BatteryParameters, Blade, BladeParameters, Led
from robots.odometer import Odometer, OdometerParameters
from robots.planner import Planner, PlannerParameters
from robots.sensors import Ultrasonic, UltrasonicParameters
from sim2d.robot import Appearance, Pose, TopicCommand, period

if TYPE_CHECKING:
    from sim2d.robot import RobotConfig, RobotWorld


STOP = TopicCommand("cmd_vel", "geometry_msgs/msg/Twist", {})


@dataclass(frozen=True, slots=True)
class VehicleParameters(DriveParameters):
    """What a world file may say of a ground vehicle."""

    odom: OdometerParameters = field(default=OdometerParameters())
    range: UltrasonicParameters = field(default=UltrasonicParameters())
    planner: PlannerParameters = field(default=PlannerParameters())


class Vehicle:
    """A `sim2d.robot.SimulatedRobot` that drives; types add what else they have."""

    Parameters: ClassVar[type[Any]] = VehicleParameters
    SAFE_STATE: ClassVar[tuple[TopicCommand, ...]] = (STOP,)
    SAFE_SUSPENDED: ClassVar[tuple[TopicCommand, ...]] = SAFE_STATE
    FAULTS: ClassVar[tuple[str, ...]] = ("range", "wheels")

    def __init__(self, config: RobotConfig, world: RobotWorld) -> None:
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
    def appearance(self) -> Appearance:
        pose = self.pose
        return Appearance(pose, cone=self._ultrasonic.cone(pose))

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
        raise ConfigError(f"unknown fault {kind!r} of {name}, a {type}; {suggestion(kind, known)}")


class Car(Vehicle):
    """A robot of type ``car``."""

    def __init__(self, config: RobotConfig, world: RobotWorld) -> None:
        super().__init__(config, world)
        self._led = Led(self.node)

    @property
    def appearance(self) -> Appearance:
        return super().appearance._replace(led=self._led.colour)

    @property
    def status(self) -> Mapping[str, Any]:
        return {"led": self._led.colour}


@dataclass(frozen=True, slots=True)
class TractorParameters(VehicleParameters):
    """What a world file may say of a tractor."""

    length: float = parameter(0.6, "m", above=0, maximum=20)
    width: float = parameter(0.4, "m", above=0, maximum=20)
    mass: float = parameter(30.0, "kg", above=0)
    max_turn_rate: float = parameter(1.5, "rad/s", above=0)
    acceleration: float = parameter(1.0, "m/s²", above=0)
    turn_acceleration: float = parameter(5.0, "rad/s²", above=0)
    friction: float = parameter(FRICTION["grass"], "", above=0, names=FRICTION)
    range: UltrasonicParameters = field(default=UltrasonicParameters(max=3.0))
    planner: PlannerParameters = field(default=PlannerParameters(margin=0.1, tolerance=0.25))
    blade: BladeParameters = field(default=BladeParameters())
    battery: BatteryParameters = field(default=BatteryParameters())


class Tractor(Vehicle):
    """A robot of type ``tractor``."""

    Parameters: ClassVar[type[Any]] = TractorParameters
    SAFE_STATE: ClassVar[tuple[TopicCommand, ...]] = (STOP, TopicCommand("blade_force", "geometry_msgs/msg/Wrench", {}))
    SAFE_SUSPENDED: ClassVar[tuple[TopicCommand, ...]] = SAFE_STATE

    def __init__(self, config: RobotConfig, world: RobotWorld) -> None:
        super().__init__(config, world)
        p: TractorParameters = config.parameters
        self._blade = Blade(self.node, p.blade, config.name, world.weeds)
        self._battery, self._charging = Battery(self.node, p.battery), world.charging
        self._tell, self._drain = period(p.battery.rate, world.step), period(DRAIN_RATE, world.step)
        self._drain_time = self._drain * world.step

    @property
    def appearance(self) -> Appearance:
        blade = self._blade.radius if self._blade.turns else 0.0
        return super().appearance._replace(blade=blade, charge=self._battery.charge)

    @property
    def status(self) -> Mapping[str, Any]:
        return {"battery": round(self._battery.charge, 4), "blade": self._blade.turns}

    def sense(self, now: int, count: int) -> None:
        super().sense(now, count)
        if self._blade.turns:
            self._blade.cut(now, self.pose)
        if count and count % self._drain == 0:
            gained = self._charging((self.pose.x, self.pose.y))
            self._battery.drain(self._drain_time, self.drive.motion.ahead, self._blade.turns, gained)
            if self._battery.empty:
                self.drive.blocked = self._blade.blocked = True
                self._blade.turn(False)
        if count % self._tell == 0:
            self._battery.measure(now)
