"""``fame record``: recording nodes."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.arguments import Commands, add_json, add_types, command, positive
from fame.cli.network import add_network
from fame.cli.output import note, print_json

if TYPE_CHECKING:
    from fame.clock import WallScheduler
    from fame.middleware.interface import Middleware
    from fame.monitor.pipeline.recording import RecordingNode

_EXAMPLES = (
    "fame record joints.yaml -o runs.csv",
    "fame record joints.yaml -o runs.csv --append --run-topic /task_start",
    "fame record joints.yaml --bag runs_bag -o runs.csv",
    "fame record joints.yaml -o runs.mcap -o http://localhost:8086/robots",
)


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "record", run, examples=_EXAMPLES,
        help="record the inputs of a configuration as CSV, MCAP, a bag of ROS 2, or into InfluxDB",
    )  # fmt: skip
    parser.add_argument("configuration", type=Path, metavar="CONFIG.yaml")
    parser.add_argument(
        "-o", "--output", action="append", required=True, metavar="WHERE",
        help="FILE.csv, FILE.mcap, a folder (a bag), or http://host:8086/database; may be given several times",
    )  # fmt: skip
    parser.add_argument("--bag", type=Path, metavar="BAG", help="read a bag (ROS 1, ROS 2, MCAP) instead of listening")
    parser.add_argument("--append", action="store_true", help="go on with a CSV file, as its next run")
    parser.add_argument(
        "--run-topic", default="", metavar="TOPIC", help="a message (std_msgs/Empty) begins the next run"
    )
    parser.add_argument("--duration", type=positive, metavar="S", help="end after this many seconds")
    parser.add_argument("--namespace", default="", metavar="NAME", help="that topics are relative to")
    add_types(parser)
    add_network(parser)
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Record until interrupted, or until the bag ends."""
    from fame.clock import SECOND
    from fame.errors import MissionError
    from fame.monitor.pipeline.configuration import load
    from fame.monitor.pipeline.recording import RecordingNode, record_bag
    from fame.scenario import serve

    configuration = load(arguments.configuration)
    options = {
        "namespace": arguments.namespace, "append": arguments.append, "run_topic": arguments.run_topic, "report": note,
    }  # fmt: skip
    nodes: list[RecordingNode] = []

    def build(scheduler: WallScheduler, middleware: Middleware) -> RecordingNode:
        scheduler.run(scheduler.now + SECOND // 2)  # until others are found
        node = RecordingNode(middleware, scheduler, configuration, arguments.output, **options)
        nodes.append(node)
        note(f"{configuration.name}: recording to {', '.join(arguments.output)}")
        if arguments.duration:
            scheduler.after(round(arguments.duration * SECOND), scheduler.stop)
        return node

    if arguments.bag is not None:
        nodes.append(record_bag(arguments.bag, configuration, arguments.output, **options))
    else:
        serve(arguments.middleware, arguments.network, build)
    rows, runs = nodes[0].rows, nodes[0].run + bool(nodes[0].rows)
    if not rows:
        raise MissionError("nothing was recorded: its topics were silent")
    if arguments.json:
        print_json({"status": "completed", "rows": rows, "runs": runs, "outputs": arguments.output})
    else:
        print(f"{', '.join(arguments.output)}: {rows} rows, {runs} {'run' if runs == 1 else 'runs'}")
    return 0
