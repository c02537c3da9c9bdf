"""Sensors that look at the world: an ultrasonic range sensor, and a camera that finds weeds.

The range sensor gives the distance of the nearest solid thing within a cone, not its direction. It follows REP 117:
what is farther than `max` reads +inf, what is nearer than `min` reads -inf. It sees obstacles, targets, walls and other
robots alike, but nothing that flies.

The camera looks straight down at a circle of the ground: radius = altitude * tan(field of view / 2). It finds where
weeds are, not which. It misses some of them, anew in each picture, and places the others a little wrongly.

All sensors share `maker` and `header_maker`: messages that are mostly alike are made from a template, many times
cheaper than from a mapping. It is the most frequent thing that a world does. A sensor that `fails`
publishes nothing more.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND
from fame.config.parameters import parameter
from fame.middleware import messages
from fame.middleware.interface import Message, Node
from sim2d.randomness import Noise
from sim2d.robot import MEASUREMENT, Cone, Pose

if TYPE_CHECKING:
    import numpy as np
    import pymunk

    from sim2d.ground import Weeds


def constructor(type: str) -> Callable[..., Message]:
    """The class of a message type: it takes fields in the order of ROS, and neither converts nor checks."""
    kind: Any = messages.message_type(type)
    return kind  # type: ignore[no-any-return]


def maker(template: Message, *fields: str) -> Callable[..., Message]:
    """The constructor of messages like `template` but for these `fields`, which it takes by name."""
    kept = {name: getattr(template, name) for name in template.__slots__ if name not in fields}
    return partial(template.__class__, **kept)


@cache
def header_maker(frame: str) -> Callable[[int], Message]:
    """A function of a time (ns) that gives a std_msgs/msg/Header with this stamp and frame."""
    header, time = constructor("std_msgs/msg/Header"), constructor("builtin_interfaces/msg/Time")
    return lambda now: header(time(now // SECOND, now % SECOND), frame)


RANGE = "sensor_msgs/msg/Range"
_RECESS = 0.02
"""Rays begin this far (m) behind the sensor's face: a ray that begins inside a thing that is touched would miss it."""


@dataclass(frozen=True, slots=True)
class UltrasonicParameters:
    """`min` and `max` are the range (m), `field_of_view` the whole opening (deg), `noise` a standard deviation (m)."""

    rate: float = parameter(20.0, "Hz", above=0)
    noise: float = parameter(0.01, "m", minimum=0)
    min: float = parameter(0.02, "m", minimum=0, up_to="max")
    max: float = parameter(2.0, "m", above=0)
    field_of_view: float = parameter(30.0, "deg", above=0, maximum=180)
    rays: int = parameter(9, "", minimum=2, maximum=1000)


class Ultrasonic:
    """Publishes `range` until it `fails`. Mounted `ahead` m in front of the middle of its vehicle."""

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
        self.fails = False
        self.field_of_view = math.radians(p.field_of_view)
        self._parameters, self._noise, self._space, self._ignored = p, Noise(random, 1), space, ignored
        self._ahead, self._length = ahead, _RECESS + p.max + 4 * p.noise
        angles = (self.field_of_view * (ray / (p.rays - 1) - 0.5) for ray in range(p.rays))
        self._rays = [(self._length * math.cos(angle), self._length * math.sin(angle)) for angle in angles]
        # All rays lie in this circle about a point on their axis: if nothing else is in it, none needs to be followed.
        half, length = self.field_of_view / 2, self._length
        narrow = half <= math.pi / 4
        self._reach = length / (2 * math.cos(half)) if narrow else length * math.sin(half)
        self._middle = self._reach if narrow else length * math.cos(half)
        self._publisher = node.publisher("range", RANGE, MEASUREMENT)
        self._distance = math.inf
        self._make, self._header = _maker(p), header_maker(f"{node.namespace}/range")

    def measure(self, now: int, pose: Pose) -> None:
        """Publish a measurement from a vehicle at `pose`."""
        if self.fails:
            return
        self._distance = self.distance(pose)
        measured = self._distance + self._parameters.noise * self._noise.row()[0]
        if measured > self._parameters.max:
            measured = math.inf
        elif measured < self._parameters.min:
            measured = -math.inf
        self._publisher.publish(self._make(header=self._header(now), range=measured))

    def distance(self, pose: Pose) -> float:
        """The true distance (m) of the nearest thing on any ray; infinite if there is none within the range."""
        place = pose.ahead(self._ahead - _RECESS)
        middle = pose.ahead(self._ahead - _RECESS + self._middle)
        if self._space.point_query_nearest(middle, self._reach, self._ignored) is None:
            return math.inf
        (x, y), nearest = place, math.inf
        cos, sin = math.cos(pose.heading), math.sin(pose.heading)
        for ahead, left in self._rays:
            end = x + ahead * cos - left * sin, y + ahead * sin + left * cos
            hit = self._space.segment_query_first(place, end, 0, self._ignored)
            if hit is not None and hit.alpha < nearest:
                nearest = hit.alpha
        return nearest * self._length - _RECESS

    def cone(self, pose: Pose) -> Cone | None:
        """What the last measurement found free; None if the sensor fails."""
        if self.fails:
            return None
        at = Pose(*pose.ahead(self._ahead), pose.heading)
        return Cone(at, self.field_of_view, min(max(self._distance, 0.0), self._parameters.max))


@cache
def _maker(parameters: UltrasonicParameters) -> Callable[..., Message]:
    """The constructor of a measurement of sensors with these parameters, from `header` and `range`."""
    fields = {
        "radiation_type": 0,
        "field_of_view": math.radians(parameters.field_of_view),
        "min_range": parameters.min,
        "max_range": parameters.max,
        "variance": parameters.noise**2,
    }
    return maker(messages.create(RANGE, fields), "header", "range")


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
