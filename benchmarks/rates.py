"""The true rate of false alarms of many machines: python benchmarks/rates.py [--machines N] [--runs N] [--train N].

Each generated machine (`machines`) gets a model of its own, learned from a few undisturbed runs at 0.05 false alarms
per run. Its rate is then counted in further undisturbed runs. A model is beyond the conditional bound if its count is
above what the bound allows in 95 of 100 such counts. The pooled rate has an interval over machines (500 resamplings).

Thresholds come from scores of runs that are left out, by models that learned from fewer runs than the one in use. How
much larger these scores are than those of new runs is printed, too: 1 if the size of the folds does not matter.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from scipy.stats import binom

sys.path.insert(0, str(Path(__file__).resolve().parent))
from machines import Machine
from phases import ASKED, STRIDE, own_model
from shares import over_clusters

from fame.monitor.pipeline.train import losses

FIRST = 3000
"""Seed of the first machine: none of these was looked at while building."""


def alarms(seed: int, train: int, runs: int, detector: str) -> tuple[int, float]:
    """Count the alarms of a machine's undisturbed runs; and give the median score of left-out runs in units of that of
    new runs, in the median over channels."""
    machine = Machine(seed)
    model = own_model(detector, [machine.run(number) for number in range(train)])
    new = range(10_000, 10_000 + runs)
    scores = np.array([losses(model, machine.run(number), STRIDE).values.max(axis=0) for number in new])
    ratio = np.median(np.median(model.calibration.scores, axis=0) / np.median(scores, axis=0))
    return int((scores > np.array(model.thresholds)).any(axis=1).sum()), float(ratio)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=200)
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--train", type=int, default=19)
    parser.add_argument("--detector", default="phase")
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    begun = time.monotonic()
    seeds = range(FIRST, FIRST + given.machines)
    work = (delayed(alarms)(seed, given.train, given.runs, given.detector) for seed in seeds)
    found = Parallel(n_jobs=given.jobs)(work)
    counts, ratios = np.array([count for count, _ in found]), [ratio for _, ratio in found]
    rates, bound = counts / given.runs, bound_of(given.train)
    low, high = over_clusters(np.stack([counts, np.full_like(counts, given.runs)], axis=1))
    above = int((counts > binom.ppf(0.95, given.runs, bound)).sum())
    print(f"{given.detector}, {given.train} runs train, {given.runs} judged, {time.monotonic() - begun:.0f} s")
    print(f"pooled rate: {rates.mean():.4f} (95 % over machines: {low:.4f} to {high:.4f}), asked for: {ASKED}")
    low, middle, high = np.quantile(ratios, [0.1, 0.5, 0.9])
    print(f"scores of left-out runs: {middle:.2f} times those of new runs (80 % of machines: {low:.2f} to {high:.2f})")
    print("rates of machines: " + ", ".join(f"{part:.0%} below {np.quantile(rates, part):.3f}" for part in (0.5, 0.9)))
    print(
        f"bound that 90 % of the models keep: {bound:.3f}; above it: {(rates > bound).sum()} of {len(rates)}, "
        f"beyond binomial error: {above}"
    )


def bound_of(train: int) -> float:
    """Give the conditional bound that a card states for so many runs."""
    from fame.monitor.calibration import calibrate_runs

    return calibrate_runs(np.arange(train, dtype=float), ASKED).bound


if __name__ == "__main__":
    main()
