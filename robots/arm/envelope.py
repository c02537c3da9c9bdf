"""The tolerance envelope: runs just outside what is tolerated, as training data, without touching the arm.

From a polygon, a tolerance and the arm's kinematics: benign runs are altered so that they cut a polygon whose sides
all lie `tolerance` farther out, and one whose sides all lie that much farther in. A classifier trained on these and on
benign runs puts its boundary midway, at about half the tolerance.
"""

from __future__ import annotations

import numpy as np

from fame.errors import ConfigError
from fame.monitor.anomaly.recording import ANOMALOUS, Recording, of_runs
from fame.monitor.arrays import Floats
from fame.monitor.kinematics import Chain
from robots.arm.sabotage import Knot, alter
from robots.arm.task import Polygon, find_cut


def envelope(benign: Recording, polygon: Polygon, tolerance: float, chain: Chain) -> Recording:
    """Cuts just outside (anomalous runs): of each benign run one larger and one smaller, by `tolerance` (m) at each
    side. Only the cutting part, as in the published data. Raises ConfigError for a tolerance that leaves no polygon.
    """
    runs: list[Floats] = []
    for sign in (-1, 1):
        shift = polygon.offset(np.full(len(polygon.corners), sign * tolerance)) - polygon.corners
        if tolerance <= 0 or _turned(polygon.corners, polygon.corners + shift):
            text = (
                f"a tolerance of {1000 * tolerance:g} mm leaves nothing of the part; more than 0, less would be right"
            )
            raise ConfigError(text)
        closed = [*shift, shift[0]]
        knots = [Knot(number, 0.0, float(x), float(y)) for number, (x, y) in enumerate(closed)]
        for run in benign:
            altered = alter(run.values, knots, chain, polygon).values
            cut = find_cut(chain.places(altered), polygon)
            runs.append(altered[cut.first : cut.last + 1])
    return of_runs(runs, ANOMALOUS, benign.joints, source=f"envelope of {benign.source}")


def _turned(corners: Floats, moved: Floats) -> bool:
    """Whether a side points the other way after moving: then nothing is left between the sides."""
    old, new = (np.roll(points, -1, axis=0) - points for points in (corners, moved))
    return bool(((old * new).sum(axis=1) <= 0).any())
