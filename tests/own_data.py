"""Data as a user's own robot gives them: a machine with twelve channels, undisturbed runs, and runs with rare faults.

Channels differ in size, shape and noise: four torques, four currents that follow them, two temperatures that creep, a
pressure with steps, and a vibration. From run to run vary: speed along the task, gain, offsets, noise level, friction,
temperature. Faults begin at `ONSET` (s): a spike, a wrong phase of one movement, a stuck sensor, a small vibration.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from fame.monitor.pipeline.processor import Samples

RATE, SECONDS, ONSET = 100.0, 20.0, 9.0
NAMES = (*(f"torque_{n}" for n in range(4)), *(f"current_{n}" for n in range(4)), "oil", "housing", "pressure", "shake")

Fault = Literal["none", "spike", "wrong phase", "stuck", "vibration"]
FAULTS: tuple[Fault, ...] = ("spike", "wrong phase", "stuck", "vibration")


def run(seed: int, fault: Fault = "none") -> Samples:
    """One run: (n, 12) at 100 Hz."""
    random = np.random.default_rng([seed, 19])
    duration = SECONDS * random.normal(1.0, 0.01)
    stamps = np.arange(round(duration * RATE)) / RATE
    phase = stamps / duration  # 0 ... 1 along the task
    shift = np.zeros((len(stamps), 4))
    if fault == "wrong phase":
        shift[:, seed % 4] = np.where((stamps > ONSET) & (stamps < ONSET + 4), 0.04, 0.0)
    speeds = np.array([2.0, 3.0, 4.0, 5.0])
    angles = 2 * np.pi * speeds * phase[:, None]
    waves = np.sin(angles + 2 * np.pi * speeds * shift) + 0.4 * np.sin(2.3 * angles)
    torques = waves * np.array([40.0, 25.0, 8.0, 3.0]) * random.normal(1.0, 0.02, 4) + random.normal(0, 0.3, 4)
    friction = np.tanh(5 * np.gradient(waves, axis=0) * RATE) * random.normal(1, 0.1, 4)
    torques += np.array([2.0, 1.5, 0.6, 0.3]) * friction
    currents = torques / np.array([18.0, 12.0, 4.0, 1.5]) * random.normal(1.0, 0.02, 4)
    warm = random.normal(0.0, 1.0)
    temperatures = np.column_stack([41 + warm + 1.5 * phase, 30 + 0.5 * warm + 0.4 * phase**2])
    pressure = 6.0 + 0.5 * ((phase % 0.25) < 0.1) + random.normal(0, 0.05)
    shake = 0.05 * np.abs(waves).sum(axis=1)
    values = np.column_stack([torques, currents, temperatures, pressure, shake])
    noise = np.array([0.6, 0.5, 0.2, 0.08, 0.05, 0.05, 0.05, 0.05, 0.1, 0.1, 0.03, 0.02]) * random.normal(1.0, 0.1)
    values = values + noise * random.standard_normal(values.shape)
    broken(values, stamps, fault, seed % 12, noise)
    return Samples(values, stamps, NAMES)


def broken(values: np.ndarray, stamps: np.ndarray, fault: Fault, channel: int, noise: np.ndarray) -> None:
    """Put a fault into one channel."""
    after = stamps >= ONSET
    if fault == "spike":
        values[after.argmax() : after.argmax() + 3, channel] += 1.5 * np.std(values[:, channel]) + 12 * noise[channel]
    elif fault == "stuck":
        values[after, channel % 8] = values[after.argmax(), channel % 8]
    elif fault == "vibration":
        values[after, channel] += 3 * noise[channel] * np.sin(2 * np.pi * 17.0 * stamps[after])
