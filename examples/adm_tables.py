"""The paper's Tables I to IV beside ours, on the public data: python examples/adm_tables.py [--data DIR].

Train is the public data. Validation and test sets are not public: they are simulated here, from recorded runs that no
classifier learned from, with seeds of their own, and say so. All thresholds are fixed before: 0.22 (one-class SVM) and
0.01 (RBF-SVM) as published, 0.002 for the path detector; its limits come from its training runs.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fame.errors import FameError
from fame.monitor.anomaly import PathDetector, Recording, read_csv
from fame.monitor.anomaly.classifiers import (
    DEFAULTS,
    ConfusionMatrix,
    by_run,
    fit,
    make,
    run_scores,
)
from fame.monitor.anomaly.learning_file import CandidateClassifier
from fame.monitor.anomaly.model import PointClassifier
from fame.monitor.anomaly.recording import ANOMALOUS, BENIGN, join, of_runs
from fame.monitor.plots import deviations, joint_space, matrices
from fame.text import table
from robots.arm.sabotage import KINDS, alter, envelope, knots, knots_of_slope
from robots.arm.task import FILE, MH5, TRIANGLE, simulated_runs

HELD_OUT = range(24, 30)
"""Benign runs that nothing is learned from in the tables of attacks and of simulated sets."""

PATH = CandidateClassifier("path", "PathDetector", {"chain": str(FILE)}, reduction=0, threshold=0.002)
ENTRIES = (*DEFAULTS, PATH)
TABLE_1 = {
    "OC train": ("15528", "15528", "30", "0", "0"),
    "RBF train": ("20221", "15527", "30", "4692", "20"),
    "validate": ("13953", "9304", "20", "4649", "20"),
    "test": ("7767", "5182", "10", "2585", "10"),
}
TABLE_2 = {
    ("ocsvm", "train"): ".96 1 .91 .95", ("rbfsvm", "train"): "1 1 1 1",
    ("ocsvm", "validation"): ".5 1 .5 .67", ("rbfsvm", "validation"): "1 1 1 1",
    ("ocsvm", "test"): "1 1 1 1", ("rbfsvm", "test"): "1 1 1 1",
}  # fmt: skip
TABLE_3 = {1: (0.0858, 0.0271, 0.1459, 0.0814), 2: (0.1543, 0.1553, 0.1578, 0.0854), 3: (0.198, 0.1934, 0.1709, 0.1362)}
TABLE_4 = {
    4: 0.0912, 3: 0.0716, 2.75: 0.0603, 2.17: 0.0605, 2.1: 0.0463, 2: 0.0019,
    1.99: 0.0037, 1.97: 0.0304, 1.91: 0.0324, 1.86: 0.0605, 1: 0.0788,
}  # fmt: skip


class Trained:
    """A classifier and how it scores."""

    def __init__(self, candidate: CandidateClassifier, benign: Recording, both: Recording) -> None:
        self.candidate = candidate
        self.estimator = make(candidate, Path())
        if isinstance(self.estimator, PointClassifier):
            self.estimator.process.fit(benign.values)
        fit(self.estimator, both if self.estimator.supervised else benign)

    def scores(self, data: Recording) -> list[float]:
        return run_scores(data, self.estimator.predict(data))

    def matrix(self, data: Recording) -> ConfusionMatrix:
        return by_run(data.run_labels(), self.scores(data), float(self.candidate.threshold or 0))


def table_1(sets: dict[str, Recording]) -> Iterator[Sequence[str]]:
    for name, data in sets.items():
        labels = data.run_labels()
        points = [int((data.labels == label).sum()) for label in (BENIGN, ANOMALOUS)]
        ours = (str(len(data)), str(points[0]), str(labels.count(BENIGN)), str(points[1]), str(labels.count(ANOMALOUS)))
        paper = TABLE_1[name.split(" (")[0]]
        yield (name, *(f"{mine} ({its})" for mine, its in zip(ours, paper, strict=True)))


def table_2(trained: dict[str, list[Trained]], sets: dict[str, Recording]) -> Iterator[Sequence[str]]:
    for name, data in sets.items():
        short = name.split(" (")[0]
        for item in trained["all" if short == "train" else "held out"]:
            m = item.matrix(data)
            ratios = f"{m.accuracy:.2f} {m.recall:.2f} {m.precision:.2f} {m.f1:.2f}"
            yield item.candidate.name, name, *map(str, m), ratios, TABLE_2.get((item.candidate.name, short), "-")


def attacks(trained: list[Trained], carrier: Recording) -> Iterator[tuple[str, str, str]]:
    """Mean score over the held-out runs, per kind and magnitude: ours, the paper's, the path detector's."""
    rbf, path = trained
    for millimetres in (0.1, 0.25, 0.5, *TABLE_3):
        for number, kind in enumerate((*KINDS, "rotated", "none") if millimetres < 1 else (*KINDS, "rotated")):
            runs = altered(carrier, knots(kind, millimetres))
            paper = TABLE_3.get(millimetres, ())
            yield (
                f"{kind} {millimetres:g} mm",
                *seen([rbf], runs),
                f"{paper[number]:.4f}" if number < len(paper) else "-",
                *seen([path], runs),
            )  # type: ignore[misc]


def altered(carrier: Recording, changes: Any) -> Recording:
    return of_runs([alter(run.values, changes).values for run in carrier], ANOMALOUS, carrier.joints)


def seen(trained: list[Trained], runs: Recording) -> list[str]:
    """The mean score, and how many runs are above the threshold."""
    told = []
    for item in trained:
        scores = item.scores(runs)
        above = sum(score > (item.candidate.threshold or 0) for score in scores)
        told.append(f"{np.mean(scores):.4f} ({above}/{len(scores)})")
    return told


def plot(folder: Path, trained: list[Trained], benign: Recording, held: Recording, test: Recording) -> None:
    """The paper's Fig. 10 (benign joint space) and Fig. 13 (with verdicts), attacks along the path, Table II drawn."""
    joint_space(folder / "fig10_benign.png", benign, title="Benign points in joint space (cf. Fig. 10)")
    told = []
    for item in trained:
        name = item.candidate.name
        predicted = item.estimator.predict(test)
        joint_space(
            folder / f"fig13_{name}.png", test, predicted, title=f"{name} on the simulated test set (cf. Fig. 13)"
        )
        told.append((f"{name}, test (simulated)", item.matrix(test)))
    matrices(folder / "confusion.png", told)
    path = trained[-1].estimator
    assert isinstance(path, PathDetector)
    one = held.select([0])
    attacked = [(f"{kind}, 0.25 mm", altered(one, knots(kind, 0.25))) for kind in KINDS]
    deviations(folder / "deviation.png", path, [("benign", one), *attacked])
    print(f"\nplots in {folder}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    default = Path(__file__).resolve().parent.parent.parent / "shared" / "data" / "mh5"
    parser.add_argument("--data", type=Path, default=default, help="folder with the two CSV files")
    parser.add_argument("--plots", type=Path, metavar="DIR", help="draw joint space, deviations, confusion matrices")
    arguments = parser.parse_args()
    folder = arguments.data
    benign, both = read_csv(folder / "original_30.csv"), read_csv(folder / "rbfsvm_train_30.csv")
    learned_from = benign.select([number for number in range(benign.count) if number not in HELD_OUT])
    held = benign.select(list(HELD_OUT))
    loops = both.select([number for number, label in enumerate(both.run_labels()) if label == ANOMALOUS])
    part = join([loops, learned_from])
    simulated = {}
    for name, count, seed in (("validation", 20, 2018), ("test", 10, 2019)):
        runs = of_runs(simulated_runs(held, count, seed, MH5), BENIGN, benign.joints)
        outside = envelope(runs, TRIANGLE, 0.001, MH5).select(
            list(range(count // 2)) + list(range(count, count + count // 2))
        )
        simulated[name] = join([runs, outside])
    validation, test = simulated["validation"], simulated["test"]

    print("Table I: points, benign points and runs, anomalous points and runs: ours (paper's)")
    sets = {"OC train": benign, "RBF train": both, "validate (simulated)": validation, "test (simulated)": test}
    print(table(("set", "points", "benign", "runs", "anomalous", "runs"), list(table_1(sets))), end="\n\n")
    trained = {"all": [Trained(candidate, benign, both) for candidate in ENTRIES]}
    trained["held out"] = [Trained(candidate, learned_from, part) for candidate in ENTRIES]
    print("Table II: runs, with accuracy, recall, precision, F1")
    sets = {"train (learned from)": both, "validation (simulated)": validation, "test (simulated)": test}
    heads = ("classifier", "set", "TP", "FP", "TN", "FN", "ours", "paper")
    print(table(heads, list(table_2(trained, sets))), end="\n\n")
    pair = trained["held out"][1:]
    print(f"Table III and beyond: mean score (runs above the threshold) of attacks put into {held.count} held-out runs")
    print(table(("attack", "rbfsvm", "paper", "path"), list(attacks(pair, held))), end="\n\n")
    print("Table IV: slope of part of a side")
    lines = []
    for slope, paper in TABLE_4.items():
        runs = altered(held, knots_of_slope(slope))
        lines.append((f"{slope:g}", *seen(pair[:1], runs), f"{paper:.4f}", *seen(pair[1:], runs)))
    print(table(("slope", "rbfsvm", "paper", "path"), lines))
    if arguments.plots is not None:
        plot(arguments.plots, trained["held out"], benign, held, test)


if __name__ == "__main__":
    try:
        main()
    except FameError as error:
        print(f"{Path(__file__).name}: error: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
