"""The robots: what each publishes and obeys, and how it moves. A new one is one file and one line of this table."""

from __future__ import annotations

from collections.abc import Mapping

from robots.arm.cutter import Cutter
from robots.arm.handler import Handler
from robots.car import Car
from robots.drone import Drone
from robots.robot import Robot
from robots.tractor import Tractor

ROBOTS: Mapping[str, type[Robot]] = {
    "car": Car,
    "drone": Drone,
    "mh5": Cutter,
    "tractor": Tractor,
    "ur5e": Handler,
}
"""Robot types by the name that a world file gives them."""
