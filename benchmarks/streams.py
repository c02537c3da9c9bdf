"""A machine that never stops, and runs that begin late: whether `phase` judges each cycle as it judges the first one.

Of each generated cell (`benchmarks.cells`) `phase` learns from 40 undisturbed runs, at 0.05 false alarms per run. Then
it judges streams of 20 cycles with a rest between them, in which a step is missing in cycle 1, 4 or 20; the same cycles
as runs of their own; and undisturbed runs that begin 0 to 0.2 s late. Intervals are over cells.
``python -m benchmarks.streams [CELLS [FIRST]]`` (a minute for each cell; from the seed FIRST on).
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np

from benchmarks.cells import FROZEN, RATE, Cell
from benchmarks.shares import told
from fame.monitor.data_files import LabelledRun
from fame.monitor.judge import judge_trained
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.train import Training, fit
from fame.monitor.pipeline.trained_model import TrainedModel

RUNS, CYCLES = 40, 20
MISSING = (1, 4, 20)
LATE = (0.0, 0.03, 0.05, 0.1, 0.13, 0.15, 0.2)
EACH = 10
"""Runs of each cell that begin so late."""
REST = 1.0
"""Between two cycles of a stream, s."""


def alarms(model: TrainedModel, samples: Samples) -> list[float]:
    """Return when (s) alarms of a run or stream begin."""
    run = LabelledRun(samples, np.ones(len(samples), dtype=np.int64), "")
    return [event.start for event in judge_trained(model, [run], "").runs[0].events]


def stream(runs: list[Samples], random: np.random.Generator) -> tuple[Samples, list[float]]:
    """Return runs one after another, with rests as noisy as the last second of each, and when (s) each begins."""
    parts, begins, length = [], [], 0
    for run in runs:
        still = run.values[-1] + run.values[-round(RATE) :].std(axis=0) * random.standard_normal(
            (round(REST * RATE), run.values.shape[1])
        )
        parts += [run.values, still]
        begins.append(length / RATE)
        length += len(run) + len(still)
    return Samples(np.concatenate(parts), np.arange(length) / RATE, runs[0].names), begins


def judged(seed: int) -> Iterator[tuple[str, int, int]]:
    """Yield what was judged of a cell, how much of it raised an alarm, and how much there was."""
    cell = Cell(seed)
    config = Training(detector="phase", window=25, false_alarms="0.05 per run")
    model = fit([cell.run(number) for number in range(RUNS)], config)
    for missing in MISSING:
        runs = [cell.run(1000 + number, "missing step" * (number == missing)) for number in range(1, CYCLES + 1)]
        samples, begins = stream(runs, np.random.default_rng(seed))
        hit = set(np.searchsorted(begins, alarms(model, samples), side="right").tolist())
        yield f"missing step in cycle {missing} of a stream", int(missing in hit), 1
        yield f"the same run by itself (cycle {missing})", int(bool(alarms(model, runs[missing - 1]))), 1
        yield "undisturbed cycles of streams", len(hit - {missing}), CYCLES - 1
    for place, late in enumerate(LATE):
        found = [bool(alarms(model, cell.run(2000 + EACH * place + number, late=late))) for number in range(EACH)]
        yield f"undisturbed, {late:g} s late", sum(found), EACH


def main() -> None:
    count, first = (*map(int, sys.argv[1:]), *(len(FROZEN), FROZEN[0])[len(sys.argv) - 1 :])
    cells = range(first, first + count)
    counts: dict[str, list[list[int]]] = {}
    for seed in cells:
        of_cell: dict[str, list[int]] = {}
        for name, found, total in judged(seed):
            both = of_cell.setdefault(name, [0, 0])
            both[0], both[1] = both[0] + found, both[1] + total
        for name, both in of_cell.items():
            counts.setdefault(name, []).append(both)
        print(f"cell {seed}: {of_cell}", file=sys.stderr, flush=True)
    print("| judged | with an alarm |\n| --- | --- |")
    for name, each in counts.items():
        print(f"| {name} | {told(each)} |")


if __name__ == "__main__":
    main()
