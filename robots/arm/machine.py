"""An arm under computed torque control: it follows its trajectory except for external forces.

Computed torque makes the deviation e from the reference obey M (e'' + 2 w e' + w^2 e) = external forces, with each
joint critically damped; without external forces e is 0, and the efforts are the inverse dynamics of the reference.
While a force acts, the equation is integrated at the control rate (semi-implicit Euler) with inertia, Jacobian and
gravity of the reference, because deviations stay below a few mm. The effort is that of the motors: inverse dynamics,
the controller's correction M (-2 w e' - w^2 e), friction, and noise. The controller knows the friction except for a
factor that depends on temperature and wear and is drawn for each joint and run.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from fame.monitor.arrays import Floats
from robots.arm.bench import LID, Bench, Push
from robots.arm.dynamics import Arm, friction, inertia_matrices, inverse_dynamics
from robots.arm.kinematics import Motion, forward, sampled
from sim2d.randomness import Noise

BANDWIDTH = 60.0
"""w, rad/s."""
STILL = 1e-9
"""Deviations below this (rad, rad/s) are set to 0."""
BRAKE = 0.25
"""Time in which the arm stops on `hold`, s."""


class State(NamedTuple):
    """State of the joints at a cycle: rad, rad/s, Nm."""

    positions: list[float]
    velocities: list[float]
    efforts: list[float]


class Plan:
    """A motion with everything that is computed from it alone; the arm stays at its end."""

    def __init__(self, arm: Arm, motion: Motion) -> None:
        self._arm, self.motion = arm, motion
        self._efforts: dict[bool, Floats] = {}
        self.friction = friction(arm, motion.velocities)
        self.places = arm.chain.places(motion.positions).tolist()

    def efforts(self, load: bool) -> Floats:
        """Inverse dynamics (cycles, joints), Nm, with the lid or without."""
        if load not in self._efforts:
            arm = self._arm.carrying(LID) if load else self._arm
            self._efforts[load] = inverse_dynamics(arm, *self.motion)
        return self._efforts[load]

    @cached_property
    def jacobians(self) -> Floats:
        """Jacobians of the position of the fingertips (cycles, 3, joints)."""
        return forward(self._arm.chain, self.motion.positions)[2][:, :3]

    @cached_property
    def inertias(self) -> Floats:
        return inertia_matrices(self._arm, self.motion.positions)


class Machine:
    """An arm and its gripper at a bench."""

    def __init__(self, arm: Arm, posture: Floats, period: float, generators: Generators, *, bench: bool = True) -> None:
        self.arm, self.period = arm, period
        self.bench = Bench(generators.bench) if bench else None
        self.push: Push | None = None
        self._people = generators.people
        self._noise = Noise(generators.effort, len(posture))
        self._factor = generators.friction.normal(1.0, 0.05, len(posture))
        self._deviation, self._rate = np.zeros(len(posture)), np.zeros(len(posture))
        self._cycle = 0
        still = np.zeros((1, len(posture)))
        self.plan = Plan(arm, Motion(posture[None], still, still))
        self.state = State(posture.tolist(), [0.0] * len(posture), [0.0] * len(posture))

    @property
    def reference(self) -> tuple[Floats, Floats]:
        """Reference positions and velocities: rad, rad/s."""
        at = min(self._cycle, len(self.plan.places) - 1)
        return self.plan.motion.positions[at], self.plan.motion.velocities[at]

    @property
    def moving(self) -> bool:
        return self._cycle < len(self.plan.places) - 1

    def follow(self, times: Floats, positions: Floats) -> None:
        """Follow positions (points, joints), rad, at times (points,), s from now, positive and increasing."""
        here, rate = self.reference
        times, positions = np.concatenate([[0.0], times]), np.vstack([here, positions])
        self.start(Plan(self.arm, sampled(times, positions, rate, self.period)))

    def start(self, plan: Plan) -> None:
        """Follow a plan from the next cycle on; it begins at the reference."""
        self.plan, self._cycle = plan, -1

    def hold(self) -> None:
        """Come to rest."""
        here, rate = self.reference
        self.follow(np.array([BRAKE]), (here + rate * BRAKE / 2)[None])

    def grip(self, shut: bool) -> bool:
        """Shut or open the gripper; return whether it holds something then."""
        at = min(max(self._cycle, 0), len(self.plan.places) - 1)
        return self.bench is not None and self.bench.grip(shut, np.array(self.plan.places[at]))

    def obstruct_shoulder(self) -> None:
        """Let a person push joint 0, then block it, for some seconds."""
        self.push = Push(self._people)

    def hold_lid(self) -> None:
        """Let a person hold the lid down."""
        if self.bench is not None:
            self.bench.held_down = True

    def step(self) -> State:
        """Compute one control cycle."""
        self._cycle = at = min(self._cycle + 1, len(self.plan.places) - 1)
        plan, bench = self.plan, self.bench
        efforts = plan.efforts(bench is not None and bench.load)[at] + self._factor * plan.friction[at]
        positions, velocities = plan.motion.positions[at], plan.motion.velocities[at]
        if self._pushed(at):
            positions, velocities = positions + self._deviation, velocities + self._rate
            efforts = efforts + self._correct(at, positions, velocities)
        efforts = efforts + self.arm.noise * self._noise.row()
        self.state = State(positions.tolist(), velocities.tolist(), efforts.tolist())
        return self.state

    def _pushed(self, at: int) -> bool:
        """Whether there is, or may be, a deviation."""
        if self.push is not None or self._deviation.any():
            return True
        return self.bench is not None and self.bench.touches(*self.plan.places[at])

    def _correct(self, at: int, positions: Floats, velocities: Floats) -> Floats:
        """Return the controller's correction (joints,), Nm, and advance the deviation by one cycle."""
        plan, outer = self.plan, np.zeros(len(positions))
        if self.bench is not None:
            jacobian = plan.jacobians[at]
            place = plan.places[at] + jacobian @ self._deviation
            outer += jacobian.T @ self.bench.force(place, jacobian @ velocities)
        if self.push is not None:
            torque = self.push.torque(float(positions[0]), self.period)
            outer[0] += torque or 0.0
            self.push = None if torque is None else self.push
        inertia = plan.inertias[at]
        wanted = -2 * BANDWIDTH * self._rate - BANDWIDTH**2 * self._deviation
        self._rate = self._rate + self.period * (wanted + np.linalg.solve(inertia, outer))
        self._deviation = self._deviation + self.period * self._rate
        if not outer.any() and max(np.abs(self._deviation).max(), np.abs(self._rate).max()) < STILL:
            self._deviation, self._rate = np.zeros_like(outer), np.zeros_like(outer)
        return np.asarray(inertia @ wanted)


class Generators(NamedTuple):
    """One random generator for each source of randomness."""

    effort: np.random.Generator
    friction: np.random.Generator
    bench: np.random.Generator
    people: np.random.Generator
