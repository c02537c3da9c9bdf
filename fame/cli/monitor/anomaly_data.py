"""The runs that ``fame monitor adm`` works on: labelled files, and the topics or bags that runs come from."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from fame.cli.arguments import Commands, Parser, add_json, command, natural, positive
from fame.cli.monitor.pipelines import listen
from fame.cli.output import note, print_json
from fame.errors import ConfigError, MissionError
from fame.text import writable

if TYPE_CHECKING:
    from fame.clock import Scheduler
    from fame.middleware.interface import Middleware
    from fame.monitor.anomaly.recording import Recording
    from fame.monitor.pipeline.recording import RecordingNode

    Playing = TypeVar("Playing", bound=RecordingNode)


FIELDS, RULES = ("position", "velocity", "effort"), ("home", "signal", "count")


def add_published(parser: Parser, metavar: str, types: Mapping[str, Callable[[str], Any]]) -> None:
    """The arguments of the published module, which has no options: all of them by place, or none."""
    parser.add_argument("published", nargs="*", metavar=metavar, help="positional form, as in the paper's programs")
    parser.set_defaults(published_types=types)


def add_source(parser: Parser) -> None:
    """Which joint states, and what of them is a run."""
    parser.add_argument("--topic", default="/joint_states", help="default: /joint_states")
    parser.add_argument("--field", choices=FIELDS, default="position")
    parser.add_argument("--bag", type=Path, metavar="BAG", help="read a bag instead of listening")
    parser.add_argument("--rule", choices=RULES, default="home", help="what delimits a run (default: home)")
    parser.add_argument(
        "--points", type=natural, default=0, metavar="N",
        help="with --rule count: points per run (default of operate: as learned)",
    )  # fmt: skip
    parser.add_argument("--runs", type=natural, default=0, metavar="N", help="stop after N runs")


def settle(arguments: Namespace, *required: str) -> None:
    """Put what was given by place where the options are. Raises ConfigError for what is missing or wrong."""
    types: Mapping[str, Callable[[str], Any]] = arguments.published_types
    words = arguments.published
    if words and len(words) != len(types):
        raise ConfigError(f"expected {', '.join(types)}, or options, got {len(words)} positional arguments")
    for (name, convert), text in zip(types.items(), words, strict=bool(words)):
        try:
            setattr(arguments, name, convert(text))
        except ValueError:
            raise ConfigError(f"expected a number as {name}, got {text!r}") from None
    missing = [name for name in required if getattr(arguments, name) is None]
    if missing:
        raise ConfigError(f"needs --{missing[0]} (see --help)")
    threshold = getattr(arguments, "threshold", None)
    if threshold is not None and not 0 <= threshold < 1:
        raise ConfigError(f"expected a threshold from 0 to 1, got {threshold:g}")
    if getattr(arguments, "label", 1) not in (1, -1):
        raise ConfigError(f"expected the label 1 (benign) or -1 (anomalous), got {arguments.label}")


def drive(arguments: Namespace, make: Callable[[Middleware, Scheduler], Playing]) -> Playing:
    """Make the node and let it work, until the bag ends, its work is done or it is interrupted. Returns the node."""
    from fame.monitor.anomaly.nodes import bag_topics
    from fame.monitor.pipeline.recording import play

    if arguments.bag is None:
        return listen(arguments, make)
    node = play(arguments.bag, make, bag_topics(arguments.topic, arguments.rule))
    if not node.rows:
        raise MissionError(f"{arguments.bag}: {arguments.topic} holds no messages")
    return node


def add_labelled_files(parts: Commands) -> None:
    merging = command(
        parts, "merge", merge, examples=("fame monitor adm merge benign.csv outside.csv -o training.csv",),
        help="join labelled CSV files into one",
    )  # fmt: skip
    merging.add_argument("files", type=Path, nargs="+", metavar="CSV")
    enveloping = command(
        parts, "envelope", envelope, examples=("fame monitor adm envelope benign.csv --tolerance 1 -o outside.csv",),
        help="compute runs just outside a tolerance, as labelled training data",
    )  # fmt: skip
    enveloping.add_argument("benign", type=Path, metavar="BENIGN.csv", help="recorded runs of the task")
    enveloping.add_argument(
        "--tolerance", type=positive, required=True, metavar="MM", help="tolerance of each side of the part (mm)"
    )
    enveloping.add_argument(
        "--task", type=Path, metavar="TASK.yaml", help="corners (m) and height (m) of the cut; default: the triangle"
    )
    enveloping.add_argument("--chain", type=Path, metavar="ARM.yaml", help="kinematics of the arm; default: the MH5")
    for parser in (merging, enveloping):
        parser.add_argument("-o", "--output", type=Path, required=True, metavar="CSV")
        add_json(parser)


def merge(arguments: Namespace) -> int:
    """Join files, write the result, and print what it holds."""
    from fame.monitor.anomaly import recording

    writable(arguments.output, *arguments.files)
    joined = recording.merge(arguments.files)
    recording.write_csv(arguments.output, joined)
    return print_written(arguments, joined)


def envelope(arguments: Namespace) -> int:
    """Alter benign runs so that they cut just outside a tolerance, write them as anomalous ones, and print that."""
    from fame.monitor.anomaly.recording import read_csv, write_csv
    from fame.monitor.kinematics import load_chain
    from robots.arm import sabotage
    from robots.arm.task import MH5, TRIANGLE, read_polygon

    writable(arguments.output, *filter(None, (arguments.benign, arguments.task, arguments.chain)))
    polygon = read_polygon(arguments.task) if arguments.task is not None else TRIANGLE
    chain = load_chain(arguments.chain) if arguments.chain is not None else MH5
    recording = sabotage.envelope(read_csv(arguments.benign), polygon, arguments.tolerance / 1000, chain)
    write_csv(arguments.output, recording)
    return print_written(arguments, recording)


def print_written(arguments: Namespace, recording: Recording) -> int:
    """Print what was written to `output`, and the notes on it. Returns the exit code."""
    for text in recording.notes:
        note(text)
    labels = recording.run_labels()
    benign, anomalous = labels.count(1), labels.count(-1)
    if arguments.json:
        runs = {"runs": len(labels), "benign_runs": benign, "anomalous_runs": anomalous}
        print_json({"status": "completed", "file": str(arguments.output), "points": len(recording), **runs})
    else:
        print(f"{arguments.output}: {len(recording)} points, {benign} benign and {anomalous} anomalous runs")
    return 0
