"""Flight of a quadrotor: turns `cmd_vel`, `takeoff` and `land` into the motion of a body and its altitude.

The rotors give no more than a certain acceleration, level and upright, so it flies on for v²/(2 a) when it brakes. On
the ground the motors are off. `takeoff` starts them and it climbs by itself; from then on it obeys `cmd_vel`, but
never sinks below `floor` nor climbs above `ceiling`; `land` lets it sink by itself until it stands, and stops the
motors. Without a command for `watchdog` seconds it hovers. Higher than `CLEAR` it meets nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from fame.clock import SECOND
from fame.config.parameters import parameter
from fame.config.values import Point
from fame.middleware.interface import Message
from robots.drive import GRAVITY, towards, within
from robots.odometer import Motion
from sim2d.robot import Pose, body_of, rectangle

if TYPE_CHECKING:
    import pymunk

CLEAR = 0.3
"""m above the ground from which on a drone flies over everything, and no sensor on the ground sees it."""
_SKIDS = 0.5
"""The friction of its skids on the ground."""

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
    acceleration: float = parameter(2.0, "m/s²", above=0)
    climb_acceleration: float = parameter(2.0, "m/s²", above=0)
    turn_acceleration: float = parameter(6.0, "rad/s²", above=0)
    height: float = parameter(1.5, "m, of the take-off", minimum=0.5)
    floor: float = parameter(0.5, "m", minimum=CLEAR, up_to="ceiling")
    ceiling: float = parameter(10.0, "m", minimum=0.5)
    watchdog: float = parameter(1.0, "s, 0 for none", minimum=0)


class Flight:
    """A flying body. `altitude` in m, `climb` in m/s; `dead` rotors start no more, and bring it down if it flies."""

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
        self._valid_until = 0

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
        if body.is_sleeping:  # it knows nothing of height
            return Motion(up=self.climb)
        (vx, vy), (cos, sin) = body.velocity, body.rotation_vector
        return Motion(vx * cos + vy * sin, vy * cos - vx * sin, self.climb, body.angular_velocity)

    def command(self, twist: Message, now: int) -> None:
        """Obey a geometry_msgs/msg/Twist in the frame of the body, cut to the limits; NaN is a stop."""
        p = self._parameters
        ahead, left = within(twist.linear.x, math.inf), within(twist.linear.y, math.inf)
        share = min(1.0, p.max_speed / (math.hypot(ahead, left) or 1.0))
        self._ahead, self._left = ahead * share, left * share
        self._up = within(twist.linear.z, p.max_climb)
        self._turn_rate = within(twist.angular.z, p.max_turn_rate)
        self._valid_until = now + round(p.watchdog * SECOND)

    def take_off(self) -> None:
        """Start the motors and climb; nothing if it flies already."""
        if self.phase != "flying" and not self.dead:
            self.phase = "taking off"

    def land(self) -> None:
        """Sink, and stop the motors on the ground; nothing if it stands."""
        if self.airborne:
            self.phase = "landing"

    def move(self, now: int, duration: float) -> None:
        """Push the body as the rotors can, for a step of `duration` s."""
        p, body = self._parameters, self.body
        if self.dead:
            self.land()
        if self.phase == "landed":
            if not body.is_sleeping:
                self._push(0.0, 0.0, 0.0, _SKIDS * GRAVITY, duration)
            return
        if self.phase != "flying" or (p.watchdog and now > self._valid_until):
            self._ahead = self._left = self._up = self._turn_rate = 0.0
        cos, sin = body.rotation_vector
        wanted = self._ahead * cos - self._left * sin, self._ahead * sin + self._left * cos
        self._push(*wanted, self._turn_rate, p.acceleration, duration)
        self._rise(duration)

    def _push(self, vx: float, vy: float, turn_rate: float, acceleration: float, duration: float) -> None:
        """Force the body towards a velocity in the world (m/s, rad/s), with an acceleration of at most so much."""
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
        """The climb (m/s) with which a height is reached and not passed: half of the acceleration brakes."""
        p, left = self._parameters, height - self.altitude
        speed = min(p.max_climb, math.sqrt(p.climb_acceleration * abs(left)), 5 * abs(left))
        return math.copysign(speed, left)

    def _arrive(self) -> None:
        p = self._parameters
        if self.phase == "taking off" and abs(min(p.height, p.ceiling) - self.altitude) < 0.02:
            self.phase = "flying"
        elif self.phase == "landing" and self.altitude < 0.01:
            self.phase, self.altitude, self.climb = "landed", 0.0, 0.0
