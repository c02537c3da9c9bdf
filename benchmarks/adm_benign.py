"""What the path detector says of benign changes: python benchmarks/adm_benign.py [--data DIR] [--seed N] [--simulated].

Five contiguous folds of the 30 benign runs, as in adm_attacks.py: each run is changed and judged by a detector that
never saw it, with time stamps and without. One line for each change: runs with an alarm (two anomalous points), the
kinds of their anomalous points, and the benign changes that were reported, with the number of runs. All seeds are
`--seed` and the number of the run. The bounds of what is tolerated were chosen by the runs as they were recorded and
the seed 1900; others are fresh. `--simulated` changes runs that are simulated along the recorded ones instead: with
noise and timing of their own, which no bound was chosen by.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from adm_attacks import ALARM, PERIOD, held_out, paced

from fame.errors import ConfigError
from fame.monitor.anomaly.paths import PathDetector
from fame.monitor.anomaly.recording import Recording, of_runs, read_csv
from fame.monitor.arrays import Floats
from fame.text import table
from robots.arm.kinematics import inverse
from robots.arm.task import MH5, simulated

SEED = 1900
PAUSE_AT, PAUSE = 200, 8  # samples: 0.2 s at 40 Hz

Change = Callable[[Recording, np.random.Generator], Recording]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    root = Path(__file__).resolve().parent.parent.parent
    parser.add_argument("--data", type=Path, default=root / "shared" / "data" / "mh5")
    parser.add_argument("--only", default="", metavar="TEXT", help="changes whose name contains this")
    parser.add_argument("--seed", type=int, default=SEED, metavar="N", help="of what is random in changes and runs")
    parser.add_argument("--simulated", action="store_true", help="runs simulated along the recorded ones")
    arguments = parser.parse_args()
    try:
        benign = read_csv(arguments.data / "original_30.csv")
    except ConfigError as error:
        sys.exit(f"{error}; the recordings are those of mh5_anomaly_detector: --data DIR")
    lines = []
    for stamps, data in (("no", benign), ("yes", replace(benign, stamps=PERIOD * np.arange(len(benign))))):
        pairs = held_out(data)
        if arguments.simulated:
            pairs = [
                (detector, _simulated(run, number, arguments.seed)) for number, (detector, run) in enumerate(pairs)
            ]
        lines += [
            (name, stamps, *told(pairs, change, arguments.seed))
            for name, change in CHANGES.items()
            if arguments.only in name
        ]
    print(table(("change", "stamps", "alarms", "of kind", "reported"), lines))


def _simulated(run: Recording, number: int, seed: int) -> Recording:
    """A run along a recorded one, with stamps if that has some."""
    return of(run, simulated(run.values[run.values.any(axis=1)], np.random.default_rng([seed, number, 1]), MH5))


def told(pairs: list[tuple[PathDetector, Recording]], change: Change, seed: int) -> tuple[str, str, str]:
    """How many changed runs raise an alarm, the kinds of their anomalous points, and what was reported."""
    alarms, kinds, reported = 0, Counter[str](), Counter[str]()
    for number, (detector, run) in enumerate(pairs):
        changed = change(run, np.random.default_rng([seed, number]))
        tracker = detector.tracker()
        stamps = [None] * len(changed) if changed.stamps is None else changed.stamps.tolist()
        readings = [tracker.step(row, at) for row, at in zip(changed.values.tolist(), stamps, strict=True)]
        found = [reading.kind for reading in readings if reading.anomalous]
        alarms += len(found) >= ALARM
        kinds.update(sorted(set(found)) if len(found) >= ALARM else ())
        reported.update(f"{item.kind}{'' if item.tolerated else ' (beyond)'}" for item in tracker.changes())
    return f"{alarms} of {len(pairs)}", _counts(kinds), _counts(reported)


def _counts(found: Counter[str]) -> str:
    return ", ".join(f"{name} {count}" for name, count in found.most_common()) or "-"


def of(run: Recording, values: Floats, stamps: Floats | None = None) -> Recording:
    """Another run with these values; without stamps, those of `run` go on at its rate."""
    made = of_runs([MH5.quantised(values)], 1, run.joints)
    if run.stamps is None:
        return made
    return replace(made, stamps=run.stamps[0] + PERIOD * np.arange(len(values)) if stamps is None else stamps)


def _only(run: Recording, kept: Floats) -> Recording:
    return of(run, run.values[kept], None if run.stamps is None else run.stamps[kept])


def _pause(run: Recording, random: np.random.Generator) -> Recording:
    held = np.repeat(run.values[PAUSE_AT : PAUSE_AT + 1], PAUSE, axis=0)
    return of(run, np.concatenate([run.values[:PAUSE_AT], held, run.values[PAUSE_AT:]]))


def _start(run: Recording, random: np.random.Generator) -> Recording:
    share = np.maximum(0, 1 - np.arange(len(run)) / 60)[:, None]
    return of(run, run.values + share * np.radians(0.5) * np.eye(6)[0])


def _sag(run: Recording, millimetres: float) -> Recording:
    places = MH5.places(run.values) - [0.0, 0.0, millimetres / 1000]
    return of(run, inverse(MH5, places, MH5.orientations(run.values), run.values))


def _noise(run: Recording, random: np.random.Generator, steps: float) -> Recording:
    return of(run, run.values + random.normal(0, steps, run.values.shape) * 2 * np.pi / np.array(MH5.steps))


CHANGES: Mapping[str, Change] = {
    "none": lambda run, random: run,
    "speed -2 %": lambda run, random: paced(run, 0.98, whole=True),
    "speed +2 %": lambda run, random: paced(run, 1.02, whole=True),
    "2 % of samples lost": lambda run, random: _only(run, random.random(len(run)) > 0.02),
    "pause of 0.2 s": _pause,
    "start 0.5 degrees off": _start,
    "sag of 0.05 mm": lambda run, random: _sag(run, 0.05),
    "encoder noise of 2 steps": lambda run, random: _noise(run, random, 2),
    "encoder noise of 4 steps": lambda run, random: _noise(run, random, 4),
    "half the rate": lambda run, random: _only(run, np.arange(len(run)) % 2 == 0),
}

if __name__ == "__main__":
    main()
