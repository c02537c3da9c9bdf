"""The drone: a quadrotor that finds weeds with a camera that looks down.

It subscribes to `takeoff`, `land` (also commands of its service `tello_action`) and `cmd_vel`, and publishes `odom`,
`battery_state` and, while it flies, `camera/weeds`. With an empty battery it lands. Its planner answers `goal_pose`
with a `plan` that is a straight line, because it flies over everything. If the sourced ROS lacks the type of the
service, the drone runs without the service and the middleware warns.

The rotors have a limited acceleration, horizontally and vertically, so the braking distance is v²/(2 a). On the ground
the motors are off. `takeoff` starts them and the drone climbs to its take-off height; from then on it obeys `cmd_vel`
between `floor` and `ceiling`; `land` lets it sink to the ground and stops the motors. Without a command for `watchdog`
seconds it hovers. Above `CLEAR` it collides with nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from fame.config.values import Point, parameter
from fame.dataclasses import dataclass, field
from fame.errors import MissingTypeError
from fame.middleware.interface import AnyMessage, EndpointWarning
from robots.equipment import DRAIN_RATE, Battery, BatteryParameters
from robots.planner import DirectPlanner
from robots.sensors import Camera, CameraParameters, Motion, Odometer, OdometerParameters
from robots.twist_mux import DEAD_MAN, TwistMux
from robots.vehicles import GRAVITY, STOP, check_fault, end_of, towards, within
from sim2d.robot import Appearance, Pose, TopicCommand, body_of, period, rectangle

if TYPE_CHECKING:
    import pymunk

    from sim2d.robot import RobotConfig, RobotWorld


CLEAR = 0.3
"""Above this height (m) a drone flies over everything, and no sensor on the ground sees it."""
_SKIDS = 0.5
"""Friction of its skids on the ground."""

Phase = Literal["landed", "taking off", "flying", "landing"]


@dataclass(frozen=True, slots=True)
class FlightParameters:
    """A drone's size (m), mass (kg) and limits."""

    length: float = parameter(0.4, "m", above=0, maximum=20)
    width: float = parameter(0.4, "m", above=0, maximum=20)
    mass: float = parameter(1.5, "kg", above=0)
    max_speed: float = parameter(2.0, "m/s", above=0)
    max_climb: float = parameter(1.0, "m/s", above=0)
    max_turn_rate: float = parameter(1.5, "rad/s", above=0)
    acceleration: float = parameter(2.0, "m/s², also for braking", above=0)
    climb_acceleration: float = parameter(2.0, "m/s², also for braking", above=0)
    turn_acceleration: float = parameter(6.0, "rad/s²", above=0)
    height: float = parameter(1.5, "m, altitude after take-off, at most the ceiling", minimum=0.5)
    floor: float = parameter(0.5, "m, lowest altitude for commands", minimum=CLEAR, up_to="ceiling")
    ceiling: float = parameter(10.0, "m, highest altitude for commands", minimum=0.5)
    watchdog: float = parameter(1.0, "s without a command until it hovers; 0: never", minimum=0)
    manual_speed: float = parameter(0.5, "m/s, at most while a person steers", above=0)


class Flight:
    """A flying body. `altitude` is in m, `climb` in m/s; with `dead` rotors it lands and does not start again."""

    def __init__(self, space: pymunk.Space, start: Pose, parameters: FlightParameters) -> None:
        import pymunk

        p = self._parameters = parameters
        self.outline: tuple[Point, ...] = rectangle(p.length, p.width)
        self.body, self._shape = body_of(space, start, self.outline, p.mass)
        self._solid, self._clear = self._shape.filter, pymunk.ShapeFilter(mask=0)
        self.phase: Phase = "landed"
        self.altitude = self.climb = 0.0
        self.dead = self._is_clear = False
        self._ahead = self._left = self._up = self._turn_rate = 0.0
        self._valid_until = 0.0  # ns

    @property
    def airborne(self) -> bool:
        return self.phase != "landed"

    @property
    def pose(self) -> Pose:
        x, y = self.body.position
        return Pose(x, y, self.body.angle)

    @property
    def motion(self) -> Motion:
        body = self.body
        if body.is_sleeping:  # the physics engine knows nothing of height
            return Motion(up=self.climb)
        (vx, vy), (cos, sin) = body.velocity, body.rotation_vector
        return Motion(vx * cos + vy * sin, vy * cos - vx * sin, self.climb, body.angular_velocity)

    def command(self, twist: AnyMessage, now: int, *, by_hand: bool = False) -> None:
        """Obey a geometry_msgs/msg/Twist in the body frame, clipped to the limits; NaN stops."""
        p = self._parameters
        ahead, left = within(twist.linear.x, math.inf), within(twist.linear.y, math.inf)
        fastest = min(p.max_speed, p.manual_speed) if by_hand else p.max_speed
        share = min(1.0, fastest / (math.hypot(ahead, left) or 1.0))
        self._ahead, self._left = ahead * share, left * share
        self._up = within(twist.linear.z, min(p.max_climb, fastest))
        self._turn_rate = within(twist.angular.z, p.max_turn_rate)
        self._valid_until = end_of(now, DEAD_MAN if by_hand else p.watchdog)

    def take_off(self) -> None:
        """Start the motors and climb; no effect in flight."""
        if self.phase != "flying" and not self.dead:
            self.phase = "taking off"

    def land(self) -> None:
        """Sink, and stop the motors on the ground; no effect on the ground."""
        if self.airborne:
            self.phase = "landing"

    def move(self, now: int, duration: float) -> None:
        """Apply the forces of the rotors for a step of `duration` s."""
        p, body = self._parameters, self.body
        if self.dead:
            self.land()
        if self.phase == "landed":
            if not body.is_sleeping:
                self._push(0.0, 0.0, 0.0, _SKIDS * GRAVITY, duration)
            return
        if self.phase != "flying" or now > self._valid_until:
            self._ahead = self._left = self._up = self._turn_rate = 0.0
        cos, sin = body.rotation_vector
        wanted = self._ahead * cos - self._left * sin, self._ahead * sin + self._left * cos
        self._push(*wanted, self._turn_rate, p.acceleration, duration)
        self._rise(duration)

    def _push(self, vx: float, vy: float, turn_rate: float, acceleration: float, duration: float) -> None:
        """Push the body towards a velocity in the world frame (m/s, rad/s), with a limited acceleration (m/s²)."""
        body = self.body
        now_x, now_y = body.velocity
        x, y = vx - now_x, vy - now_y
        change = math.hypot(x, y)
        if change > 0:
            push = body.mass / duration * min(1.0, acceleration * duration / change)
            body.force = x * push, y * push
        turning = body.angular_velocity
        if turning != turn_rate:
            following = towards(turning, turn_rate, self._parameters.turn_acceleration * duration)
            body.torque = (following - turning) * body.moment / duration

    def _rise(self, duration: float) -> None:
        p = self._parameters
        if self.phase == "flying":
            wanted = max(self._arriving(p.floor), min(self._up, self._arriving(p.ceiling)))
        else:
            wanted = self._arriving(min(p.height, p.ceiling) if self.phase == "taking off" else 0.0)
        self.climb = towards(self.climb, wanted, p.climb_acceleration * duration)
        self.altitude = max(0.0, self.altitude + self.climb * duration)
        self._arrive()
        if (self.altitude > CLEAR) != self._is_clear:
            self._is_clear = not self._is_clear
            self._shape.filter = self._clear if self._is_clear else self._solid

    def _arriving(self, height: float) -> float:
        """The climb rate (m/s) that reaches a height without overshoot: half of the acceleration is for braking."""
        p, left = self._parameters, height - self.altitude
        speed = min(p.max_climb, math.sqrt(p.climb_acceleration * abs(left)), 5 * abs(left))
        return math.copysign(speed, left)

    def _arrive(self) -> None:
        p = self._parameters
        if self.phase == "taking off" and abs(min(p.height, p.ceiling) - self.altitude) < 0.02:
            self.phase = "flying"
        elif self.phase == "landing" and self.altitude < 0.01:
            self.phase, self.altitude, self.climb = "landed", 0.0, 0.0


UNKNOWN, OK, NOT_CONNECTED, BUSY = 0, 1, 2, 3
"""Return codes of tello_msgs/srv/TelloAction: 1 started, 2 the rotors are dead, 3 already taking off or landing; 0,
which the real drone does not have, for an unknown command."""


@dataclass(frozen=True, slots=True)
class DroneParameters(FlightParameters):
    """The parameters of a drone in a world file."""

    odom: OdometerParameters = field(
        default=OdometerParameters(position_noise=0.02, heading_noise=0.01, speed_noise=0.02)
    )
    camera: CameraParameters = field(default=CameraParameters())
    battery: BatteryParameters = field(
        default=BatteryParameters(capacity=60.0, voltage=14.8, idle=3.0, motion=10.0, work=120.0)
    )


class Drone:
    """A robot of type ``drone`` (`sim2d.robot.SimulatedRobot`)."""

    Parameters: ClassVar[type[Any]] = DroneParameters
    SAFE_STATE: ClassVar[tuple[TopicCommand, ...]] = (STOP, TopicCommand("land", "std_msgs/msg/Empty", {}))
    SAFE_SUSPENDED: ClassVar[tuple[TopicCommand, ...]] = (STOP,)
    FAULTS: ClassVar[tuple[str, ...]] = ("camera", "rotors")

    def __init__(self, config: RobotConfig, world: RobotWorld) -> None:
        p: DroneParameters = config.parameters
        self.name, self.type = config.name, config.type
        self._node = node = world.middleware.node("robot", config.name)
        self._flight = flight = Flight(world.space, Pose(*config.at, config.heading), p)
        self.body, self.outline = flight.body, flight.outline
        self._odometer = Odometer(node, p.odom, world.random(config.name, "odom"), world.middleware.warn, flies=True)
        self._camera = Camera(node, p.camera, world.random(config.name, "camera"), world.weeds)
        self._battery, self._charging = Battery(node, p.battery), world.charging
        self._every = tuple(period(rate, world.step) for rate in (p.odom.rate, p.camera.rate, p.battery.rate))
        self._drain = period(DRAIN_RATE, world.step)
        self._drain_time = self._drain * world.step
        self._planner_node = world.middleware.node("planner", config.name)
        self._planner = DirectPlanner(self._planner_node)
        TwistMux(node, world.scheduler, flight)
        node.subscription("takeoff", "std_msgs/msg/Empty", lambda _: flight.take_off())
        node.subscription("land", "std_msgs/msg/Empty", lambda _: flight.land())
        try:
            node.service("tello_action", "tello_msgs/srv/TelloAction", self._act)
        except MissingTypeError as error:  # topics of unknown types are left out with a warning too
            text = f"{config.name} offers no service tello_action: {error}"
            world.middleware.warn(EndpointWarning("", text, "backend"))

    def _act(self, request: AnyMessage) -> Mapping[str, int]:
        """Start a command of a Tello; the response does not wait until it is done."""
        flight, command = self._flight, request.cmd.strip().lower()
        if command not in ("takeoff", "land"):
            return {"rc": UNKNOWN}
        if flight.dead:
            return {"rc": NOT_CONNECTED}
        if flight.phase in ("taking off", "landing"):
            return {"rc": BUSY}
        if command == "takeoff":
            flight.take_off()
        else:
            flight.land()
        return {"rc": OK}

    @property
    def pose(self) -> Pose:
        return self._flight.pose

    @property
    def altitude(self) -> float:
        """How high it is above the ground, m."""
        return self._flight.altitude

    @property
    def appearance(self) -> Appearance:
        altitude = self.altitude
        return Appearance(self.pose, altitude, footprint=self._camera.radius(altitude), charge=self._battery.charge)

    @property
    def status(self) -> Mapping[str, Any]:
        return {
            "battery": round(self._battery.charge, 4),
            "altitude": round(self._flight.altitude, 4),
            "landed": not self._flight.airborne,
        }

    def start(self) -> None:
        """Do nothing: a drone has no latched topics."""

    def move(self, now: int, duration: float) -> None:
        self._flight.move(now, duration)

    def sense(self, now: int, count: int) -> None:
        odom, camera, battery = self._every
        flight = self._flight
        if count % odom == 0:
            self._odometer.measure(now, flight.pose, flight.motion, flight.altitude)
        if count and count % self._drain == 0:
            gained = 0.0 if flight.airborne else self._charging((flight.pose.x, flight.pose.y))
            self._battery.drain(self._drain_time, math.hypot(*flight.motion[:3]), flight.airborne, gained)
            flight.dead |= self._battery.empty
        if flight.airborne and count % camera == 0:
            self._camera.measure(now, flight.pose, flight.altitude)
        if count % battery == 0:
            self._battery.measure(now)

    def fault(self, kind: str) -> None:
        """`camera`: it stops publishing. `rotors`: the drone lands where it is and does not start again."""
        check_fault(self.name, self.type, kind, self.FAULTS)
        if kind == "camera":
            self._camera.fails = True
        else:
            self._flight.dead = True

    def close(self) -> None:
        self._planner_node.close()
        self._node.close()
