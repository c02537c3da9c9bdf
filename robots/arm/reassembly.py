"""The reassembly: take the lid off the motor, put it on the table, pick it up again, put it back; simulated runs of it.

A recorded run has the samples of `joint_states` that the mission `models/reassembly.bpmn` gives with the same seed,
computed without topics, tokens and a world: as the mission, it sends goals, waits until the twin has planned, and waits
`PAUSE` after each movement and each gripper command.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Literal, NamedTuple

import numpy as np

from fame.clock import SECOND
from fame.monitor.arrays import Floats
from robots.arm.bench import MOTOR, TABLE
from robots.arm.dynamics import HOME, UR5E
from robots.arm.kinematics import sampled, straight
from robots.arm.machine import TYPICAL, ControlledArm, Generators, JointState, PlannedMotion, PlanningTime, RunVariation
from sim2d.randomness import generator

RATE = 500.0
ABOVE = np.array([0.0, 0.0, 0.12])
START = np.array([0.492, 0.193, 0.338])
"""Where the fingertips begin and end, m."""
PAUSE = 0.4
"""Pause after each movement and each gripper command, s."""
HELD = 1.0
"""Time at which a person holds the lid down in the scenario ``blocked_lid``, s."""

Disturbance = Literal["none", "blocked_shoulder", "blocked_lid"]
SCENARIOS: tuple[Disturbance, ...] = ("none", "blocked_shoulder", "blocked_lid")


class ProgramStep(NamedTuple):
    """Move to `place` (m), then shut (True), open (False) or keep (None) the gripper."""

    place: Floats
    shut: bool | None = None


PROGRAM = (
    ProgramStep(MOTOR + ABOVE, False),
    ProgramStep(MOTOR, True),
    ProgramStep(MOTOR + ABOVE),
    ProgramStep(TABLE + ABOVE),
    ProgramStep(TABLE, False),
    ProgramStep(TABLE + ABOVE),
    ProgramStep(TABLE, True),
    ProgramStep(TABLE + ABOVE),
    ProgramStep(MOTOR + ABOVE),
    ProgramStep(MOTOR, False),
    ProgramStep(MOTOR + ABOVE),
    ProgramStep(START),
)
ASIDE = 3
"""The step that moves the lid sideways."""


class RecordedRun(NamedTuple):
    """Stamps (cycles,), s; the rest (cycles, joints): rad, rad/s, Nm."""

    stamps: Floats
    positions: Floats
    velocities: Floats
    efforts: Floats


@cache
def plans() -> tuple[tuple[int, PlannedMotion], ...]:
    """Return the movements of the program, the same in all runs, each with the duration of its trajectory, ns."""
    made: list[tuple[int, PlannedMotion]] = []
    posture, here, rate = HOME, HOME, np.zeros(len(HOME))
    for step in PROGRAM:
        way = straight(UR5E.chain, posture, step.place)
        nanoseconds = np.rint(way.times * SECOND).astype(int)
        times = nanoseconds // SECOND + nanoseconds % SECOND / SECOND  # as a message has them
        times, positions = np.concatenate([[0.0], times]), np.vstack([here, way.positions])
        plan = PlannedMotion(UR5E, sampled(times, positions, rate, 1 / RATE))
        made.append((int(nanoseconds[-1]), plan))
        posture, here, rate = way.positions[-1], plan.motion.positions[-1], plan.motion.velocities[-1]
    return tuple(made)


def generators(seed: int) -> Generators:
    """Return the generators that the world makes for the robot ``Arm``."""
    return Generators(*(generator(seed, "Arm", name) for name in Generators._fields))


def recorded(
    seed: int, scenario: Disturbance = "none", at: float | None = None, variation: RunVariation = TYPICAL
) -> RecordedRun:
    """Simulate one run. In obstructed ones a person pushes joint 0 and then blocks it, or holds the lid on the motor
    until the gripper slips off: at the time `at` (s), as ``--fault Arm@S:blocked_shoulder``. By default, the shoulder
    is pushed shortly before the lid is moved sideways."""
    moment = generator(seed, "moment").uniform(0.2, 0.6)
    rehearsal = _Rehearsal(seed, variation)
    if scenario == "blocked_lid":
        rehearsal.fault(HELD if at is None else at, rehearsal.machine.hold_lid)
    if scenario == "blocked_shoulder" and at is not None:
        rehearsal.fault(at, rehearsal.machine.obstruct_shoulder)
    for number, (step, (duration, plan)) in enumerate(zip(PROGRAM, plans(), strict=True)):
        pushed = scenario == "blocked_shoulder" and at is None and number == ASIDE - 1
        rehearsal.move(duration, plan, moment if pushed else None)
        if step.shut is not None:
            rehearsal.grip(step.shut)
    return rehearsal.run()


class _Rehearsal:
    """The mission's commands to a machine, at the times (ns) at which the mission gives them."""

    def __init__(self, seed: int, variation: RunVariation) -> None:
        self.now = 0
        sources = generators(seed)
        self.machine = ControlledArm(UR5E, HOME, 1 / RATE, sources, variation)
        self._planning = PlanningTime(variation, sources.planning)
        self._states: list[JointState] = []
        self._faults: list[tuple[int, Callable[[], None]]] = []

    def fault(self, time: float, action: Callable[[], None]) -> None:
        """Let a fault come at a time (s)."""
        self._faults.append((round(time * SECOND), action))

    def move(self, duration: int, plan: PlannedMotion, pushed: float | None = None) -> None:
        """Send a goal and follow the trajectory. A person pushes joint 0 `pushed` s before the end."""
        self.wait(self._planning.draw())
        self.machine.start(plan)
        if pushed is not None:
            self.fault((self.now + duration) / SECOND + PAUSE - pushed, self.machine.obstruct_shoulder)
        self.wait(round(duration + PAUSE * SECOND))

    def grip(self, shut: bool) -> None:
        """Use the gripper."""
        self.machine.grip(shut)
        self.wait(round(PAUSE * SECOND))

    def wait(self, duration: int) -> None:
        """Let time pass, ns: a cycle is computed after everything else that happens at its time."""
        self.now += duration
        period = round(SECOND / RATE)
        while (cycle := period * (len(self._states) + 1)) < self.now:
            for fault in [fault for fault in self._faults if fault[0] <= cycle]:
                self._faults.remove(fault)
                fault[1]()
            self._states.append(self.machine.step())

    def run(self) -> RecordedRun:
        """Return what was measured."""
        columns = (np.array(column) for column in zip(*self._states, strict=True))
        return RecordedRun(np.arange(1, len(self._states) + 1) / RATE, *columns)
