"""An arm under computed torque control: it follows its trajectory except for external forces.

Computed torque makes the deviation e from the reference obey M (e'' + 2 w e' + w^2 e) = external forces, with each
joint critically damped; without external forces e is 0, and the efforts are the inverse dynamics of the reference.
While a force acts, the equation is integrated at the control rate, or `FINEST` if that is faster (semi-implicit Euler;
slower it would not be stable), with inertia, Jacobian and gravity of the reference, because deviations stay below a few
mm. The effort is that of the motors: inverse dynamics,
the controller's correction M (-2 w e' - w^2 e), friction, and the errors of its measurement. `RunVariation` says what
differs from run to run and from cycle to cycle.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np

from fame.clock import SECOND
from fame.config.values import parameter
from fame.dataclasses import dataclass
from fame.errors import MissionError
from fame.monitor.arrays import Floats
from robots.arm.bench import Bench, Push
from robots.arm.dynamics import Arm, friction, inertia_matrices, inverse_dynamics
from robots.arm.kinematics import JointMotion, forward, sampled
from sim2d.randomness import Noise

FINEST = 500.0
"""The rate of the UR5e, Hz."""
APART = 1.0
"""A larger deviation (rad) cannot come from the equation: the simulation has failed."""
BANDWIDTH = 60.0
"""w, rad/s."""
STILL = 1e-9
"""Deviations below this (rad, rad/s) are set to 0."""
BRAKE = 0.25
"""Time in which the arm stops on `hold`, s."""


@dataclass(frozen=True, slots=True)
class RunVariation:
    """How much runs differ, and how a joint's effort is measured. docs/arm.md gives the source of each size.

    friction     deviation of each joint's friction between runs, relative: wear, and load of its gears
    temperature  deviation of the arm's temperature between runs, K; friction falls by `COOLING` per K in all joints
    bias         deviation of the measured effort's offset between runs, relative to the noise of the joint
    coloured     part of the noise's variance that is correlated in time
    correlation  time constant of this part, s
    payload      deviation of the lid's mass between runs, relative
    planning     mean time from a goal to its trajectory, s; `jitter` is its deviation, s
    encoders     whether positions are rounded to the steps of the encoders
    """

    friction: float = parameter(0.05, "relative, per joint and run", minimum=0, maximum=1)
    temperature: float = parameter(4.0, "K between runs: 1 % of friction per K", minimum=0)
    bias: float = parameter(0.2, "of the noise of the joint", minimum=0)
    coloured: float = parameter(0.3, "of the variance of the noise", minimum=0, maximum=1)
    correlation: float = parameter(0.02, "s, of the coloured noise", above=0)
    payload: float = parameter(0.02, "relative, of the mass of parts", minimum=0, maximum=0.5)
    planning: float = parameter(0.04, "s from goal to trajectory", minimum=0)
    jitter: float = parameter(0.01, "s, standard deviation of `planning`", minimum=0)
    encoders: bool = parameter(True, "(positions are rounded to the steps of the encoders)")


TYPICAL = RunVariation()
COOLING = 0.01
"""Relative loss of friction per K."""


class JointState(NamedTuple):
    """State of the joints at a cycle: rad, rad/s, Nm."""

    positions: list[float]
    velocities: list[float]
    efforts: list[float]


class PlannedMotion:
    """A motion with everything that is computed from it alone; the arm stays at its end."""

    def __init__(self, arm: Arm, motion: JointMotion) -> None:
        self._arm, self.motion = arm, motion
        self.friction = friction(arm, motion.velocities)
        self.places = arm.chain.places(motion.positions).tolist()

    def effort(self, at: int, load: float) -> Floats:
        """Inverse dynamics (joints,), Nm, at a cycle, with a load in kg. It is linear in the mass of the load."""
        return np.asarray(self._empty[at] + load * self._per_mass[at] if load else self._empty[at])

    @cached_property
    def _empty(self) -> Floats:
        return inverse_dynamics(self._arm, *self.motion)

    @cached_property
    def _per_mass(self) -> Floats:
        return inverse_dynamics(self._arm.carrying(1.0), *self.motion) - self._empty

    @cached_property
    def jacobians(self) -> Floats:
        """Jacobians of the position of the fingertips (cycles, 3, joints)."""
        return forward(self._arm.chain, self.motion.positions)[2][:, :3]

    @cached_property
    def inertias(self) -> Floats:
        return inertia_matrices(self._arm, self.motion.positions)


class ControlledArm:
    """An arm and its gripper at a bench."""

    def __init__(
        self, arm: Arm, posture: Floats, period: float, generators: Generators, variation: RunVariation = TYPICAL
    ) -> None:
        self.arm, self.period = arm, period
        self._parts = max(1, math.ceil(period * FINEST - 1e-9))  # in which a period is integrated
        self.bench = Bench(generators.bench, variation.payload)
        self.push: Push | None = None
        self._people = generators.people
        self._sensor = EffortSensor(arm, period, generators, variation)
        warmer = generators.temperature.normal(0.0, variation.temperature)
        self._factor = generators.friction.normal(1.0, variation.friction, len(posture)) * math.exp(-COOLING * warmer)
        self._quantise = arm.chain.quantised if variation.encoders and arm.chain.steps else np.asarray
        self._deviation, self._rate = np.zeros(len(posture)), np.zeros(len(posture))
        self._deviates = False
        self._cycle = 0
        still = np.zeros((1, len(posture)))
        self.plan = PlannedMotion(arm, JointMotion(posture[None], still, still))
        self.state = JointState(posture.tolist(), [0.0] * len(posture), [0.0] * len(posture))

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
        self.start(PlannedMotion(self.arm, sampled(times, positions, rate, self.period)))

    def start(self, plan: PlannedMotion) -> None:
        """Follow a plan from the next cycle on; it begins at the reference."""
        self.plan, self._cycle = plan, -1

    def hold(self) -> None:
        """Come to rest."""
        here, rate = self.reference
        self.follow(np.array([BRAKE]), (here + rate * BRAKE / 2)[None])

    def grip(self, shut: bool) -> bool:
        """Shut or open the gripper; return whether it holds something then."""
        at = min(max(self._cycle, 0), len(self.plan.places) - 1)
        return self.bench.grip(shut, np.array(self.plan.places[at]))

    def obstruct_shoulder(self) -> None:
        """Let a person push joint 0, then block it, for some seconds."""
        self.push = Push(self._people)

    def hold_lid(self) -> None:
        """Let a person hold the lid down."""
        self.bench.held_down = True

    def step(self) -> JointState:
        """Compute one control cycle."""
        self._cycle = at = min(self._cycle + 1, len(self.plan.places) - 1)
        plan = self.plan
        efforts = plan.effort(at, self.bench.load) + self._factor * plan.friction[at]
        positions, velocities = plan.motion.positions[at], plan.motion.velocities[at]
        if self._pushed(at):
            positions, velocities = positions + self._deviation, velocities + self._rate
            for _ in range(self._parts):
                correction = self._correct(at)
            efforts = efforts + correction
        efforts = efforts + self._sensor.error()
        self.state = JointState(self._quantise(positions).tolist(), velocities.tolist(), efforts.tolist())
        return self.state

    def _pushed(self, at: int) -> bool:
        """Whether there is, or may be, a deviation."""
        if self.push is not None or self._deviates:
            return True
        return self.bench.touches(*self.plan.places[at])

    def _correct(self, at: int) -> Floats:
        """Return the controller's correction (joints,), Nm, and advance the deviation by a part of the cycle.

        Raises MissionError if the deviation is no longer one."""
        plan, period = self.plan, self.period / self._parts
        positions = plan.motion.positions[at] + self._deviation
        velocities, outer = plan.motion.velocities[at] + self._rate, np.zeros(len(positions))
        jacobian = plan.jacobians[at]
        place = plan.places[at] + jacobian @ self._deviation
        outer += jacobian.T @ self.bench.force(place, jacobian @ velocities)
        if self.push is not None:
            torque = self.push.torque(float(positions[0]), period)
            outer[0] += torque or 0.0
            self.push = None if torque is None else self.push
        inertia = plan.inertias[at]
        wanted = -2 * BANDWIDTH * self._rate - BANDWIDTH**2 * self._deviation
        self._rate = self._rate + period * (wanted + np.linalg.solve(inertia, outer))
        self._deviation = self._deviation + period * self._rate
        if not np.abs(self._deviation).max() < APART:
            raise MissionError(
                f"the simulation of the arm has failed: it is more than {APART:g} rad from its reference"
            )
        if not outer.any() and max(np.abs(self._deviation).max(), np.abs(self._rate).max()) < STILL:
            self._deviation, self._rate = np.zeros_like(outer), np.zeros_like(outer)
        self._deviates = bool(self._deviation.any())
        return np.asarray(inertia @ wanted)


class EffortSensor:
    """The error of measured efforts: an offset for each run, white noise, and noise that is correlated in time."""

    def __init__(self, arm: Arm, period: float, generators: Generators, variation: RunVariation) -> None:
        joints = len(arm.noise)
        self._white = Noise(generators.effort, joints)
        self._slow = Noise(generators.colour, joints)
        self._offset = variation.bias * arm.noise * generators.bias.standard_normal(joints)
        self._keep = math.exp(-period / variation.correlation)
        self._drive = math.sqrt((1 - self._keep**2) * variation.coloured) * arm.noise
        self._share = math.sqrt(1 - variation.coloured) * arm.noise
        self._state: Floats = math.sqrt(variation.coloured) * arm.noise * self._slow.row()

    def error(self) -> Floats:
        """Return the error (joints,), Nm, at the next cycle."""
        self._state = self._keep * self._state + self._drive * self._slow.row()
        return np.asarray(self._offset + self._state + self._share * self._white.row())


class PlanningTime:
    """The time from a goal to its trajectory, which varies."""

    def __init__(self, variation: RunVariation, random: np.random.Generator) -> None:
        self._mean, self._deviation, self._random = variation.planning, variation.jitter, random

    def draw(self) -> int:
        """Return the next planning time, ns."""
        return round(max(0.0, self._random.normal(self._mean, self._deviation)) * SECOND)


class Generators(NamedTuple):
    """One random generator for each source of randomness."""

    effort: np.random.Generator
    friction: np.random.Generator
    bench: np.random.Generator
    people: np.random.Generator
    temperature: np.random.Generator
    bias: np.random.Generator
    colour: np.random.Generator
    planning: np.random.Generator
