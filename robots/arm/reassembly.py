"""The reassembly: take the lid off the motor, put it on the table, pick it up again, put it back; simulated runs of it.

A run has the samples that `joint_states` would have, computed by the same machine without topics.
"""

from __future__ import annotations

from functools import cache
from typing import Literal, NamedTuple

import numpy as np

from fame.monitor.arrays import Floats
from robots.arm.bench import MOTOR, TABLE
from robots.arm.dynamics import HOME, UR5E
from robots.arm.kinematics import sampled, straight
from robots.arm.machine import Generators, Machine, Plan
from sim2d.randomness import generator

RATE = 500.0
ABOVE = np.array([0.0, 0.0, 0.12])
PAUSE = 0.4
"""Pause after each movement and each gripper command, s."""

Scenario = Literal["none", "blocked_shoulder", "blocked_lid"]
SCENARIOS: tuple[Scenario, ...] = ("none", "blocked_shoulder", "blocked_lid")


class Step(NamedTuple):
    """Move to `place` (m), then shut (True), open (False) or keep (None) the gripper."""

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
    """The movements of the program, the same in all runs."""
    posture, made = HOME, []
    for step in PROGRAM:
        times, positions = straight(UR5E.chain, posture, step.place)
        times, positions = np.concatenate([[0.0], times]), np.vstack([posture, positions])
        made.append(Plan(UR5E, sampled(times, positions, np.zeros(6), 1 / RATE)))
        posture = made[-1].motion.positions[-1]
    return tuple(made)


def generators(seed: int, robot: str = "Arm") -> Generators:
    """Return the generators that the world makes for a robot of this name."""
    return Generators(*(generator(seed, robot, name) for name in Generators._fields))


def recorded(seed: int, scenario: Scenario = "none") -> Run:
    """Simulate one run. In obstructed ones a person pushes joint 0 shortly before the lid is moved sideways and then
    blocks it, or holds the lid on the motor until the gripper slips off."""
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
