"""``fame adm``: the anomaly detection module."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.arguments import Commands, add_json, command, positive
from fame.cli.network import add_network

if TYPE_CHECKING:
    from fame.clock import Scheduler
    from fame.middleware.interface import Middleware

_EXAMPLES = (
    "fame adm collect --label 1 --runs 30 -o benign.csv",
    "fame adm learn examples/adm_learn.yaml -o best.skops",
    "fame adm envelope benign.csv --tolerance 1 -o outside.csv",
    "fame adm operate --model best.skops --threshold 0.01",
)


def add(commands: Commands) -> None:
    """Declare the command and its four parts."""
    from fame.anomaly.cli import add_arguments

    parser = command(
        commands, "adm", run, examples=_EXAMPLES,
        help="learn what a repetitive task looks like, and raise an alarm when a run leaves it",
    )  # fmt: skip
    parts = parser.add_subparsers(metavar="PART", required=True)
    for node in add_arguments(parts):
        add_network(node)
    envelope = parts.add_parser("envelope", help="runs just outside a tolerance, as labelled training data")
    envelope.add_argument("benign", type=Path, metavar="BENIGN.csv", help="recorded runs of the task")
    envelope.add_argument("--tolerance", type=positive, required=True, metavar="MM", help="of each side of the part")
    envelope.add_argument(
        "--task", type=Path, metavar="TASK.yaml", help="corners (m) and height (m) of the cut; default: the triangle"
    )
    envelope.add_argument("--chain", type=Path, metavar="ARM.yaml", help="kinematics of the arm; default: the MH5")
    envelope.add_argument("-o", "--output", type=Path, required=True, metavar="CSV")
    add_json(envelope)
    envelope.set_defaults(adm=_envelope)


def run(arguments: Namespace) -> int:
    """Do it, on the network unless a bag is read."""
    from fame.anomaly import cli
    from fame.remote import connect, scheduler_for

    def join() -> tuple[Middleware, Scheduler]:
        scheduler = scheduler_for(arguments.middleware)
        return connect(arguments.middleware, scheduler, arguments.network), scheduler

    return cli.run(arguments, join)


def _envelope(arguments: Namespace, _connect: object) -> int:
    """Alter benign runs so that they cut just outside the tolerance, and write them as anomalous ones."""
    from fame.anomaly.chain import load_chain
    from fame.anomaly.cli import written
    from fame.anomaly.files import read_csv, write_csv
    from robots.arm.envelope import envelope
    from robots.arm.mh5 import MH5
    from robots.arm.task import TRIANGLE, read_polygon

    polygon = read_polygon(arguments.task) if arguments.task is not None else TRIANGLE
    chain = load_chain(arguments.chain) if arguments.chain is not None else MH5
    recording = envelope(read_csv(arguments.benign), polygon, arguments.tolerance / 1000, chain)
    write_csv(arguments.output, recording)
    return written(arguments, recording)
