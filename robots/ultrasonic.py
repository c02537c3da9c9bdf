"""An ultrasonic range sensor: the distance of the nearest solid thing within a cone, and nothing about its direction.

Follows REP 117: what is farther than `max` reads +inf, what is nearer than `min` reads -inf. It sees obstacles,
targets, walls and other robots alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fame.middleware import messages
from fame.middleware.interface import Message, Node
from robots.robot import MEASUREMENT, Cone, Pose
from robots.stamp import stamped
from sim2d.reading import parameter

if TYPE_CHECKING:
    import numpy as np
    import pymunk

RANGE = "sensor_msgs/msg/Range"
_RECESS = 0.02
"""Rays begin this far (m) behind the sensor's face: a ray that begins inside a thing that is touched would miss it."""


@dataclass(frozen=True, slots=True)
class UltrasonicParameters:
    """`min` and `max` are the range (m), `field_of_view` the whole opening (deg), `noise` a standard deviation (m)."""

    rate: float = parameter(20.0, "Hz", above=0)
    noise: float = parameter(0.01, "m", minimum=0)
    min: float = parameter(0.02, "m", minimum=0)
    max: float = parameter(2.0, "m", above=0)
    field_of_view: float = parameter(30.0, "deg", above=0, maximum=180)
    rays: int = parameter(9, "", minimum=2)


class Ultrasonic:
    """Publishes `range`. Mounted `ahead` m in front of the middle of its vehicle."""

    def __init__(
        self,
        node: Node,
        parameters: UltrasonicParameters,
        random: np.random.Generator,
        space: pymunk.Space,
        ignored: pymunk.ShapeFilter,
        ahead: float,
    ) -> None:
        p = parameters
        self.field_of_view = math.radians(p.field_of_view)
        self._parameters, self._random, self._space, self._ignored, self._ahead = p, random, space, ignored, ahead
        self._rays = [self.field_of_view * (ray / (p.rays - 1) - 0.5) for ray in range(p.rays)]
        self._publisher = node.publisher("range", RANGE, MEASUREMENT)
        self._distance = p.max
        self._template: Message = messages.create(
            RANGE,
            {
                "header": {"frame_id": f"{node.namespace}/range"},
                "radiation_type": 0,
                "field_of_view": self.field_of_view,
                "min_range": p.min,
                "max_range": p.max,
                "variance": p.noise**2,
            },
        )

    def measure(self, now: int, pose: Pose) -> None:
        """Publish a measurement from a vehicle at `pose`."""
        self._distance = self.distance(pose)
        measured = self._distance + self._parameters.noise * self._random.standard_normal()
        if measured > self._parameters.max:
            measured = math.inf
        elif measured < self._parameters.min:
            measured = -math.inf
        self._publisher.publish(stamped(self._template, now, range=float(measured)))

    def distance(self, pose: Pose) -> float:
        """The true distance (m) of the nearest thing on any ray; infinite if there is none within the range."""
        length = _RECESS + self._parameters.max + 4 * self._parameters.noise
        x, y = self._at(pose, self._ahead - _RECESS)
        nearest = math.inf
        for angle in self._rays:
            end = x + length * math.cos(pose.heading + angle), y + length * math.sin(pose.heading + angle)
            hit = self._space.segment_query_first((x, y), end, 0, self._ignored)
            if hit is not None and hit.alpha < nearest:
                nearest = hit.alpha
        return nearest * length - _RECESS

    def cone(self, pose: Pose) -> Cone:
        """What the last measurement found free."""
        at = Pose(*self._at(pose, self._ahead), pose.heading)
        return Cone(at, self.field_of_view, min(max(self._distance, 0.0), self._parameters.max))

    def _at(self, pose: Pose, ahead: float) -> tuple[float, float]:
        return pose.x + ahead * math.cos(pose.heading), pose.y + ahead * math.sin(pose.heading)
