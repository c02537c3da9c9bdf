"""The triangle-cutting task: the polygon, and where a recorded run cuts it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fame.config.loader import read_document
from fame.errors import ConfigError
from fame.monitor.arrays import Floats, Whole

DEPTH = 5e-4
"""How far (m) from the cutting plane still counts as cutting: benign runs stay within 0.3 mm of it."""


@dataclass(frozen=True, slots=True)
class Polygon:
    """Corners (corners, 2) in m, in the order in which they are cut; cutting begins and ends at the first. `height` of
    the cutting plane in m."""

    corners: Floats
    height: float

    def offset(self, distances: Floats) -> Floats:
        """The corners if each side is moved outwards by its distance (m)."""
        ahead = np.roll(self.corners, -1, axis=0) - self.corners
        normals = np.stack([ahead[:, 1], -ahead[:, 0]], axis=1) / np.linalg.norm(ahead, axis=1, keepdims=True)
        normals *= np.sign(self.area)
        levels = (normals * self.corners).sum(axis=1) + distances
        pairs = zip(np.roll(normals, 1, axis=0), normals, np.roll(levels, 1), levels, strict=True)
        return np.array([np.linalg.solve(np.stack([n, m]), [a, b]) for n, m, a, b in pairs])

    @property
    def area(self) -> float:
        """m2; positive if the corners go round counter-clockwise."""
        x, y = self.corners.T
        return float(0.5 * (x * np.roll(y, -1) - np.roll(x, -1) * y).sum())


TRIANGLE = Polygon(np.array([(0.5669, 0.0), (0.4169, 0.07505), (0.4169, -0.07505)]), 0.0882)
"""150 x 150 mm; the slope of the two long sides (sides 0 and 2; side 1 is the base) is 2."""


def read_polygon(path: Path) -> Polygon:
    """A task file: ``corners``, [x, y] (m) each, in the order of cutting, and ``height`` (m). Raises ConfigError."""
    document = read_document(path)
    document.mapping(("corners", "height"))
    corners, height = (
        document.required("corners", "a list of [x, y] in m"),
        document.required("height", "a number of m"),
    )
    polygon = Polygon(np.array([corner.point() for corner in corners.items()]), height.number())
    if len(polygon.corners) < 3 or abs(polygon.area) < 1e-9:
        raise corners.error(f"expected a polygon, got {len(polygon.corners)} corners around no area")
    return polygon


class Cut(NamedTuple):
    """Where a run cuts: its first and last sample, and for each of them the side and how far along (0 to 1)."""

    first: int
    last: int
    sides: Whole
    fractions: Floats


def find_cut(places: Floats, polygon: Polygon) -> Cut:
    """The cutting part of a run whose tool is at `places` (points, 3), m. Raises ConfigError if it never cuts."""
    cutting = np.flatnonzero(np.abs(places[:, 2] - polygon.height) < DEPTH)
    if not len(cutting):
        text = f"never cuts: no point lies in the cutting plane, {1e3 * polygon.height:.1f} mm above the base"
        raise ConfigError(text)
    first, last = int(cutting[0]), int(cutting[-1])
    points = places[first : last + 1, :2]
    ends = np.roll(polygon.corners, -1, axis=0)
    along = [_project(points, a, b) for a, b in zip(polygon.corners, ends, strict=True)]
    sides = _in_order(np.stack([distance for _, distance in along], axis=1))
    fractions = np.stack([fraction for fraction, _ in along], axis=1)[np.arange(len(points)), sides]
    return Cut(first, last, sides, fractions)


def _project(points: Floats, a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """How far along the side from a to b each point lies (0 to 1), and its distance from it (m)."""
    ahead = b - a
    fraction = np.clip((points - a) @ ahead / (ahead @ ahead), 0, 1)
    return fraction, np.linalg.norm(points - a - fraction[:, None] * ahead, axis=1)


def _in_order(distances: Floats) -> Whole:
    """The side of each point, never going back: the split that makes the sum of distances least."""
    count, sides = distances.shape
    total: Floats = np.vstack([np.zeros(sides), np.cumsum(distances, axis=0)])
    best, came = total[:, 0], []
    for side in range(1, sides):
        gain = best - total[:, side]
        begin = np.array([int(np.argmin(gain[: index + 1])) for index in range(count + 1)])
        came.append(begin)
        best = total[:, side] + gain[begin]
    result = np.zeros(count, dtype=np.int64)
    end = count
    for side in range(sides - 1, 0, -1):
        start = int(came[side - 1][end])
        result[start:end] = side
        end = start
    return result
