"""Valid names of robots, topics and services in ROS 2."""

from __future__ import annotations

import re

_ROS_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
NAMES = "letters, digits and _, not starting with a digit"
"""What ROS 2 allows between the slashes of a name."""


def is_ros_name(name: str) -> bool:
    """Whether ROS 2 accepts the full name of a topic or service."""
    return _ROS_NAME.fullmatch(name) is not None
