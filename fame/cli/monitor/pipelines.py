"""Commands of monitoring: processing nodes, recording nodes and the training of detectors.

``fame monitor process``, ``fame monitor record`` and ``fame monitor train``.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from fame.cli.arguments import (
    ROWS,
    Commands,
    Parser,
    add_json,
    add_rows,
    add_time_unit,
    add_types,
    assignment,
    command,
    namespace,
    positive,
)
from fame.cli.network import add_network
from fame.cli.output import note, print_json, progress_line, table
from fame.errors import NOT_KNOWN, ConfigError, MissionError, UnavailableError
from fame.text import writable

if TYPE_CHECKING:
    from fame.clock import Scheduler, WallScheduler
    from fame.middleware.interface import Middleware
    from fame.monitor.pipeline.configuration import Configuration
    from fame.monitor.pipeline.recording import RecordingNode
    from fame.monitor.pipeline.train import Complete, Training
    from fame.monitor.pipeline.trained_model import TrainedModel
    from fame.scenario.process import Component

    Listening = TypeVar("Listening", bound=Component)


_PROCESS_EXAMPLES = (
    "fame monitor process models/monitoring/joint_monitor/low_pass.yaml",
    "fame monitor process encoder_0.yaml --processor my_model.py:Encoder --frequency 20",
    "fame monitor process low_pass.yaml encoders.yaml threshold.yaml --set cutoff=5",
)


def add_process(commands: Commands) -> None:
    parser = command(
        commands, "process", run_process, examples=_PROCESS_EXAMPLES,
        help="run processing nodes: filters and learned models between topics",
    )  # fmt: skip
    parser.add_argument("configurations", type=Path, nargs="+", metavar="CONFIG.yaml")
    parser.add_argument(
        "--processor", action="append", default=[], metavar="CLASS",
        help="processor instead of those of the configuration: LowPass ..., module:Class, file.py:Class; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--set", action="append", default=[], type=assignment, metavar="NAME=VALUE", dest="values",
        help="a parameter, of all processing nodes that have it; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--frequency", type=positive, metavar="HZ", help="calls per second, instead of those of the configuration"
    )
    parser.add_argument("--namespace", type=namespace, default="", metavar="NAME", help="namespace of relative topics")
    parser.add_argument("--graph", type=Path, metavar="FILE.svg", help="draw the configured pipeline and exit")
    add_types(parser)
    add_network(parser)


def listen(arguments: Namespace, make: Callable[[Middleware, Scheduler], Listening]) -> Listening:
    """Make a node and let it work until it is interrupted or its scheduler is stopped. Returns it, closed."""
    from fame.clock import SECOND
    from fame.scenario import serve

    made: list[Listening] = []

    def build(scheduler: WallScheduler, middleware: Middleware) -> Listening:
        scheduler.run(scheduler.now + SECOND // 2)  # until others are found, and with them the types of topics
        made.append(make(middleware, scheduler))
        return made[0]

    serve(arguments.middleware, arguments.network, build)
    return made[0]


def run_process(arguments: Namespace) -> int:
    """Serve until interrupted."""
    from fame.monitor.pipeline.node import ProcessingNode
    from fame.monitor.pipeline.processors import assign, find_classes, make_processors

    configurations = [_configured(path, arguments) for path in arguments.configurations]
    if arguments.graph is not None:
        from fame.monitor.plots import draw

        for configuration in configurations:
            find_classes(configuration)
        draw(configurations, arguments.graph)
        return 0
    chains = [make_processors(configuration) for configuration in configurations]
    for chain, configuration in zip(chains, configurations, strict=True):
        assign(chain, configuration)

    values = _values_of(chains, arguments.values)

    def make(middleware: Middleware, scheduler: Scheduler) -> ExitStack:
        with ExitStack() as nodes:
            for chain, configuration, own in zip(chains, configurations, values, strict=True):
                node = ProcessingNode(
                    middleware, scheduler, configuration, processors=chain, namespace=arguments.namespace, report=note
                )
                nodes.callback(node.close)
                for name, value in own:
                    node.set(name, value)
                note(f"{configuration.name}: {' -> '.join(type(each).__name__ for each in chain)} "
                     f"at {configuration.frequency:g} Hz")  # fmt: skip
            return nodes.pop_all()

    listen(arguments, make)
    return 0


def _values_of(chains: Sequence[Sequence[Any]], values: Sequence[tuple[str, Any]]) -> list[list[tuple[str, Any]]]:
    """Return for each chain the values of the parameters that it has. Raises ConfigError for one that none has."""
    from fame.monitor.pipeline.parameters import owners

    known = [owners(chain) for chain in chains]
    for name, _ in values:
        if not any(name in each for each in known):
            names = dict.fromkeys(name for each in known for name in each)
            raise ConfigError(f"unknown parameter; known are {', '.join(names) or 'none'}", element=name)
    return [[(name, value) for name, value in values if name in each] for each in known]


def _configured(path: Path, arguments: Namespace) -> Configuration:
    """Return a configuration, with what the command line says instead. Raises ConfigError."""
    from fame.config.values import ConfigValue
    from fame.monitor.pipeline.configuration import hertz, load, stages_of

    configuration = load(path)
    if not (configuration.inputs or configuration.outputs):
        raise ConfigError("has no Inputs or Outputs to process", file=str(path))
    if arguments.processor:
        stages = stages_of(ConfigValue(list(arguments.processor), "--processor"))
        own = configuration.stages
        if len(own) == len(stages):  # another class, with the parameters that the file has for it
            stages = tuple(replace(stage, parameters=old.parameters) for stage, old in zip(stages, own, strict=True))
        configuration = replace(configuration, stages=stages)
    if arguments.frequency is not None:
        configuration = replace(configuration, frequency=hertz(ConfigValue(arguments.frequency, "--frequency")))
    return configuration


_RECORD_EXAMPLES = (
    "fame monitor record joints.yaml -o runs.csv",
    "fame monitor record joints.yaml -o runs.csv --append --run-topic /task_start",
    "fame monitor record joints.yaml --bag runs_bag -o runs.csv",
    "fame monitor record joints.yaml -o runs.mcap -o http://localhost:8086/robots",
)


def add_record(commands: Commands) -> None:
    parser = command(
        commands, "record", run_record, examples=_RECORD_EXAMPLES,
        help="record the inputs of a configuration as CSV, MCAP, ROS 2 bag or into InfluxDB",
    )  # fmt: skip
    parser.add_argument("configuration", type=Path, metavar="CONFIG.yaml")
    parser.add_argument(
        "-o", "--output", action="append", required=True, metavar="WHERE",
        help="FILE.csv, FILE.mcap, a folder (ROS 2 bag), or http://host:8086/database (InfluxDB); repeatable",
    )  # fmt: skip
    parser.add_argument("--bag", type=Path, metavar="BAG", help="read a bag (ROS 1, ROS 2, MCAP) instead of listening")
    parser.add_argument(
        "--elements", action="store_true",
        help="add the active element of the mission (topic bpmn_events) to CSV files, from which phase learns",
    )  # fmt: skip
    parser.add_argument("--append", action="store_true", help="append the next run to an existing CSV file")
    parser.add_argument(
        "--run-topic",
        default="",
        metavar="TOPIC",
        help="a message (std_msgs/msg/Empty) on this topic begins the next run",
    )
    parser.add_argument(
        "--duration", type=positive, metavar="S", help="end after this many s of the robot's time (stamps)"
    )
    parser.add_argument("--namespace", type=namespace, default="", metavar="NAME", help="namespace of relative topics")
    add_types(parser)
    add_network(parser)
    add_json(parser)


_SILENT = "its topics were silent"


def run_record(arguments: Namespace) -> int:
    """Record until interrupted, for the duration, or until the bag ends; exit code 3 if an output lacks some of what
    came."""
    from fame.monitor.pipeline.configuration import load
    from fame.monitor.pipeline.recording import RecordingNode, RecordingOptions, record_bag

    if arguments.bag is not None and arguments.duration is not None:
        raise ConfigError("--duration is for listening: a bag is read to its end")
    configuration = load(arguments.configuration)
    options = RecordingOptions(
        namespace=arguments.namespace, append=arguments.append, run_topic=arguments.run_topic,
        elements=arguments.elements, report=note,
    )  # fmt: skip

    def make(middleware: Middleware, scheduler: Scheduler) -> RecordingNode:
        node = RecordingNode(middleware, scheduler, configuration, arguments.output, options)
        note(f"{configuration.name}: recording to {', '.join(arguments.output)}")
        if arguments.duration:
            node.end_after(arguments.duration, scheduler.stop)
        return node

    if arguments.bag is not None:
        node = record_bag(arguments.bag, configuration, arguments.output, options)
    else:
        node = listen(arguments, make)
    rows, runs = node.rows, node.recorded_runs
    left_out = node.left_out
    if not rows:
        raise MissionError(f"nothing was recorded: {'; '.join(each.text for each in left_out) or _SILENT}")
    stored = list(zip(arguments.output, node.stored, strict=True))
    if arguments.json:
        print_json({
            "status": "completed" if node.is_whole else "partial", "rows": rows, "runs": runs,
            "outputs": arguments.output, "stored": [{"output": where, **each._asdict()} for where, each in stored],
            "left_out": [each._asdict() for each in left_out],
        })  # fmt: skip
    else:
        print(f"{', '.join(arguments.output)}: {rows} rows, {runs} {'run' if runs == 1 else 'runs'}")
        for where, each in stored:
            if not each.whole:
                why = "; ".join(each.reasons) or "they do not fit its columns"
                print(f"{where}: has {each.rows} rows, {each.missing} are missing: {why}")
        for each_topic in left_out:
            print(each_topic.text)
    return 0 if node.is_whole else NOT_KNOWN


def add_train(commands: Commands) -> None:
    parser = command(
        commands, "train", run_train,
        examples=(
            "fame monitor train monitor.yaml --plots out",
            "fame monitor train monitor.yaml --compare",
            "fame monitor train --data runs.csv --run-column cycle -o model.skops",
            "fame monitor train --data monday.mcap tuesday_bag --config joints.yaml -o model.skops",
        ),
        help="train a detector on recorded runs, with thresholds that promise a rate of false alarms",
    )  # fmt: skip
    parser.add_argument(
        "configuration", type=Path, nargs="?", metavar="CONFIG.yaml", help="a configuration with the section Training"
    )
    _add_training_runs(parser)
    parser.add_argument("--window", type=int, metavar="N", help="samples of a window (default: 50)")
    parser.add_argument("--stride", type=int, metavar="N", help="samples from one window to the next (default: 5)")
    parser.add_argument(
        "--detector", metavar="NAME",
        help="phase, 'any of pca, knn', sklearn.ensemble.IsolationForest ... instead of the configuration's Detector; "
        "without either, the best of some, by a comparison on left-out runs (mahalanobis for fewer than 5 runs)",
    )  # fmt: skip
    parser.add_argument("--false-alarms", metavar="RATE", help="rate to promise, as '0.05 per run'")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="MODEL.skops", help="file to write, instead of the configuration's Model"
    )
    parser.add_argument("--onnx", type=Path, metavar="MODEL.onnx", help="deprecated: fame monitor export writes ONNX")
    parser.add_argument("--onnx-single", action="store_true", help="deprecated: fame monitor export --single")
    parser.add_argument("--plots", type=Path, metavar="DIR", help="draw the loss of each run, with the thresholds")
    parser.add_argument("--compare", action="store_true", help="compare all detectors on these runs, and use the best")
    parser.add_argument(
        "--check", action="store_true", help="only check that the stored model was trained on these data"
    )
    parser.add_argument(
        "--keep", action="store_true",
        help="train also if runs are unlike the others (left-out loss, movement, duration); leave out copies of runs",
    )  # fmt: skip
    add_json(parser)


def _add_training_runs(parser: Parser) -> None:
    """Add what is read of which files."""
    parser.add_argument(
        "--data", type=Path, nargs="+", default=[], metavar="FILE",
        help="runs as CSV or Parquet files, with --config also bags, MCAP files and recordings of FAME, each a run",
    )  # fmt: skip
    parser.add_argument(
        "--config", type=Path, metavar="CONFIG.yaml", help="configuration whose Inputs are read from the bags of --data"
    )
    parser.add_argument(
        "--namespace", type=namespace, default="", metavar="NAME", help="namespace of relative topics of bags"
    )
    parser.add_argument(
        "--elements", action="store_true",
        help="read the mission's active element from bags, too (topic bpmn_events), for phase",
    )  # fmt: skip
    parser.add_argument("--run-column", metavar="NAME", help="column whose changes begin a run (default: run)")
    parser.add_argument(
        "--element-column", metavar="NAME", help="column of the mission's active element, for phase (default: element)"
    )
    parser.add_argument("--time-column", metavar="NAME", help="column of the times, in s or dates (default: stamp)")
    add_time_unit(parser, "s, refused where that is doubtful")
    parser.add_argument(
        "--exclude", nargs="+", metavar="NAME",
        help="columns that are no channels, such as texts; and runs, as 'run 7', or by the name of their file",
    )  # fmt: skip
    add_rows(parser)


def run_train(arguments: Namespace) -> int:
    """Train on tables, and on bags by the Inputs of a configuration."""
    from fame.imports import require
    from fame.monitor.data_files import is_bag
    from fame.monitor.pipeline.recording import RecordingOptions, tables_of

    if arguments.onnx is not None:
        require("onnx", "onnxruntime")
        note("fame: note: fame monitor train --onnx is now fame monitor export MODEL.skops -o MODEL.onnx")
    elif arguments.onnx_single:
        raise ConfigError("--onnx-single is about the file of --onnx, which is not given")
    training, file = _training(arguments)
    names = [name for name in ("config", "namespace", "elements") if getattr(arguments, name)]
    if names and not any(is_bag(Path(each)) for each in training.files):
        raise ConfigError(f"--{names[0]} is about bags, and {', '.join(training.files)} has none")
    if not (arguments.keep or arguments.check) and (failed := _failed(training.files)):
        name, robots = next(iter(failed.items()))
        text = f"the mission of {', '.join(robots)} failed in this recording: leave it out, or train with --keep"
        raise ConfigError(text, file=name)
    options = RecordingOptions(namespace=arguments.namespace, elements=arguments.elements, report=note)
    with tables_of(training.files, arguments.config or arguments.configuration, options) as tables:
        return store_trained(arguments, replace(training, files=tables.paths), file, training.files, tables.completed)


def _failed(files: Sequence[str]) -> dict[str, list[str]]:
    """Return the recordings of FAME in which missions failed, each with the robots."""
    from fame.monitor.data_files import failed_missions

    return {each: robots for each in files if (robots := failed_missions(Path(each)))}


def store_trained(arguments: Namespace, training: Training, file: str, files: Sequence[str], complete: Complete) -> int:
    """Train, store the model with its card, and print the result; `files` are what the user named, and `complete` says
    what was left out of them."""
    from fame.cli.monitor.export import export
    from fame.monitor.data_files import hash_files, read_labelled_runs
    from fame.monitor.pipeline.trained_model import TrainedModel
    from fame.monitor.pipeline.training_checks import warnings_of

    path = arguments.output or Path(training.model)
    if arguments.check:
        model = TrainedModel.load(path, columns=training.columns, data=hash_files(files))
    else:
        for output in filter(None, (path, arguments.onnx)):
            writable(output, *files)  # a model that is trained again takes its own place
        model = _store(_trained_model(arguments, training, file, path, complete), files, path)
    if arguments.onnx is not None:
        runs = [run.samples for run in read_labelled_runs(training.files, model.columns, training.special)]
        export(model, runs, arguments.onnx, single=arguments.onnx_single)
    if arguments.plots is not None:
        _plot_training(arguments.plots, model, training)
    if arguments.json:
        compared = [] if arguments.check else model.conditions.get("compared", [])
        comparison = {"compared": compared} if compared else {}
        print_json(_trained(path, model, replace(training, files=tuple(files)), warnings_of(model)) | comparison)
    else:
        _print_trained(path, model)
    return 0


def _trained_model(arguments: Namespace, training: Training, file: str, path: Path, complete: Complete) -> TrainedModel:
    """Train, and print the comparison if there is one. Raises ConfigError, also for a doubtful model."""
    from fame.monitor.pipeline.compare import ALL
    from fame.monitor.pipeline.train import train

    with progress_line(sys.stderr) as line:
        progress: Callable[[str], object] = line.write if line is not None else print
        asked = ALL if arguments.compare else ()
        config, keep = replace(training, model=str(path)), arguments.keep
        model = train(config, report=progress, keep=keep, complete=complete, detectors=asked)
    if (compared := model.conditions.get("compared", [])) and not arguments.json:
        print(_comparison(compared))
    if not (arguments.keep or training.keep):
        _refuse_doubtful(model, file, training, path)
    return model


def _store(model: TrainedModel, files: Sequence[str], path: Path) -> TrainedModel:
    """Store a model of some files, with its card. Returns it with what is said of these."""
    from fame.monitor.data_files import hash_files
    from fame.monitor.model_card import origin_of, write_card

    named = {
        "files": [Path(each).name for each in files], "paths": [str(Path(each).resolve()) for each in files],
        "failed": _failed(files), **origin_of(path),
    }  # fmt: skip
    model = replace(model, data=hash_files(files), conditions={**model.conditions, **named})
    model.save(path)
    write_card(model, path)
    return model


def _print_trained(path: Path, model: TrainedModel) -> None:
    from fame.monitor.pipeline.training_checks import warnings_of

    for text in warnings_of(model):
        note(f"warning: {text}")
    kinds = ("training_mean", "training_max", "validation_max")
    figures = zip(*(model.metrics[kind] for kind in kinds), model.thresholds, strict=True)
    rows = [(name, *(f"{value:.4g}" for value in row)) for name, row in zip(model.columns, figures, strict=True)]
    print(table(("loss of", "training mean", "maximum", "left out maximum", "threshold"), rows))
    promise = model.calibration.text if model.calibration is not None else "no promise"
    print(f"\n{path}: {_detector_text(model)}, windows of {model.window} samples at {model.rate:.4g} Hz, "
          f"data {model.data[:12]}\nfalse alarms: {promise}")  # fmt: skip


def _training(arguments: Namespace) -> tuple[Training, str]:
    """Return the settings of a configuration or of options, and the file that errors name. Raises ConfigError."""
    from fame.monitor.data_files import is_bag
    from fame.monitor.pipeline.configuration import load
    from fame.monitor.pipeline.training_settings import Training, section_of, training_of

    if (arguments.configuration is None) == (not arguments.data):
        raise ConfigError("expected a configuration with the section Training, or --data FILE")
    names = ("run_column", "time_column", "element_column", "time_unit", "detector", "false_alarms", "window", "stride",
             *ROWS)  # fmt: skip
    given: dict[str, Any] = {name: value for name in names if (value := getattr(arguments, name)) is not None}
    if arguments.exclude:
        given["exclude"] = tuple(arguments.exclude)
    if arguments.data:
        configured = arguments.config is not None and any(map(is_bag, arguments.data))
        made = load(arguments.config) if configured else None
        given |= {"join": made.join, "run": made.run} if made is not None else {}
        return Training(files=tuple(map(str, arguments.data)), **given), str(arguments.data[0])
    configuration = load(arguments.configuration)
    training = training_of(section_of(configuration), configuration.folder)
    return replace(training, join=configuration.join, run=configuration.run, **given), str(configuration.file)


def _refuse_doubtful(model: TrainedModel, file: str, training: Training, path: Path) -> None:
    """Raise ConfigError for a detector that knows its own runs only, or runs that are unlike the others: these are
    drawn on a page beside the model, if matplotlib is there."""
    from fame.monitor.pipeline.training_checks import memorised, outliers

    if text := memorised(model):
        mend = "record more or longer runs, take another Detector (--compare) or a shorter Window"
        raise ConfigError(f"{text}: {mend}, or train with --keep", file=file, element="Training")
    benign = model.conditions.get("benign", [])  # whatever they look like, somebody said so
    if strange := {number: text for number, text in outliers(model).items() if number not in benign}:
        page = path.with_suffix(".refused.html")
        drawn, mend = "", "record it again"
        if not model.conditions.get("cut"):
            mend = f"leave them out (--exclude 'run {next(iter(strange))}')"
            with suppress(UnavailableError):
                _write_refused(model, training, strange, page)
                drawn = f" ({page})"
        text = f"{'; '.join(strange.values())}; look at these runs{drawn} and {mend}, or train with --keep"
        raise ConfigError(text, file=file, element="Training.Files")


def _write_refused(model: TrainedModel, training: Training, strange: Mapping[int, str], page: Path) -> None:
    """Draw strange runs of the training in the band of the others."""
    from fame.monitor.data_files import is_other_class, read_labelled_runs
    from fame.monitor.judge import judge_trained
    from fame.monitor.judge_report import write_refused
    from fame.monitor.pipeline.train import band_of

    read = read_labelled_runs(training.files, training.columns, training.special, undisturbed=True)
    others = [
        run.samples for number, run in enumerate(read)
        if number not in strange and len(run.samples) and not is_other_class(run, training.special)
    ]  # fmt: skip
    judging = replace(model, band=band_of(others, model.elements))
    shown = judge_trained(judging, [read[number] for number in strange], str(page)).runs
    write_refused(shown, list(strange.values()), page)


def _comparison(compared: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of a comparison and its rule."""
    from fame.monitor.pipeline.compare import RULE

    rows = [
        (
            item["detector"], f"{item['false alarms']} of {item['runs']}",
            f"{sum(item['found'].values())} of {item['faults']}", *map(str, item["found"].values()),
            "-" if item["latency"] is None else f"{item['latency']:.3g} s", f"{item['cost']:.1f} us",
        )
        for item in compared
    ]  # fmt: skip
    heads = ("detector", "false alarms", "faults found", *compared[0]["found"], "latency", "cost per sample")
    return f"{table(heads, rows)}\n{compared[0]['detector']} is used: {RULE}\n"


def _detector_text(model: TrainedModel) -> str:
    from fame.monitor.pipeline.detectors import ChannelAutoencoders

    if isinstance(model.detector, ChannelAutoencoders):
        return f"{'-'.join(map(str, model.network.layers))} per channel"
    return model.detector_text


def _trained(path: Path, model: TrainedModel, training: Training, warnings: list[str]) -> dict[str, Any]:
    """The object of ``--json``."""
    from fame.monitor.pipeline.detectors import detector_name

    calibration = model.calibration
    alarms = {"asked": calibration.asked, "promised": calibration.promised} if calibration is not None else {}
    settings = asdict(training) | {"detector": detector_name(model.detector)}
    for name in ("model", "columns", "estimator"):
        del settings[name]
    return {
        "status": "completed", "model": str(path), "columns": model.columns, "data": model.data, "rate": model.rate,
        "detector": detector_name(model.detector), "thresholds": model.thresholds, "metrics": dict(model.metrics),
        "false_alarms": alarms, "warnings": warnings, "versions": dict(model.versions), "training": settings,
    }  # fmt: skip


def _plot_training(folder: Path, model: TrainedModel, training: Training) -> None:
    """Draw the loss of each training run that has a window, under the number that messages give it."""
    from fame.monitor.data_files import read_labelled_runs
    from fame.monitor.pipeline.train import losses, prepared
    from fame.monitor.plots import plot_loss

    folder.mkdir(parents=True, exist_ok=True)
    runs = [run.samples for run in read_labelled_runs(training.files, model.columns, training.special)]
    drawn = 0
    for number, run in enumerate(prepared(runs, training)):
        if len(run) and len(loss := losses(model, run, training.stride)):
            plot_loss(loss, folder / f"run_{number:03d}.png", thresholds=model.thresholds, title=f"run {number}")
            drawn += 1
    left_out = f"; too short to be judged: {len(runs) - drawn} runs" if drawn < len(runs) else ""
    note(f"{drawn} {'plot' if drawn == 1 else 'plots'} in {folder}{left_out}")
