"""Differential drive on tyres: turns `cmd_vel` into the motion of a body, within what motors and friction allow.

In each step the motors ask for a change of speed, the tyres want to undo any sideways slip, and the ground gives no
more than friction times gravity for both together (Kamm's circle). So a vehicle takes v²/(2 µ g) to brake, slides
when it is hit, and never freezes. Without a command for `watchdog` seconds it brakes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fame.clock import SECOND
from fame.config.parameters import parameter
from fame.config.values import Point
from fame.middleware.interface import Message
from robots.odometer import STILL, Motion
from sim2d.robot import Pose, body_of, rectangle

if TYPE_CHECKING:
    import pymunk

GRAVITY = 9.81
"""m/s²."""
FRICTION: Mapping[str, float] = {"rubber": 0.43, "smooth": 0.12, "grass": 0.35}
"""Tyres on ground, by name. The first two brake at 4.2 and 1.2 m/s², as the real and the simulated car of the FAME
paper (section 5.4) do."""
_SLIP = 1e-9
"""m/s that need no push: rounding, as long as the vehicle is not to stand still to the last digit."""


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
    friction: float = parameter(FRICTION["rubber"], "", above=0, names=FRICTION)
    watchdog: float = parameter(1.0, "s, 0 for none", minimum=0)


class Drive:
    """A driven body. `speed` and `turn_rate` are the latest command, within the limits; `blocked` wheels obey none."""

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
        self._valid_until = 0

    @property
    def pose(self) -> Pose:
        """Where the body is."""
        x, y = self.body.position
        return Pose(x, y, self.body.angle)

    @property
    def motion(self) -> Motion:
        """How it moves ahead and turns. What slips sideways is not measured by wheels."""
        body = self.body
        if body.is_sleeping:
            return STILL
        (vx, vy), (cos, sin) = body.velocity, body.rotation_vector
        return Motion(ahead=vx * cos + vy * sin, turn_rate=body.angular_velocity)

    def command(self, twist: Message, now: int) -> None:
        """Obey a geometry_msgs/msg/Twist: `linear.x` and `angular.z`, cut to the limits; NaN is a stop."""
        limits = self._parameters
        self.speed = within(twist.linear.x, limits.max_speed)
        self.turn_rate = within(twist.angular.z, limits.max_turn_rate)
        self._valid_until = now + round(limits.watchdog * SECOND)

    def move(self, now: int, duration: float) -> None:
        """Push the body as motors and tyres can, for a step of `duration` s."""
        limits, body = self._parameters, self.body
        if self.blocked or (limits.watchdog and now > self._valid_until):
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
            # As forces, not as a new velocity: a body that is pushed against a wall must not creep into it.
            push = body.mass / duration * min(1.0, self._grip * duration / change)
            along, across = along * push, across * push
            body.force = along * cos - across * sin, along * sin + across * cos
        turning = body.angular_velocity
        if turning != self.turn_rate:
            wanted = towards(turning, self.turn_rate, limits.turn_acceleration * duration)
            body.torque = (wanted - turning) * body.moment / duration


def within(value: float, limit: float) -> float:
    """A commanded value, cut to a limit on either side; 0 if it is no number."""
    return min(max(float(value), -limit), limit) if math.isfinite(value) else 0.0


def towards(value: float, goal: float, change: float) -> float:
    """The value, nearer to a goal by `change` at most."""
    return min(value + change, goal) if goal > value else max(value - change, goal)
