"""From the points of a trajectory to what the joints do at each control cycle.

Between two points every joint follows the quintic that has their positions, velocities and accelerations. What a
trajectory leaves open is that of the cubic spline through its points that is at rest at the end, with no acceleration
at the first and last point: a single point is reached with least jerk.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fame.monitor.arrays import Floats


class Motion(NamedTuple):
    """Of each joint at each cycle: (cycles, joints), rad, rad/s, rad/s2."""

    positions: Floats
    velocities: Floats
    accelerations: Floats


def sampled(times: Floats, positions: Floats, begin: Floats, period: float) -> Motion:
    """The motion through `positions` (points, joints) at `times` (points,), s, the first of which is now.

    `begin` (joints,) is the velocity now. Sampled every `period` s from one period after now to the end.
    """
    velocities = _spline_velocities(times, positions, begin)
    accelerations = _spline_accelerations(times, positions, velocities)
    at = period * np.arange(1, max(1, int(np.ceil(times[-1] / period - 1e-6))) + 1)
    at[-1] = times[-1]
    piece = np.clip(np.searchsorted(times, at, side="left") - 1, 0, len(times) - 2)
    span = (times[piece + 1] - times[piece])[:, None]
    powers = ((at - times[piece])[:, None] / span)[:, :, None] ** np.arange(6)  # (cycles, 1, 6)
    ends = [
        part[side]
        for part in (positions, velocities, accelerations)
        for side in (piece, piece + 1)
    ]  # fmt: skip
    scale: list[float | Floats] = [1.0, 1.0, span, span, span**2, span**2]
    given = np.stack([end * factor for end, factor in zip(ends, scale, strict=True)], axis=2)  # (cycles, joints, 6)
    weights = given @ _QUINTIC.T
    rates = np.arange(1, 6) * powers[:, :, :5]
    bends = np.arange(2, 6) * np.arange(1, 5) * powers[:, :, :4]
    return Motion(
        (weights * powers).sum(axis=2),
        (weights[:, :, 1:] * rates).sum(axis=2) / span,
        (weights[:, :, 2:] * bends).sum(axis=2) / span**2,
    )


def _quintic() -> Floats:
    """Coefficients of the quintic on 0 to 1 from its ends: positions, velocities, accelerations, each at 0 and 1."""
    powers = np.arange(6)
    rows = []
    for order in range(3):
        factor = np.prod([powers - step for step in range(order)], axis=0) if order else np.ones(6)
        rows += [np.where(powers == order, factor, 0.0), factor]
    return np.asarray(np.linalg.inv(np.array(rows, dtype=np.float64)))


_QUINTIC = _quintic()


def _spline_velocities(times: Floats, positions: Floats, begin: Floats) -> Floats:
    """Those of the clamped cubic spline: its second derivative has no jumps."""
    count = len(times)
    spans = np.diff(times)
    slopes = np.diff(positions, axis=0) / spans[:, None]
    matrix, right = np.eye(count), np.zeros_like(positions)
    right[0] = begin
    for row in range(1, count - 1):
        before, after = spans[row - 1], spans[row]
        matrix[row, row - 1 : row + 2] = after, 2 * (before + after), before
        right[row] = 3 * (after * slopes[row - 1] + before * slopes[row])
    return np.asarray(np.linalg.solve(matrix, right))


def _spline_accelerations(times: Floats, positions: Floats, velocities: Floats) -> Floats:
    result = np.zeros_like(positions)
    spans = np.diff(times)[1:, None]
    slopes = np.diff(positions, axis=0)[1:] / spans
    result[1:-1] = (6 * slopes - 4 * velocities[1:-1] - 2 * velocities[2:]) / spans
    return result
