"""Ground vehicles: a differential drive on tyres, odometry, an ultrasonic sensor at the nose, the map, a path planner.

All vehicles subscribe to `cmd_vel` (while a person steers, to `cmd_vel_manual`: `robots.twist_mux`) and publish `odom`,
`range` and, once, `map`. Their planner answers `goal_pose` with `plan`. With `navigation: nav2` the action servers of
Nav2 replace the planner.

car      a small vehicle with an LED, set by `led`
tractor  a field robot with a blade under it, set by `blade_force`, and a battery, published as `battery_state`. With an
         empty battery it brakes and its blade stops
carrier  a warehouse robot with a battery and a tray: its services `load` and `unload` move parcels

In each step the motors ask for a change of speed, the tyres oppose sideways slip, and the ground gives at most friction
times gravity for both together (Kamm's circle). Hence the braking distance is v²/(2 µ g), and a vehicle that is hit
slides. Without a command for `watchdog` seconds it brakes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from fame.clock import SECOND
from fame.config.values import Point, parameter
from fame.dataclasses import dataclass, field
from fame.errors import ConfigError
from fame.middleware.interface import LATCHED, AnyMessage
from fame.text import suggestion
from robots.equipment import DRAIN_RATE, Battery, BatteryParameters, Blade, BladeParameters, Led, Tray, TrayParameters
from robots.nav2 import Nav2
from robots.navigation import Dock, Limits
from robots.planner import Planner, PlannerParameters
from robots.sensors import STILL, Motion, Odometer, OdometerParameters, Ultrasonic, UltrasonicParameters
from robots.twist_mux import DEAD_MAN, TwistMux
from sim2d.robot import Appearance, Cone, Pose, TopicCommand, body_of, period, rectangle

if TYPE_CHECKING:
    import pymunk

    from sim2d.robot import RobotConfig, RobotWorld


GRAVITY = 9.81
"""m/s²."""
FRICTION: Mapping[str, float] = {"rubber": 0.43, "smooth": 0.12, "grass": 0.35}
"""Friction of tyres on ground, by name. The first two brake at 4.2 and 1.2 m/s², like the real and the simulated car of
the FAME paper (section 5.4)."""
TYRES = f"µ of the tyres: a number, {', '.join(f'`{name}` ({value})' for name, value in FRICTION.items())}"
"""What the parameter `friction` is."""
_SLIP = 1e-9
"""Smaller changes of speed (m/s) are rounding errors and need no force, unless the vehicle has to stop exactly."""


@dataclass(frozen=True, slots=True)
class DriveParameters:
    """A vehicle's size (m), mass (kg), limits and tyres."""

    length: float = parameter(0.25, "m", above=0, maximum=20)
    width: float = parameter(0.18, "m", above=0, maximum=20)
    mass: float = parameter(2.0, "kg", above=0)
    max_speed: float = parameter(1.0, "m/s", above=0)
    max_turn_rate: float = parameter(2.0, "rad/s", above=0)
    acceleration: float = parameter(2.0, "m/s²", above=0)
    turn_acceleration: float = parameter(10.0, "rad/s²", above=0)
    friction: float = parameter(FRICTION["rubber"], TYRES, above=0, names=FRICTION)
    watchdog: float = parameter(1.0, "s without a command until it brakes; 0: never", minimum=0)
    manual_speed: float = parameter(0.5, "m/s, at most while a person steers", above=0)


class Drive:
    """A driven body. `speed` and `turn_rate` are the latest command, within the limits; `blocked` wheels ignore it."""

    def __init__(self, space: pymunk.Space, start: Pose, parameters: DriveParameters) -> None:
        length, width = parameters.length, parameters.width
        self.outline: tuple[Point, ...] = rectangle(length, width)
        self.radius = math.hypot(length, width) / 2
        self.body, shape = body_of(space, start, self.outline, parameters.mass)
        self.filter = shape.filter
        self.speed = self.turn_rate = 0.0
        self.blocked = False
        self._parameters = parameters
        self._grip = parameters.friction * GRAVITY
        self._valid_until = 0.0  # ns
        self._pose: Pose | None = None  # since the last step, as far as it was asked for

    @property
    def pose(self) -> Pose:
        """The true pose of the body, which moves in steps only: `move` is called before each."""
        if self._pose is None:
            x, y = self.body.position
            self._pose = Pose(x, y, self.body.angle)
        return self._pose

    @property
    def motion(self) -> Motion:
        """Forward speed and turn rate. Wheels do not measure sideways slip."""
        body = self.body
        if body.is_sleeping:
            return STILL
        (vx, vy), (cos, sin) = body.velocity, body.rotation_vector
        return Motion(ahead=vx * cos + vy * sin, turn_rate=body.angular_velocity)

    def command(self, twist: AnyMessage, now: int, *, by_hand: bool = False) -> None:
        """Obey `linear.x` and `angular.z` of a geometry_msgs/msg/Twist, clipped to the limits; NaN stops."""
        limits = self._parameters
        self.speed = within(twist.linear.x, min(limits.max_speed, limits.manual_speed) if by_hand else limits.max_speed)
        self.turn_rate = within(twist.angular.z, limits.max_turn_rate)
        self._valid_until = end_of(now, DEAD_MAN if by_hand else limits.watchdog)

    def move(self, now: int, duration: float) -> None:
        """Apply the forces of motors and tyres for a step of `duration` s."""
        limits, body = self._parameters, self.body
        self._pose = None
        if self.blocked or now > self._valid_until:
            self.speed = self.turn_rate = 0.0
        if self.speed == 0 and self.turn_rate == 0 and body.is_sleeping:
            return
        vx, vy = body.velocity
        cos, sin = body.rotation_vector
        ahead, sideways = vx * cos + vy * sin, vy * cos - vx * sin
        gains = abs(self.speed) > abs(ahead) and self.speed * ahead >= 0
        wanted = towards(ahead, self.speed, (limits.acceleration if gains else self._grip) * duration)
        along, across = wanted - ahead, -sideways
        change = math.hypot(along, across)
        if change > (_SLIP if self.speed or self.turn_rate else 0.0):
            # Forces, not a new velocity: a body pushed against a wall must not creep into it.
            push = body.mass / duration * min(1.0, self._grip * duration / change)
            along, across = along * push, across * push
            body.force = along * cos - across * sin, along * sin + across * cos
        turning = body.angular_velocity
        if turning != self.turn_rate:
            wanted = towards(turning, self.turn_rate, limits.turn_acceleration * duration)
            body.torque = (wanted - turning) * body.moment / duration


def end_of(now: int, seconds: float) -> float:
    """When (ns) a command given `now` (ns) is no longer valid; never if it is for 0 s."""
    return now + seconds * SECOND if seconds else math.inf


def within(value: float, limit: float) -> float:
    """Clip a commanded value to ± `limit`; NaN and infinity give 0."""
    return min(max(float(value), -limit), limit) if math.isfinite(value) else 0.0


def towards(value: float, goal: float, change: float) -> float:
    """Move a value towards a goal by at most `change`."""
    return min(value + change, goal) if goal > value else max(value - change, goal)


STOP = TopicCommand("cmd_vel", "geometry_msgs/msg/Twist", {})


@dataclass(frozen=True, slots=True)
class VehicleParameters(DriveParameters):
    """The parameters of a ground vehicle in a world file."""

    odom: OdometerParameters = field(default=OdometerParameters())
    range: UltrasonicParameters = field(default=UltrasonicParameters())
    planner: PlannerParameters = field(default=PlannerParameters())
    navigation: str = parameter(
        "planner", "or `nav2`: its actions replace `goal_pose` and `plan`", known=("planner", "nav2")
    )


class Vehicle:
    """A `sim2d.robot.SimulatedRobot` that drives; subclasses add equipment."""

    Parameters: ClassVar[type[Any]] = VehicleParameters
    SAFE_STATE: ClassVar[tuple[TopicCommand, ...]] = (STOP,)
    SAFE_SUSPENDED: ClassVar[tuple[TopicCommand, ...]] = SAFE_STATE
    FAULTS: ClassVar[tuple[str, ...]] = ("range", "wheels")
    altitude: ClassVar[float] = 0.0

    def __init__(self, config: RobotConfig, world: RobotWorld) -> None:
        p: VehicleParameters = config.parameters
        self.name, self.type = config.name, config.type
        self.node = node = world.middleware.node("robot", config.name)
        self.drive = drive = Drive(world.space, Pose(*config.at, config.heading), p)
        self.body, self.outline = drive.body, drive.outline
        self._odometer = Odometer(node, p.odom, world.random(config.name, "odom"), world.middleware.warn)
        self._ultrasonic = Ultrasonic(
            node, p.range, world.random(config.name, "range"), world.space, drive.filter, p.length / 2
        )
        self._odom_every, self._range_every = period(p.odom.rate, world.step), period(p.range.rate, world.step)
        self._map, self._map_publisher = world.map, node.publisher("map", "nav_msgs/msg/OccupancyGrid", LATCHED)
        self._navigation_node = world.middleware.node(p.navigation, config.name)
        if p.navigation == "nav2":
            self._nav2 = self._make_nav2(p, world)
        else:
            self._planner = Planner(self._navigation_node, p.planner, drive.radius)
        TwistMux(node, world.scheduler, drive)

    def _make_nav2(self, p: VehicleParameters, world: RobotWorld) -> Nav2:
        limits = Limits(p.max_speed, p.max_turn_rate, p.acceleration / 2, self.drive.radius, p.length / 2)
        docks = {name: Dock(*pose) for name, pose in world.docks.items()}
        has_battery = hasattr(p, "battery")
        return Nav2(self._navigation_node, world.scheduler, p.planner, limits, docks, battery=has_battery)

    @property
    def pose(self) -> Pose:
        return self.drive.pose

    @property
    def appearance(self) -> Appearance:
        return Appearance(self.pose, cone=self._cone())

    def _cone(self) -> Cone | None:
        """What its range sensor saw last."""
        return self._ultrasonic.cone(self.pose)

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
        self._navigation_node.close()
        self.node.close()


def check_fault(name: str, type: str, kind: str, known: tuple[str, ...]) -> None:
    """Raise ConfigError for an unknown kind of fault."""
    if kind not in known:
        raise ConfigError(f"unknown fault {kind!r} of {name}, a {type}; {suggestion(kind, known)}")


class Car(Vehicle):
    """A robot of type ``car``."""

    def __init__(self, config: RobotConfig, world: RobotWorld) -> None:
        super().__init__(config, world)
        self._led = Led(self.node)

    @property
    def appearance(self) -> Appearance:
        return Appearance(self.pose, led=self._led.colour, cone=self._cone())

    @property
    def status(self) -> Mapping[str, Any]:
        return {"led": self._led.colour}


class BatteryVehicle(Vehicle):
    """A vehicle with a battery: when it is empty, the vehicle stops. `works`: whether its equipment needs power."""

    works = False

    def __init__(self, config: RobotConfig, world: RobotWorld) -> None:
        super().__init__(config, world)
        p = config.parameters.battery
        self._battery, self._charging = Battery(self.node, p), world.charging
        self._measure, self._drain = period(p.rate, world.step), period(DRAIN_RATE, world.step)
        self._drain_time = self._drain * world.step

    @property
    def status(self) -> Mapping[str, Any]:
        return {"battery": round(self._battery.charge, 4)}

    def sense(self, now: int, count: int) -> None:
        super().sense(now, count)
        if count and count % self._drain == 0:
            gained = self._charging((self.pose.x, self.pose.y))
            self._battery.drain(self._drain_time, self.drive.motion.ahead, self.works, gained)
            if self._battery.empty:
                self.drive.blocked = True
                self.stop_working()
        if count % self._measure == 0:
            self._battery.measure(now)

    def stop_working(self) -> None:
        """Stop the equipment permanently: the battery is empty."""


@dataclass(frozen=True, slots=True)
class TractorParameters(VehicleParameters):
    """The parameters of a tractor in a world file."""

    length: float = parameter(0.6, "m", above=0, maximum=20)
    width: float = parameter(0.4, "m", above=0, maximum=20)
    mass: float = parameter(30.0, "kg", above=0)
    max_turn_rate: float = parameter(1.5, "rad/s", above=0)
    acceleration: float = parameter(1.0, "m/s²", above=0)
    turn_acceleration: float = parameter(5.0, "rad/s²", above=0)
    friction: float = parameter(FRICTION["grass"], TYRES, above=0, names=FRICTION)
    range: UltrasonicParameters = field(default=UltrasonicParameters(max=3.0))
    planner: PlannerParameters = field(default=PlannerParameters(margin=0.1, tolerance=0.25))
    blade: BladeParameters = field(default=BladeParameters())
    battery: BatteryParameters = field(default=BatteryParameters())


class Tractor(BatteryVehicle):
    """A robot of type ``tractor``."""

    Parameters: ClassVar[type[Any]] = TractorParameters
    SAFE_STATE: ClassVar[tuple[TopicCommand, ...]] = (STOP, TopicCommand("blade_force", "geometry_msgs/msg/Wrench", {}))
    SAFE_SUSPENDED: ClassVar[tuple[TopicCommand, ...]] = SAFE_STATE

    def __init__(self, config: RobotConfig, world: RobotWorld) -> None:
        super().__init__(config, world)
        self._blade = Blade(self.node, config.parameters.blade, config.name, world.weeds)

    @property
    def works(self) -> bool:  # type: ignore[override]
        return self._blade.turns

    @property
    def appearance(self) -> Appearance:
        blade = self._blade.radius if self._blade.turns else 0.0
        return Appearance(self.pose, cone=self._cone(), blade=blade, charge=self._battery.charge)

    @property
    def status(self) -> Mapping[str, Any]:
        return {**super().status, "blade": self._blade.turns}

    def sense(self, now: int, count: int) -> None:
        if self._blade.turns:
            self._blade.cut(now, self.pose)
        super().sense(now, count)

    def stop_working(self) -> None:
        self._blade.blocked = True
        self._blade.turn(False)


@dataclass(frozen=True, slots=True)
class CarrierParameters(VehicleParameters):
    """The parameters of a carrier in a world file."""

    length: float = parameter(0.5, "m", above=0, maximum=20)
    width: float = parameter(0.4, "m", above=0, maximum=20)
    mass: float = parameter(40.0, "kg", above=0)
    max_turn_rate: float = parameter(1.5, "rad/s", above=0)
    acceleration: float = parameter(1.0, "m/s²", above=0)
    turn_acceleration: float = parameter(5.0, "rad/s²", above=0)
    planner: PlannerParameters = field(default=PlannerParameters(margin=0.1, tolerance=0.25))
    tray: TrayParameters = field(default=TrayParameters())
    battery: BatteryParameters = field(default=BatteryParameters(work=0.0))


class Carrier(BatteryVehicle):
    """A robot of type ``carrier``."""

    Parameters: ClassVar[type[Any]] = CarrierParameters

    def __init__(self, config: RobotConfig, world: RobotWorld) -> None:
        super().__init__(config, world)
        self._tray = Tray(self.node, config.parameters.tray, config.name, world.parcels, lambda: self.pose[:2])

    @property
    def appearance(self) -> Appearance:
        has_cargo = self._tray.parcel is not None
        return Appearance(self.pose, cone=self._cone(), cargo=has_cargo, charge=self._battery.charge)

    @property
    def status(self) -> Mapping[str, Any]:
        return {**super().status, "parcel": self._tray.parcel.name if self._tray.parcel is not None else ""}
