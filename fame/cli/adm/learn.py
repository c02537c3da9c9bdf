"""``fame adm learn``: classifiers fitted and evaluated on recorded runs, the best of them stored."""

from __future__ import annotations

import json
import sys
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.adm.sources import say, writable
from fame.cli.arguments import Commands, add_json, command

if TYPE_CHECKING:
    from fame.monitor.anomaly.classifiers import TrainedClassifier
    from fame.monitor.anomaly.learn import LearningData, Progress


def add(parts: Commands) -> None:
    """Declare the part."""
    parser = command(
        parts, "learn", run, examples=("fame adm learn examples/adm_learn.yaml -o best.skops --plots out/adm",),
        help="fit and judge classifiers, and store the best as a model",
    )  # fmt: skip
    parser.add_argument("config", type=Path, metavar="CONFIG.yaml")
    parser.add_argument("-o", "--output", type=Path, default=Path("best.skops"), metavar="MODEL.skops")
    parser.add_argument("--plots", type=Path, metavar="DIR", help="draw joint space, deviations, confusion matrices")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="fits at a time (default: 2)")
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Fit, judge, store the best, and print how all of them did."""
    from fame.monitor.anomaly.classifiers import plain, render, rows
    from fame.monitor.anomaly.learn import best, learn, read_data
    from fame.monitor.anomaly.learning_file import load
    from fame.monitor.anomaly.model import save_model

    learning = load(arguments.config)
    writable(arguments.output)
    data = read_data(learning)
    for note in data.notes:
        say(note)
    progress = _show if sys.stderr.isatty() else None
    learned = learn(learning, data, jobs=max(1, arguments.jobs), progress=progress)
    chosen = best(learned)
    save_model(chosen.model, arguments.output)
    if arguments.plots is not None:
        _plot(arguments.plots, learned, chosen, data)
    if arguments.json:
        told = {"status": "completed", "model": str(arguments.output), "classifiers": plain(learned, chosen)}
        print(json.dumps(told, indent=2, default=str))
        return 0
    print(render(rows(learned, chosen)))
    for item in learned:
        if item.note:
            print(f"{item.candidate.name}: {item.note}")
    print(f"* {chosen.candidate.name} is the best; stored in {arguments.output}")
    if learning.folds == 0:
        print("  (chosen by the data that it learned from: Split.folds is 0)")
    return 0


def _plot(folder: Path, learned: list[TrainedClassifier], chosen: TrainedClassifier, data: LearningData) -> None:
    """What `fame.monitor.plots` can draw of it."""
    from fame.monitor.anomaly.classifiers import data_name
    from fame.monitor.anomaly.paths import PathDetector
    from fame.monitor.anomaly.recording import BENIGN
    from fame.monitor.plots import deviations, joint_space, matrices

    whole = data.both or data.benign
    assert whole is not None
    if data.benign is not None:
        joint_space(folder / "benign.png", data.benign, title="Benign points in joint space")
    recordings = {"train": whole} | {f"test_{number}": item for number, item in enumerate(data.testing, start=1)}
    for name, recording in recordings.items():
        of = "data that it learned from" if name == "train" else Path(recording.source).name
        title = f"Verdicts of {chosen.candidate.name} on {of}"
        joint_space(folder / f"{name}.png", recording, chosen.model.predict(recording), title=title)
    told = [(f"{item.candidate.name}, {data_name(said)}", said.runs) for item in learned for said in item.evaluations]
    matrices(folder / "confusion.png", told)
    for item in learned:
        if isinstance(item.model.estimator, PathDetector):
            labels = whole.run_labels()
            some = [numbers[:3] for numbers in _by_label(labels)]
            named = [
                (f"{'benign' if labels[number] == BENIGN else 'anomalous'} run {number}", whole.select([number]))
                for numbers in some
                for number in numbers
            ]
            deviations(folder / f"{item.candidate.name}.png", item.model.estimator, named)


def _by_label(labels: list[int]) -> list[list[int]]:
    """The numbers of the runs of each label."""
    return [[number for number, label in enumerate(labels) if label == wanted] for wanted in sorted(set(labels))]


def _show(progress: Progress) -> None:
    left = "" if progress.left is None else f", about {progress.left:.0f} s left"
    print(f"\r\x1b[2K{progress.done} of {progress.total} fits{left}: {progress.name}", end="", file=sys.stderr)
    if progress.done == progress.total:
        print("\r\x1b[2K", end="", file=sys.stderr)
