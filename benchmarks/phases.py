"""Detectors of FAME beside the usual ones, on generated machines: python benchmarks/phases.py [SEED ...].

Each method learns from the same 19 undisturbed runs of a machine, and has a threshold by the same conformal rule at
0.05 false alarms per run, over left-out folds (`baselines`). It is then judged on further runs: undisturbed, and with
each fault of `machines`. A fault is found if the run raises an alarm. Without seeds, the frozen machines are judged.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from baselines import FOLDS, USUAL, with_threshold
from machines import FAULTS, FROZEN, Machine

from fame.intervals import interval
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.train import Training, fit, losses

WINDOW, STRIDE, ASKED = 25, 5, 0.05
TRAIN, UNDISTURBED, FAULTY = range(19), range(100, 140), range(200, 208)
OWN = ("phase", "mahalanobis")


def usual_alarm(name: str, runs: list[Samples]) -> Callable[[Samples], bool]:
    """Give what tells whether a usual method raises an alarm."""
    score, threshold = with_threshold(USUAL[name], runs, WINDOW, STRIDE, ASKED, whole_runs=True)
    return lambda run: bool(score(run).max() > threshold)


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
        made = {name: usual_alarm(name, runs) for name in USUAL}
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
