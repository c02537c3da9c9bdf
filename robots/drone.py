"""The drone: a quadrotor that finds weeds with a camera that looks down.

Obeys `takeoff`, `land` (topics, and commands of its service `tello_action`) and `cmd_vel`, publishes `odom`,
`camera/weeds` while it flies, and `battery_state`. With an empty battery it lands. Its planner answers `goal_pose` with
a `plan`, the straight line: it flies over everything. Where the sourced ROS does not have the type of the service, the
drone is there without it, and the middleware warns.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

from fame.errors import MissingTypeError
from robots.equipment import DRAIN_RATE, Battery, BatteryParameters
from robots.flight import Flight, FlightParameters
from robots.odometer import Odometer, OdometerParameters
from robots.planner import DirectPlanner
from robots.sensors import Camera, CameraParameters
from robots.vehicles import STOP, check_fault
from sim2d.robot import Appearance, Pose, TopicCommand, period

if TYPE_CHECKING:
    from fame.middleware.interface import Message
    from sim2d.robot import RobotConfig, RobotWorld


UNKNOWN, OK, NOT_CONNECTED, BUSY = 0, 1, 2, 3
"""What tello_msgs/srv/TelloAction answers: begun; rotors that turn no more; taking off or landing already; and 0, which
the real one does not have, for a command that there is not."""


@dataclass(frozen=True, slots=True)
class DroneParameters(FlightParameters):
    """What a world file may say of a drone."""

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
        self._odometer = Odometer(node, p.odom, world.random(config.name, "odom"), flies=True)
        self._camera = Camera(node, p.camera, world.random(config.name, "camera"), world.weeds)
        self._battery, self._charging = Battery(node, p.battery), world.charging
        self._every = tuple(period(rate, world.step) for rate in (p.odom.rate, p.camera.rate, p.battery.rate))
        self._drain = period(DRAIN_RATE, world.step)
        self._drain_time = self._drain * world.step
        self._planner_node = world.middleware.node("planner", config.name)
        self._planner = DirectPlanner(self._planner_node)
        node.subscription(
            "cmd_vel", "geometry_msgs/msg/Twist", lambda twist: flight.command(twist, world.scheduler.now)
        )
        node.subscription("takeoff", "std_msgs/msg/Empty", lambda _: flight.take_off())
        node.subscription("land", "std_msgs/msg/Empty", lambda _: flight.land())
        try:
            node.service("tello_action", "tello_msgs/srv/TelloAction", self._act)
        except MissingTypeError as error:  # topics do the same
            world.middleware.warn(f"{config.name} offers no service tello_action: {error}")

    def _act(self, request: Message) -> Mapping[str, int]:
        """A command of a Tello, begun but not yet done when the response comes."""
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
    def appearance(self) -> Appearance:
        altitude = self._flight.altitude
        return Appearance(self.pose, altitude, footprint=self._camera.radius(altitude), charge=self._battery.charge)

    @property
    def status(self) -> Mapping[str, Any]:
        return {
            "battery": round(self._battery.charge, 4),
            "altitude": round(self._flight.altitude, 4),
            "landed": not self._flight.airborne,
        }

    def start(self) -> None:
        """Nothing is said once."""

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
        """`camera` says nothing more; `rotors` are weak: it lands where it is and does not start again."""
        check_fault(self.name, self.type, kind, self.FAULTS)
        if kind == "camera":
            self._camera.fails = True
        else:
            self._flight.dead = True

    def close(self) -> None:
        self._planner_node.close()
        self._node.close()
