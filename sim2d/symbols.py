"""What robots and weeds look like on pictures and in films: polygons in the frame of the thing itself, in m."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Literal, NamedTuple

from fame.config.values import Point
from robots.robot import Look
from sim2d.shapes import disc


class Part(NamedTuple):
    """A filled polygon, or a line if it is not `closed`. `colour`: that of the robot, or what it is made of."""

    corners: Sequence[Point]
    colour: Literal["robot", "paper", "ink", "fixture", "part", "cut"]
    closed: bool = True


def symbol(kind: str, outline: Sequence[Point], look: Look) -> list[Part]:
    """The parts of a robot of some type as it looks, from below to above; x is ahead."""
    pieces = [Part(piece.corners, piece.kind, piece.closed) for piece in look.workpieces]
    return [*pieces, *_SYMBOLS.get(kind, _vehicle)(outline), *_limb(outline, look)]


def _vehicle(outline: Sequence[Point]) -> list[Part]:
    ahead = max(x for x, _ in outline)
    nose = ((ahead * 0.85, 0.0), (ahead * 0.25, ahead * 0.42), (ahead * 0.25, -ahead * 0.42))
    return [Part(outline, "robot"), Part(nose, "paper")]


def _tractor(outline: Sequence[Point]) -> list[Part]:
    """A vehicle with large wheels behind and small ones in front."""
    ahead, side = max(x for x, _ in outline), max(y for _, y in outline)
    wheels = [
        Part(_box(x * ahead, y * side, length * ahead, 0.5 * side), "ink")
        for x, length in ((-0.5, 0.85), (0.68, 0.5))
        for y in (-1.05, 1.05)
    ]
    return [*wheels, *_vehicle(outline)]


def _drone(outline: Sequence[Point]) -> list[Part]:
    """Four rotors on two crossed arms; the nose is a dart between the front rotors."""
    far = max(x for x, _ in outline)
    places = [(x * 0.6 * far, y * 0.6 * far) for x in (-1, 1) for y in (-1, 1)]
    arms = [Part(_turned(_box(0.0, 0.0, 1.7 * far, 0.15 * far), turn), "ink") for turn in (math.pi / 4, -math.pi / 4)]
    rotors = [Part(disc(place, 0.4 * far), "robot") for place in places]
    hubs = [Part(disc(place, 0.13 * far), "paper") for place in places]
    body = ((0.6, 0.0), (0.0, 0.32), (-0.32, 0.22), (-0.32, -0.22), (0.0, -0.32))
    return [*arms, *rotors, *hubs, Part(larger(body, far), "ink")]


def _arm(outline: Sequence[Point]) -> list[Part]:
    """The round base of an arm."""
    far = max(x for x, _ in outline)
    return [Part(disc((0.0, 0.0), far), "robot"), Part(disc((0.0, 0.0), 0.75 * far), "paper")]


def _limb(outline: Sequence[Point], look: Look) -> list[Part]:
    """The links of an arm from joint to joint, and at its tool a gripper's two fingers, or the tip of a blade."""
    if not look.limb:
        return []
    far, last = max(x for x, _ in outline), len(look.limb) - 1
    parts: list[Part] = []
    for number, (start, end) in enumerate(pairwise(look.limb)):
        parts += [_bar(start, end, far * (0.6 - 0.3 * number / last)), Part(disc(end, far * 0.25), "ink")]
    wrist, tool = look.limb[-2:]
    ahead = math.atan2(tool[1] - wrist[1], tool[0] - wrist[0])
    if look.jaws < 0:
        return [*parts, Part(disc(tool, 0.1 * far), "paper")]
    for side in (-1, 1):
        finger = _turned(_box(0.0, side * (look.jaws / 2 + 0.01), 0.06, 0.02), ahead)
        parts.append(Part([(x + tool[0], y + tool[1]) for x, y in finger], "ink"))
    return parts


def _bar(start: Point, end: Point, width: float) -> Part:
    """A link from one joint to the next."""
    middle, turn = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2), math.atan2(end[1] - start[1], end[0] - start[0])
    bar = _turned(_box(0.0, 0.0, math.dist(start, end) + width * 0.6, width), turn)
    return Part([(x + middle[0], y + middle[1]) for x, y in bar], "robot")


_SYMBOLS: Mapping[str, Callable[[Sequence[Point]], list[Part]]] = {
    "drone": _drone,
    "mh5": _arm,
    "tractor": _tractor,
    "ur5e": _arm,
}
"""All others look like a vehicle."""


def weed(at: Point, radius: float) -> list[Point]:
    """A rosette of leaves."""
    leaves = 6
    turns = [math.pi * step / leaves for step in range(2 * leaves)]
    return [
        (at[0] + radius * reach * math.cos(turn), at[1] + radius * reach * math.sin(turn))
        for turn, reach in zip(turns, (1.0, 0.45) * leaves, strict=True)
    ]


def larger(corners: Sequence[Point], times: float) -> list[Point]:
    """The same about its origin."""
    return [(x * times, y * times) for x, y in corners]


def _box(x: float, y: float, length: float, width: float) -> list[Point]:
    return [(x + a * length / 2, y + b * width / 2) for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))]


def _turned(corners: Sequence[Point], angle: float) -> list[Point]:
    cos, sin = math.cos(angle), math.sin(angle)
    return [(x * cos - y * sin, x * sin + y * cos) for x, y in corners]
