"""What pictures and animations have in common: colours, and where names go."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

PAPER = "#ffffff"
GROUND = "#f6f4ee"
LINES = "#e4e0d5"
INK = "#2b2f36"
FAINT = "#7d828b"
OBSTACLE = "#8a9099"
OBSTACLE_EDGE = "#5d636c"
TARGET = "#e0a100"
TARGET_EDGE = "#8c6500"
WEED = "#4f9a2f"
WEED_EDGE = "#2c5d17"
CHARGER = "#1b7f8c"
STUBBLE = "#d9cfae"
"""A weed that was cut; its edge has the colour of who cut it."""
ROBOTS = ("#2364c9", "#d9630b", "#1f8a4c", "#8a3ab9", "#0d8fa3", "#c2257e", "#6b6f1a", "#7a4a2b")
"""One for each robot, in the order of the file, and round again."""
LEDS: Mapping[str, str] = {
    "red": "#ff1f1f",
    "green": "#16d943",
    "blue": "#2f6bff",
    "yellow": "#ffd400",
    "cyan": "#00d5e8",
    "magenta": "#f02be0",
    "white": "#ffffff",
}
"""Lit LEDs; one that is off is not drawn."""
CONE, GLOW, LAMP = 34, 60, 110
"""How opaque, of 255, a range cone is, the glow of an LED far from it, and near."""


LOW = 0.2
"""Part of a battery's charge from which on it is shown that it is low."""
MATERIALS: Mapping[str, tuple[str, str | None]] = {
    "paper": (PAPER, None),
    "ink": (INK, None),
    "fixture": ("#d3d6da", OBSTACLE_EDGE),
    "part": (TARGET, TARGET_EDGE),
    "cut": (TARGET_EDGE, TARGET_EDGE),
}
"""Fill and edge of what is not in the colour of its robot."""


def paint(material: str, robot: str) -> tuple[str, str | None]:
    """Fill and edge of a part of a robot with a colour."""
    return MATERIALS.get(material, (robot, INK))


def doing(caption: str, note: str, charge: float) -> str:
    """What is told of a robot: what its body does, that its battery is empty, and what its process is at."""
    return " \N{MIDDLE DOT} ".join(text for text in (note, "" if charge else "battery empty", caption) if text)


def robot_colour(index: int) -> str:
    """The colour of robot number `index`."""
    return ROBOTS[index % len(ROBOTS)]


MOST_NAMES = 24
"""Of more robots or weeds than this no names are written: nobody could read them."""


def name_goes_above(place: Sequence[float], others: Iterable[Sequence[float]], *, near: float, top: float) -> bool:
    """Whether the name of what stands at a place is better written above it than below.

    That is away from the closest other thing, if one is `near` (m); else above, but below at the `top` of the ground.
    """
    distance, height = min(((math.dist(place[:2], other[:2]), other[1]) for other in others), default=(math.inf, 0.0))
    return height <= place[1] if distance <= near else place[1] < top - near
