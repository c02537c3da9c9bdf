"""Comparison of detectors on a user's own runs: false alarms, faults found, latency, cost; a choice by a stated rule.

Every figure is of runs that the detector has not learned from. False alarms: each run against thresholds that the
scores of the other runs set. Faults: each kind and size of `fame.monitor.pipeline.faults` is put into runs; it is found
if an alarm begins between its onset and the end. Latency counts from the onset. Cost is that of the loss of two windows
at a time, as in a running node, per sample.

The best detector keeps the rate of false alarms that was asked for, as far as chance tells; among these, it finds the
most faults; among these, it is named first: the cost depends on what else a machine does, and the same runs are to give
the same detector. A choice by the runs that set the thresholds favours detectors with low ones; so the rate is divided
among all detectors that could be chosen (`fame.monitor.calibration`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from fame.dataclasses import dataclass, replace
from fame.errors import ConfigError
from fame.intervals import interval
from fame.monitor.calibration import FEWEST, measured_alarms
from fame.monitor.pipeline.detectors import DETECTORS, is_class, split_rule
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.train import Training, fit, repeats
from fame.monitor.pipeline.trained_model import TrainedModel
from fame.monitor.pipeline.training_checks import memorised

ALL = (*DETECTORS, "any of phase, knn", "any of phase, knn, mahalanobis")
"""What is compared if the user asks."""
REPEATED = ("mahalanobis", "knn", "phase", "any of phase, knn", "any of phase, knn, mahalanobis")
OTHERS = ("mahalanobis", "knn", "any of knn, mahalanobis")
"""What is compared without a word, of runs that repeat or name elements of the mission, and of others: the simplest
first, which also cost the least."""
FEW = "mahalanobis"
"""What fewer than `FEWEST` runs get."""
CHANCE = 0.05
"""Probability, by chance alone, of so many false alarms, below which they are too many."""
RULE = (
    "the best has not learned its runs by heart and keeps the rate of false alarms, then finds the most injected "
    "faults, then is named first"
)


@dataclass(frozen=True, slots=True)
class Compared:
    """The figures of one detector. `found`: kind and size of fault, found, of how many; `latency` is the median (s),
    None if nothing was found; `cost` in us per sample; `by_heart`: training refuses it, see `memorised`."""

    detector: str
    runs: int
    false_alarms: int
    asked: float
    found: Sequence[tuple[str, str, int, int]]
    latency: float | None
    cost: float
    by_heart: bool = False

    @property
    def kinds(self) -> Mapping[str, int]:
        """Faults found, by kind."""
        counts: dict[str, int] = {}
        for kind, _, found, _ in self.found:
            counts[kind] = counts.get(kind, 0) + found
        return counts

    @property
    def faults(self) -> int:
        """The faults that were put in."""
        return sum(tried for *_, tried in self.found)

    @property
    def order(self) -> tuple[float, ...]:
        """The smallest is the best; of equal ones the one that was named first."""
        from scipy.stats import binom

        too_many = binom.sf(self.false_alarms - 1, self.runs, self.asked) < CHANCE
        return self.by_heart, bool(too_many), -sum(self.kinds.values())

    def to_plain(self) -> dict[str, Any]:
        """Return all values as plain data."""
        return {
            "detector": self.detector, "runs": self.runs, "false alarms": self.false_alarms,
            "interval": list(interval(self.false_alarms, self.runs)), "found": dict(self.kinds),
            "faults": self.faults, "latency": self.latency, "cost": self.cost,
        }  # fmt: skip


def best(
    runs: Sequence[Samples],
    config: Training,
    detectors: Sequence[str] = (),
    report: Callable[[str], object] = lambda text: None,
) -> TrainedModel:
    """Return the model of the best detector, with the comparison in its conditions; without `detectors`, of those that
    suit the runs. Raises ConfigError."""
    if not detectors and len(runs) < FEWEST:
        model = fit(runs, replace(config, detector=FEW), report=report, faults=True)
        return replace(model, conditions={**model.conditions, "chosen": f"the runs are fewer than {FEWEST}"})
    compared = compare(runs, config, detectors or suited(runs), report)
    (item, model), *_ = compared
    rivals = sum(each.by_heart == item.by_heart for each, _ in compared)
    found = f"it finds {sum(item.kinds.values())} of {item.faults} injected faults, the most of {rivals} detectors"
    if rivals < len(compared):
        found += " that have not learned the runs by heart"
    told = {"chosen": found, "compared": [each.to_plain() for each, _ in compared]}
    return replace(model, conditions={**model.conditions, **told})


def suited(runs: Sequence[Samples]) -> tuple[str, ...]:
    """Return the detectors to compare for runs of which nothing else is known."""
    return REPEATED if repeats(runs) or all(run.elements for run in runs) else OTHERS


def compare(
    runs: Sequence[Samples],
    config: Training,
    detectors: Sequence[str] = ALL,
    report: Callable[[str], object] = lambda text: None,
) -> list[tuple[Compared, TrainedModel]]:
    """Compare detectors, the best one first; those that refuse the runs are left out.

    Raises ConfigError for fewer than four runs, or if every detector refuses them.
    """
    if len(runs) < 4:
        many = "1 run" if len(runs) == 1 else f"{len(runs)} runs"
        raise ConfigError(f"has {many}; at least 4 are needed to compare detectors", element="Training")
    found, refused = [], None
    share = len({part for name in detectors for part in ([name] if is_class(name) else split_rule(name)[1])})
    for name in detectors:
        report(f"{name}: {len(runs)} runs")
        try:
            found.append(_compared(runs, replace(config, detector=name, share=share)))
        except ConfigError as error:
            report(f"{name}: {error.text}")
            refused = error
    if refused is not None and not found:
        raise refused
    return sorted(found, key=lambda pair: pair[0].order)


def _compared(runs: Sequence[Samples], config: Training) -> tuple[Compared, TrainedModel]:
    model = fit(runs, config, faults=True)
    assert model.calibration is not None
    alarms, scored = measured_alarms(model.calibration), model.calibration.runs
    found = tuple((kind, size, count, tried) for kind, size, count, tried in model.conditions["found"])
    asked, latency = model.calibration.asked, model.conditions["latency"]
    by_heart = bool(memorised(model))
    return Compared(config.detector, scored, alarms, asked, found, latency, _cost(model, config), by_heart), model


def _cost(model: TrainedModel, config: Training) -> float:
    """Measure the processor time of the loss, us per sample."""
    windows = np.random.default_rng(0).standard_normal((2, config.window, len(model.columns)))
    model.loss(windows)
    began = time.process_time()
    calls = 50
    for _ in range(calls):
        model.loss(windows)
    return 1e6 * (time.process_time() - began) / (calls * 2 * config.stride)
