"""Detectors of FAME beside the usual ones, on generated machines: python benchmarks/phases.py [SEED ...].

Each method learns from the same 19 undisturbed runs of a machine, and has a threshold by the same conformal rule at
0.05 false alarms per run, over left-out folds. It is then judged on further runs: undisturbed, and with each fault of
`machines`. A fault is found if the run raises an alarm. Without seeds, the frozen machines are judged.

`golden run`: squares of the deviation from mean and standard deviation by time since the start, averaged over a window;
`T2`: Hotelling's statistic of windows with Ledoit-Wolf's covariance; `kNN`: distance to the 5th nearest window;
`IsolationForest`; `PCA-Q`: squared error of the reconstruction by components with 95 % of the variance.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from machines import FAULTS, FROZEN, Machine

from fame.intervals import interval
from fame.monitor.arrays import Floats
from fame.monitor.calibration import calibrate_runs
from fame.monitor.pipeline.filters import Windower
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.train import Training, fit, losses

WINDOW, STRIDE, ASKED, FOLDS = 25, 5, 0.05, 5
TRAIN, UNDISTURBED, FAULTY = range(19), range(100, 140), range(200, 208)
OWN = ("phase", "mahalanobis")

Score = Callable[[Samples], float]


def windows(run: Samples) -> Floats:
    """Give the windows of a run, flat (n, window x channels)."""
    cut = Windower().feed(run, WINDOW, STRIDE).values
    return np.asarray(cut.reshape(len(cut), -1))


def _scaled(runs: list[Samples]) -> tuple[Floats, Callable[[Samples], Floats]]:
    every = np.concatenate([run.values for run in runs])
    mean, scale = every.mean(axis=0), every.std(axis=0)

    def scaled(run: Samples) -> Floats:
        return windows(run.replace((run.values - mean) / scale))

    return np.concatenate([scaled(run) for run in runs]), scaled


def golden(runs: list[Samples]) -> Score:
    count = min(map(len, runs))
    every = np.stack([run.values[:count] for run in runs])
    mean, deviation = every.mean(axis=0), every.std(axis=0, ddof=1)

    def score(run: Samples) -> float:
        rows = min(count, len(run))
        squares = ((run.values[:rows] - mean[:rows]) / deviation[:rows]) ** 2
        cut = Windower().feed(Samples(squares, run.stamps[:rows]), WINDOW, STRIDE).values
        return float(cut.mean(axis=1).max())

    return score


def hotelling(runs: list[Samples]) -> Score:
    from sklearn.covariance import LedoitWolf

    every, scaled = _scaled(runs)
    found = LedoitWolf().fit(every)
    return lambda run: float(found.mahalanobis(scaled(run)).max())


def neighbours(runs: list[Samples]) -> Score:
    from scipy.spatial import cKDTree
    from sklearn.decomposition import PCA

    every, scaled = _scaled(runs)
    axes = PCA(10).fit(every)
    tree = cKDTree(axes.transform(every))
    return lambda run: float(tree.query(axes.transform(scaled(run)), k=5)[0][:, -1].max())


def forest(runs: list[Samples]) -> Score:
    from sklearn.ensemble import IsolationForest

    every, scaled = _scaled(runs)
    found = IsolationForest(random_state=0).fit(every)
    return lambda run: float(-found.score_samples(scaled(run)).min())


def residual(runs: list[Samples]) -> Score:
    from sklearn.decomposition import PCA

    every, scaled = _scaled(runs)
    axes = PCA(0.95).fit(every)

    def score(run: Samples) -> float:
        given = scaled(run)
        return float(((given - axes.inverse_transform(axes.transform(given))) ** 2).sum(axis=1).max())

    return score


USUAL = {
    "golden run": golden, "T2 Ledoit-Wolf": hotelling, "kNN": neighbours, "IsolationForest": forest, "PCA-Q": residual,
}  # fmt: skip


def usual_alarm(learn: Callable[[list[Samples]], Score], runs: list[Samples]) -> Callable[[Samples], bool]:
    """Give what tells whether a usual method raises an alarm, by the largest of its left-out scores that promises."""
    order, scores = np.random.default_rng(0).permutation(len(runs)), np.zeros(len(runs))
    for held in np.array_split(order, FOLDS):
        score = learn([run for number, run in enumerate(runs) if number not in held])
        scores[held] = [score(runs[number]) for number in held]
    threshold, whole = calibrate_runs(scores, ASKED).thresholds[0], learn(runs)
    return lambda run: whole(run) > threshold


def own_alarm(detector: str, runs: list[Samples]) -> Callable[[Samples], bool]:
    """Give what tells whether a detector of FAME raises an alarm."""
    config = Training(detector=detector, window=WINDOW, stride=STRIDE, false_alarms=f"{ASKED} per run", folds=FOLDS)
    model = fit(runs, config)
    return lambda run: bool((losses(model, run, STRIDE).values > np.array(model.thresholds)).any())


def judged(name: str, alarm: Callable[[Samples], bool], machine: Machine) -> dict[str, list[int]]:
    """Count alarms and runs, of undisturbed runs and of each fault."""
    counts = {"undisturbed": [sum(alarm(machine.run(seed)) for seed in UNDISTURBED), len(UNDISTURBED)]}
    for fault in FAULTS:
        counts[fault] = [sum(alarm(machine.run(seed, fault)) for seed in FAULTY), len(FAULTY)]
    print(f"machine {machine.seed}, {name}: {counts}", file=sys.stderr)
    return counts


def main(seeds: list[int]) -> None:
    totals: dict[str, Any] = {}
    for machine in map(Machine, seeds or FROZEN):
        runs = [machine.run(seed) for seed in TRAIN]
        made = {name: usual_alarm(learn, runs) for name, learn in USUAL.items()}
        made |= {name: own_alarm(name, runs) for name in OWN}
        for name, alarm in made.items():
            for kind, counts in judged(name, alarm, machine).items():
                totals.setdefault(name, {}).setdefault(kind, np.zeros(2, int))
                totals[name][kind] += counts
    print(f"| method | false alarms | faults found | {' | '.join(FAULTS)} |\n|{' --- |' * (len(FAULTS) + 3)}")
    for name, found in totals.items():
        faults = sum(found[fault] for fault in FAULTS)
        cells = [f"{found[fault][0]} of {found[fault][1]}" for fault in FAULTS]
        print(f"| {name} | {told(found['undisturbed'])} | {told(faults)} | {' | '.join(cells)} |")


def told(counts: Any) -> str:
    """Give a rate with its 95 % interval."""
    count, total = map(int, counts)
    low, high = interval(count, total)
    return f"{count} of {total} ({100 * low:.0f} to {100 * high:.0f} %)"


if __name__ == "__main__":
    main([int(text) for text in sys.argv[1:]])
