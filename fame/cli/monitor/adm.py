"""``fame monitor adm``: the anomaly detection module: collect runs, learn from them, score runs as they happen."""

from __future__ import annotations

import json
import sys
import warnings
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.arguments import Commands, add_json, command, group
from fame.cli.monitor.anomaly_data import (
    add_labelled_files,
    add_published,
    add_source,
    drive,
    print_written,
    settle,
)
from fame.cli.network import add_network
from fame.cli.output import note, print_json, progress_line, table
from fame.errors import NOT_KNOWN, MissionError
from fame.text import writable

if TYPE_CHECKING:
    from fame.clock import Scheduler
    from fame.middleware.interface import Middleware
    from fame.monitor.anomaly.classifiers import TrainedClassifier
    from fame.monitor.anomaly.learn import LearningData
    from fame.monitor.anomaly.live import RunReport
    from fame.monitor.anomaly.nodes import OperateNode, RunNode


_EXAMPLES = (
    "fame monitor adm collect --label 1 --runs 30 -o benign.csv",
    "fame monitor adm learn examples/adm_learn.yaml -o best.skops",
    "fame monitor adm envelope benign.csv --tolerance 1 -o outside.csv",
    "fame monitor adm operate --model best.skops --threshold 0.01",
)


def add(commands: Commands) -> None:
    """Declare the command and its parts."""
    parser = group(
        commands, "adm", examples=_EXAMPLES,
        help="detect anomalies in a repetitive task: record runs, learn from them, judge new ones",
    )  # fmt: skip
    parts = parser.add_subparsers(metavar="SUBCOMMAND", required=True)
    for add_part in (_add_collect, _add_learn, _add_operate, add_labelled_files):
        add_part(parts)


_COLLECT_EXAMPLES = (
    "fame monitor adm collect --label 1 --runs 30 -o benign.csv",
    "fame monitor adm collect --bag recorded --label -1 -o anomalous.csv",
)


def _add_collect(parts: Commands) -> None:
    parser = command(
        parts,
        "collect",
        run_collect,
        examples=_COLLECT_EXAMPLES,
        help="record joint states of runs of a task as a labelled CSV file",
    )
    add_published(parser, "TOPIC CSV LABEL", {"topic": str, "output": Path, "label": int})
    add_source(parser)
    parser.add_argument("--label", type=int, choices=(1, -1), help="1 benign, -1 anomalous")
    parser.add_argument("-o", "--output", type=Path, metavar="CSV")
    add_network(parser)
    add_json(parser)


def run_collect(arguments: Namespace) -> int:
    """Collect until all runs are recorded, the bag ends, or Ctrl-C."""
    settle(arguments, "label", "output")
    from fame.monitor.anomaly.live import Collector
    from fame.monitor.anomaly.nodes import ArmOptions, RunNode
    from fame.monitor.anomaly.recording import write_csv

    writable(arguments.output)
    of = f" of {arguments.runs}" if arguments.runs else ""
    collector = Collector(
        arguments.label, arguments.rule, cycle=arguments.points, limit=arguments.runs,
        progress=lambda count: note(f"{count}{of} runs"),
    )  # fmt: skip

    def make(middleware: Middleware, scheduler: Scheduler) -> RunNode:
        arm = ArmOptions(topic=arguments.topic, field=arguments.field, report=note, done=scheduler.stop)
        return RunNode(middleware, scheduler, collector, arm)

    drive(arguments, make)
    recording = collector.recording()
    write_csv(arguments.output, recording)
    print_written(arguments, recording)
    missing = arguments.runs - recording.count
    if missing > 0:
        note(f"{missing} of the {arguments.runs} runs are missing: the source ended before, or they were cut off")
    return 1 if missing > 0 else 0


def _add_learn(parts: Commands) -> None:
    parser = command(
        parts, "learn", run_learn,
        examples=("fame monitor adm learn examples/adm_learn.yaml -o best.skops --plots out/adm",),
        help="train and compare classifiers, and store the best as a model",
    )  # fmt: skip
    parser.add_argument("config", type=Path, metavar="CONFIG.yaml")
    parser.add_argument("-o", "--output", type=Path, default=Path("best.skops"), metavar="MODEL.skops")
    parser.add_argument("--plots", type=Path, metavar="DIR", help="draw joint space, deviations, confusion matrices")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="number of parallel fits (default: 2)")
    add_json(parser)


def run_learn(arguments: Namespace) -> int:
    """Fit, judge, store the best, and print how all of them did."""
    from dataclasses import replace

    from fame.monitor.anomaly.classifiers import HEADS, plain, rows
    from fame.monitor.anomaly.learn import best, learn, read_data
    from fame.monitor.anomaly.learning_file import load
    from fame.monitor.model_card import origin_of, write_card
    from fame.monitor.pipeline.training_checks import drifting

    learning = load(arguments.config)
    writable(arguments.output)
    data = read_data(learning)
    for text in data.notes:
        note(text)
    with progress_line(sys.stderr) as line, warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        learned = learn(
            learning, data, jobs=max(1, arguments.jobs),
            progress=lambda at: line.write(f"{at.done} of {at.total} fits: {at.name}", at.done / at.total)
            if line is not None else None,
        )  # fmt: skip
    for each in warned:
        note(f"warning: {each.message}")
    chosen = best(learned)
    model = replace(chosen.model, conditions={**chosen.model.conditions, **origin_of(arguments.output)})
    model.save(arguments.output)
    write_card(model, arguments.output)
    note(f"{arguments.output}: {chosen.model.alarm_text()}")
    drifts = drifting(model)
    for text in drifts:
        note(f"warning: {text}")
    if arguments.plots is not None:
        _plot(arguments.plots, learned, chosen, data)
    if arguments.json:
        summary = {
            "status": "completed", "model": str(arguments.output), "classifiers": plain(learned, chosen),
            "warnings": [*(str(each.message) for each in warned), *drifts],
        }  # fmt: skip
        print(json.dumps(summary, indent=2, default=str))
        return 0
    print(table(HEADS, rows(learned, chosen)))
    for item in learned:
        if item.note:
            print(f"{item.candidate.name}: {item.note}")
    print(f"* {chosen.candidate.name} is the best; stored in {arguments.output}")
    if learning.folds == 0:
        print("  (chosen by the data that it learned from: Split.folds is 0)")
    return 0


def _plot(folder: Path, learned: list[TrainedClassifier], chosen: TrainedClassifier, data: LearningData) -> None:
    """Draw the plots of `fame.monitor.plots` that the data allow."""
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
    summary = [
        (f"{item.candidate.name}, {data_name(evaluation)}", evaluation.runs)
        for item in learned
        for evaluation in item.evaluations
    ]
    matrices(folder / "confusion.png", summary)
    for item in learned:
        if isinstance(item.model.detector, PathDetector):
            labels = whole.run_labels()
            some = [numbers[:3] for numbers in _by_label(labels)]
            named = [
                (f"{'benign' if labels[number] == BENIGN else 'anomalous'} run {number}", whole.select([number]))
                for numbers in some
                for number in numbers
            ]
            deviations(folder / f"{item.candidate.name}.png", item.model.detector, named)


def _by_label(labels: list[int]) -> list[list[int]]:
    """The numbers of the runs of each label."""
    return [[number for number, label in enumerate(labels) if label == wanted] for wanted in sorted(set(labels))]


_OPERATE_EXAMPLES = (
    "fame monitor adm operate --model best.skops --threshold 0.01",
    "fame monitor adm operate --model best.skops --bag recorded --json",
)


def _add_operate(parts: Commands) -> None:
    parser = command(
        parts,
        "operate",
        run_operate,
        examples=_OPERATE_EXAMPLES,
        help="score runs with a model, and publish the signal anomaly",
    )
    add_published(parser, "TOPIC MODEL THRESHOLD", {"topic": str, "model": Path, "threshold": float})
    add_source(parser)
    parser.add_argument("--model", type=Path, metavar="MODEL.skops")
    parser.add_argument("--threshold", type=float, metavar="SCORE", help="score above which a run is anomalous")
    add_network(parser)
    add_json(parser)


def run_operate(arguments: Namespace) -> int:
    """Judge until all runs are evaluated, the bag ends, or Ctrl-C. Returns 1 if a run was anomalous, otherwise 3 if one
    was cut off, or none was evaluated."""
    settle(arguments, "model")
    from fame.monitor.anomaly.live import RunMonitor
    from fame.monitor.anomaly.model import Model
    from fame.monitor.anomaly.nodes import ArmOptions, OperateNode

    model = Model.load(arguments.model)
    note(f"{arguments.model}: {model.alarm_text(arguments.threshold)}")

    def make(middleware: Middleware, scheduler: Scheduler) -> OperateNode:
        monitor = RunMonitor(model, arguments.threshold, arguments.rule, arguments.points, arguments.runs)
        arm = ArmOptions(topic=arguments.topic, field=arguments.field, report=note, done=scheduler.stop)
        return OperateNode(middleware, scheduler, monitor, arm)

    runs = drive(arguments, make).runs
    if not runs and arguments.bag is not None:
        raise MissionError(f"{arguments.bag}: no run was evaluated: none began that the model fits (--rule, --topic)")
    return _print_runs(runs, arguments.json)


def _print_runs(runs: Sequence[RunReport], json: bool) -> int:
    above = sum(item.above for item in runs)
    code = 1 if above else 0 if runs and all(item.judged for item in runs) else NOT_KNOWN
    if json:
        names = ("run", "points", "anomalous", "score", "above", "whole", "still")
        summary = [{name: getattr(item, name) for name in names} for item in runs]
        print_json({"status": {0: "completed", 1: "failed"}.get(code, "partial"), "runs": summary})
    else:
        cut, still = sum(not item.whole for item in runs), sum(bool(item.still) for item in runs)
        more = (f", {cut} cut off" if cut else "") + (f", {still} in which a joint hardly moved" if still else "")
        print(f"{len(runs)} runs, {above} of them anomalous{more}")
    return code
