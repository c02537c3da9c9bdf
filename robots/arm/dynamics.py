"""Forces in a serial arm: inverse dynamics by the recursive Newton-Euler algorithm, for many points at once; the UR5e.

All quantities are in the frame of the base. Velocities and accelerations are computed from the base outwards, with an
upward acceleration of the base instead of gravity; forces and moments are computed back inwards, and the component
along a joint's axis is its effort (Luh, Walker and Paul 1980; Featherstone, Rigid Body Dynamics Algorithms, chapter 5).
The columns of the inertia matrix are the efforts of unit accelerations at rest, without gravity.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fame.config.loader import read_document
from fame.dataclasses import dataclass, replace
from fame.monitor.arrays import Floats
from fame.monitor.kinematics import Chain, load_chain
from robots.arm.kinematics import rotations

GRAVITY = 9.81
STICTION = 0.01
"""Speed (rad/s) at which friction has reached most of its full value."""


@dataclass(frozen=True, slots=True, eq=False)
class RigidBody:
    """A rigid body: `mass` kg, `centre` (3,) of mass m, `inertia` (3, 3) about it kg m2."""

    mass: float
    centre: Floats
    inertia: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Arm:
    """A chain with the bodies that its joints move, in the frames of these joints. The other fields have one number per
    joint: `armature` kg m2, `coulomb` Nm, `viscous` Nm s/rad, `noise` of the measured effort Nm."""

    chain: Chain
    bodies: tuple[RigidBody, ...]
    armature: Floats
    coulomb: Floats
    viscous: Floats
    noise: Floats

    def carrying(self, mass: float) -> Arm:
        """Return this arm with a point mass of `mass` kg between its fingertips."""
        load = RigidBody(mass, np.array(self.chain.tool), np.zeros((3, 3)))
        return replace(self, bodies=(*self.bodies[:-1], joined(self.bodies[-1], load)))


def joined(a: RigidBody, b: RigidBody) -> RigidBody:
    """Return two bodies as one (parallel axis theorem)."""
    mass = a.mass + b.mass
    centre = (a.mass * a.centre + b.mass * b.centre) / mass
    inertia = sum(body.inertia + _shifted(body.mass, body.centre - centre) for body in (a, b))
    return RigidBody(mass, centre, np.asarray(inertia))


def _shifted(mass: float, away: Floats) -> Floats:
    return np.asarray(mass * (away @ away * np.eye(3) - np.outer(away, away)))


def load_arm(path: Path) -> Arm:
    """Load an arm from a YAML file like ``ur5e.yaml``."""
    data: Any = read_document(path).data
    joints = data["joints"]
    bodies = [_body(joint) for joint in joints]
    bodies[-1] = joined(bodies[-1], _body(data["gripper"]))
    columns = [np.array([float(joint[key]) for joint in joints]) for key in ("armature", "coulomb", "viscous", "noise")]
    return Arm(load_chain(path), tuple(bodies), *columns)


def _body(data: Any) -> RigidBody:
    return RigidBody(
        float(data["mass"]), np.array(data["centre"], float), np.diag(data.get("inertia", (0.0, 0.0, 0.0)))
    )


def inverse_dynamics(
    arm: Arm, angles: Floats, velocities: Floats, accelerations: Floats, gravity: float = GRAVITY
) -> Floats:
    """Return the efforts (points, joints), Nm, of a motion without friction. All arguments (points, joints)."""
    count = len(angles)
    turned: Floats = np.broadcast_to(np.eye(3), (count, 3, 3))
    spin, turning = np.zeros((count, 3)), np.zeros((count, 3))
    pull = np.broadcast_to([0.0, 0.0, gravity], (count, 3))
    links = []
    for number, (origin, axis) in enumerate(zip(arm.chain.origins, arm.chain.axes, strict=True)):
        step = turned @ np.array(origin)
        pull = pull + _carried(turning, spin, step)
        direction = turned @ np.array(axis)
        rate = direction * velocities[:, number, None]
        turning = turning + direction * accelerations[:, number, None] + np.cross(spin, rate)
        spin = spin + rate
        turned = turned @ rotations(np.array(axis), angles[:, number])
        body = arm.bodies[number]
        centre = turned @ body.centre
        inertia = turned @ body.inertia @ turned.transpose(0, 2, 1)
        force = body.mass * (pull + _carried(turning, spin, centre))
        moment = _times(inertia, turning) + np.cross(spin, _times(inertia, spin)) + np.cross(centre, force)
        links.append((step, direction, force, moment))
    return np.asarray(_inwards(links) + arm.armature * accelerations)


def _carried(turning: Floats, spin: Floats, away: Floats) -> Floats:
    """The acceleration of a point `away` from another of the same body, relative to it."""
    return np.asarray(np.cross(turning, away) + np.cross(spin, np.cross(spin, away)))


def _times(matrices: Floats, vectors: Floats) -> Floats:
    return np.asarray((matrices @ vectors[:, :, None])[:, :, 0])


def _inwards(links: list[tuple[Floats, Floats, Floats, Floats]]) -> Floats:
    """Sum forces and moments from the tool to the base: the efforts (points, joints)."""
    force = moment = np.zeros_like(links[0][0])
    efforts = []
    for step, direction, own_force, own_moment in reversed(links):
        force, moment = force + own_force, moment + own_moment
        efforts.append((direction * moment).sum(axis=1))
        moment = moment + np.cross(step, force)
    return np.stack(efforts[::-1], axis=1)


def inertia_matrices(arm: Arm, angles: Floats) -> Floats:
    """Return the inertia matrices (points, joints, joints), kg m2, of postures (points, joints)."""
    count, joints = angles.shape
    still = np.zeros((count * joints, joints))
    units = np.tile(np.eye(joints), (count, 1))
    columns = inverse_dynamics(arm, np.repeat(angles, joints, axis=0), still, units, gravity=0.0)
    return columns.reshape(count, joints, joints)


def friction(arm: Arm, velocities: Floats) -> Floats:
    """Return the friction torques (Nm) at velocities (..., joints), rad/s."""
    return np.asarray(arm.coulomb * np.tanh(velocities / STICTION) + arm.viscous * velocities)


UR5E = load_arm(Path(__file__).with_name("ur5e.yaml"))
HOME: Floats = np.array([np.pi, -np.pi / 2, np.pi / 2, -np.pi / 2, -np.pi / 2, np.pi / 2])
"""Upper arm upright, forearm level, tool down, the bracket to the side (rad)."""
