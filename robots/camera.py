"""A camera that looks straight down and finds weeds: where they are, but not which.

It sees a circle of the ground, as large as it is high: radius = altitude * tan(field of view / 2). It misses some of
what is in it, anew in each picture, and places the others a little wrongly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fame.config.parameters import parameter
from fame.middleware import messages
from fame.middleware.interface import Node
from robots.robot import MEASUREMENT, Pose
from robots.template import constructor, header_maker, maker

if TYPE_CHECKING:
    import numpy as np

    from sim2d.weeds import Weeds

POSES = "geometry_msgs/msg/PoseArray"


@dataclass(frozen=True, slots=True)
class CameraParameters:
    """`missed` is the part of the weeds in sight that a picture misses; `noise` a standard deviation (m)."""

    rate: float = parameter(5.0, "Hz", above=0)
    field_of_view: float = parameter(90.0, "deg", above=0, maximum=170)
    noise: float = parameter(0.05, "m", minimum=0)
    missed: float = parameter(0.1, "", minimum=0, maximum=1)


class Camera:
    """Publishes `camera/weeds`: positions in the frame of the robot's body (x ahead, y left, z up), until it fails."""

    def __init__(self, node: Node, parameters: CameraParameters, random: np.random.Generator, weeds: Weeds) -> None:
        self.fails = False
        self._parameters, self._random, self._weeds = parameters, random, weeds
        self._opening = math.tan(math.radians(parameters.field_of_view) / 2)
        self._publisher = node.publisher("camera/weeds", POSES, MEASUREMENT)
        self._header, self._make = header_maker(f"{node.namespace}/base_link"), constructor(POSES)
        pose = messages.create("geometry_msgs/msg/Pose", {"orientation": {"w": 1.0}})
        self._pose, self._point = maker(pose, "position"), type(pose.position)

    def radius(self, altitude: float) -> float:
        """Of the ground in sight (m)."""
        return 0.0 if self.fails else altitude * self._opening

    def measure(self, now: int, pose: Pose, altitude: float) -> None:
        """Publish what is seen from a pose at an altitude (m). All that is in sight draws chance, seen or not."""
        if self.fails:
            return
        p, cos, sin = self._parameters, math.cos(pose.heading), math.sin(pose.heading)
        poses = []
        for weed in self._weeds.near(pose[:2], self.radius(altitude)):
            found, (dx, dy) = self._random.random() >= p.missed, self._random.standard_normal(2).tolist()
            x, y = weed.at[0] - pose.x, weed.at[1] - pose.y
            if found:
                ahead, left = x * cos + y * sin + p.noise * dx, y * cos - x * sin + p.noise * dy
                poses.append(self._pose(position=self._point(ahead, left, -altitude)))
        self._publisher.publish(self._make(self._header(now), poses))
