"""Forward kinematics of any serial arm with revolute joints, for one point or many at once.

The tool's place is folded from the flange to the base: turn the vector reached so far about the joint's axis, add the
joint's origin (Rodrigues' rotation formula). The fold is plain arithmetic on components, so the same lines serve floats
and arrays; for one point, floats are ten times as fast.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from fame.config.loader import read_document
from fame.dataclasses import dataclass
from fame.errors import ConfigError
from fame.monitor.arrays import Floats

Vector: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]


@cache
def _angles(steps: tuple[float, ...]) -> Floats:
    """The angle of one step of each encoder, rad."""
    return np.asarray(2 * math.pi / np.array(steps))


@dataclass(frozen=True, slots=True)
class Chain:
    """A serial arm.

    joints   names
    origins  m, each in the frame of the joint before, in the zero posture
    axes     unit vectors, in the joint's own frame
    steps    of the encoder, per revolution; empty if unknown
    tool     m, in the frame of the last joint
    """

    joints: tuple[str, ...]
    origins: tuple[Vector, ...]
    axes: tuple[Vector, ...]
    steps: tuple[float, ...] = ()
    tool: Vector = (0.0, 0.0, 0.0)

    def place(self, angles: Sequence[float]) -> Vector:
        """Return the position of the tool (m) for one point (rad per joint)."""
        cosine, sine = [math.cos(angle) for angle in angles], [math.sin(angle) for angle in angles]
        place: Vector = self._fold(cosine, sine, *self.tool)
        return place

    def skeleton(self, angles: Sequence[float]) -> list[Vector]:
        """Return the positions of the joints, from the base on, and of the tool (m) for one point (rad per joint)."""
        ends = (*self.origins, self.tool)
        parts = (Chain(self.joints[:n], self.origins[:n], self.axes[:n], tool=end) for n, end in enumerate(ends))
        return [part.place(angles[:number]) for number, part in enumerate(parts)]

    def places(self, values: Floats) -> Floats:
        """Return the positions of the tool (points, 3), m, for (points, joints), rad."""
        reached = self._fold(np.cos(values).T, np.sin(values).T, *self.tool)
        return np.stack([np.broadcast_to(part, len(values)) for part in reached], axis=1)

    def orientations(self, values: Floats) -> Floats:
        """Return the rotations of the last joint's frame against the base (points, 3, 3) for (points, joints), rad."""
        base = Chain(self.joints, ((0.0, 0.0, 0.0),) * len(self.joints), self.axes)
        cosine, sine = np.cos(values).T, np.sin(values).T
        columns = []
        for unit in np.eye(3).tolist():
            reached = base._fold(cosine, sine, *unit)
            columns.append(np.stack([np.broadcast_to(part, len(values)) for part in reached], axis=1))
        return np.stack(columns, axis=2)

    def quaternion(self, angles: Sequence[float]) -> Quaternion:
        """Return the orientation of the last joint's frame (w, x, y, z) for one point (rad per joint)."""
        halves = [angle / 2 for angle in angles]
        turned: Quaternion = self._turn([math.cos(half) for half in halves], [math.sin(half) for half in halves])
        return turned

    def quaternions(self, values: Floats) -> Floats:
        """Return the orientations of the last joint's frame (points, 4) for (points, joints), rad."""
        halves = values.T / 2
        turned = self._turn(np.cos(halves), np.sin(halves))
        return np.stack([np.broadcast_to(part, len(values)) for part in turned], axis=1)

    def _turn(self, cosine: Any, sine: Any) -> Any:
        """Multiply the joints' quaternions, from the base to the flange; floats or arrays, as in `_fold`."""
        w, x, y, z = 1.0, 0.0, 0.0, 0.0
        for (ax, ay, az), c, s in zip(self.axes, cosine, sine, strict=True):
            i, j, k = s * ax, s * ay, s * az
            w, x, y, z = (
                w * c - x * i - y * j - z * k,
                w * i + x * c + y * k - z * j,
                w * j - x * k + y * c + z * i,
                w * k + x * j - y * i + z * c,
            )
        return w, x, y, z

    def quantised(self, values: Floats) -> Floats:
        """Round angles (rad) to the steps of the encoders."""
        step = _angles(self.steps)
        return np.asarray((values / step).round() * step)

    def _fold(self, cosine: Any, sine: Any, x: Any, y: Any, z: Any) -> Any:
        for (ox, oy, oz), (ax, ay, az), c, s in zip(
            reversed(self.origins), reversed(self.axes), reversed(cosine), reversed(sine), strict=True
        ):
            along = (ax * x + ay * y + az * z) * (1 - c)
            x, y, z = (
                ox + c * x + s * (ay * z - az * y) + along * ax,
                oy + c * y + s * (az * x - ax * z) + along * ay,
                oz + c * z + s * (ax * y - ay * x) + along * az,
            )
        return x, y, z


def load_chain(source: str | Path | Mapping[str, Any]) -> Chain:
    """Load an arm from a YAML file (or its content): `joints`, each with name, origin, axis; `tool`. All joints have
    steps, or none has.

    Raises ConfigError.
    """
    file = "" if isinstance(source, Mapping) else str(source)
    text = source if isinstance(source, Mapping) else read_document(source).data
    try:
        joints = list(text["joints"])
        origins = tuple(_vector(joint["origin"]) for joint in joints)
        axes = tuple(_unit(_vector(joint["axis"])) for joint in joints)
        steps = tuple(_steps(joint["steps"]) for joint in joints if "steps" in joint)
        names = tuple(str(joint["name"]) for joint in joints)
        tool = _vector(text.get("tool", (0, 0, 0)))
        if not joints or len(set(names)) < len(names) or len(steps) not in (0, len(joints)):
            raise ValueError("each joint has a name of its own; all or none have steps")
    except (LookupError, TypeError, ValueError, ArithmeticError, AttributeError) as error:
        text = f"is not an arm ({error!r}): expected joints, each with name, origin [x, y, z] and axis [x, y, z]"
        raise ConfigError(text, file=file) from None
    return Chain(names, origins, axes, steps, tool)


def _vector(value: Any) -> Vector:
    x, y, z = (float(part) for part in value)
    if not all(map(math.isfinite, (x, y, z))):
        raise ValueError(f"{[x, y, z]} is not finite")
    return x, y, z


def _steps(value: Any) -> float:
    steps = float(value)
    if not 0 < steps < math.inf:
        raise ValueError(f"expected a number of steps per revolution, got {value!r}")
    return steps


def _unit(vector: Vector) -> Vector:
    length = math.hypot(*vector)
    return vector[0] / length, vector[1] / length, vector[2] / length
