"""Odometry: where a robot believes it is.

The error of the pose wanders slowly but does not grow: a first-order Gauss-Markov process about the truth, as a
robot has that corrects its odometry by landmarks. So the pose is given in the frame of the map.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

from fame.middleware import messages
from fame.middleware.interface import Message, Node
from robots.noise import Noise
from robots.robot import MEASUREMENT, Pose
from robots.template import header_maker
from sim2d.reading import parameter

if TYPE_CHECKING:
    import numpy as np

ODOMETRY = "nav_msgs/msg/Odometry"
Deviations = tuple[float, float, float, float]
"""Of x, y, z and yaw, or of their rates."""
_CORRELATION = 5.0
"""Seconds after which the error has forgotten two thirds of what it was."""


class Motion(NamedTuple):
    """How a robot moves in its own frame: m/s ahead, to the left and up; rad/s counter-clockwise."""

    ahead: float = 0.0
    left: float = 0.0
    up: float = 0.0
    turn_rate: float = 0.0


STILL = Motion()


@dataclass(frozen=True, slots=True)
class OdometerParameters:
    """`position_noise` (m), `heading_noise` (rad), `speed_noise` (m/s, rad/s) are standard deviations."""

    rate: float = parameter(20.0, "Hz", above=0)
    position_noise: float = parameter(0.005, "m", minimum=0)
    heading_noise: float = parameter(0.003, "rad", minimum=0)
    speed_noise: float = parameter(0.005, "m/s and rad/s", minimum=0)


class Odometer:
    """Publishes `odom` in the frame `map`. Of a robot that `flies` also height, climb and sideways speed are noisy."""

    def __init__(
        self, node: Node, parameters: OdometerParameters, random: np.random.Generator, *, flies: bool = False
    ) -> None:
        p, aloft = parameters, float(flies)
        self._noise = Noise(random, 8)
        self._sigma = p.position_noise, p.position_noise, p.position_noise * aloft, p.heading_noise
        self._speed_sigma = p.speed_noise, p.speed_noise * aloft, p.speed_noise * aloft, p.speed_noise
        self._keep = math.exp(-1 / (p.rate * _CORRELATION))
        fresh = math.sqrt(1 - self._keep**2)
        self._fresh = tuple(fresh * sigma for sigma in self._sigma)
        self._error = [sigma * draw for sigma, draw in zip(self._sigma, self._noise.row(), strict=False)]
        self._publisher = node.publisher("odom", ODOMETRY, MEASUREMENT)
        self._frame = f"{node.namespace}/base_link"
        self._template, self._header = _template(self._sigma, self._speed_sigma)

    def measure(self, now: int, pose: Pose, motion: Motion, altitude: float = 0.0) -> None:
        """Publish a measurement of the true pose, altitude (m) and motion."""
        draws, keep = self._noise.row(), self._keep
        self._error = [
            keep * error + fresh * draw for error, fresh, draw in zip(self._error, self._fresh, draws, strict=False)
        ]
        dx, dy, dz, turn = self._error
        where = pose.x + dx, pose.y + dy, altitude + dz, pose.heading + turn
        ahead, left, up, turn_rate = (
            true + sigma * draw for true, sigma, draw in zip(motion, self._speed_sigma, draws[4:], strict=True)
        )
        self._publisher.publish(self._message(now, where, Motion(ahead, left, up, turn_rate)))

    def _message(self, now: int, where: tuple[float, float, float, float], motion: Motion) -> Message:
        """Made of the types themselves, their fields in the order of ROS: nothing is published more often."""
        t, (x, y, z, heading) = self._template, where
        pose, twist = t.pose.pose, t.twist.twist
        orientation = type(pose.orientation)(0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2))
        linear = type(twist.linear)(motion.ahead, motion.left, motion.up)
        return type(t)(
            self._header(now),
            self._frame,
            type(t.pose)(type(pose)(type(pose.position)(x, y, z), orientation), t.pose.covariance),
            type(t.twist)(type(twist)(linear, type(twist.angular)(0.0, 0.0, motion.turn_rate)), t.twist.covariance),
        )


@cache
def _template(sigma: Deviations, speed_sigma: Deviations) -> tuple[Message, Callable[[int], Message]]:
    """What all robots share that measure equally well, and so stays in the processor's cache: a message, its header."""
    fields = {
        "pose": {"covariance": _covariance(sigma)},
        "twist": {"covariance": _covariance(speed_sigma)},
    }
    template = messages.create(ODOMETRY, fields)
    return template, header_maker("map")


def _covariance(sigma: Deviations) -> list[float]:
    """The 6 x 6 matrix of x, y, z, roll, pitch, yaw, row by row."""
    x, y, z, yaw = sigma
    diagonal = [x**2, y**2, z**2, 0.0, 0.0, yaw**2]
    return [diagonal[row] if row == column else 0.0 for row in range(6) for column in range(6)]
