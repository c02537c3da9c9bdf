"""What robots and weeds look like on pictures and in films: polygons in the frame of the thing itself, in m."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Literal, NamedTuple

from sim2d.reading import Point


class Part(NamedTuple):
    """A filled polygon. `colour`: that of the robot, or of paper or ink."""

    corners: Sequence[Point]
    colour: Literal["robot", "paper", "ink"]


def symbol(kind: str, outline: Sequence[Point]) -> list[Part]:
    """The parts of a robot of some type, from below to above; x is ahead."""
    return _SYMBOLS.get(kind, _vehicle)(outline)


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
    """A round base, two links bent at an elbow, and a gripper that points ahead."""
    far = max(x for x, _ in outline)
    upper = _turned(_box(0.8 * far, 0.0, 1.7 * far, 0.5 * far), 0.6)
    elbow = 1.6 * far * math.cos(0.6), 1.6 * far * math.sin(0.6)
    fore = [(x + elbow[0], y + elbow[1]) for x, y in _turned(_box(0.8 * far, 0.0, 1.7 * far, 0.4 * far), -0.6)]
    fingers = [Part(_box(2 * elbow[0] + 0.25 * far, y * far, 0.6 * far, 0.14 * far), "ink") for y in (-0.22, 0.22)]
    joints = [Part(disc(place, 0.3 * far), "ink") for place in (elbow, (2 * elbow[0], 0.0))]
    base = [Part(disc((0.0, 0.0), far), "robot"), Part(disc((0.0, 0.0), 0.35 * far), "paper")]
    return [*base[:1], Part(upper, "robot"), Part(fore, "robot"), *joints, *fingers, *base[1:]]


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


def disc(at: Point, radius: float) -> list[Point]:
    """A polygon that looks round."""
    turns = [math.tau * step / 24 for step in range(24)]
    return [(at[0] + radius * math.cos(turn), at[1] + radius * math.sin(turn)) for turn in turns]


def larger(corners: Sequence[Point], times: float) -> list[Point]:
    """The same about its origin."""
    return [(x * times, y * times) for x, y in corners]


def _box(x: float, y: float, length: float, width: float) -> list[Point]:
    return [(x + a * length / 2, y + b * width / 2) for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))]


def _turned(corners: Sequence[Point], angle: float) -> list[Point]:
    cos, sin = math.cos(angle), math.sin(angle)
    return [(x * cos - y * sin, x * sin + y * cos) for x, y in corners]
