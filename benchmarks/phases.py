"""Detectors of FAME beside the usual ones, on generated machines: python benchmarks/phases.py [SEED ...].

Each method learns from the same 19 undisturbed runs of a machine, and has a threshold by the same conformal rule at
0.05 false alarms per run, over left-out folds (`baselines`). It is then judged on further runs: undisturbed, and with
each fault of `machines`. A fault is found if the run raises an alarm. Without seeds, the frozen machines are judged.
The first table has the shares, with 95 % intervals over machines; the second, for each fault, the usual method that
finds the most of it, and how many times as many `phase` finds.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from baselines import FOLDS, USUAL, with_threshold
from machines import FAULTS, FROZEN, Machine
from shares import over_clusters, told

from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.train import Training, fit, losses
from fame.monitor.pipeline.trained_model import TrainedModel

WINDOW, STRIDE, ASKED = 25, 5, 0.05
TRAIN, UNDISTURBED, FAULTY = range(19), range(100, 140), range(200, 208)
OWN = ("phase", "mahalanobis", "any of phase, mahalanobis")
Tables = dict[str, dict[str, Any]]
"""Alarms and runs of each method and kind of run (machines, 2)."""


def usual_alarm(name: str, runs: list[Samples]) -> Callable[[Samples], bool]:
    """Give what tells whether a usual method raises an alarm."""
    score, threshold = with_threshold(USUAL[name], runs, WINDOW, STRIDE, ASKED, whole_runs=True)
    return lambda run: bool(score(run).max() > threshold)


def own_model(detector: str, runs: list[Samples]) -> TrainedModel:
    """Train a detector of FAME."""
    config = Training(detector=detector, window=WINDOW, stride=STRIDE, false_alarms=f"{ASKED} per run", folds=FOLDS)
    return fit(runs, config)


def own_alarm(detector: str, runs: list[Samples]) -> Callable[[Samples], bool]:
    """Give what tells whether a detector of FAME raises an alarm."""
    model = own_model(detector, runs)
    return lambda run: bool((losses(model, run, STRIDE).values > np.array(model.thresholds)).any())


def judged(name: str, alarm: Callable[[Samples], bool], machine: Machine) -> dict[str, list[int]]:
    """Count alarms and runs, of undisturbed runs and of each fault."""
    counts = {"undisturbed": [sum(alarm(machine.run(seed)) for seed in UNDISTURBED), len(UNDISTURBED)]}
    for fault in FAULTS:
        counts[fault] = [sum(alarm(machine.run(seed, fault)) for seed in FAULTY), len(FAULTY)]
    print(f"machine {machine.seed}, {name}: {counts}", file=sys.stderr)
    return counts


def main(seeds: list[int]) -> None:
    found: dict[str, dict[str, list[list[int]]]] = {}
    for machine in map(Machine, seeds or FROZEN):
        runs = [machine.run(seed) for seed in TRAIN]
        made = {name: usual_alarm(name, runs) for name in USUAL}
        made |= {name: own_alarm(name, runs) for name in OWN}
        for name, alarm in made.items():
            for kind, counts in judged(name, alarm, machine).items():
                found.setdefault(name, {}).setdefault(kind, []).append(counts)
    tables = {name: {kind: np.array(counts) for kind, counts in kinds.items()} for name, kinds in found.items()}
    print("\n".join((*shares(tables), "", *ratios(tables))))


def shares(tables: Tables) -> Iterator[str]:
    """Give the table of shares: false alarms, faults found, and each fault."""
    yield f"| method | false alarms | faults found | {' | '.join(FAULTS)} |\n|{' --- |' * (len(FAULTS) + 3)}"
    for name, counts in tables.items():
        faults = np.sum([counts[fault] for fault in FAULTS], axis=0)
        cells = ["{} of {}".format(*counts[fault].sum(axis=0)) for fault in FAULTS]
        yield f"| {name} | {told(counts['undisturbed'])} | {told(faults)} | {' | '.join(cells)} |"


def ratios(tables: Tables) -> Iterator[str]:
    """Give the table of each fault: the usual method that finds the most, `phase`, and the ratio of both."""
    yield "| fault | most by a usual method | `phase` | times as many |\n| --- | --- | --- | --- |"
    for fault in FAULTS:
        best = max(USUAL, key=lambda name: tables[name][fault][:, 0].sum())
        usual, own = tables[best][fault], tables["phase"][fault]
        pair = np.stack([own[:, 0], usual[:, 0]], axis=1)
        low, high = over_clusters(pair, ratio)
        times = f"{ratio(pair.sum(axis=0)):.2f} ({low:.2f} to {high:.2f})"
        yield f"| {fault} | {best}: {told(usual)} | {told(own)} | {times} |"


def ratio(counts: Any) -> float:
    """Give the ratio of two counts; of none in the second, as of one."""
    return float(counts[0] / max(counts[1], 1))


if __name__ == "__main__":
    main([int(text) for text in sys.argv[1:]])
