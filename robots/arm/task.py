"""The triangle-cutting task of the Yaskawa Motoman MH5: the arm, the polygon, and runs that cut it.

The program moves from home to the part, once round the polygon, and home again, sampled at a fixed rate. Approach and
return are joint movements, the cut is a straight line from corner to corner at the feed with the tool pointing down;
every piece begins and ends at rest (quintic in time), like a real program. The feed is that of the published
recordings: the triangle takes 5.6 s.

A simulated run follows the path of a recorded one (a cubic spline through its samples, which keeps its noise and the
slow drift of its joints). The sampling clock has a random phase, a share `LATE` of the samples comes late, and each
joint jitters by `JITTER` of its encoder's steps before quantisation. Such runs replace validation and test sets that
are not public; wherever they are used they are called simulated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fame.config.loader import read_document
from fame.dataclasses import dataclass
from fame.errors import ConfigError
from fame.imports import require
from fame.monitor.anomaly.recording import Recording
from fame.monitor.arrays import Floats, Whole
from fame.monitor.kinematics import Chain, load_chain
from robots.arm.kinematics import inverse

FILE = Path(__file__).with_name("mh5.yaml")
MH5 = load_chain(FILE)
"""Six joints S, L, U, R, B, T; the tool is the flange."""

DEPTH = 5e-4
"""How far (m) from the cutting plane still counts as cutting: benign runs stay within 0.3 mm of it."""


@dataclass(frozen=True, slots=True)
class CutPolygon:
    """Corners (corners, 2) in m, in cutting order; cutting begins and ends at the first. `height` is that of the
    cutting plane (m)."""

    corners: Floats
    height: float

    def offset(self, distances: Floats) -> Floats:
        """Return the corners after each side has moved outwards by its distance (m)."""
        ahead = np.roll(self.corners, -1, axis=0) - self.corners
        normals = np.stack([ahead[:, 1], -ahead[:, 0]], axis=1) / np.linalg.norm(ahead, axis=1, keepdims=True)
        normals *= np.sign(self.area)
        levels = (normals * self.corners).sum(axis=1) + distances
        pairs = zip(np.roll(normals, 1, axis=0), normals, np.roll(levels, 1), levels, strict=True)
        return np.array([np.linalg.solve(np.stack([n, m]), [a, b]) for n, m, a, b in pairs])

    @property
    def area(self) -> float:
        """The area (m²), positive if the corners are in counter-clockwise order."""
        x, y = self.corners.T
        return float(0.5 * (x * np.roll(y, -1) - np.roll(x, -1) * y).sum())


TRIANGLE = CutPolygon(np.array([(0.5669, 0.0), (0.4169, 0.07505), (0.4169, -0.07505)]), 0.0882)
"""150 x 150 mm; the slope of the two long sides (sides 0 and 2; side 1 is the base) is 2."""


def read_polygon(path: Path) -> CutPolygon:
    """Read a task file: ``corners``, [x, y] (m) each, in cutting order, and ``height`` (m). Raises ConfigError."""
    document = read_document(path)
    document.mapping(("corners", "height"))
    corners, height = (
        document.required("corners", "a list of [x, y] in m"),
        document.required("height", "a number of m"),
    )
    polygon = CutPolygon(np.array([corner.point() for corner in corners.items()]), height.number())
    if len(polygon.corners) < 3 or abs(polygon.area) < 1e-9:
        raise corners.error(f"expected a polygon, got {len(polygon.corners)} corners around no area")
    ahead = np.roll(polygon.corners, -1, axis=0) - polygon.corners
    behind = np.roll(ahead, 1, axis=0)
    turns = behind[:, 0] * ahead[:, 1] - behind[:, 1] * ahead[:, 0]
    for corner, turn in zip(corners.items(), turns, strict=True):
        if abs(turn) < 1e-9:
            raise corner.expected("a corner where two sides meet at an angle")
    return polygon


class Cut(NamedTuple):
    """The cutting part of a run: its first and last sample, and for each sample the side and the fraction of it."""

    first: int
    last: int
    sides: Whole
    fractions: Floats


def find_cut(places: Floats, polygon: CutPolygon) -> Cut:
    """Find the cutting part of a run whose tool is at `places` (points, 3), m. Raises ConfigError if it never cuts."""
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
    """For each point, the fraction (0 to 1) along the side from a to b, and the distance from the side (m)."""
    ahead = b - a
    fraction = np.clip((points - a) @ ahead / (ahead @ ahead), 0, 1)
    return fraction, np.linalg.norm(points - a - fraction[:, None] * ahead, axis=1)


def _in_order(distances: Floats) -> Whole:
    """The side of each point, in order: the split that minimises the sum of distances, by dynamic programming."""
    count, sides = distances.shape
    total: Floats = np.vstack([np.zeros(sides), np.cumsum(distances, axis=0)])
    best, begins = total[:, 0], []  # by end: the least sum up to there on the sides so far, and where each side begins
    for side in range(1, sides):
        gain = best - total[:, side]
        begin = np.array([int(np.argmin(gain[: index + 1])) for index in range(count + 1)])
        begins.append(begin)
        best = total[:, side] + gain[begin]
    sides_of = np.zeros(count, dtype=np.int64)
    end = count
    for side in range(sides - 1, 0, -1):  # back from the last point
        start = int(begins[side - 1][end])
        sides_of[start:end] = side
        end = start
    return sides_of


FEED = 0.087
"""Mean speed over a side, m/s."""

CLEARANCE = 0.05
"""Height (m) above the part at which approach ends and return begins."""

APPROACH, RETURN = 2.8, 2.8
"""Duration (s) of the movements from home and to home."""

DOWN = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Orientation with the tool down; the flange points along x in the zero posture."""

_NEAR = (0.0, 0.6, -0.6, 0.0, -0.6, 0.0)
"""A posture (rad) with the tool down over the part: the seed of the inverse kinematics."""


def cutting_run(chain: Chain, polygon: CutPolygon, rate: float) -> Floats:
    """Return one run: angles (points, joints), rad, sampled at `rate` Hz. Raises MissionError for a part out of
    reach."""
    corners = [*polygon.corners, polygon.corners[0]]
    above = np.array([*polygon.corners[0], polygon.height + CLEARANCE])
    places = [above, *(np.array([x, y, polygon.height]) for x, y in corners), above]
    tool = np.concatenate([_line(a, b, rate) for a, b in pairwise(places)])
    start = inverse(chain, tool[:1], DOWN[None], np.array([_NEAR]))
    angles = _along(chain, tool, start[0])
    home = np.zeros(len(chain.joints))
    return np.concatenate(
        [movement(home, angles[0], APPROACH, rate), angles, movement(angles[-1], home, RETURN, rate), home[None]]
    )


def movement(begin: Floats, end: Floats, duration: float, rate: float) -> Floats:
    """Return a movement from rest to rest in `duration` s (points, joints), rad, without the last point."""
    return begin + (end - begin) * _progress(duration, rate)[:, None]


def _line(begin: Floats, end: Floats, rate: float) -> Floats:
    duration = float(np.linalg.norm(end - begin)) / FEED
    return begin + (end - begin) * _progress(duration, rate)[:, None]


def _progress(duration: float, rate: float) -> Floats:
    """The minimum-jerk profile from 0 to 1: 10 s^3 - 15 s^4 + 6 s^5."""
    count = max(1, math.ceil(duration * rate))
    s = np.arange(count) / count
    return np.asarray(s**3 * (10 - 15 * s + 6 * s**2))


def _along(chain: Chain, places: Floats, start: Floats) -> Floats:
    """Postures with the tool down at each place, each computed from the one before."""

    def postures() -> Iterator[Floats]:
        near = start
        for place in places:
            near = inverse(chain, place[None], DOWN[None], near[None])[0]
            yield near

    return np.array(list(postures()))


LATE, LATEST = 0.03, 0.5
"""Share of samples that come late, and maximum delay in periods."""

JITTER = 0.5
"""Standard deviation in encoder steps."""


def simulated_runs(recorded: Recording, count: int, seed: int, chain: Chain) -> list[Floats]:
    """Simulate `count` runs (points, joints), rad, along recorded ones drawn at random."""
    random = np.random.default_rng(seed)
    runs = [run.values[(run.values != 0).any(axis=1)] for run in recorded]
    return [simulated(runs[random.integers(len(runs))], random, chain) for _ in range(count)]


def simulated(run: Floats, random: np.random.Generator, chain: Chain) -> Floats:
    """Simulate one run along a recorded one (points, joints), rad."""
    require("scipy")
    from scipy.interpolate import CubicSpline

    count = len(run) - 1
    late = np.where(random.random(count) < LATE, LATEST * random.random(count), 0.0)
    times = np.clip(np.arange(count) + random.random() + late, 0, count)
    steps = 2 * math.pi / np.array(chain.steps)
    jitter = random.normal(0.0, JITTER, (count, len(steps))) * steps
    return chain.quantised(CubicSpline(np.arange(count + 1), run)(times) + jitter)
