"""Modifications of the cut, applied to recorded runs: the seven kinds of the paper's Fig. 12 and a rotated part.

A modification is a displacement of the tool that varies linearly between knots on the polygon's sides. Its size is in
mm *across a side*: the distance of the moved side from the original; for the corner (d), its distance from the
original corner. Kinds e and g may also be given by the slope dx/dy of the part that they bend; the benign slope is 2.

The arm approaches the altered part like the original one: the displacement grows over the last `BLEND` of the
approach. Encoder noise, drift and late samples of the run are kept. Where the path becomes longer or shorter, samples
are added or removed so that the feed stays the same. The result is quantised like encoder values. Without displacement
a run does not change.

The tolerance envelope consists of runs just outside the tolerance. It gives training data without using the arm: benign
runs are altered to cut a polygon whose sides lie `tolerance` farther out, and one whose sides lie as much farther in. A
classifier trained on these and on benign runs puts its boundary midway, at about half the tolerance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from fame.errors import ConfigError
from fame.imports import require
from fame.monitor.anomaly.recording import ANOMALOUS, Recording, of_runs
from fame.monitor.arrays import Floats
from fame.monitor.kinematics import Chain
from robots.arm.kinematics import inverse
from robots.arm.task import MH5, TRIANGLE, Cut, CutPolygon, find_cut

BLEND = 0.06
"""The path length (m) before and after the cut over which the displacement grows and vanishes."""

PART = (0.25, 0.75)
"""The section of a side that e and g bend: from, to."""

SLOPED = (0.05, 0.85, 0.95)
"""The section of the last side that is cut with another slope: from, to, and where it is back on the original side. The
paper gives no values; docs/anomaly.md explains this choice."""

JERK = (0.45, 0.5, 0.55)
"""Where on a side the quick jerk begins, is deepest and ends: 17 mm of a long side."""

NOTHING = 1e-9
"""Displacements below this (m) are rounding errors."""


class Knot(NamedTuple):
    """The displacement (x, y), m, at a fraction of a side."""

    side: int
    fraction: float
    x: float
    y: float


class Altered(NamedTuple):
    """A run with a modification: angles (points, joints), and for each point how far (m) the tool was moved across
    its direction of travel."""

    values: Floats
    moved: Floats


def knots(kind: str, millimetres: float, polygon: CutPolygon = TRIANGLE) -> list[Knot]:
    """Return the displacement of one kind: ``a`` to ``g``, ``rotated`` (mm at the farthest corner), ``none``. Raises
    ConfigError for other kinds."""
    if kind not in _KINDS:
        raise ConfigError(f"expected one of {', '.join(_KINDS)}, got {kind!r}")
    return _KINDS[kind](millimetres / 1000, polygon)


def knots_of_slope(slope: float, polygon: CutPolygon = TRIANGLE) -> list[Knot]:
    """Return the displacement of the last side if `SLOPED` of it is cut with another slope (dx/dy) and then leads
    straight back to the original side: below 2 it moves out (e), above 2 it moves in (g)."""
    side = len(polygon.corners) - 1
    begin, turn, _ = SLOPED
    dx, dy = (float(way) * (turn - begin) for way in polygon.corners[0] - polygon.corners[side])
    return _bend(side, *SLOPED, np.array([0.0, math.copysign(abs(dx) / slope, dy) - dy]))


def alter(values: Floats, changes: list[Knot], chain: Chain = MH5, polygon: CutPolygon = TRIANGLE) -> Altered:
    """Displace the cut of a run (points, joints), rad. Raises ConfigError if it does not cut the polygon."""
    places = chain.places(values)
    shift = displacements(places, changes, polygon)
    index = _resampling(places, places + shift)
    wanted = _at(places + shift, index)
    nearest = np.round(index).astype(int)
    orientations, seed = chain.orientations(values), values[nearest]
    touched = np.linalg.norm(wanted - places[nearest], axis=1) > NOTHING
    result = seed.copy()
    if touched.any():
        chosen = nearest[touched]
        result[touched] = inverse(chain, wanted[touched], orientations[chosen], seed[touched])
        result[touched] = chain.quantised(result[touched])
    return Altered(result, _across(places, shift)[nearest])


def displacements(places: Floats, changes: list[Knot], polygon: CutPolygon) -> Floats:
    """Return the displacement of each point of a run (points, 3), m."""
    cut = find_cut(places, polygon)
    shift = np.zeros_like(places)
    position = cut.sides + cut.fractions
    at = [knot.side + knot.fraction for knot in changes]
    for axis, parts in enumerate(zip(*[(knot.x, knot.y) for knot in changes], strict=True)):
        shift[cut.first : cut.last + 1, axis] = np.interp(position, at, parts)
        shift[:, axis] += _blend(places, cut, float(shift[cut.first, axis]), float(shift[cut.last, axis]))
    return shift


def _blend(places: Floats, cut: Cut, first: float, last: float) -> Floats:
    """The displacement before and after the cut, where it grows and vanishes."""
    way = np.cumsum(np.linalg.norm(np.diff(places, axis=0, prepend=places[:1]), axis=1))
    before, after = way[cut.first] - way, way - way[cut.last]
    come = np.where(before > 0, np.clip(1 - before / BLEND, 0, 1), 0.0)
    go = np.where(after > 0, np.clip(1 - after / BLEND, 0, 1), 0.0)
    come[cut.first :], go[: cut.last + 1] = 0, 0
    return np.asarray(come * first + go * last)


def _resampling(places: Floats, moved: Floats) -> Floats:
    """For each sample of the altered run, the (fractional) index into the original one that keeps the feed.

    Sections whose path length changes by less than half a sample keep their samples.
    """
    old = np.linalg.norm(np.diff(places, axis=0), axis=1)
    new = np.linalg.norm(np.diff(moved, axis=0), axis=1)
    ratio = np.where(old > 1e-4, new / np.maximum(old, 1e-9), 1.0)
    changed = np.flatnonzero(np.abs(ratio - 1) > 1e-9)
    if not len(changed):
        return np.arange(len(places), dtype=np.float64)
    first, last = int(changed[0]), int(changed[-1]) + 1
    time = np.concatenate([[0.0], np.cumsum(ratio[first:last])])
    longer = float(time[-1]) - (last - first)
    if abs(longer) < 0.5:
        return np.arange(len(places), dtype=np.float64)
    count = math.ceil(float(time[-1]))  # rounds to a slightly slower feed, never a faster one
    inside = np.interp(np.linspace(0, time[-1], count + 1), time, np.arange(first, last + 1))
    return np.concatenate([np.arange(first), inside, np.arange(last + 1, len(places))])


def _at(places: Floats, index: Floats) -> Floats:
    """The path at fractional samples: a cubic spline through all samples."""
    require("scipy")
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(np.arange(len(places)), places)(index))


def _across(places: Floats, shift: Floats) -> Floats:
    """The length (m) of each displacement across the direction of travel."""
    step = np.gradient(places, axis=0)
    length = np.linalg.norm(step, axis=1, keepdims=True)
    ahead = np.where(length > 5e-5, step / np.maximum(length, 5e-5), 0.0)
    return np.asarray(np.linalg.norm(shift - (shift * ahead).sum(axis=1, keepdims=True) * ahead, axis=1))


# ---- the kinds -------------------------------------------------------------------------------------------------------


def _sides(signs: tuple[int, int, int]) -> Callable[[float, CutPolygon], list[Knot]]:
    """Sides moved outwards (+) or inwards (-)."""

    def made(magnitude: float, polygon: CutPolygon) -> list[Knot]:
        return _corners(polygon.offset(magnitude * np.array(signs)) - polygon.corners)

    return made


def _corner(magnitude: float, polygon: CutPolygon) -> list[Knot]:
    """The first corner moved away from the centre."""
    away = polygon.corners[0] - polygon.corners.mean(axis=0)
    shift = np.zeros_like(polygon.corners)
    shift[0] = magnitude * away / np.linalg.norm(away)
    return _corners(shift)


def _rotated(magnitude: float, polygon: CutPolygon) -> list[Knot]:
    """The whole part rotated about its centre."""
    around = polygon.corners - polygon.corners.mean(axis=0)
    angle = magnitude / np.linalg.norm(around, axis=1).max()
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    return _corners(around @ turn.T - around)


def _bent(sign: int, places: tuple[float, float, float]) -> Callable[[float, CutPolygon], list[Knot]]:
    """Part of the first side moved outwards (+) or inwards (-)."""

    def made(magnitude: float, polygon: CutPolygon) -> list[Knot]:
        ahead = polygon.corners[1] - polygon.corners[0]
        outwards = np.array([ahead[1], -ahead[0]]) / np.linalg.norm(ahead) * np.sign(polygon.area)
        return _bend(0, *places, sign * magnitude * outwards)

    return made


def _bend(side: int, begin: float, middle: float, end: float, shift: Floats) -> list[Knot]:
    x, y = (float(part) for part in shift)
    return [Knot(side, begin, 0.0, 0.0), Knot(side, middle, x, y), Knot(side, end, 0.0, 0.0)]


def _corners(shift: Floats) -> list[Knot]:
    """Each corner displaced, with linear interpolation in between."""
    closed = [*shift, shift[0]]
    return [Knot(number, 0.0, float(x), float(y)) for number, (x, y) in enumerate(closed)]


_PART = (PART[0], sum(PART) / 2, PART[1])
_KINDS: Mapping[str, Callable[[float, CutPolygon], list[Knot]]] = {
    "a": _sides((-1, 0, -1)),
    "b": _sides((1, 0, 1)),
    "c": _sides((-1, 0, 1)),
    "d": _corner,
    "e": _bent(1, _PART),
    "f": _bent(-1, JERK),
    "g": _bent(-1, _PART),
    "rotated": _rotated,
    "none": _sides((0, 0, 0)),
}
KINDS = tuple("abcdefg")


def envelope(benign: Recording, polygon: CutPolygon, tolerance: float, chain: Chain) -> Recording:
    """Return cuts just outside the tolerance, labelled anomalous: for each benign run one larger and one smaller by
    `tolerance` (m) at each side. Runs contain the cutting part only, like the published data. Raises ConfigError for a
    tolerance that leaves no polygon.
    """
    runs: list[Floats] = []
    for sign in (-1, 1):
        shift = polygon.offset(np.full(len(polygon.corners), sign * tolerance)) - polygon.corners
        if tolerance <= 0 or _turned(polygon.corners, polygon.corners + shift):
            text = f"expected a tolerance above 0 that leaves something of the part, got {1000 * tolerance:g} mm"
            raise ConfigError(text)
        closed = [*shift, shift[0]]
        knots = [Knot(number, 0.0, float(x), float(y)) for number, (x, y) in enumerate(closed)]
        for run in benign:
            altered = alter(run.values, knots, chain, polygon).values
            cut = find_cut(chain.places(altered), polygon)
            runs.append(altered[cut.first : cut.last + 1])
    return of_runs(runs, ANOMALOUS, benign.joints, source=f"envelope of {benign.source}")


def _turned(corners: Floats, moved: Floats) -> bool:
    """Whether a side points the other way after moving: then no polygon is left."""
    old, new = (np.roll(points, -1, axis=0) - points for points in (corners, moved))
    return bool(((old * new).sum(axis=1) <= 0).any())
