"""Odometry: where a robot believes it is.

The error of the pose wanders slowly but does not grow: a first-order Gauss-Markov process about the truth, as a
robot has that corrects its odometry by landmarks. So the pose is given in the frame of the map.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

from fame.config.parameters import parameter
from fame.middleware import messages
from fame.middleware.interface import Message, Node
from robots.sensors import header_maker
from sim2d.randomness import Noise
from sim2d.robot import MEASUREMENT, Pose

if TYPE_CHECKING:
    import numpy as np

ODOMETRY = "nav_msgs/msg/Odometry"
Deviations = tuple[float, float, float, float]
"""Of x, y, z and yaw, or of their rates."""
Place = tuple[float, float, float]
"""m."""
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
        sigma = p.position_noise, p.position_noise, p.position_noise * aloft, p.heading_noise
        self._speed_sigma = p.speed_noise, p.speed_noise * aloft, p.speed_noise * aloft, p.speed_noise
        self._keep = math.exp(-1 / (p.rate * _CORRELATION))
        fresh = math.sqrt(1 - self._keep**2)
        self._fresh = tuple(fresh * deviation for deviation in sigma)
        self._error = [deviation * draw for deviation, draw in zip(sigma, self._noise.row(), strict=False)]
        self._publisher = node.publisher("odom", ODOMETRY, MEASUREMENT)
        self._frame = f"{node.namespace}/base_link"
        self._make, self._header = _maker(sigma, self._speed_sigma), header_maker("map")

    def measure(self, now: int, pose: Pose, motion: Motion, altitude: float = 0.0) -> None:
        """Publish a measurement of the true pose, altitude (m) and motion."""
        draws, keep = self._noise.row(), self._keep
        self._error = [
            keep * error + fresh * draw for error, fresh, draw in zip(self._error, self._fresh, draws, strict=False)
        ]
        measured = [true + sigma * draw for true, sigma, draw in zip(motion, self._speed_sigma, draws[4:], strict=True)]
        dx, dy, dz, turn = self._error
        place = pose.x + dx, pose.y + dy, altitude + dz
        self._publisher.publish(self._make(self._header(now), self._frame, place, pose.heading + turn, measured))


@cache
def _maker(
    sigma: Deviations, speed_sigma: Deviations
) -> Callable[[Message, str, Place, float, Sequence[float]], Message]:
    """Makes messages of their types themselves, fields in the order of ROS: nothing is published more often.

    All robots that measure equally well share the maker, which so stays in the processor's cache.
    """
    covariances = {"pose": {"covariance": _covariance(sigma)}, "twist": {"covariance": _covariance(speed_sigma)}}
    like = messages.create(ODOMETRY, covariances)
    sure_of_pose, sure_of_twist = like.pose.covariance, like.twist.covariance
    odometry: Any = type(like)
    pose_of, twist_of = type(like.pose), type(like.twist)
    pose, twist, point = type(like.pose.pose), type(like.twist.twist), type(like.pose.pose.position)
    quaternion, vector = type(like.pose.pose.orientation), type(like.twist.twist.linear)

    def make(header: Message, frame: str, place: Place, heading: float, motion: Sequence[float]) -> Message:
        ahead, left, up, turn_rate = motion
        orientation = quaternion(0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2))
        velocity = twist(vector(ahead, left, up), vector(0.0, 0.0, turn_rate))
        return odometry(
            header,
            frame,
            pose_of(pose(point(*place), orientation), sure_of_pose),
            twist_of(velocity, sure_of_twist),
        )

    return make


def _covariance(sigma: Deviations) -> list[float]:
    """The 6 x 6 matrix of x, y, z, roll, pitch, yaw, row by row."""
    x, y, z, yaw = sigma
    diagonal = [x**2, y**2, z**2, 0.0, 0.0, yaw**2]
    return [diagonal[row] if row == column else 0.0 for row in range(6) for column in range(6)]
