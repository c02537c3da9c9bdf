"""What ROS reads from the command line and from the environment."""

from __future__ import annotations

import os
from xml.sax.saxutils import quoteattr

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_INTERFACE = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name={}/></Interfaces></General></Domain></CycloneDDS>"
)


def ros_arguments(words: list[str]) -> list[str]:
    """What of a command line is for ROS: from ``--ros-args`` on.

    >>> ros_arguments(["fame", "engine", "REX", "--ros-args", "-p", "use_sim_time:=true"])
    ['--ros-args', '-p', 'use_sim_time:=true']
    """
    return words[words.index("--ros-args") :] if "--ros-args" in words else []


def confine(network: str | None) -> None:
    """Let ROS look for others on this machine only, or on the network. It reads that from the environment."""
    if network is None:
        os.environ[RANGE] = "LOCALHOST"
    elif os.environ.get(RANGE, "LOCALHOST") in ("LOCALHOST", "OFF"):
        os.environ[RANGE] = "SUBNET"
    os.environ.pop("ROS_LOCALHOST_ONLY", None)  # that of earlier distributions, which would overrule it
    if network is not None and os.environ.get("RMW_IMPLEMENTATION") == "rmw_cyclonedds_cpp":
        os.environ.setdefault("CYCLONEDDS_URI", _INTERFACE.format(quoteattr(network)))
