"""What the path detector sees of attacks, and how soon: python benchmarks/adm_attacks.py [--data DIR].

Five contiguous folds of the 30 benign runs: each run is judged by a detector that never saw it. It is judged as it is,
as an unaltered control, with each modification put into it, and at another speed: over the whole run, and over the
first side of the part alone. One line each: how many of the 30 runs raised an alarm at the threshold of 0.002 (two
anomalous points), and how many samples after the first deviating one the latest alarm came. A point deviates if it was
moved by more than benign edges ever are (57 micrometres).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from fame.errors import ConfigError
from fame.monitor.anomaly.learn import fold_numbers
from fame.monitor.anomaly.paths import PathDetector
from fame.monitor.anomaly.recording import ANOMALOUS, Recording, of_runs, read_csv
from fame.monitor.arrays import Floats
from fame.text import table
from robots.arm.sabotage import KINDS, alter, knots
from robots.arm.task import MH5, TRIANGLE, find_cut

FOLDS = 5
REPEATABILITY = 57e-6
ALARM = 2
"""Anomalous points that raise the alarm: more than 0.002 of 518."""

PERIOD = 0.025
SPEEDS = (0.8, 0.9, 1.1, 1.2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    root = Path(__file__).resolve().parent.parent.parent
    parser.add_argument("--data", type=Path, default=root / "shared" / "data" / "mh5")
    parser.add_argument("--sizes", type=float, nargs="+", default=[0.1, 0.25], metavar="MM")
    arguments = parser.parse_args()
    try:
        benign = read_csv(arguments.data / "original_30.csv")
    except ConfigError as error:
        sys.exit(f"{error}; the recordings are those of mh5_anomaly_detector: --data DIR")
    plain, stamped = held_out(benign), held_out(replace(benign, stamps=PERIOD * np.arange(len(benign))))
    lines = [("benign", *seen(plain, lambda run: (run, None)))]
    lines += [("benign, with time stamps", *seen(stamped, lambda run: (run, None)))]
    for size in (0.0, *arguments.sizes):
        for kind in (*KINDS, "rotated") if size else ("none",):
            name = f"{kind}, {size:g} mm" if size else "put through the mill, unaltered"
            lines.append((name, *seen(plain, lambda run, kind=kind, size=size: attacked(run, kind, size))))
    for data, name in ((plain, ""), (stamped, ", with time stamps")):
        for speed in SPEEDS:
            for part, whole in (("", True), (" on one side", False)):
                title = f"speed {speed:g}{part}{name}"
                lines.append((title, *seen(data, lambda run, s=speed, w=whole: (paced(run, s, whole=w), None))))
    print(table(("held-out runs", "alarms", "latest (samples)"), lines))


def held_out(benign: Recording) -> list[tuple[PathDetector, Recording]]:
    """Each run with a detector that learned from the other folds."""
    numbers = fold_numbers(benign, FOLDS)
    pairs = []
    for fold in range(FOLDS):
        detector = PathDetector(MH5).fit(benign.select(np.flatnonzero(numbers != fold).tolist()))
        pairs += [(detector, benign.select([number])) for number in np.flatnonzero(numbers == fold).tolist()]
    return pairs


Altered = tuple[Recording, Floats | None]


def seen(pairs: list[tuple[PathDetector, Recording]], change: Callable[[Recording], Altered]) -> tuple[str, str]:
    """How many runs raise an alarm once changed, and the latest alarm."""
    delays = list(alarms(pairs, change))
    known = [delay for delay in delays if delay is not None and delay >= 0]
    raised = sum(delay is not None for delay in delays)
    return f"{raised} of {len(delays)}", str(max(known)) if known else "-"


def alarms(pairs: list[tuple[PathDetector, Recording]], change: Callable[[Recording], Altered]) -> Iterator[int | None]:
    """Of each run: None without an alarm, else the samples since the first deviating one (-1 if that is not known)."""
    for detector, run in pairs:
        changed, moved = change(run)
        anomalous = np.flatnonzero([reading.anomalous for reading in detector.follow(changed)])
        if len(anomalous) < ALARM:
            yield None
        else:
            yield -1 if moved is None else max(0, int(anomalous[ALARM - 1] - np.argmax(moved > REPEATABILITY)))


def attacked(run: Recording, kind: str, millimetres: float) -> Altered:
    """The run with a modification put into it."""
    altered = alter(run.values, knots(kind, millimetres))
    return of_runs([altered.values], ANOMALOUS, run.joints), altered.moved if millimetres else None


def paced(run: Recording, speed: float, *, whole: bool) -> Recording:
    """The run, or the cut of the first side, at `speed` times its speed; samples come as often as before."""
    first, last = 0, len(run) - 1
    if not whole:
        cut = find_cut(MH5.places(run.values), TRIANGLE)
        first, last = cut.first, cut.first + int(np.argmax(cut.sides > 0))
    inside = np.linspace(first, last, round((last - first) / speed) + 1)
    index = np.concatenate([np.arange(first), inside, np.arange(last + 1, len(run))])
    values = np.stack([np.interp(index, np.arange(len(run)), column) for column in run.values.T], axis=1)
    made = of_runs([MH5.quantised(values)], ANOMALOUS, run.joints)
    return made if run.stamps is None else replace(made, stamps=run.stamps[0] + PERIOD * np.arange(len(made)))


if __name__ == "__main__":
    main()
