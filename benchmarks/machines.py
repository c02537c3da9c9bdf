"""Generated machines that repeat a task, with heavy-tailed noise, and faults of stated sizes.

A machine is a seed. It has `CHANNELS` channels, each a smooth course over the task with steps where a movement begins.
Noise of a channel is Gaussian or Student's t with 2.5 to 5 degrees of freedom, white or coloured, and partly shared by
neighbours. From run to run vary gain, offset, duration (0.3 %) and level of noise. A fault begins at `ONSET` of the
task, in one channel, in units of the deviation of its noise; `weak` faults are such that no method finds all of them.
Seeds 0 to 99 are for building detectors; those of `FROZEN` are for judging them, and were not looked at before (2000 to
2005 first; the others when the detectors were finished, because six machines say little about all machines).
"""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from fame.monitor.arrays import Floats
from fame.monitor.pipeline.processor import Samples

RATE, SECONDS, CHANNELS, ONSET = 50.0, 12.0, 6, 0.45
FAULTS = ("offset", "vibration", "spike", "stuck", "late", "uncoupled")
FROZEN = tuple(range(2000, 2030))
NAMES = tuple(f"channel_{n}" for n in range(CHANNELS))


class Machine:
    """A machine; `run` gives one of its runs."""

    def __init__(self, seed: int) -> None:
        random = np.random.default_rng([seed, 7])
        self.seed = seed
        self.waves = random.normal(0, 1, (CHANNELS, 8)) / np.arange(1, 9)
        self.phases = random.uniform(0, 2 * np.pi, (CHANNELS, 8))
        self.edges = np.sort(random.uniform(0.1, 0.9, (CHANNELS, 3)), axis=1)
        self.steps = random.normal(0, 0.7, (CHANNELS, 3))
        self.noise = 10.0 ** random.uniform(-1.5, -0.5, CHANNELS)
        self.freedom = random.choice([2.5, 3.0, 5.0, np.inf], CHANNELS)
        self.colour = random.choice([0.0, 0.0, 0.6, 0.9], CHANNELS)
        self.shared = random.uniform(0, 0.6, CHANNELS)
        self.size = 10.0 ** random.uniform(-2, 2, CHANNELS)

    def run(self, seed: int, fault: str = "") -> Samples:
        """Give a run: (n, channels) at 50 Hz."""
        random = np.random.default_rng([self.seed, seed, 11])
        count = round(SECONDS * RATE * (1 + 0.003 * random.standard_normal()))
        task = np.arange(count) / count
        channel, onset = int(random.integers(CHANNELS)), round(ONSET * count)
        noise = self._noise(random, count, channel if fault == "uncoupled" else -1, onset)
        moved = np.repeat(task[:, None], CHANNELS, axis=1)
        if fault == "late":
            moved[onset:, channel] -= 0.03
        values = self.course(moved) * random.normal(1, 0.01, CHANNELS) + noise * random.normal(1, 0.1)
        values += 0.3 * self.noise * random.standard_normal(CHANNELS)
        deviation = float(self.noise[channel])
        sign = random.choice((-1, 1))
        if fault == "offset":
            values[onset:, channel] += 3 * deviation * sign
        elif fault == "vibration":
            cycle = 2 * np.pi * random.uniform(4, 9) * np.arange(count - onset) / RATE
            values[onset:, channel] += 2.5 * deviation * np.sin(cycle)
        elif fault == "spike":
            values[onset : onset + 4, channel] += 12 * deviation * sign
        elif fault == "stuck":
            values[onset : onset + 150, channel] = values[onset, channel]
        return Samples(values * self.size, np.arange(count) / RATE, NAMES)

    def course(self, task: Floats) -> Floats:
        """Give the undisturbed course (n, channels) at places of the task, 0 to 1."""
        order = np.arange(1, 9)
        waves = np.sin(2 * np.pi * order * task[:, :, None] + self.phases) * self.waves
        steps = self.steps / (1 + np.exp(-(task[:, :, None] - self.edges) / 0.004))
        return np.asarray(waves.sum(axis=2) + steps.sum(axis=2))

    def _noise(self, random: np.random.Generator, count: int, uncoupled: int, onset: int) -> Floats:
        white = random.standard_normal((count, CHANNELS))
        for channel, freedom in enumerate(self.freedom):
            if np.isfinite(freedom):
                white[:, channel] = random.standard_t(freedom, count) / np.sqrt(freedom / (freedom - 2))
        for channel, colour in enumerate(self.colour):
            white[:, channel] = lfilter([np.sqrt(1 - colour**2)], [1, -colour], white[:, channel])
        share = np.repeat(self.shared[None], count, axis=0)
        if uncoupled >= 0:
            share[onset:, uncoupled] *= -1  # what it shares with its neighbour turns over
        return np.asarray((np.sqrt(1 - share**2) * white + share * np.roll(white, 1, axis=1)) * self.noise)
