"""``fame adm merge``: labelled files of runs as one."""

from __future__ import annotations

import sys
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.arguments import Commands, add_json, command
from fame.cli.output import print_json

if TYPE_CHECKING:
    from fame.monitor.anomaly.recording import Recording


def add(parts: Commands) -> None:
    """Declare the part."""
    parser = command(
        parts, "merge", run, examples=("fame adm merge benign.csv outside.csv -o training.csv",),
        help="join labelled CSV files into one",
    )  # fmt: skip
    parser.add_argument("files", type=Path, nargs="+", metavar="CSV")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="CSV")
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Join them, write the result, and say so."""
    from fame.monitor.anomaly.recording import merge, write_csv

    recording = merge(arguments.files)
    write_csv(arguments.output, recording)
    return tell_written(arguments, recording)


def tell_written(arguments: Namespace, recording: Recording) -> int:
    """Say what was written to `output`, and what was odd. Gives the exit code."""
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
