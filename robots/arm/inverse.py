"""Inverse kinematics of any serial arm: damped least squares from a nearby posture, for many points at once.

The step is dq = J^T (J J^T + d^2 I)^-1 e, with e the error of place (m) and of orientation (rotation vector, rad). The
damping keeps the wrist from turning wildly where its axes nearly align; the result stays near the posture begun from.
"""

from __future__ import annotations

import numpy as np

from fame.errors import MissionError
from fame.monitor.arrays import Floats
from fame.monitor.kinematics import Chain

DAMPING = 1e-4
ROUNDS = 30
CLOSE = 1e-7
"""Errors (m, rad) that count as none: a hundredth of an encoder step of the MH5."""


def inverse(chain: Chain, places: Floats, orientations: Floats, seed: Floats) -> Floats:
    """Joint angles (points, joints), rad, that bring the tool to `places` (points, 3), m, in `orientations`
    (points, 3, 3). `seed` are angles nearby. Raises MissionError for places that the arm does not reach.
    """
    angles = seed.copy()
    for _ in range(ROUNDS):
        reached, turned, jacobian = forward(chain, angles)
        error = np.concatenate([places - reached, _rotation_vectors(orientations, turned)], axis=1)
        if np.abs(error).max() < CLOSE:
            return angles
        damped = jacobian @ jacobian.transpose(0, 2, 1) + DAMPING**2 * np.eye(6)
        step = jacobian.transpose(0, 2, 1) @ np.linalg.solve(damped, error[:, :, None])
        angles = angles + step[:, :, 0]
    worst = int(np.abs(error).max(axis=1).argmax())
    x, y, z = places[worst]
    raise MissionError(f"the arm does not reach x {x:.4f}, y {y:.4f}, z {z:.4f} m in the orientation asked for")


def forward(chain: Chain, angles: Floats) -> tuple[Floats, Floats, Floats]:
    """Place (points, 3), orientation (points, 3, 3) and geometric Jacobian (points, 6, joints)."""
    count = len(angles)
    turned = np.broadcast_to(np.eye(3), (count, 3, 3))
    place = np.zeros((count, 3))
    origins, axes = [], []
    for origin, axis, angle in zip(chain.origins, chain.axes, angles.T, strict=True):
        place = place + turned @ np.array(origin)
        origins.append(place)
        axes.append(turned @ np.array(axis))
        turned = turned @ rotations(np.array(axis), angle)
    place = place + turned @ np.array(chain.tool)
    columns = [
        np.concatenate([np.cross(axis, place - origin), axis], axis=1)
        for origin, axis in zip(origins, axes, strict=True)
    ]
    return place, turned, np.stack(columns, axis=2)


def rotations(axis: Floats, angle: Floats) -> Floats:
    """Rotations (points, 3, 3) about one axis (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    sine, rest = np.sin(angle)[:, None, None], (1 - np.cos(angle))[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + rest * (cross @ cross))


def _rotation_vectors(wanted: Floats, turned: Floats) -> Floats:
    """What turns `turned` into `wanted`, to first order (points, 3), rad."""
    return np.asarray(0.5 * np.cross(turned, wanted, axis=1).sum(axis=2))
