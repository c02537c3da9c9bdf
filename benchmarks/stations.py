"""Generated filling stations, on which detectors are developed: valves, a pump, a heater, and faults of stated kinds.

A station is a seed. Its recipe is a list of steps, each with the speed of the pump, the valves that are open and the
goal of the heater. Flow, pressure, level and temperature follow with time constants of their own; some stations have
more sensors of these. From run to run vary viscosity, the supply, offsets, and how long each step takes (0.1 to 8 %).
Noise is Gaussian or Student's t with three degrees of freedom, white or coloured. Nothing here judges: that is for
`cells`.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from fame.monitor.arrays import Floats
from fame.monitor.pipeline.processor import Samples

RATE = 20.0
FAULTS = (
    "offset", "spike", "stuck", "noise", "drift", "late", "swapped", "clogged", "leak", "slow valve", "missing step",
    "extra step", "dropout",
)  # fmt: skip
Step = tuple[float, Floats, float, float]
"""Speed of the pump, valves, goal of the heater, seconds."""


class Station:
    """A station; `run` gives one of its runs."""

    def __init__(self, seed: int) -> None:
        random = np.random.default_rng([seed, 113])
        self.seed, self.valves = seed, int(random.integers(1, 4))
        self.steps: list[Step] = [
            (random.choice([0.0, *random.uniform(0.3, 1, 3)]), (random.random(self.valves) < 0.6) * 1.0,
             random.uniform(0.2, 1), random.uniform(0.8, 3))
            for _ in range(int(random.integers(5, 9)))
        ]  # fmt: skip
        self.copies = int(random.integers(0, 3))
        self.channels = 5 + self.valves + self.copies
        self.names = tuple(f"sensor_{n}" for n in range(self.channels))
        self.looseness = random.choice([0.001, 0.01, 0.03, 0.08])
        self.constants = random.uniform([0.1, 0.1, 0.4], [0.3, 0.4, 1.5])
        self.noise = 10.0 ** random.uniform(-2.7, -1.2, self.channels)
        self.heavy = random.random(self.channels) < 0.35
        self.colour = random.choice([0.0, 0.0, 0.7], self.channels)
        self.scale = 10.0 ** random.uniform(-1, 2, self.channels)

    def run(self, seed: int, fault: str = "") -> Samples:
        """Give a run, (n, channels) at 20 Hz."""
        random = np.random.default_rng([self.seed, seed, 127])
        steps, middle = list(self.steps), len(self.steps) // 2
        if fault == "missing step":
            del steps[middle]
        elif fault == "extra step":
            steps.insert(middle, steps[int(random.integers(len(steps)))])
        lasts = np.array([step[3] for step in steps]) * (1 + self.looseness * random.standard_normal(len(steps)))
        counts = np.maximum(2, np.round(lasts * RATE)).astype(int)
        speed, valves, goal = (np.repeat([step[n] for step in steps], counts, axis=0) for n in range(3))
        after = np.arange(len(speed)) >= counts[:middle].sum()
        values = self._course(random, speed, valves, goal, fault, after)
        moving = values.std(axis=0)
        values += 0.3 * self.noise * random.standard_normal(self.channels) + self._noise(random, len(values))
        self._break(values, fault, np.flatnonzero(after), np.maximum(moving, 0.1), random)
        return Samples(values * self.scale, np.arange(len(values)) / RATE, self.names)

    def _course(
        self, random: np.random.Generator, speed: Floats, valves: Floats, goal: Floats, fault: str, after: Floats
    ) -> Floats:
        viscosity, supply = random.normal(1, 0.02), random.normal(1, 0.01)
        turn, fill, warm = self.constants
        opened = np.column_stack([_lag(each, turn * (4 if fault == "slow valve" else 1)) for each in valves.T])
        pump = _lag(speed * supply, turn)
        width = opened.mean(axis=1) * np.where(after & (fault == "clogged"), 0.7, 1.0)
        flow = _lag(pump * width / viscosity, fill)
        pressure = _lag(pump * (1.2 - width) * np.where(after & (fault == "leak"), 0.75, 1.0), fill)
        level = np.cumsum(flow - 0.2) / RATE / 3
        heat = _lag(goal, warm)
        current = pump * (0.4 + 0.6 * pressure) * viscosity + 0.2 * np.gradient(pump) * RATE
        every = np.column_stack((flow, pressure, level, heat, current, opened))
        return np.hstack((every, every[:, : self.copies]))

    def _noise(self, random: np.random.Generator, count: int) -> Floats:
        white = random.standard_normal((count, self.channels))
        tails = random.standard_t(3.0, (count, self.channels)) / np.sqrt(3.0)
        mixed = np.where(self.heavy, tails, white)
        for channel, colour in enumerate(self.colour):
            mixed[:, channel] = lfilter([np.sqrt(1 - colour**2)], [1, -colour], mixed[:, channel])
        return np.asarray(mixed * self.noise * random.normal(1, 0.1))

    def _break(self, values: Floats, fault: str, rows: Floats, moving: Floats, random: np.random.Generator) -> None:
        """Put a fault of a sensor into the values; those of the station are in its course."""
        channel, sign = int(random.integers(self.channels)), random.choice((-1, 1))
        size = moving[channel] * sign
        if fault == "offset":
            values[rows, channel] += 0.3 * size
        elif fault == "spike":
            values[rows[:2], channel] += 3 * size
        elif fault == "stuck":
            values[rows[: round(1.5 * RATE)], channel] = values[rows[0], channel]
        elif fault == "noise":
            values[rows, channel] += 0.15 * size * random.standard_normal(len(rows))
        elif fault == "drift":
            values[rows, channel] += 0.6 * size * np.linspace(0, 1, len(rows))
        elif fault == "late":
            values[rows, channel] = values[rows - round(0.3 * RATE), channel]
        elif fault == "swapped":
            one, other = random.choice(5, 2, replace=False)
            values[np.ix_(rows, [one, other])] = values[np.ix_(rows, [other, one])]
        elif fault == "dropout":
            values[rows[: round(0.4 * RATE)], channel] = 0.0


def _lag(goal: Floats, constant: float) -> Floats:
    """Follow a goal with a time constant (s), from its first value."""
    share = 1 - np.exp(-1 / (RATE * constant))
    return np.asarray(lfilter([share], [1, share - 1], goal - goal[0]) + goal[0])
