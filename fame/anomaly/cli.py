"""`fame adm`: collect, learn, operate and merge on the command line.

`add_arguments` declares the four on a parser's subparsers, `run` does what the parsed arguments say and gives the exit
code. Nodes need a middleware and its scheduler: `run` gets a function that makes both, unless a bag is read.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.errors import ConfigError, MissionError

if TYPE_CHECKING:
    from fame.anomaly.learn import Data, Learned, Progress
    from fame.anomaly.recording import Recording
    from fame.clock import Scheduler
    from fame.middleware.interface import Middleware

    Connect = Callable[[], tuple[Middleware, Scheduler]]

FIELDS, RULES = ("position", "velocity", "effort"), ("home", "signal", "count")


def add_arguments(subparsers: Any) -> tuple[Any, Any]:
    """Declare collect, learn, operate and merge. Gives the parsers of the two nodes, collect and operate."""
    collect = subparsers.add_parser("collect", help="record joint states of runs of a task as a labelled CSV file")
    _add_published(collect, "TOPIC CSV LABEL", {"topic": str, "output": Path, "label": int})
    _add_source(collect)
    collect.add_argument("--label", type=int, choices=(1, -1), help="1 benign, -1 anomalous")
    collect.add_argument("--runs", type=int, default=0, metavar="N", help="stop after N runs")
    collect.add_argument("-o", "--output", type=Path, metavar="CSV")
    collect.set_defaults(adm=_collect)
    learn = subparsers.add_parser("learn", help="fit and judge classifiers, and store the best as a model")
    learn.add_argument("config", type=Path, metavar="CONFIG.yaml")
    learn.add_argument("-o", "--output", type=Path, default=Path("best.skops"), metavar="MODEL.skops")
    learn.add_argument("--plots", type=Path, metavar="DIR", help="draw joint space, deviations, confusion matrices")
    learn.add_argument("--jobs", type=int, default=2, metavar="N", help="fits at a time (default: 2)")
    learn.set_defaults(adm=_learn)
    operate = subparsers.add_parser("operate", help="score runs with a model, and raise the signal anomaly")
    _add_published(operate, "TOPIC MODEL THRESHOLD", {"topic": str, "model": Path, "threshold": float})
    _add_source(operate)
    operate.add_argument("--model", type=Path, metavar="MODEL.skops")
    operate.add_argument("--threshold", type=float, metavar="SCORE", help="a run is anomalous above it")
    operate.add_argument("--runs", type=int, default=0, metavar="N", help="stop after N runs")
    operate.set_defaults(adm=_operate)
    merge = subparsers.add_parser("merge", help="join labelled CSV files into one")
    merge.add_argument("files", type=Path, nargs="+", metavar="CSV")
    merge.add_argument("-o", "--output", type=Path, required=True, metavar="CSV")
    merge.set_defaults(adm=_merge)
    for parser in (collect, learn, operate, merge):
        parser.add_argument("--json", action="store_true", help="print one JSON object, also if something goes wrong")
    return collect, operate


def run(arguments: argparse.Namespace, connect: Connect | None = None) -> int:
    """Do it. `connect` gives a middleware and its scheduler. Returns the exit code; raises FameError."""
    code: int = arguments.adm(arguments, connect)
    return code


def _add_published(parser: argparse.ArgumentParser, metavar: str, types: Mapping[str, Callable[[str], Any]]) -> None:
    """The arguments of the published module, which has no options: all of them by place, or none."""
    parser.add_argument("published", nargs="*", metavar=metavar, help="the same without options, as published")
    parser.set_defaults(published_types=types)


def _settle(arguments: argparse.Namespace, *required: str) -> None:
    """Put what was given by place where the options are. Raises ConfigError for what is missing or wrong."""
    types = arguments.published_types
    if arguments.published:
        if len(arguments.published) != len(types):
            names = ", ".join(types)
            raise ConfigError(
                f"found {len(arguments.published)} arguments by place; {names} would be right, or options"
            )
        for (name, convert), text in zip(types.items(), arguments.published, strict=True):
            try:
                setattr(arguments, name, convert(text))
            except ValueError:
                raise ConfigError(f"found {text!r} as {name}; a number would be right") from None
    missing = [name for name in required if getattr(arguments, name) is None]
    if missing:
        raise ConfigError(f"needs --{missing[0]} (see --help)")
    _require_threshold(getattr(arguments, "threshold", None))
    if getattr(arguments, "label", 1) not in (1, -1):
        raise ConfigError(f"found the label {arguments.label}; 1 (benign) or -1 (anomalous) would be right")


def _require_threshold(threshold: float | None) -> None:
    if threshold is not None and not 0 <= threshold < 1:
        raise ConfigError(f"found the threshold {threshold:g}; a number from 0 to 1 would be right")


def _require_folder(path: Path) -> None:
    """Make the folder that a result will be written to, before hours are spent on it. Raises ConfigError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"cannot be written: {error.strerror}", file=str(path)) from None
    if path.is_dir():
        raise ConfigError("is a folder; the name of a file would be right", file=str(path))


def _add_source(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--topic", default="/joint_states", help="default: /joint_states")
    parser.add_argument("--field", choices=FIELDS, default="position")
    parser.add_argument("--bag", type=Path, metavar="BAG", help="read a bag instead of listening")
    parser.add_argument("--rule", choices=RULES, default="home", help="what delimits a run (default: home)")
    parser.add_argument(
        "--points", type=int, default=0, metavar="N", help="with --rule count: points of a run (operate: as learned)"
    )


def _say(text: str) -> None:
    print(text, file=sys.stderr)


# ---- collect and merge -----------------------------------------------------------------------------------------------


def _collect(arguments: argparse.Namespace, connect: Connect | None) -> int:
    _settle(arguments, "label", "output")
    from fame.anomaly.collect import Collect, Collector
    from fame.anomaly.files import write_csv

    _require_folder(arguments.output)
    collector = Collector(arguments.label, arguments.rule, cycle=arguments.points, limit=arguments.runs)
    of = f" of {arguments.runs}" if arguments.runs else ""

    def progress(count: int) -> None:
        _say(f"{count}{of} runs")

    def make(middleware: Middleware, scheduler: Scheduler) -> Any:
        return Collect(
            middleware, scheduler, collector, topic=arguments.topic, field=arguments.field,
            report=_say, progress=progress, done=scheduler.stop,
        )  # fmt: skip

    _drive(arguments, connect, make, lambda: collector.done)
    recording = collector.recording()
    write_csv(arguments.output, recording)
    written(arguments, recording)
    missing = arguments.runs - recording.count
    if missing > 0:
        _say(f"{missing} of the {arguments.runs} runs are missing: the source ended before, or they were cut off")
    return 1 if missing > 0 else 0


def _merge(arguments: argparse.Namespace, connect: Connect | None) -> int:
    from fame.anomaly.files import merge, write_csv

    recording = merge(arguments.files)
    write_csv(arguments.output, recording)
    return written(arguments, recording)


def written(arguments: argparse.Namespace, recording: Recording) -> int:
    """Say what was written, and what was odd. Gives the exit code."""
    for note in recording.notes:
        _say(note)
    labels = recording.run_labels()
    told = {
        "status": "completed", "file": str(arguments.output), "points": len(recording), "runs": len(labels),
        "benign_runs": labels.count(1), "anomalous_runs": labels.count(-1),
    }  # fmt: skip
    text = (
        f"{arguments.output}: {len(recording)} points, {labels.count(1)} benign and {labels.count(-1)} anomalous runs"
    )
    print(json.dumps(told, indent=2) if arguments.json else text)
    return 0


# ---- learn -----------------------------------------------------------------------------------------------------------


def _learn(arguments: argparse.Namespace, connect: Connect | None) -> int:
    from fame.anomaly.config import load
    from fame.anomaly.learn import best, learn, read_data
    from fame.anomaly.persist import save_model
    from fame.anomaly.table import plain, render, rows

    learning = load(arguments.config)
    _require_folder(arguments.output)
    data = read_data(learning)
    for note in data.notes:
        _say(note)
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
            print(f"{item.entry.name}: {item.note}")
    print(f"* {chosen.entry.name} is the best; stored in {arguments.output}")
    if learning.folds == 0:
        print("  (chosen by the data that it learned from: Split.folds is 0)")
    return 0


def _plot(folder: Path, learned: list[Learned], chosen: Learned, data: Data) -> None:
    """What `fame.anomaly.plots` can draw of it."""
    from fame.anomaly.paths import PathDetector
    from fame.anomaly.plots import deviations, joint_space, matrices
    from fame.anomaly.recording import BENIGN
    from fame.anomaly.table import data_name

    whole = data.both or data.benign
    assert whole is not None
    if data.benign is not None:
        joint_space(folder / "benign.png", data.benign, title="Benign points in joint space")
    judged = {"train": whole} | {f"test_{number}": item for number, item in enumerate(data.testing, start=1)}
    for name, recording in judged.items():
        of = "data that it learned from" if name == "train" else Path(recording.source).name
        title = f"Verdicts of {chosen.entry.name} on {of}"
        joint_space(folder / f"{name}.png", recording, chosen.model.predict(recording), title=title)
    told = [(f"{item.entry.name}, {data_name(said)}", said.runs) for item in learned for said in item.judged]
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
            deviations(folder / f"{item.entry.name}.png", item.model.estimator, named)


def _by_label(labels: list[int]) -> list[list[int]]:
    """The numbers of the runs of each label."""
    return [[number for number, label in enumerate(labels) if label == wanted] for wanted in sorted(set(labels))]


def _show(progress: Progress) -> None:
    left = "" if progress.left is None else f", about {progress.left:.0f} s left"
    print(f"\r\x1b[2K{progress.done} of {progress.total} fits{left}: {progress.name}", end="", file=sys.stderr)
    if progress.done == progress.total:
        print("\r\x1b[2K", end="", file=sys.stderr)


# ---- operate ---------------------------------------------------------------------------------------------------------


def _operate(arguments: argparse.Namespace, connect: Connect | None) -> int:
    _settle(arguments, "model")
    from fame.anomaly.operate import Operate
    from fame.anomaly.persist import load_model

    model = load_model(arguments.model)
    nodes: list[Operate] = []

    def enough() -> bool:
        return bool(nodes) and 0 < arguments.runs <= len(nodes[0].runs)

    over = False

    def report(text: str) -> None:
        nonlocal over
        if over:
            return
        _say(text)
        over = enough()
        if over:
            nodes[0].scheduler.stop()

    def make(middleware: Middleware, scheduler: Scheduler) -> Operate:
        nodes.append(
            Operate(
                middleware, scheduler, model, topic=arguments.topic, field=arguments.field,
                threshold=arguments.threshold, rule=arguments.rule, cycle=arguments.points, report=report,
            )
        )  # fmt: skip
        return nodes[0]

    _drive(arguments, connect, make, enough)
    runs = nodes[0].runs[: arguments.runs or None]
    if not runs and arguments.bag is not None:
        raise MissionError(f"{arguments.bag}: no run was judged: none began that the model fits (--rule, --topic)")
    above = [item for item in runs if item.above]
    if arguments.json:
        told = [
            {
                "run": r.run,
                "points": r.points,
                "anomalous": r.anomalous,
                "score": r.score,
                "above": r.above,
                "whole": r.whole,
            }
            for r in runs
        ]
        print(json.dumps({"status": "failed" if above else "completed", "runs": told}, indent=2))
    else:
        cut = sum(not item.whole for item in runs)
        print(f"{len(runs)} runs, {len(above)} of them anomalous" + (f", {cut} cut off" if cut else ""))
    return 1 if above else 0


# ---- where messages come from ----------------------------------------------------------------------------------------


def _drive(
    arguments: argparse.Namespace,
    connect: Connect | None,
    make: Callable[[Middleware, Scheduler], Any],
    enough: Callable[[], bool],
) -> None:
    """Make the node and let it work: on a bag until that ends or is enough, on a middleware until it is done or
    interrupted."""
    if arguments.bag is not None:
        _play(arguments, make, enough)
        return
    if connect is None:
        raise ConfigError("without a middleware give a bag: --bag BAG")
    middleware, scheduler = connect()
    node = make(middleware, scheduler)
    try:
        scheduler.run()
    except KeyboardInterrupt:
        _say("interrupted: what has come so far counts")
    finally:
        node.close()
        middleware.close()


def _play(
    arguments: argparse.Namespace, make: Callable[[Middleware, Scheduler], Any], enough: Callable[[], bool]
) -> None:
    """A bag on topics within this process, in the time of the bag."""
    from fame.anomaly.bags import read_bag
    from fame.anomaly.joints import TYPE
    from fame.anomaly.operate import EMPTY, END, START
    from fame.clock import SECOND, Kind, Scheduler
    from fame.middleware import messages
    from fame.middleware.interface import SENSOR_DATA
    from fame.middleware.local import LocalMiddleware

    scheduler = Scheduler()
    middleware = LocalMiddleware(scheduler)
    node = make(middleware, scheduler)
    player = middleware.node("bag")
    joints = player.publisher(arguments.topic, TYPE, SENSOR_DATA)
    signals = {topic: player.publisher(topic, EMPTY) for topic in (START, END) if arguments.rule == "signal"}
    first, empty = None, True
    for time, topic, message in read_bag(arguments.bag, {arguments.topic: TYPE} | dict.fromkeys(signals, EMPTY)):
        first = time if first is None else first
        due = round((time - first) * SECOND)
        if topic in signals:
            scheduler.at(due, partial(signals[topic].publish, messages.create(EMPTY)), Kind.WORLD)
        else:
            header = {"stamp": {"sec": message.header.stamp.sec, "nanosec": message.header.stamp.nanosec}}
            content = {name: list(getattr(message, name)) for name in ("name", *FIELDS)}
            sent = messages.create(TYPE, {"header": header, **content})
            scheduler.at(due, partial(joints.publish, sent), Kind.WORLD)
            empty = False
        scheduler.run(due)
        if enough():
            break
    if empty:
        raise MissionError(f"{arguments.bag}: {arguments.topic} holds no messages")
    node.close()
