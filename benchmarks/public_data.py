"""Detectors on public recordings that you download yourself: python benchmarks/public_data.py NAME PATH.

All have windows of 10 rows and the conformal threshold at 0.05, by left-out folds (`baselines`). `default` is what the
commands of docs/performance_monitors.md make of the files as they are published; `alarm always` is an alarm in every
row or run.

skab      the folder of a part of SKAB (github.com/waico/SKAB, such as valve1): of each file the first 400 rows are the
          training, all further rows are judged, a row by the window that ends there. F1, and shares of false and of
          missed alarms, over the rows of all files; 95 % of 500 resamplings of files. The folds are five parts of the
          400 rows, so 0.05 is a share of rows. Rows do not repeat, so there is no golden run. `T2 or Q` is the
          alarm of one of the two, each at half the rate.
failures  a file of the robot execution failures (UCI 138): the runs of the class normal in five folds. What learned
          from four of them is judged by the fifth, and by all failures.
cobotops  the file of UR3 CobotOps (UCI 963): a cycle is a run, anomalous if it has a protective stop or a lost grip.
          The undisturbed cycles of the first half of the file are the training, all cycles of the second half are
          judged by their largest score: the area under the ROC curve, false alarms, and cycles found.
cuts      the folder of mh5_anomaly_detector: each of its 30 benign runs is judged by what learned from the other four
          of five contiguous folds, as it is, and with each of 8 modifications of the cut in each of `SIZES` (mm), as in
          adm_attacks.py. The methods learn joint angles, or places of the tool. Beside them the path detector, which
          has its own threshold: two anomalous points.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).resolve().parent))
from adm_attacks import ALARM, FOLDS, attacked, held_out
from baselines import USUAL, with_threshold
from shares import over_clusters, told

from fame.cli import main
from fame.monitor import Detector, Samples
from fame.monitor.anomaly.learn import fold_numbers
from fame.monitor.anomaly.recording import Recording, read_csv
from fame.monitor.arrays import Floats
from fame.monitor.data_files import Special, read_labelled_runs
from fame.monitor.judge import areas
from robots.arm.sabotage import KINDS
from robots.arm.task import MH5

WINDOW, RATE, TRAIN = 10, 0.05, 400
ROBOT_RATE = 47.6
"""Hz, of the robot failures."""
OWN = ("phase", "mahalanobis")
SIZES = (0.1, 0.25, 1.0, 3.0)
INPUTS: dict[str, Callable[[Recording], Floats]] = {
    "angles": lambda run: run.values, "places": lambda run: MH5.places(run.values),
}  # fmt: skip
"""What methods learn of recorded cuts (n, channels): rad, m."""


def scores(
    name: str, train: Sequence[Samples], judged: Sequence[Samples], *, whole_runs: bool, rate: float = RATE
) -> list[Floats]:
    """Give the scores of the windows of each run, divided by the threshold: above 1 there is an alarm."""
    if name in USUAL:
        score, threshold = with_threshold(USUAL[name], train, WINDOW, 1, rate, whole_runs=whole_runs)
        return [score(run) / threshold for run in judged]
    found = Detector(name, window=WINDOW, false_alarms=rate)
    numbers = np.repeat(np.arange(len(train)), list(map(len, train)))
    found.fit(np.concatenate([run.values for run in train]), runs=numbers if whole_runs else None)
    return [found.score_samples(run.values)[WINDOW - 1 :] / found.offset_ for run in judged]


def run_of(values: Any) -> Samples:
    """Give rows as a run, one row per s."""
    return Samples(np.asarray(values, dtype=np.float64), np.arange(len(values), dtype=np.float64))


def skab(folder: Path) -> Iterator[str]:
    files = sorted(folder.glob("*.csv"))
    tables = [pd.read_csv(path, sep=";") for path in files]
    truth = [table["anomaly"].to_numpy()[TRAIN:] > 0 for table in tables]
    runs = [run_of(table.drop(columns=["datetime", "anomaly", "changepoint"])) for table in tables]
    yield f"| method | F1 on {len(tables)} files | false alarms | missed |\n| --- | --- | --- | --- |"
    yield _row_of_rows("default", np.array([_by_commands(path) for path in files]))
    usual = [name for name in USUAL if name != "golden run"]
    found = {name: [_skab_alarms(name, run, RATE) for run in runs] for name in (*OWN, *usual)}
    pair = [[_skab_alarms(name, run, RATE / 2) for run in runs] for name in ("T2 Ledoit-Wolf", "PCA-Q")]
    found["T2 or Q"] = [one | other for one, other in zip(*pair, strict=True)]
    found["alarm always"] = [np.ones(len(each), dtype=bool) for each in truth]
    for name, alarms in found.items():
        counts = [[(a & t).sum(), (a & ~t).sum(), (~a & t).sum(), (~a & ~t).sum()]
                  for a, t in zip(alarms, truth, strict=True)]  # fmt: skip
        yield _row_of_rows(name, np.array(counts))


def _skab_alarms(name: str, run: Samples, rate: float) -> Any:
    """Give whether there is an alarm in each row behind the training."""
    train = [run_of(part) for part in np.split(run.values[:TRAIN], 5)]
    (found,) = scores(name, train, [run], whole_runs=False, rate=rate)
    return found[TRAIN - WINDOW + 1 :] > 1


def _row_of_rows(name: str, counts: Any) -> str:
    f1, false, missed = _figures(counts.sum(axis=0))
    low, high = over_clusters(counts, lambda summed: _figures(summed)[0])
    return f"| {name} | {f1:.2f} ({low:.2f} to {high:.2f}) | {100 * false:.0f} % | {100 * missed:.0f} % |"


def _command(*words: Any) -> str:
    """Run a command of FAME. Gives what it prints."""
    with redirect_stdout(StringIO()) as printed, redirect_stderr(StringIO()) as said:
        code = main(["monitor", *map(str, words)])
    assert code in (0, 1, 3), said.getvalue()
    return printed.getvalue()


def _by_commands(path: Path) -> list[int]:
    """Count the rows of a file as the documented commands judge it; those without a whole window have no alarm."""
    with TemporaryDirectory() as folder:
        model = Path(folder) / "s.skops"
        _command("train", "--data", path, "--time-column", "datetime", "--rate", 1, "--end", TRAIN,
                 "--anomaly-column", "anomaly", "--exclude", "changepoint", "--window", WINDOW, "--stride", 1,
                 "-o", model)  # fmt: skip
        found = json.loads(_command("judge", model, path, "--start", TRAIN, "--json"))
    return list(found["runs"][0]["rows"].values())


def failures(file: Path) -> Iterator[str]:
    runs = read_labelled_runs([file], (), Special(benign="normal", rate=ROBOT_RATE))
    normal = [number for number, run in enumerate(runs) if (run.labels == 1).all()]
    wrong = [number for number in range(len(runs)) if number not in normal]
    alarms = {name: np.zeros((len(runs), 2), dtype=int) for name in ("default", *OWN, *USUAL)}
    for held in np.array_split(np.random.default_rng(0).permutation(normal), 5):
        judged = [*sorted(held), *wrong]
        train = [runs[number].samples for number in normal if number not in held]
        for name in (*OWN, *USUAL):
            found = scores(name, train, [runs[number].samples for number in judged], whole_runs=True)
            alarms[name][judged] += [[part.max() > 1, 1] for part in found]
        verdicts = _verdicts(file, held)
        alarms["default"][judged] += [[verdicts[number] == "anomalous", 1] for number in judged]
    alarms["alarm always"] = np.ones((len(runs), 2), dtype=int)
    yield f"| method | false alarms in {len(normal)} runs | found, of {len(wrong)} failures |\n| --- | --- | --- |"
    for name, counts in alarms.items():
        yield f"| {name} | {told(counts[normal].sum(axis=0))} | {told(counts[wrong])} |"


def _verdicts(file: Path, held: Any) -> list[str]:
    """Give the verdict on each run by the documented commands, without some runs in the training."""
    with TemporaryDirectory() as folder:
        model = Path(folder) / "m.skops"
        _command("train", "--data", file, "--benign", "normal", "--rate", ROBOT_RATE, "--window", WINDOW, "--stride", 1,
                 "--false-alarms", f"{RATE} per run", "-o", model,
                 "--exclude", *(f"run {number}" for number in held))  # fmt: skip
        return [run["verdict"] for run in json.loads(_command("judge", model, file, "--json"))["runs"]]


def _figures(counts: Any) -> tuple[float, float, float]:
    """Give F1, and the shares of false and missed alarms, of true and false alarms, missed and quiet rows."""
    hit, false, missed, quiet = counts
    return 2 * hit / (2 * hit + false + missed), false / (false + quiet), missed / (missed + hit)


def cobotops(file: Path) -> Iterator[str]:
    table = pd.read_csv(file, sep=";", decimal=",").iloc[:, :24].dropna()
    table.columns = table.columns.str.strip()
    ends = ["Robot_ProtectiveStop", "grip_lost"]
    cycles = [cycle for _, cycle in table.groupby("cycle") if len(cycle) >= 2 * WINDOW]
    bad = np.array([(cycle[ends].astype(str) == "True").to_numpy().any() for cycle in cycles])
    runs = [run_of(cycle.drop(columns=["Num", "Timestamp", "cycle", *ends])) for cycle in cycles]
    half = len(runs) // 2
    train, judged = [run for run, wrong in zip(runs[:half], bad, strict=False) if not wrong], runs[half:]
    wrong = bad[half:]
    yield f"{len(train)} undisturbed cycles train; of {len(judged)} judged ones {wrong.sum()} are anomalous\n"
    yield "| method | area under ROC | false alarms | found |\n| --- | --- | --- | --- |"
    for name in (*OWN, *USUAL):
        largest = np.array([part.max() for part in scores(name, train, judged, whole_runs=True)])
        area = areas(largest, wrong)["area under ROC"]
        low, high = area["interval"]
        cells = [told(((largest[kind] > 1).sum(), kind.sum())) for kind in (~wrong, wrong)]
        yield f"| {name} | {area['value']:.2f} ({low:.2f} to {high:.2f}) | {' | '.join(cells)} |"


def cuts(folder: Path) -> Iterator[str]:
    benign = read_csv(folder / "original_30.csv")
    pairs, folds = held_out(benign), fold_numbers(benign, FOLDS)
    attacks = [(kind, size) for size in SIZES for kind in (*KINDS, "rotated")]
    changed = [[run, *(attacked(run, *attack)[0] for attack in attacks)] for _, run in pairs]
    sizes = " | ".join(f"{size:g} mm" for size in SIZES)
    yield f"| method | of | false alarms | {sizes} |\n|{' --- |' * (len(SIZES) + 3)}"
    anomalous = [
        [sum(reading.anomalous for reading in detector.follow(run)) for run in each]
        for (detector, _), each in zip(pairs, changed, strict=True)
    ]
    yield _cut_row("path detector | places", np.array(anomalous) >= ALARM)
    for inputs, values in INPUTS.items():
        runs = [[run_of(values(run)) for run in each] for each in changed]
        for name in (*OWN, *USUAL):
            alarms = []
            for fold in range(FOLDS):
                train = [each[0] for each, number in zip(runs, folds, strict=True) if number != fold]
                judged = [run for each, number in zip(runs, folds, strict=True) if number == fold for run in each]
                alarms += [part.max() > 1 for part in scores(name, train, judged, whole_runs=True)]
            yield _cut_row(f"{name} | {inputs}", np.reshape(alarms, (len(runs), -1)))


def _cut_row(name: str, alarms: Any) -> str:
    """Give the row of alarms (runs, 1 and those of each size)."""
    sizes = np.split(alarms[:, 1:], len(SIZES), axis=1)
    found = [told(np.stack([each.sum(axis=1), np.full(len(each), each.shape[1])], axis=1)) for each in sizes]
    return f"| {name} | {told((alarms[:, 0].sum(), len(alarms)))} | {' | '.join(found)} |"


DATA = {"skab": skab, "failures": failures, "cobotops": cobotops, "cuts": cuts}


def print_tables() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", choices=tuple(DATA))
    parser.add_argument("path", type=Path)
    given = parser.parse_args()
    for line in DATA[given.data](given.path):
        print(line, flush=True)


if __name__ == "__main__":
    print_tables()
