"""Comparison of detectors on a user's own runs: false alarms, faults found, latency, cost; a choice by a stated rule.

Every figure is of runs that the detector has not learned from. False alarms: each run against thresholds that the
scores of the other runs set. Faults: one of each kind of `FAULTS` is put into each run, in a channel that changes from
run to run, in the middle of the run; it is found if an alarm begins between its onset and the end. Latency counts from
the onset. Cost is that of the loss of two windows at a time, as in a running node, per sample.

The best detector has the fewest false alarms; among these, it finds the most faults; among these, it is the cheapest.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from fame.dataclasses import dataclass, replace
from fame.errors import ConfigError
from fame.intervals import interval
from fame.monitor.arrays import Floats
from fame.monitor.calibration import false_alarm_rate, left_out_thresholds
from fame.monitor.data_files import rate_of
from fame.monitor.pipeline.detectors import DETECTORS
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.train import Training, left_out, losses, prepared

Inject = Callable[[Floats, int, float, np.random.Generator], Floats]
"""Gives the values of a channel (n,) with a fault from a row on; the float is the deviation of the channel."""


def _spike(values: Floats, onset: int, deviation: float, random: np.random.Generator) -> Floats:
    values[onset : onset + 3] += 4 * deviation * random.choice((-1, 1))
    return values


def _offset(values: Floats, onset: int, deviation: float, random: np.random.Generator) -> Floats:
    values[onset:] += 0.5 * deviation * random.choice((-1, 1))
    return values


def _stuck(values: Floats, onset: int, deviation: float, random: np.random.Generator) -> Floats:
    values[onset:] = values[onset]
    return values


def _vibration(values: Floats, onset: int, deviation: float, random: np.random.Generator) -> Floats:
    phase = 2 * np.pi * random.uniform(0.08, 0.2) * np.arange(len(values) - onset)
    values[onset:] += 0.3 * deviation * np.sin(phase)
    return values


def _late(values: Floats, onset: int, deviation: float, random: np.random.Generator) -> Floats:
    shift = max(1, len(values) // 50)
    values[onset:] = values[onset - shift : len(values) - shift]
    return values


FAULTS: Mapping[str, Inject] = {
    "spike": _spike, "offset": _offset, "stuck": _stuck, "vibration": _vibration, "late": _late,
}  # fmt: skip
"""A spike of 4 deviations for three samples, an offset of half a deviation, a value that stays, a vibration of 0.3
deviations at 0.08 to 0.2 of the rate, and a channel that is late by 2 % of the run."""


@dataclass(frozen=True, slots=True)
class Compared:
    """The figures of one detector. `latency` is the median (s), None if nothing was found; `cost` in us per sample."""

    detector: str
    runs: int
    false_alarms: int
    found: Mapping[str, int]
    latency: float | None
    cost: float

    @property
    def faults(self) -> int:
        """The faults that were put in."""
        return self.runs * len(self.found)

    @property
    def order(self) -> tuple[float, ...]:
        """The smallest is the best."""
        return self.false_alarms, -sum(self.found.values()), self.cost

    def to_plain(self) -> dict[str, Any]:
        """Return all values as plain data."""
        return {
            "detector": self.detector, "runs": self.runs, "false alarms": self.false_alarms,
            "interval": list(interval(self.false_alarms, self.runs)), "found": dict(self.found),
            "faults": self.faults, "latency": self.latency, "cost": self.cost,
        }  # fmt: skip


def compare(
    runs: Sequence[Samples],
    config: Training,
    detectors: Sequence[str] = DETECTORS,
    report: Callable[[str], object] = lambda text: None,
) -> list[Compared]:
    """Compare detectors, the best one first. Raises ConfigError for fewer than four runs."""
    if len(runs) < 4:
        many = "1 run" if len(runs) == 1 else f"{len(runs)} runs"
        raise ConfigError(f"has {many}; at least 4 are needed to compare detectors", element="Training")
    found = []
    for name in detectors:
        report(f"{name}: {len(runs)} runs")
        found.append(_compared(runs, replace(config, detector=name)))
    return sorted(found, key=lambda item: item.order)


def _compared(runs: Sequence[Samples], config: Training) -> Compared:
    rate = rate_of(runs)
    filtered = prepared(runs, config)
    deviations = np.concatenate([run.channels() for run in runs]).std(axis=0)
    moving = np.flatnonzero(deviations > 0)
    if not len(moving):
        raise ConfigError("has no channel that moves: nothing to compare", element="Training.Files")
    scores = np.zeros((len(runs), runs[0].channels().shape[1]))
    losses_of: dict[tuple[str, int], Samples] = {}
    for index, model in left_out(filtered, config, rate):
        scores[index] = losses(model, filtered[index], config.stride).values.max(axis=0)
        for kind in FAULTS:
            (run,) = prepared([_faulty(runs[index], index, kind, moving, deviations)], config)
            losses_of[kind, index] = losses(model, run, config.stride)
    seconds = float(np.mean([run.stamps[-1] - run.stamps[0] for run in runs]))
    asked = false_alarm_rate(config.false_alarms, seconds)
    thresholds = left_out_thresholds(scores, asked, config.margin)
    alarms = int((scores > thresholds).any(axis=1).sum())
    found, latencies = dict.fromkeys(FAULTS, 0), list[float]()
    for (kind, index), loss in losses_of.items():
        onset = float(runs[index].stamps[len(runs[index]) // 2])
        above = (loss.values > thresholds[index]).any(axis=1) & (loss.stamps >= onset)
        if above.any():
            found[kind] += 1
            latencies.append(float(loss.stamps[above.argmax()]) - onset)
    latency = float(np.median(latencies)) if latencies else None
    return Compared(config.detector, len(runs), alarms, found, latency, _cost(model, config))


def _faulty(run: Samples, number: int, kind: str, moving: Any, deviations: Floats) -> Samples:
    """Put a fault into the middle of a run."""
    random = np.random.default_rng([number, len(kind)])
    channel, values = int(moving[number % len(moving)]), run.channels().astype(np.float64).copy()
    values[:, channel] = FAULTS[kind](values[:, channel].copy(), len(values) // 2, float(deviations[channel]), random)
    return run.replace(values)


def _cost(model: Any, config: Training) -> float:
    """Measure the processor time of the loss, us per sample."""
    windows = np.random.default_rng(0).standard_normal((2, config.window, len(model.columns)))
    model.loss(windows)
    began = time.process_time()
    calls = 200
    for _ in range(calls):
        model.loss(windows)
    return 1e6 * (time.process_time() - began) / (calls * 2 * config.stride)
