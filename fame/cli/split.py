"""``fame split``: one executable model per pool."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from fame.cli.arguments import Commands, add_json, add_library, command
from fame.cli.output import print_json


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "split", run, examples=("fame split models/ground_vehicles.bpmn -o out/split",),
        help="write one self-contained, executable .bpmn file per pool of a collaboration",
    )  # fmt: skip
    parser.add_argument("model", type=Path, metavar="MODEL.bpmn")
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", required=True, help="folder for the files")
    add_library(parser)
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Write the files and name them."""
    from fame.bpmn.library import Library
    from fame.bpmn.reader import read
    from fame.bpmn.split import split

    parts = split(read(arguments.model), Library(arguments.library))
    arguments.output.mkdir(parents=True, exist_ok=True)
    files = {part.name: arguments.output / part.filename for part in parts}
    for part in parts:
        files[part.name].write_bytes(part.source)
    if arguments.json:
        print_json({"status": "completed", "files": {name: str(path) for name, path in files.items()}})
    else:
        print(*files.values(), sep="\n")
    return 0
