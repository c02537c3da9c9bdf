"""Odometry: where a vehicle believes it is.

The error of the pose wanders slowly but does not grow: a first-order Gauss-Markov process about the truth, as a
vehicle has that corrects its odometry by landmarks. So the pose is given in the frame of the map.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from fame.middleware import messages
from fame.middleware.interface import Message, Node
from robots.robot import MEASUREMENT, Pose
from robots.stamp import stamped
from sim2d.reading import parameter

if TYPE_CHECKING:
    import numpy as np

ODOMETRY = "nav_msgs/msg/Odometry"
_CORRELATION = 5.0
"""Seconds after which the error has forgotten two thirds of what it was."""


@dataclass(frozen=True, slots=True)
class OdometerParameters:
    """`position_noise` (m), `heading_noise` (rad), `speed_noise` (m/s, rad/s) are standard deviations."""

    rate: float = parameter(20.0, "Hz", above=0)
    position_noise: float = parameter(0.005, "m", minimum=0)
    heading_noise: float = parameter(0.003, "rad", minimum=0)
    speed_noise: float = parameter(0.005, "m/s and rad/s", minimum=0)


class Odometer:
    """Publishes `odom` in the frame `map`."""

    def __init__(self, node: Node, parameters: OdometerParameters, random: np.random.Generator) -> None:
        p = parameters
        self._publisher = node.publisher("odom", ODOMETRY, MEASUREMENT)
        self._random = random
        self._sigma = p.position_noise, p.position_noise, p.heading_noise
        self._speed_noise = p.speed_noise
        self._error = tuple(sigma * random.standard_normal() for sigma in self._sigma)
        self._keep = math.exp(-1 / (p.rate * _CORRELATION))
        self._template: Message = messages.create(
            ODOMETRY,
            {
                "header": {"frame_id": "map"},
                "child_frame_id": f"{node.namespace}/base_link",
                "pose": {"covariance": _covariance(p.position_noise, p.heading_noise)},
                "twist": {"covariance": _covariance(p.speed_noise, p.speed_noise)},
            },
        )

    def measure(self, now: int, pose: Pose, twist: tuple[float, float]) -> None:
        """Publish a measurement of the true pose and twist (m/s ahead, rad/s)."""
        keep, fresh, normal = self._keep, math.sqrt(1 - self._keep**2), self._random.standard_normal(5).tolist()
        self._error = tuple(
            keep * error + fresh * sigma * draw
            for error, sigma, draw in zip(self._error, self._sigma, normal[:3], strict=True)
        )
        dx, dy, turn = self._error
        heading = pose.heading + turn
        t = self._template
        where = replace(
            t.pose.pose,
            position=replace(t.pose.pose.position, x=pose.x + dx, y=pose.y + dy),
            orientation=replace(t.pose.pose.orientation, z=math.sin(heading / 2), w=math.cos(heading / 2)),
        )
        speed, turn_rate = (true + self._speed_noise * draw for true, draw in zip(twist, normal[3:], strict=True))
        motion = replace(
            t.twist.twist,
            linear=replace(t.twist.twist.linear, x=speed),
            angular=replace(t.twist.twist.angular, z=turn_rate),
        )
        self._publisher.publish(stamped(t, now, pose=replace(t.pose, pose=where), twist=replace(t.twist, twist=motion)))


def _covariance(position: float, heading: float) -> list[float]:
    """The 6 x 6 matrix of x, y, z, roll, pitch, yaw, row by row."""
    diagonal = [position**2, position**2, 0.0, 0.0, 0.0, heading**2]
    return [diagonal[row] if row == column else 0.0 for row in range(6) for column in range(6)]
