"""The detector that training takes by itself, beside the usual ones: python benchmarks/defaults.py [SEED ...].

Each method learns from the same 19 undisturbed runs of a cell (`cells`), at 0.05 false alarms per run, by the same
conformal rule over left-out folds (`baselines`). It is then judged on further runs: undisturbed, and with each fault. A
fault is found if the run raises an alarm. Without seeds, the frozen cells are judged. `--detectors` adds detectors of
FAME by name. Intervals are over cells.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from baselines import FOLDS, USUAL, with_threshold
from cells import FAULTS, FROZEN, Cell
from shares import over_clusters, told

from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.train import Training, fit, losses

WINDOW, STRIDE, ASKED = 25, 5, 0.05
TRAIN, UNDISTURBED, FAULTY = range(19), range(100, 120), range(200, 206)
KINDS = ("undisturbed", *FAULTS)
DEFAULT = "default"


def methods(runs: list[Samples], own: tuple[str, ...]) -> Iterator[tuple[str, Callable[[Samples], bool]]]:
    """Give each method with what tells whether it raises an alarm."""
    for name, learn in USUAL.items():
        score, threshold = with_threshold(learn, runs, WINDOW, STRIDE, ASKED, whole_runs=True)
        yield name, lambda run, score=score, threshold=threshold: bool(score(run).max() > threshold)
    for name in own:
        config = Training(detector=name.removeprefix(DEFAULT), window=WINDOW, stride=STRIDE, folds=FOLDS)
        model = fit(runs, replace(config, false_alarms=f"{ASKED} per run"))
        print(f"  {name}: {model.detector_text}", file=sys.stderr)
        limits = np.array(model.thresholds)
        yield name, lambda run, model=model, limits=limits: bool((losses(model, run, STRIDE).values > limits).any())


def judged(seed: int, own: tuple[str, ...]) -> dict[str, list[int]]:
    """Count the alarms of each method in the runs of each kind."""
    cell, counts = Cell(seed), dict[str, list[int]]()
    runs = {"undisturbed": [cell.run(each) for each in UNDISTURBED]}
    runs |= {fault: [cell.run(each, fault) for each in FAULTY] for fault in FAULTS}
    for name, alarm in methods([cell.run(each) for each in TRAIN], own):
        counts[name] = [sum(map(alarm, runs[kind])) for kind in KINDS]
        print(f"cell {seed}, {name}: {counts[name]}", file=sys.stderr, flush=True)
    return counts


def sums(counts: Any) -> float:
    """Give how many times as many faults (own, usual) are found."""
    return float(counts[0] / max(counts[1], 1))


def tables(found: dict[str, Any]) -> Iterator[str]:
    """Give the table of shares, and that of each kind beside the usual method that finds the most of it."""
    yield f"| method | false alarms | faults found | {' | '.join(FAULTS)} |\n|{' --- |' * (len(FAULTS) + 3)}"
    for name, counts in found.items():
        many = np.full(len(counts), len(FAULTY))
        alarms = np.stack((counts[:, 0], np.full(len(counts), len(UNDISTURBED))), axis=1)
        faults = np.stack((counts[:, 1:].sum(axis=1), many * len(FAULTS)), axis=1)
        cells = " | ".join(f"{100 * counts[:, 1 + n].sum() / many.sum():.0f} %" for n in range(len(FAULTS)))
        yield f"| {name} | {told(alarms)} | {told(faults)} | {cells} |"
    own = found[DEFAULT]
    best = max(USUAL, key=lambda name: found[name][:, 1:].sum())
    pair = np.stack((own[:, 1:].sum(axis=1), found[best][:, 1:].sum(axis=1)), axis=1)
    low, high = over_clusters(pair, sums)
    yield f"\nall faults: {sums(pair.sum(axis=0)):.2f} ({low:.2f} to {high:.2f}) times as many as {best}, the best\n"
    yield "| fault | most by a usual method | default | times as many |\n| --- | --- | --- | --- |"
    for place, fault in enumerate(FAULTS, start=1):
        best = max(USUAL, key=lambda name: found[name][:, place].sum())
        pair = np.stack((own[:, place], found[best][:, place]), axis=1)
        low, high = over_clusters(pair, sums)
        shares = [f"{100 * count / (len(own) * len(FAULTY)):.0f} %" for count in pair.sum(axis=0)]
        times = f"{sums(pair.sum(axis=0)):.2f} ({low:.2f} to {high:.2f})"
        yield f"| {fault} | {best}: {shares[1]} | {shares[0]} | {times} |"


def main() -> None:
    parser = ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("seeds", type=int, nargs="*", default=FROZEN)
    parser.add_argument("--detectors", nargs="*", default=[])
    given = parser.parse_args()
    every = [judged(seed, (DEFAULT, *given.detectors)) for seed in given.seeds]
    print("\n".join(tables({name: np.array([counts[name] for counts in every]) for name in every[0]})))


if __name__ == "__main__":
    main()
