"""Kinematics of any serial arm: inverse kinematics, straight lines of its tool, interpolation of trajectories.

Inverse kinematics is damped least squares from a nearby posture, for many points at once. The step is
dq = J^T (J J^T + d^2 I)^-1 e, with e the error of position (m) and orientation (rotation vector, rad). The damping
limits the motion of the wrist near singularities; the result stays near the initial posture.

A straight line keeps the tool's orientation and runs with minimum jerk from rest to rest. It does not avoid obstacles.

Between two points of a trajectory every joint follows the quintic with their positions, velocities and accelerations.
Velocities and accelerations that a trajectory does not give are those of the cubic spline through its points that is at
rest at the end, with zero acceleration at the first and last point: a single point is reached with minimum jerk.
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
"""Errors (m, rad) below this are accepted: a hundredth of an encoder step of the MH5."""


def inverse(chain: Chain, places: Floats, orientations: Floats, seed: Floats) -> Floats:
    """Return joint angles (points, joints), rad, that bring the tool to `places` (points, 3), m, in `orientations`
    (points, 3, 3). `seed` are angles nearby. Raises MissionError for places out of reach.
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
    raise MissionError(f"the arm cannot reach x {x:.4f}, y {y:.4f}, z {z:.4f} m in the given orientation")


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
    """The rotation vectors (points, 3), rad, from `turned` to `wanted`, to first order."""
    return np.asarray(0.5 * np.cross(turned, wanted, axis=1).sum(axis=2))


SPEED = 0.25
"""Maximum speed of the tool, m/s."""
SHORTEST = 1.0
"""Minimum duration of a line, s."""
NODE = 0.05
"""Approximate time between two points, s."""


class Waypoints(NamedTuple):
    """Times (points,), s from the beginning, and positions (points, joints), rad."""

    times: Floats
    positions: Floats


def straight(chain: Chain, posture: Floats, place: Floats) -> Waypoints:
    """Return the tool's straight line from a posture (joints,) to a place (3,), m. Raises MissionError if it is out of
    reach or too fast for a joint."""
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
    return Waypoints(part * duration, np.array(positions))


class JointMotion(NamedTuple):
    """The joints at each control cycle: (cycles, joints), rad, rad/s, rad/s²."""

    positions: Floats
    velocities: Floats
    accelerations: Floats


def sampled(times: Floats, positions: Floats, begin: Floats, period: float) -> JointMotion:
    """Return the motion through `positions` (points, joints) at `times` (points,), s, the first of which is now.

    `begin` (joints,) is the velocity now. Samples are `period` s apart, from one period after now to the end.
    """
    from scipy.interpolate import BPoly, CubicSpline

    spline = CubicSpline(times, positions, bc_type=((1, begin), (1, np.zeros_like(begin))))
    velocities, accelerations = spline(times, 1), spline(times, 2)
    accelerations[[0, -1]] = 0
    quintics = BPoly.from_derivatives(times, np.stack([positions, velocities, accelerations], axis=1))
    at = period * np.arange(1, max(1, int(np.ceil(times[-1] / period - 1e-6))) + 1)
    at[-1] = times[-1]
    return JointMotion(*(quintics(at, order) for order in range(3)))
