"""An arm under computed torque: it follows its trajectory, but for what pushes it.

Computed torque makes the deviation e from the reference obey M (e'' + 2 w e' + w^2 e) = outer forces, joint by joint
critically damped; so without outer forces e is 0, and the efforts are the inverse dynamics of the reference. While
something pushes, the equation is integrated at the control rate (semi-implicit Euler), with inertia, Jacobian and
gravity those of the reference: deviations are below a few mm. The effort is that of the motors: inverse dynamics, the
controller's correction M (-2 w e' - w^2 e), friction, and noise. Friction is known to the controller, but for its
factor, which warms up and wears: another one for each joint and run.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from fame.monitor.arrays import Floats
from robots.arm.bench import LID, Bench, Push
from robots.arm.dynamics import Arm, friction, inertia_matrices, inverse_dynamics
from robots.arm.kinematics import forward
from robots.arm.trajectory import Motion, sampled
from sim2d.randomness import Noise

BANDWIDTH = 60.0
"""w, rad/s."""
STILL = 1e-9
"""rad and rad/s: a deviation that is none."""
BRAKE = 0.25
"""s in which an arm that is told to hold comes to rest."""


class State(NamedTuple):
    """Of the joints at a cycle: rad, rad/s, Nm."""

    positions: list[float]
    velocities: list[float]
    efforts: list[float]


class Plan:
    """A motion with all that depends on it alone; after its end the arm stays there."""

    def __init__(self, arm: Arm, motion: Motion) -> None:
        self._arm, self.motion = arm, motion
        self._efforts: dict[bool, Floats] = {}
        self.friction = friction(arm, motion.velocities)
        self.places = arm.chain.places(motion.positions).tolist()

    def efforts(self, load: bool) -> Floats:
        """Inverse dynamics, with the lid or without (cycles, joints)."""
        if load not in self._efforts:
            arm = self._arm.carrying(LID) if load else self._arm
            self._efforts[load] = inverse_dynamics(arm, *self.motion)
        return self._efforts[load]

    @cached_property
    def jacobians(self) -> Floats:
        """Of the fingertips' place (cycles, 3, joints)."""
        return forward(self._arm.chain, self.motion.positions)[2][:, :3]

    @cached_property
    def inertias(self) -> Floats:
        return inertia_matrices(self._arm, self.motion.positions)


class Machine:
    """An arm and its gripper at a bench. `random` gives the generator of what has a name: effort, friction, bench."""

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
        """Where the joints should be and how fast: rad, rad/s."""
        at = min(self._cycle, len(self.plan.places) - 1)
        return self.plan.motion.positions[at], self.plan.motion.velocities[at]

    @property
    def moving(self) -> bool:
        return self._cycle < len(self.plan.places) - 1

    def follow(self, times: Floats, positions: Floats) -> None:
        """Go through positions (points, joints), rad, at times (points,), s from now, above 0 and growing."""
        here, rate = self.reference
        times, positions = np.concatenate([[0.0], times]), np.vstack([here, positions])
        self.start(Plan(self.arm, sampled(times, positions, rate, self.period)))

    def start(self, plan: Plan) -> None:
        """Follow a plan from the next cycle on; it begins where the reference is."""
        self.plan, self._cycle = plan, -1

    def hold(self) -> None:
        """Come to rest."""
        here, rate = self.reference
        self.follow(np.array([BRAKE]), (here + rate * BRAKE / 2)[None])

    def grip(self, shut: bool) -> bool:
        """Shut or open the gripper; whether it holds something then."""
        at = min(max(self._cycle, 0), len(self.plan.places) - 1)
        return self.bench is not None and self.bench.grip(shut, np.array(self.plan.places[at]))

    def obstruct_shoulder(self) -> None:
        """Somebody pushes joint 0, then blocks it, for a while."""
        self.push = Push(self._people)

    def hold_lid(self) -> None:
        """Somebody holds the lid down when it is about to be lifted."""
        if self.bench is not None:
            self.bench.held_down = True

    def step(self) -> State:
        """One control cycle."""
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
        """The controller's correction (joints,), Nm; then the deviation goes on by one cycle."""
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
    """What chance decides, each with a generator of its own."""

    effort: np.random.Generator
    friction: np.random.Generator
    bench: np.random.Generator
    people: np.random.Generator
