"""Joint states as messages: which of their values belong to which joint, and why one is not taken."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from fame.monitor.anomaly.runs import JUMP

TYPE = "sensor_msgs/msg/JointState"
FIELDS = ("position", "velocity", "effort")


class Unusable(Exception):
    """A message that cannot be taken; its text says what was found."""


def stamp_of(message: Any) -> float:
    """Its time in s; 0.0 if it has none."""
    stamp = message.header.stamp
    return float(stamp.sec) + float(stamp.nanosec) * 1e-9


def values_of(message: Any, joints: Sequence[str], field: str = "position") -> list[float]:
    """The values of `joints`, in their order; of all, in the message's order, if `joints` is empty.

    Joints of a headerless file have made-up names (``joint_1`` ...) and are taken by position if no name fits.
    Raises Unusable.
    """
    found = [float(value) for value in getattr(message, field)]
    names = [str(name) for name in message.name]
    if not found:
        raise Unusable(f"its {field} is empty")
    if joints and set(joints) <= set(names) and len(names) == len(found):
        found = [found[names.index(joint)] for joint in joints]
    elif joints and (len(found) != len(joints) or not _made_up(joints)):
        missing = [joint for joint in joints if joint not in names]
        lack = f", without {', '.join(missing)}" if missing else ""
        raise Unusable(
            f"it has {len(found)} joints ({', '.join(names) or 'unnamed'}){lack}; the model has {len(joints)}"
        )
    if not all(map(math.isfinite, found)):
        raise Unusable(f"its {field} holds a value that is not finite")
    return found


def refuse_dropout(values: list[float], before: Sequence[float]) -> list[float]:
    """The values, unless all are 0 at once while the arm was away from home before. Raises Unusable."""
    if before and not any(values) and max(map(abs, before)) > JUMP:
        raise Unusable("all joints are 0 at once while the arm is away from home")
    return values


def _made_up(joints: Sequence[str]) -> bool:
    return all(joint.startswith("joint_") and joint.removeprefix("joint_").isdecimal() for joint in joints)
