"""A buffer of transforms between frames, as tf2 keeps it: what ``/tf`` and ``/tf_static`` said in the last 10 s.

Each frame has one parent. A transform between two frames goes up from both to the nearest frame above both, at the
latest time that every moving frame on this way has reached, or at a time that is asked for. Between two stamps it is
interpolated, linearly and on the sphere; nothing is extrapolated.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from typing import Any, NamedTuple

from fame.clock import SECOND
from fame.dataclasses import dataclass, field
from fame.middleware import messages
from fame.middleware.interface import AnyMessage, QoS
from fame.middleware.messages import nanoseconds

TF = "tf2_msgs/msg/TFMessage"
TOPICS = {"/tf": QoS(), "/tf_static": QoS(durability="transient_local")}
"""Topic -> QoS of a subscription."""
_KEPT = 10 * SECOND
"""How long a transform is kept after its frame's latest (ns), as in tf2."""


class Transform(NamedTuple):
    """The pose of a frame in another one: translation (m) and unit quaternion, x y z w."""

    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)

    def __matmul__(self, inner: Transform) -> Transform:
        """The pose of what is at `inner` in the frame whose pose this is."""
        x, y, z, w = self.rotation
        a, b, c, d = inner.rotation
        turned = (
            w * a + x * d + y * c - z * b, w * b - x * c + y * d + z * a, w * c + x * b - y * a + z * d,
            w * d - x * a - y * b - z * c,
        )  # fmt: skip
        moved = zip(self.translation, _turn(self.rotation, inner.translation), strict=True)
        tx, ty, tz = (here + there for here, there in moved)
        return Transform((tx, ty, tz), turned)

    def inverse(self) -> Transform:
        """Return the pose of the other frame in this one."""
        x, y, z, w = self.rotation
        back = (-x, -y, -z, w)
        tx, ty, tz = _turn(back, self.translation)
        return Transform((-tx, -ty, -tz), back)


@dataclass(slots=True)
class _Frame:
    """The poses of a frame in its parent, by time (ns); of a static one there is one pose."""

    parent: str
    static: bool
    times: list[int] = field(default_factory=list)
    poses: list[Transform] = field(default_factory=list)

    def add(self, time: int, pose: Transform) -> None:
        if self.static or (self.times and time < self.times[-1] - _KEPT):  # time has begun anew
            self.times, self.poses = [], []
        place = bisect_right(self.times, time)
        self.times.insert(place, time)
        self.poses.insert(place, pose)
        old = bisect_left(self.times, self.times[-1] - _KEPT)
        del self.times[:old], self.poses[:old]

    def at(self, time: int) -> Transform | None:
        """Return its pose at a time, None outside of what is known."""
        if self.static:
            return self.poses[0]
        if not self.times[0] <= time <= self.times[-1]:
            return None
        place = bisect_left(self.times, time)
        if self.times[place] == time:
            return self.poses[place]
        begin, end = self.times[place - 1], self.times[place]
        return _between(self.poses[place - 1], self.poses[place], (time - begin) / (end - begin))


class TransformBuffer:
    """The frames that a robot knows. `namespace`: its frame ``REX/base_link`` may be called ``base_link``."""

    def __init__(self, namespace: str) -> None:
        self._namespace = namespace
        self._frames: dict[str, _Frame] = {}

    def put(self, message: AnyMessage, *, static: bool) -> None:
        """Take a tf2_msgs/msg/TFMessage. What is no transform is ignored."""
        for each in message.transforms:
            child, parent = each.child_frame_id.lstrip("/"), each.header.frame_id.lstrip("/")
            place, turn = each.transform.translation, each.transform.rotation
            size = math.hypot(turn.x, turn.y, turn.z, turn.w)
            if not (child and parent and child != parent and 0 < size < math.inf):
                continue
            rotation = turn.x / size, turn.y / size, turn.z / size, turn.w / size
            frame = self._frames.get(child)
            if frame is None or (frame.parent, frame.static) != (parent, static):
                frame = self._frames[child] = _Frame(parent, static)
            frame.add(nanoseconds(each.header.stamp), Transform((place.x, place.y, place.z), rotation))

    def lookup(self, target: str, source: str, at: Any = None) -> AnyMessage | None:
        """Return the pose of frame `source` in frame `target`, as geometry_msgs/msg/TransformStamped.

        `at` is a builtin_interfaces/msg/Time; without it the latest is meant. None if it is not known.
        """
        target, source = self._name(target), self._name(source)
        down, up = self._line(source), self._line(target)
        above = next((frame for frame in down if frame in up), None)
        if above is None:
            return None
        down, up = down[: down.index(above)], up[: up.index(above)]
        moving = [self._frames[name].times[-1] for name in (*down, *up) if not self._frames[name].static]
        time = min(moving, default=0) if at is None else nanoseconds(at)
        below, beside = self._pose(down, time), self._pose(up, time)
        if below is None or beside is None:
            return None
        (x, y, z), (a, b, c, d) = beside.inverse() @ below
        return messages.create("geometry_msgs/msg/TransformStamped", {
            "header": {"stamp": {"sec": time // SECOND, "nanosec": time % SECOND}, "frame_id": target},
            "child_frame_id": source,
            "transform": {"translation": {"x": x, "y": y, "z": z}, "rotation": {"x": a, "y": b, "z": c, "w": d}},
        })  # fmt: skip

    def _name(self, frame: str) -> str:
        own = f"{self._namespace}/{frame}"
        return own if own in self._frames else frame.lstrip("/")

    def _line(self, frame: str) -> list[str]:
        """A frame and those above it. One that would come twice ends it."""
        line = [frame]
        while (known := self._frames.get(line[-1])) is not None and known.parent not in line:
            line.append(known.parent)
        return line

    def _pose(self, line: Sequence[str], time: int) -> Transform | None:
        """The pose of the first of these frames in the parent of the last."""
        pose = Transform()
        for name in line:
            outer = self._frames[name].at(time)
            if outer is None:
                return None
            pose = outer @ pose
        return pose


def _turn(rotation: tuple[float, ...], vector: tuple[float, float, float]) -> tuple[float, float, float]:
    """A vector turned by a unit quaternion: v + 2 r x (r x v + w v)."""
    x, y, z, w = rotation
    a, b, c = vector
    p, q, r = y * c - z * b + w * a, z * a - x * c + w * b, x * b - y * a + w * c
    return a + 2 * (y * r - z * q), b + 2 * (z * p - x * r), c + 2 * (x * q - y * p)


def _between(one: Transform, other: Transform, share: float) -> Transform:
    """The pose at a share (0 to 1) of the way, its rotation at constant speed (Shoemake 1985: slerp)."""
    cosine = sum(a * b for a, b in zip(one.rotation, other.rotation, strict=True))
    sign, angle = math.copysign(1.0, cosine), math.acos(min(1.0, abs(cosine)))
    first, last = (1 - share, share) if angle < 1e-6 else (math.sin((1 - share) * angle), math.sin(share * angle))
    mixed = [first * a + sign * last * b for a, b in zip(one.rotation, other.rotation, strict=True)]
    size = math.hypot(*mixed)
    x, y, z, w = (each / size for each in mixed)
    tx, ty, tz = (a + share * (b - a) for a, b in zip(one.translation, other.translation, strict=True))
    return Transform((tx, ty, tz), (x, y, z, w))
