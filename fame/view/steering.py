"""How pages steer a robot that somebody has taken over (`fame.robot.suspension`)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fame.middleware import messages

MANUAL, TWIST = "cmd_vel_manual", "geometry_msgs/msg/Twist"
"""The topic by which people steer a robot, relative to its namespace, and its type."""


def twist_of(command: Mapping[str, Any]) -> Any:
    """Return the message of a page's command to steer: `speed` (m/s), `turn` (rad/s)."""
    return messages.create(TWIST, {"linear": {"x": float(command["speed"])}, "angular": {"z": float(command["turn"])}})
