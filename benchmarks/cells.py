"""Generated work cells: an arm of three axes with a gripper that carries a part, and faults of stated kinds.

A cell is a seed. Its task is a list of moves of all axes and of grips, each with a pause behind it. Channels are the
position and current of each axis, the vacuum of the gripper and the total power. A current has inertia, friction,
gravity and the load of the part. From run to run vary the part's mass, friction (a warm and a cold arm), the supply,
offsets of sensors, and how long each step and pause takes: strictly repeated in some cells (0.2 %), loosely in others
(up to 6 %). Noise is Gaussian, or Student's t with three degrees of freedom.

Faults begin at a step in the middle of the task. They were written, with their sizes, before any detector was chosen or
tuned by them; cells from 5000 on (`FROZEN`) are for judging, those from 0 to 99 for building.
"""

from __future__ import annotations

import numpy as np

from fame.monitor.arrays import Floats
from fame.monitor.pipeline.processor import Samples

AXES, RATE = 3, 25.0
NAMES = ("position_0", "position_1", "position_2", "current_0", "current_1", "current_2", "vacuum", "power")
FAULTS = (
    "offset", "spike", "stuck", "vibration", "late", "swapped", "decoupled", "missing step", "extra step",
    "wrong object", "oscillation", "wear", "dropout",
)  # fmt: skip
FROZEN = tuple(range(5000, 5040))
Step = tuple[Floats, float, float, bool]
"""Where the axes go, how long that takes and the pause behind it (s), and whether the gripper holds then."""


class Cell:
    """A work cell; `run` gives one of its runs."""

    def __init__(self, seed: int) -> None:
        random = np.random.default_rng([seed, 59])
        self.seed = seed
        count = int(random.integers(6, 10))
        hold = np.zeros(count, dtype=bool)
        begin = int(random.integers(1, 3))
        hold[begin : begin + int(random.integers(3, count - 2))] = True
        self.home = random.uniform(-1, 1, AXES)
        self.steps: list[Step] = [
            (random.uniform(-1.2, 1.2, AXES), random.uniform(0.6, 1.4), random.uniform(0.1, 0.6), bool(hold[n]))
            for n in range(count)
        ]
        self.looseness = random.choice([0.002, 0.01, 0.03, 0.06])
        self.inertia, self.friction = random.uniform(0.05, 0.2, AXES), random.uniform(0.2, 0.8, AXES)
        self.viscous, self.gravity = random.uniform(0.1, 0.4, AXES), random.uniform(0, 1.5, AXES)
        self.load = random.uniform(0.3, 0.9, AXES)
        self.noise = 10.0 ** random.uniform(-2.5, -1.3, len(NAMES))
        self.heavy = random.random(len(NAMES)) < 0.35
        self.scale = 10.0 ** random.uniform(-1, 2, len(NAMES))

    def run(self, seed: int, fault: str = "", late: float = 0.0) -> Samples:
        """Give a run, (n, 8) at 25 Hz, that begins `late` s after the recording does."""
        random = np.random.default_rng([self.seed, seed, 61])
        steps = self._steps(random, fault)
        mass, warm = random.normal(1, 0.02), random.normal(1, 0.03)
        middle = len(steps) // 2
        onset = sum(moves + pause for _, moves, pause, _ in steps[:middle]) + late
        position, held = self._motion(steps, late)
        count = len(position)
        at = np.arange(count) / RATE
        after = at >= onset
        axis, sign = int(random.integers(AXES)), random.choice((-1, 1))
        if fault == "oscillation":  # a loop of control that is badly tuned, or a gear that is loose
            position[after, axis] += 0.04 * np.sin(2 * np.pi * random.uniform(1, 3) * at[after])
        friction = np.ones((count, AXES))
        if fault == "wear":
            friction[:, axis] = 1.6
        load = held * mass * (1.5 if fault == "wrong object" else 1.0)
        current = self._current(position, friction * warm, load)
        vacuum = np.convolve(held, np.exp(-np.arange(12) / 3) / 3.5, mode="full")[:count] * random.normal(1, 0.01)
        supply = random.normal(1, 0.01)
        power = 1 + np.abs(current).sum(axis=1) * supply + 0.5 * vacuum
        values = np.column_stack((position, current, vacuum, power))
        values += 0.3 * self.noise * random.standard_normal(len(NAMES))
        moving = values.std(axis=0)
        values += self._noise(random, count)
        channel = int(random.integers(len(NAMES)))
        self._break(values, fault, after, channel, axis, sign, moving, random)
        return Samples(values * self.scale, at, NAMES)

    def _steps(self, random: np.random.Generator, fault: str) -> list[Step]:
        steps = list(self.steps)
        middle = len(steps) // 2
        if fault == "missing step":
            del steps[middle]
        elif fault == "extra step":
            steps.insert(middle, (steps[middle - 1][0] + random.uniform(0.2, 0.5, AXES), 0.8, 0.2, steps[middle][3]))
        vary = 1 + self.looseness * random.standard_normal((len(steps), 2))
        return [
            (goal, moves * times[0], pause * max(0.1, times[1] + self.looseness * times[1]), holds)
            for (goal, moves, pause, holds), times in zip(steps, vary, strict=True)
        ]

    def _motion(self, steps: list[Step], late: float) -> tuple[Floats, Floats]:
        """Give position (n, axes) and whether the part is held (n,)."""
        ends = late + np.cumsum([moves + pause for _, moves, pause, _ in steps])
        at = np.arange(round((ends[-1] + 0.3) * RATE)) / RATE
        position, held, begin = np.tile(self.home, (len(at), 1)), np.zeros(len(at)), late
        before = self.home
        for (goal, moves, _, holds), end in zip(steps, ends, strict=True):
            share = np.clip((at - begin) / moves, 0, 1)
            course = share**3 * (10 - 15 * share + 6 * share**2)  # least jerk: Flash and Hogan 1985
            inside = at >= begin
            position[inside] = (before + course[:, None] * (goal - before))[inside]
            held[inside] = holds
            begin, before = end, goal
        return position, held

    def _current(self, position: Floats, friction: Floats, load: Floats) -> Floats:
        velocity = np.gradient(position, 1 / RATE, axis=0)
        acceleration = np.gradient(velocity, 1 / RATE, axis=0)
        rubs = self.friction * np.tanh(velocity / 0.05) + self.viscous * velocity
        weighs = (self.gravity + self.load * load[:, None]) * np.cos(position)
        inert = (self.inertia + 0.1 * load[:, None]) * acceleration
        return np.asarray(inert + friction * rubs + weighs)

    def _noise(self, random: np.random.Generator, count: int) -> Floats:
        white = random.standard_normal((count, len(NAMES)))
        tails = random.standard_t(3.0, (count, len(NAMES))) / np.sqrt(3.0)
        return np.asarray(np.where(self.heavy, tails, white) * self.noise * random.normal(1, 0.1))

    def _break(
        self, values: Floats, fault: str, after: Floats, channel: int, axis: int, sign: int, moving: Floats,
        random: np.random.Generator,
    ) -> None:  # fmt: skip
        """Put a fault of a sensor into the values; those of the arm are in its motion."""
        rows = np.flatnonzero(after)
        size = moving[channel]
        if fault == "offset":
            values[rows, channel] += 0.3 * size * sign
        elif fault == "spike":
            values[rows[:3], channel] += 3 * size * sign
        elif fault == "stuck":
            values[rows[: round(1.5 * RATE)], channel] = values[rows[0], channel]
        elif fault == "vibration":
            values[rows, channel] += 0.15 * size * np.sin(2 * np.pi * random.uniform(4, 9) * rows / RATE)
        elif fault == "late":
            values[rows, channel] = values[rows - round(0.25 * RATE), channel]
        elif fault == "swapped":
            one, other = random.choice(AXES, 2, replace=False)
            values[np.ix_(rows, [one, other])] = values[np.ix_(rows, [other, one])]
        elif fault == "decoupled":  # the motor no longer moves its axis: the current goes on, by another course
            moved = values[rows, AXES + axis].copy()
            values[rows, AXES + axis] = moved[::-1]
        elif fault == "dropout":
            values[rows[: round(0.4 * RATE)], channel] = 0.0
