"""``fame adm merge`` and ``fame adm envelope``: labelled files of runs, joined or altered."""

from __future__ import annotations

import sys
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.arguments import Commands, add_json, command, positive
from fame.cli.output import print_json

if TYPE_CHECKING:
    from fame.monitor.anomaly.recording import Recording


def add(parts: Commands) -> None:
    """Declare the parts."""
    merging = command(
        parts, "merge", merge, examples=("fame adm merge benign.csv outside.csv -o training.csv",),
        help="join labelled CSV files into one",
    )  # fmt: skip
    merging.add_argument("files", type=Path, nargs="+", metavar="CSV")
    enveloping = command(
        parts, "envelope", envelope, examples=("fame adm envelope benign.csv --tolerance 1 -o outside.csv",),
        help="runs just outside a tolerance, as labelled training data",
    )  # fmt: skip
    enveloping.add_argument("benign", type=Path, metavar="BENIGN.csv", help="recorded runs of the task")
    enveloping.add_argument("--tolerance", type=positive, required=True, metavar="MM", help="of each side of the part")
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

    joined = recording.merge(arguments.files)
    recording.write_csv(arguments.output, joined)
    return print_written(arguments, joined)


def envelope(arguments: Namespace) -> int:
    """Alter benign runs so that they cut just outside a tolerance, write them as anomalous ones, and print that."""
    from fame.monitor.anomaly.recording import read_csv, write_csv
    from fame.monitor.kinematics import load_chain
    from robots.arm import sabotage
    from robots.arm.task import MH5, TRIANGLE, read_polygon

    polygon = read_polygon(arguments.task) if arguments.task is not None else TRIANGLE
    chain = load_chain(arguments.chain) if arguments.chain is not None else MH5
    recording = sabotage.envelope(read_csv(arguments.benign), polygon, arguments.tolerance / 1000, chain)
    write_csv(arguments.output, recording)
    return print_written(arguments, recording)


def print_written(arguments: Namespace, recording: Recording) -> int:
    """Print what was written to `output`, and the notes on it. Returns the exit code."""
    for note in recording.notes:
        print(note, file=sys.stderr)
    labels = recording.run_labels()
    benign, anomalous = labels.count(1), labels.count(-1)
    if arguments.json:
        runs = {"runs": len(labels), "benign_runs": benign, "anomalous_runs": anomalous}
        print_json({"status": "completed", "file": str(arguments.output), "points": len(recording), **runs})
    else:
        print(f"{arguments.output}: {len(recording)} points, {benign} benign and {anomalous} anomalous runs")
    return 0
