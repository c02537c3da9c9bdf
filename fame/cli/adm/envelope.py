"""``fame adm envelope``: benign runs, altered so that they cut just outside a tolerance, as anomalous ones."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from fame.cli.adm.merge import tell_written
from fame.cli.arguments import Commands, add_json, command, positive


def add(parts: Commands) -> None:
    """Declare the part."""
    parser = command(
        parts, "envelope", run, examples=("fame adm envelope benign.csv --tolerance 1 -o outside.csv",),
        help="runs just outside a tolerance, as labelled training data",
    )  # fmt: skip
    parser.add_argument("benign", type=Path, metavar="BENIGN.csv", help="recorded runs of the task")
    parser.add_argument("--tolerance", type=positive, required=True, metavar="MM", help="of each side of the part")
    parser.add_argument(
        "--task", type=Path, metavar="TASK.yaml", help="corners (m) and height (m) of the cut; default: the triangle"
    )
    parser.add_argument("--chain", type=Path, metavar="ARM.yaml", help="kinematics of the arm; default: the MH5")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="CSV")
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Alter them, write them, and say so."""
    from fame.monitor.anomaly.recording import read_csv, write_csv
    from fame.monitor.kinematics import load_chain
    from robots.arm.mh5 import MH5
    from robots.arm.sabotage import envelope
    from robots.arm.task import TRIANGLE, read_polygon

    polygon = read_polygon(arguments.task) if arguments.task is not None else TRIANGLE
    chain = load_chain(arguments.chain) if arguments.chain is not None else MH5
    recording = envelope(read_csv(arguments.benign), polygon, arguments.tolerance / 1000, chain)
    write_csv(arguments.output, recording)
    return tell_written(arguments, recording)
