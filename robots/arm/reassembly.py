"""The reassembly: take the lid off the motor, put it on the table, take it up again, put it back. And runs of it.

A run is recorded as the arm's `joint_states` would be, but without topics: the same machine, cycle by cycle.
"""

from __future__ import annotations

from functools import cache
from typing import Literal, NamedTuple

import numpy as np

from fame.monitor.arrays import Floats
from robots.arm.bench import MOTOR, TABLE
from robots.arm.kinematics import straight
from robots.arm.machine import Generators, Machine, Plan
from robots.arm.trajectory import sampled
from robots.arm.ur5e import HOME, UR5E
from sim2d.randomness import generator

RATE = 500.0
ABOVE = np.array([0.0, 0.0, 0.12])
PAUSE = 0.4
"""s after each way, and after each word to the gripper."""

Scenario = Literal["none", "blocked_shoulder", "blocked_lid"]
SCENARIOS: tuple[Scenario, ...] = ("none", "blocked_shoulder", "blocked_lid")


class Step(NamedTuple):
    """Go to `place` (m), then shut the gripper, open it, or leave it."""

    place: Floats
    shut: bool | None = None


PROGRAM = (
    Step(MOTOR + ABOVE, False),
    Step(MOTOR, True),
    Step(MOTOR + ABOVE),
    Step(TABLE + ABOVE),
    Step(TABLE, False),
    Step(TABLE + ABOVE),
    Step(TABLE, True),
    Step(TABLE + ABOVE),
    Step(MOTOR + ABOVE),
    Step(MOTOR, False),
    Step(MOTOR + ABOVE),
)
ASIDE = 3
"""The step that moves the lid sideways."""


class Run(NamedTuple):
    """Stamps (cycles,), s; the rest (cycles, joints): rad, rad/s, Nm."""

    stamps: Floats
    positions: Floats
    velocities: Floats
    efforts: Floats


@cache
def plans() -> tuple[Plan, ...]:
    """The ways of the program: the same for all runs."""
    posture, made = HOME, []
    for step in PROGRAM:
        times, positions = straight(UR5E.chain, posture, step.place)
        times, positions = np.concatenate([[0.0], times]), np.vstack([posture, positions])
        made.append(Plan(UR5E, sampled(times, positions, np.zeros(6), 1 / RATE)))
        posture = made[-1].motion.positions[-1]
    return tuple(made)


def generators(seed: int, robot: str = "Arm") -> Generators:
    """As the world has them for a robot of this name."""
    return Generators(*(generator(seed, robot, name) for name in Generators._fields))


def recorded(seed: int, scenario: Scenario = "none") -> Run:
    """One run. The obstructed ones have somebody push joint 0 from a moment before the lid is moved sideways on, and
    block it then; or hold the lid on the motor until the gripper has slipped off."""
    machine = Machine(UR5E, HOME, 1 / RATE, generators(seed))
    pause = round(PAUSE * RATE)
    states = [machine.step() for _ in range(pause)]
    early = round(RATE * generator(seed, "moment").uniform(0.2, 0.6))
    if scenario == "blocked_lid":
        machine.hold_lid()
    for number, (step, plan) in enumerate(zip(PROGRAM, plans(), strict=True)):
        machine.start(plan)
        states += [machine.step() for _ in range(len(plan.places) + pause)]
        if scenario == "blocked_shoulder" and number == ASIDE - 1:
            machine.obstruct_shoulder()
            states += [machine.step() for _ in range(early)]
        if step.shut is not None:
            machine.grip(step.shut)
            states += [machine.step() for _ in range(pause)]
    columns = (np.array(column) for column in zip(*states, strict=True))
    return Run(np.arange(1, len(states) + 1) / RATE, *columns)
