"""Things on the ground: solid shapes, weeds, chargers. All lengths in m.

Shapes are circles and convex polygons, seen from above. Weeds and chargers are flat: neither solid nor in the map.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from fame.config.values import Point
from fame.dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Circle:
    """A disc with its centre and radius."""

    centre: Point
    radius: float


@dataclass(frozen=True, slots=True)
class Polygon:
    """A convex polygon with counter-clockwise corners."""

    corners: tuple[Point, ...]

    @property
    def centre(self) -> Point:
        """The mean of its corners."""
        return sum(x for x, _ in self.corners) / len(self.corners), sum(y for _, y in self.corners) / len(self.corners)


Outline = Circle | Polygon


def box(centre: Point, width: float, height: float, angle: float) -> Polygon:
    """Return a rectangle turned counter-clockwise by `angle` (rad)."""
    cos, sin = math.cos(angle), math.sin(angle)
    half = [(-width / 2, -height / 2), (width / 2, -height / 2), (width / 2, height / 2), (-width / 2, height / 2)]
    return Polygon(tuple((centre[0] + x * cos - y * sin, centre[1] + x * sin + y * cos) for x, y in half))


def convex(corners: Sequence[Point]) -> Polygon | None:
    """Return the polygon with these corners, in either direction, or None if it is not convex or has no area."""
    turns = [_turn(corners[i - 2], corners[i - 1], corners[i]) for i in range(len(corners))]
    if len(corners) < 3 or None in turns:
        return None
    angles = [turn for turn in turns if turn is not None]
    # A star turns to one side as well, but more than once around; hence the sum of all turns has to be one turn.
    if not math.isclose(abs(sum(angles)), math.tau, rel_tol=1e-6):
        return None
    left = sum(angles) > 0
    if any(angle < -1e-9 if left else angle > 1e-9 for angle in angles):
        return None
    return Polygon(tuple(corners) if left else tuple(reversed(corners)))


def _turn(a: Point, b: Point, c: Point) -> float | None:
    """The angle (rad, left positive) by which the path a-b-c turns at b; None if it turns back or b equals a or c."""
    first, second = (b[0] - a[0], b[1] - a[1]), (c[0] - b[0], c[1] - b[1])
    cross = first[0] * second[1] - first[1] * second[0]
    dot = first[0] * second[0] + first[1] * second[1]
    if abs(cross) <= 1e-12 and dot <= 0:
        return None
    return math.atan2(cross, dot)


def disc(at: Point, radius: float) -> list[Point]:
    """Return the corners of a polygon that approximates a disc."""
    turns = [math.tau * step / 24 for step in range(24)]
    return [(at[0] + radius * math.cos(turn), at[1] + radius * math.sin(turn)) for turn in turns]


def bounding_box(shape: Outline) -> tuple[float, float, float, float]:
    """Return xmin, ymin, xmax, ymax."""
    if isinstance(shape, Circle):
        (x, y), r = shape.centre, shape.radius
        return x - r, y - r, x + r, y + r
    xs, ys = zip(*shape.corners, strict=True)
    return min(xs), min(ys), max(xs), max(ys)


def placed(points: Sequence[Point], pose: tuple[float, float, float]) -> list[Point]:
    """Transform points of a frame at a pose (x, y in m, heading in rad) to places in the world."""
    x, y, heading = pose
    cos, sin = math.cos(heading), math.sin(heading)
    return [(x + ahead * cos - left * sin, y + ahead * sin + left * cos) for ahead, left in points]


@dataclass(frozen=True, slots=True)
class Thing:
    """An obstacle or a target, solid and static. `path` is its key in the file."""

    name: str
    shape: Outline
    path: str = ""


@dataclass(frozen=True, slots=True)
class WeedConfig:
    """A weed: flat, neither solid nor in the map. In m."""

    name: str
    at: Point
    radius: float = 0.1


@dataclass(frozen=True, slots=True)
class ChargerConfig:
    """A place that charges the batteries of robots on it with `power` W. Flat, in m.

    Robots dock there in the direction `heading` (degrees, counter-clockwise from x).
    """

    name: str
    at: Point
    radius: float = 0.5
    power: float = 500.0
    heading: float = 0.0


@dataclass(slots=True)
class Weed:
    """A weed. `cut_at` is the second since the start at which robot `cut_by` cut it, None before.

    A weed inside something solid is `covered`: no blade can reach it.
    """

    name: str
    at: Point
    radius: float
    cut_at: float | None = None
    cut_by: str | None = None
    covered: bool = False

    def summary(self) -> dict[str, Any]:
        """Return its state, JSON-serialisable."""
        cut = None if self.cut_at is None else round(self.cut_at, 4)
        return {"x": self.at[0], "y": self.at[1], "cut": cut, "by": self.cut_by}


class Weeds:
    """All weeds, in the order of the file. `clock` gives the seconds since the start."""

    def __init__(self, configs: Iterable[WeedConfig], clock: Callable[[], float]) -> None:
        self.all = [Weed(config.name, config.at, config.radius) for config in configs]
        self._clock = clock

    def near(self, place: Point, distance: float) -> list[Weed]:
        """Return the uncut weeds whose centre is within `distance` (m) of a place."""
        return [weed for weed in self.all if weed.cut_at is None and math.dist(weed.at, place) <= distance]

    def cut(self, weed: Weed, by: str) -> None:
        """Mark a weed as cut by a robot."""
        weed.cut_at, weed.cut_by = self._clock(), by
