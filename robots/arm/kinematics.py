"""Inverse kinematics of any serial arm, and straight ways of its tool.

Inverse kinematics is damped least squares from a nearby posture, for many points at once. The step is
dq = J^T (J J^T + d^2 I)^-1 e, with e the error of place (m) and of orientation (rotation vector, rad). The damping
keeps the wrist from turning wildly where its axes nearly align; the result stays near the posture begun from.

A straight way keeps the tool's orientation and goes with least jerk from rest to rest. It knows nothing of what stands
in between.
"""

from __future__ import annotations

from typing import NamedTuple

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


SPEED = 0.25
"""m/s of the tool, at its fastest."""
SHORTEST = 1.0
"""s of any way."""
NODE = 0.05
"""s between two points, about."""


class Way(NamedTuple):
    """Times (points,), s from its begin, and positions (points, joints), rad."""

    times: Floats
    positions: Floats


def straight(chain: Chain, posture: Floats, place: Floats) -> Way:
    """The way of the tool from a posture (joints,) to a place (3,), m. Raises MissionError if it cannot be gone."""
    begin = chain.places(posture[None])[0]
    orientation = chain.orientations(posture[None])
    length = float(np.linalg.norm(place - begin))
    duration = max(SHORTEST, 1.875 * length / SPEED)  # least jerk is 1.875 times as fast at its middle as on average
    count = int(np.ceil(duration / NODE))
    part = np.arange(1, count + 1) / count
    done = part**3 * (10 - 15 * part + 6 * part**2)
    positions, now = [], posture[None]
    for share in done:
        now = inverse(chain, (begin + share * (place - begin))[None], orientation, now)
        positions.append(now[0])
    steps = np.abs(np.diff(np.vstack([posture, positions]), axis=0)).max() * count / duration
    if steps > np.pi:
        raise MissionError(f"expected joints that turn at most at {np.pi:.1f} rad/s, got {steps:.1f} rad/s on the way")
    return Way(part * duration, np.array(positions))
