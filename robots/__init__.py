"""The robots: what each publishes and obeys, and how it moves. A new one is one file and one line of this table."""

from __future__ import annotations

from collections.abc import Mapping

from robots.car import Car
from robots.robot import Robot

ROBOTS: Mapping[str, type[Robot]] = {
    "car": Car,
}
"""Robot types by the name that a world file gives them."""
