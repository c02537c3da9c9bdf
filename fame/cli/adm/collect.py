"""``fame adm collect``: runs of a task as a labelled file."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.adm.labelled_files import print_written
from fame.cli.adm.sources import add_published, add_source, drive, say, settle, writable
from fame.cli.arguments import Commands, add_json, command
from fame.cli.network import add_network

if TYPE_CHECKING:
    from fame.clock import Scheduler
    from fame.middleware.interface import Middleware
    from fame.monitor.anomaly.nodes import CollectNode

_EXAMPLES = (
    "fame adm collect --label 1 --runs 30 -o benign.csv",
    "fame adm collect --bag recorded --label -1 -o anomalous.csv",
)


def add(parts: Commands) -> None:
    """Declare the part."""
    parser = command(
        parts, "collect", run, examples=_EXAMPLES, help="record joint states of runs of a task as a labelled CSV file"
    )
    add_published(parser, "TOPIC CSV LABEL", {"topic": str, "output": Path, "label": int})
    add_source(parser)
    parser.add_argument("--label", type=int, choices=(1, -1), help="1 benign, -1 anomalous")
    parser.add_argument("-o", "--output", type=Path, metavar="CSV")
    add_network(parser)
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Collect until all runs are there, the bag is over, or somebody interrupts."""
    settle(arguments, "label", "output")
    from fame.monitor.anomaly.live import Collector
    from fame.monitor.anomaly.nodes import CollectNode
    from fame.monitor.anomaly.recording import write_csv

    writable(arguments.output)
    collector = Collector(arguments.label, arguments.rule, cycle=arguments.points, limit=arguments.runs)
    of = f" of {arguments.runs}" if arguments.runs else ""

    def make(middleware: Middleware, scheduler: Scheduler) -> CollectNode:
        return CollectNode(
            middleware, scheduler, collector, topic=arguments.topic, field=arguments.field,
            report=say, progress=lambda count: say(f"{count}{of} runs"), done=scheduler.stop,
        )  # fmt: skip

    drive(arguments, make, lambda: collector.done)
    recording = collector.recording()
    write_csv(arguments.output, recording)
    print_written(arguments, recording)
    missing = arguments.runs - recording.count
    if missing > 0:
        say(f"{missing} of the {arguments.runs} runs are missing: the source ended before, or they were cut off")
    return 1 if missing > 0 else 0
