"""The common style of pictures and animations: colours, positions of names, symbols of robots and weeds (polygons,
m)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Literal, NamedTuple

from fame.config.values import Point
from sim2d.ground import disc
from sim2d.robot import Appearance

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
STATION = "#7b5ea7"
PARCEL, PARCEL_EDGE = "#c98d4b", "#7a4d1f"
PARCEL_SIZE = 0.3
"""m."""
DOOR = "#b03a2e"
STUBBLE = "#d9cfae"
"""A cut weed; its edge has the colour of the robot that cut it."""
ROBOTS = ("#2364c9", "#b04b05", "#1a7841", "#8a3ab9", "#0a707f", "#c2257e", "#65691a", "#7a4a2b")
"""One colour for each robot, in the order of the file, cyclic: those of the page (fame/view/page/dom.js)."""
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
"""Opacity (of 255) of a range cone and of the outer and inner glow of an LED."""
LOW = 0.2
"""State of charge below which a battery is drawn as low."""
MATERIALS: Mapping[str, tuple[str, str | None]] = {
    "paper": (PAPER, None),
    "ink": (INK, None),
    "fixture": ("#d3d6da", OBSTACLE_EDGE),
    "part": (TARGET, TARGET_EDGE),
    "cut": (TARGET_EDGE, TARGET_EDGE),
}
"""Fill and edge of parts that do not have the colour of their robot."""


def paint(material: str, robot: str) -> tuple[str, str | None]:
    """Return fill and edge of a part of a robot with a colour."""
    return MATERIALS.get(material, (robot, INK))


def activity_text(caption: str, note: str, charge: float) -> str:
    """Join what a robot's body does, an empty battery, and the caption of its process."""
    return " \N{MIDDLE DOT} ".join(text for text in (note, "" if charge else "battery empty", caption) if text)


def robot_colour(index: int) -> str:
    """Return the colour of robot number `index`."""
    return ROBOTS[index % len(ROBOTS)]


MOST_NAMES = 24
"""With more robots or weeds than this no names are drawn, because they would overlap."""


def name_goes_above(place: Sequence[float], others: Iterable[Sequence[float]], *, near: float, top: float) -> bool:
    """Return whether the name of a thing at a place is drawn above it rather than below.

    It goes away from the closest other thing, if one is `near` (m); else above, but below at the `top` of the ground.
    """
    distance, height = min(((math.dist(place[:2], other[:2]), other[1]) for other in others), default=(math.inf, 0.0))
    return height <= place[1] if distance <= near else place[1] < top - near


class Figure(NamedTuple):
    """A filled polygon, or a line if not `closed`. `colour` is that of the robot or the name of a material."""

    corners: Sequence[Point]
    colour: Literal["robot", "paper", "ink", "fixture", "part", "cut"]
    closed: bool = True


def symbol(kind: str, outline: Sequence[Point], appearance: Appearance) -> list[Figure]:
    """Return the parts of the symbol of a robot type, from bottom to top; x is forward."""
    pieces = [Figure(piece.corners, piece.kind, piece.closed) for piece in appearance.workpieces]
    return [*pieces, *_SYMBOLS.get(kind, _vehicle)(outline), *_limb(outline, appearance)]


def _vehicle(outline: Sequence[Point]) -> list[Figure]:
    ahead = max(x for x, _ in outline)
    nose = ((ahead * 0.85, 0.0), (ahead * 0.25, ahead * 0.42), (ahead * 0.25, -ahead * 0.42))
    return [Figure(outline, "robot"), Figure(nose, "paper")]


def _tractor(outline: Sequence[Point]) -> list[Figure]:
    """A vehicle with large wheels behind and small ones in front."""
    ahead, side = max(x for x, _ in outline), max(y for _, y in outline)
    wheels = [
        Figure(_box(x * ahead, y * side, length * ahead, 0.5 * side), "ink")
        for x, length in ((-0.5, 0.85), (0.68, 0.5))
        for y in (-1.05, 1.05)
    ]
    return [*wheels, *_vehicle(outline)]


def _drone(outline: Sequence[Point]) -> list[Figure]:
    """Four rotors on two crossed arms; the nose is a dart between the front rotors."""
    far = max(x for x, _ in outline)
    places = [(x * 0.6 * far, y * 0.6 * far) for x in (-1, 1) for y in (-1, 1)]
    arms = [Figure(_turned(_box(0.0, 0.0, 1.7 * far, 0.15 * far), turn), "ink") for turn in (math.pi / 4, -math.pi / 4)]
    rotors = [Figure(disc(place, 0.4 * far), "robot") for place in places]
    hubs = [Figure(disc(place, 0.13 * far), "paper") for place in places]
    body = ((0.6, 0.0), (0.0, 0.32), (-0.32, 0.22), (-0.32, -0.22), (0.0, -0.32))
    return [*arms, *rotors, *hubs, Figure(larger(body, far), "ink")]


def _arm(outline: Sequence[Point]) -> list[Figure]:
    """The round base of an arm."""
    far = max(x for x, _ in outline)
    return [Figure(disc((0.0, 0.0), far), "robot"), Figure(disc((0.0, 0.0), 0.75 * far), "paper")]


def _limb(outline: Sequence[Point], appearance: Appearance) -> list[Figure]:
    """The links of an arm, and at its tool the two fingers of a gripper or the tip of a blade."""
    if not appearance.limb:
        return []
    far, last = max(x for x, _ in outline), len(appearance.limb) - 1
    parts: list[Figure] = []
    for number, (start, end) in enumerate(pairwise(appearance.limb)):
        parts += [_bar(start, end, far * (0.6 - 0.3 * number / last)), Figure(disc(end, far * 0.25), "ink")]
    wrist, tool = appearance.limb[-2:]
    ahead = math.atan2(tool[1] - wrist[1], tool[0] - wrist[0])
    if appearance.jaws < 0:
        return [*parts, Figure(disc(tool, 0.1 * far), "paper")]
    for side in (-1, 1):
        finger = _turned(_box(0.0, side * (appearance.jaws / 2 + 0.01), 0.06, 0.02), ahead)
        parts.append(Figure([(x + tool[0], y + tool[1]) for x, y in finger], "ink"))
    return parts


def _bar(start: Point, end: Point, width: float) -> Figure:
    """A link from one joint to the next."""
    middle, turn = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2), math.atan2(end[1] - start[1], end[0] - start[0])
    bar = _turned(_box(0.0, 0.0, math.dist(start, end) + width * 0.6, width), turn)
    return Figure([(x + middle[0], y + middle[1]) for x, y in bar], "robot")


_SYMBOLS: Mapping[str, Callable[[Sequence[Point]], list[Figure]]] = {
    "drone": _drone,
    "mh5": _arm,
    "tractor": _tractor,
    "ur5e": _arm,
}
"""Other types are drawn as vehicles."""


def weed(at: Point, radius: float) -> list[Point]:
    """Return a rosette of leaves."""
    leaves = 6
    turns = [math.pi * step / leaves for step in range(2 * leaves)]
    return [
        (at[0] + radius * reach * math.cos(turn), at[1] + radius * reach * math.sin(turn))
        for turn, reach in zip(turns, (1.0, 0.45) * leaves, strict=True)
    ]


def parcel(at: Sequence[float]) -> list[Point]:
    """Return the corners of a parcel."""
    return _box(at[0], at[1], PARCEL_SIZE, PARCEL_SIZE)


def door_leaves(start: Point, end: Point, opening: float) -> list[tuple[Point, Point]]:
    """Return the two leaves of a sliding door, which retract to its ends as it opens (0 to 1)."""
    (x1, y1), (x2, y2), part = start, end, max(0.5 * (1 - opening), 0.05)
    dx, dy = (x2 - x1) * part, (y2 - y1) * part
    return [(start, (x1 + dx, y1 + dy)), (end, (x2 - dx, y2 - dy))]


def larger(corners: Sequence[Point], times: float) -> list[Point]:
    """Scale corners about the origin."""
    return [(x * times, y * times) for x, y in corners]


def _box(x: float, y: float, length: float, width: float) -> list[Point]:
    return [(x + a * length / 2, y + b * width / 2) for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))]


def _turned(corners: Sequence[Point], angle: float) -> list[Point]:
    cos, sin = math.cos(angle), math.sin(angle)
    return [(x * cos - y * sin, x * sin + y * cos) for x, y in corners]
