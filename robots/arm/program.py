"""Runs of the MH5: as its program makes them, and as they would be recorded.

The program goes from home to the part, once round the polygon, and home again, sampled at a fixed rate. The way to and
from the part is a joint movement, the cut a straight line from corner to corner at the feed with the tool pointing
down; every piece begins and ends at rest (quintic in time), as the corners of a real program do. The feed is that
of the published recordings: the triangle takes 5.6 s.

A simulated run goes along the path of a recorded one (a cubic spline through its samples, so its noise and the slow
drift of its joints stay). The clock that takes the samples has another phase, about `LATE` of the samples come late,
and each joint jitters by `JITTER` of its encoder's steps before it is quantised. Such runs replace validation and
test sets that are not public; wherever they are used they are called simulated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from fame.extras import require
from fame.monitor.anomaly.recording import Recording
from fame.monitor.arrays import Floats
from fame.monitor.kinematics import Chain
from robots.arm.kinematics import inverse
from robots.arm.task import Polygon

FEED = 0.087
"""m/s, mean over a side."""

CLEARANCE = 0.05
"""How far (m) above the part the tool comes down and goes up."""

APPROACH, RETURN = 2.8, 2.8
"""How long (s) the way from home and to home takes."""

DOWN = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""The orientation in which the flange, which looks along x in the zero posture, looks down."""

_NEAR = (0.0, 0.6, -0.6, 0.0, -0.6, 0.0)
"""A posture (rad) with the tool down over the part, for the inverse kinematics to begin from."""


def cutting_run(chain: Chain, polygon: Polygon, rate: float) -> Floats:
    """One run: angles (points, joints), rad, `rate` of them a second. Raises MissionError for a part out of reach."""
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
    """From rest to rest in `duration` s (points, joints), rad, without the last point."""
    return begin + (end - begin) * _progress(duration, rate)[:, None]


def _line(begin: Floats, end: Floats, rate: float) -> Floats:
    duration = float(np.linalg.norm(end - begin)) / FEED
    return begin + (end - begin) * _progress(duration, rate)[:, None]


def _progress(duration: float, rate: float) -> Floats:
    """From 0 to 1 without jerks at its ends: 10 s^3 - 15 s^4 + 6 s^5."""
    count = max(1, math.ceil(duration * rate))
    s = np.arange(count) / count
    return np.asarray(s**3 * (10 - 15 * s + 6 * s**2))


def _along(chain: Chain, places: Floats, start: Floats) -> Floats:
    """Postures with the tool down at each place, each near the one before."""

    def postures() -> Iterator[Floats]:
        near = start
        for place in places:
            near = inverse(chain, place[None], DOWN[None], near[None])[0]
            yield near

    return np.array(list(postures()))


LATE, LATEST = 0.03, 0.5
"""Part of the samples that come late, and by how many periods at most."""

JITTER = 0.5
"""Standard deviation, in steps of the encoder."""


def simulated_runs(recorded: Recording, count: int, seed: int, chain: Chain) -> list[Floats]:
    """`count` new runs (points, joints), rad."""
    random = np.random.default_rng(seed)
    runs = [run.values[(run.values != 0).any(axis=1)] for run in recorded]
    return [simulated(runs[random.integers(len(runs))], random, chain) for _ in range(count)]


def simulated(run: Floats, random: np.random.Generator, chain: Chain) -> Floats:
    """One new run along a recorded one (points, joints)."""
    require("scipy")
    from scipy.interpolate import CubicSpline

    count = len(run) - 1
    late = np.where(random.random(count) < LATE, LATEST * random.random(count), 0.0)
    times = np.clip(np.arange(count) + random.random() + late, 0, count)
    steps = 2 * math.pi / np.array(chain.steps)
    jitter = random.normal(0.0, JITTER, (count, len(steps))) * steps
    return chain.quantised(CubicSpline(np.arange(count + 1), run)(times) + jitter)
