"""New runs like recorded ones: sampled at other instants, with late samples and encoder jitter.

Every new run goes along the path of a recorded one (a cubic spline through its samples, so its noise and the slow drift
of its joints stay). The clock that takes the samples has another phase, about `LATE` of the samples come late, and each
joint jitters by `JITTER` of its encoder's steps before it is quantised. Such runs stand in for validation and test sets
that are not public; wherever they are used they are called simulated.
"""

from __future__ import annotations

import math

import numpy as np

from fame.extras import require
from fame.monitor.anomaly.recording import Recording
from fame.monitor.arrays import Floats
from fame.monitor.kinematics import Chain

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
