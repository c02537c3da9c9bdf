"""Sensors: an ultrasonic range sensor, a camera that finds weeds, and odometry.

The range sensor measures the distance of the nearest solid thing within a cone, not its direction. It follows REP 117:
farther than `max` reads +inf, nearer than `min` reads -inf. It sees obstacles, targets, walls and other robots, but
nothing that flies.

The camera looks straight down at a circle of the ground: radius = altitude * tan(field of view / 2). It reports the
positions of weeds, not their identities. In each picture it misses some at random and adds noise to the others.

The pose error of odometry wanders slowly but does not grow: a first-order Gauss-Markov process about the truth, like
that of a robot that corrects its odometry by landmarks. Therefore the pose is given in the frame of the map.

Publishing measurements is the most frequent operation of a world. Messages are therefore made from templates by `maker`
and `header_maker`, which is many times cheaper than from a mapping. A sensor that `fails` stops publishing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple

from fame.clock import SECOND
from fame.config.values import parameter
from fame.dataclasses import dataclass
from fame.errors import MissingTypeError
from fame.middleware import messages
from fame.middleware.interface import AnyMessage, EndpointWarning, Node, Publisher
from sim2d.randomness import Noise
from sim2d.robot import MEASUREMENT, Cone, Pose

if TYPE_CHECKING:
    import numpy as np
    import pymunk

    from sim2d.ground import Weeds


@cache
def message_class(type: str) -> Callable[..., AnyMessage]:
    """Return the class of a message type: it takes fields by name or in the order of ROS, without conversion or checks.

    Raises MessageError for an unknown type.
    """
    kind: Any = messages.message_type(type)
    return kind  # type: ignore[no-any-return]


def maker(template: AnyMessage, *fields: str) -> Callable[..., AnyMessage]:
    """Return a constructor of messages like `template`; it takes the given `fields` by name."""
    kept = {name: getattr(template, name) for name in template.__slots__ if name not in fields}
    return partial(template.__class__, **kept)


@cache
def header_maker(frame: str) -> Callable[[int], AnyMessage]:
    """Return a function that makes a std_msgs/msg/Header with this frame from a time (ns)."""
    header, time = message_class("std_msgs/msg/Header"), message_class("builtin_interfaces/msg/Time")
    return lambda now: header(time(now // SECOND, now % SECOND), frame)


RANGE = "sensor_msgs/msg/Range"
_RECESS = 0.02
"""Rays begin this far (m) behind the sensor's face: a ray that begins inside a touched obstacle would miss it."""


@dataclass(frozen=True, slots=True)
class UltrasonicParameters:
    """`min` and `max` are the range (m), `field_of_view` the whole opening (deg), `noise` a standard deviation (m)."""

    rate: float = parameter(20.0, "Hz", above=0)
    noise: float = parameter(0.01, "m, standard deviation", minimum=0)
    min: float = parameter(0.02, "m; less is -inf", minimum=0, up_to="max")
    max: float = parameter(2.0, "m; more is +inf", above=0)
    field_of_view: float = parameter(30.0, "deg", above=0, maximum=180)
    rays: int = parameter(9, "in the field of view", minimum=2, maximum=1000)


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
        # This circle about a point on the axis contains all rays: if it is empty, no ray needs to be followed.
        half, length = self.field_of_view / 2, self._length
        narrow = half <= math.pi / 4
        self._reach = length / (2 * math.cos(half)) if narrow else length * math.sin(half)
        self._middle = self._reach if narrow else length * math.cos(half)
        self._publisher = node.publisher("range", RANGE, MEASUREMENT)
        self._distance = math.inf
        self._make, self._header = _range_maker(p), header_maker(f"{node.namespace}/range")

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
        """Return the true distance (m) of the nearest thing on any ray; infinite if nothing is within the range."""
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
        """Return the area that the last measurement found free; None if the sensor fails."""
        if self.fails:
            return None
        at = Pose(*pose.ahead(self._ahead), pose.heading)
        return Cone(at, self.field_of_view, min(max(self._distance, 0.0), self._parameters.max))


@cache
def _range_maker(parameters: UltrasonicParameters) -> Callable[..., AnyMessage]:
    """Return the constructor of range messages of such sensors; it takes `header` and `range`."""
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
    """`missed` is the share of visible weeds that a picture misses; `noise` is a standard deviation (m)."""

    rate: float = parameter(5.0, "Hz", above=0)
    field_of_view: float = parameter(90.0, "deg", above=0, maximum=170)
    noise: float = parameter(0.05, "m, standard deviation", minimum=0)
    missed: float = parameter(0.1, "probability that an image misses a weed", minimum=0, maximum=1)


class Camera:
    """Publishes `camera/weeds` until it `fails`: positions in the robot's body frame (x forward, y left, z up)."""

    def __init__(self, node: Node, parameters: CameraParameters, random: np.random.Generator, weeds: Weeds) -> None:
        self.fails = False
        self._parameters, self._random, self._weeds = parameters, random, weeds
        self._opening = math.tan(math.radians(parameters.field_of_view) / 2)
        self._publisher = node.publisher("camera/weeds", POSES, MEASUREMENT)
        self._header, self._make = header_maker(f"{node.namespace}/base_link"), message_class(POSES)
        pose = messages.create("geometry_msgs/msg/Pose", {"orientation": {"w": 1.0}})
        self._pose, self._point = maker(pose, "position"), type(pose.position)

    def radius(self, altitude: float) -> float:
        """Return the radius (m) of the visible ground at an altitude (m)."""
        return 0.0 if self.fails else altitude * self._opening

    def measure(self, now: int, pose: Pose, altitude: float) -> None:
        """Publish the weeds seen from a pose at an altitude (m). Missed weeds draw random numbers too."""
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


ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
Deviations = tuple[float, float, float, float]
"""Standard deviations of x, y, z and yaw, or of their rates."""
Position = tuple[float, float, float]
"""x, y, z (m)."""
_CORRELATION = 5.0
"""Correlation time of the pose error, s."""


class Motion(NamedTuple):
    """A robot's velocity in its own frame: forward, left and up (m/s), and counter-clockwise (rad/s)."""

    ahead: float = 0.0
    left: float = 0.0
    up: float = 0.0
    turn_rate: float = 0.0


STILL = Motion()


@dataclass(frozen=True, slots=True)
class OdometerParameters:
    """`position_noise` (m), `heading_noise` (rad), `speed_noise` (m/s, rad/s) are standard deviations."""

    rate: float = parameter(20.0, "Hz", above=0)
    position_noise: float = parameter(0.005, "m, standard deviation", minimum=0)
    heading_noise: float = parameter(0.003, "rad, standard deviation", minimum=0)
    speed_noise: float = parameter(0.005, "m/s and rad/s, standard deviation", minimum=0)


class Odometer:
    """Publishes `odom` in the frame `map`, and its pose on `/tf`; `warn` is called if ROS has no type for that.

    If the robot `flies`, height, climb and sideways speed are noisy too.
    """

    def __init__(
        self,
        node: Node,
        parameters: OdometerParameters,
        random: np.random.Generator,
        warn: Callable[[EndpointWarning], object],
        *,
        flies: bool = False,
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
        self._transforms: Publisher | None = None
        try:
            self._transforms = node.publisher("/tf", TRANSFORMS)
        except MissingTypeError as error:
            warn(EndpointWarning("/tf", f"{node.namespace} publishes no transforms: {error}", "backend"))
        self._frame = f"{node.namespace}/base_link"
        self._make, self._header = _odometry_maker(sigma, self._speed_sigma), header_maker("map")

    def measure(self, now: int, pose: Pose, motion: Motion, altitude: float = 0.0) -> None:
        """Publish a measurement of the true pose, altitude (m) and motion."""
        draws, keep = self._noise.row(), self._keep
        self._error = [
            keep * error + fresh * draw for error, fresh, draw in zip(self._error, self._fresh, draws, strict=False)
        ]
        measured = [true + sigma * draw for true, sigma, draw in zip(motion, self._speed_sigma, draws[4:], strict=True)]
        dx, dy, dz, turn = self._error
        place = pose.x + dx, pose.y + dy, altitude + dz
        message = self._make(self._header(now), self._frame, place, pose.heading + turn, measured)
        self._publisher.publish(message)
        if self._transforms is not None:
            self._transforms.publish(_transforms(message))


def _transforms(odometry: AnyMessage) -> AnyMessage:
    """The tf2_msgs/msg/TFMessage of an odometry: the robot in the frame `map`."""
    stamped = message_class("geometry_msgs/msg/TransformStamped")
    transform = message_class("geometry_msgs/msg/Transform")
    pose, vector = odometry.pose.pose, message_class("geometry_msgs/msg/Vector3")
    place = vector(pose.position.x, pose.position.y, pose.position.z)
    one = stamped(odometry.header, odometry.child_frame_id, transform(place, pose.orientation))
    return message_class(TRANSFORMS)([one])


@cache
def _odometry_maker(
    sigma: Deviations, speed_sigma: Deviations
) -> Callable[[AnyMessage, str, Position, float, Sequence[float]], AnyMessage]:
    """Return a constructor of odometry messages. Robots with equal noise share it, which keeps it in the CPU cache."""
    covariances = {"pose": {"covariance": _covariance(sigma)}, "twist": {"covariance": _covariance(speed_sigma)}}
    like = messages.create(ODOMETRY, covariances)
    sure_of_pose, sure_of_twist = like.pose.covariance, like.twist.covariance
    odometry: Any = type(like)
    pose_of, twist_of = type(like.pose), type(like.twist)
    pose, twist, point = type(like.pose.pose), type(like.twist.twist), type(like.pose.pose.position)
    quaternion, vector = type(like.pose.pose.orientation), type(like.twist.twist.linear)

    def make(header: AnyMessage, frame: str, place: Position, heading: float, motion: Sequence[float]) -> AnyMessage:
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
    """The 6 x 6 covariance matrix of x, y, z, roll, pitch, yaw, row by row."""
    x, y, z, yaw = sigma
    diagonal = [x**2, y**2, z**2, 0.0, 0.0, yaw**2]
    return [diagonal[row] if row == column else 0.0 for row in range(6) for column in range(6)]
