"""``fame convert``: a file of any dialect in the current form."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from fame.cli.arguments import Commands, add_json, command
from fame.cli.output import print_json

_EXAMPLES = (
    "fame convert old.bpmn -o new.bpmn",
    "fame convert old.bpmn -o new.bpmn --semantics original",
)


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "convert", run, examples=_EXAMPLES,
        help="write a model of the original FaMe, Camunda 8 or Flowable in the current form, which does the same",
    )  # fmt: skip
    parser.add_argument("model", type=Path, metavar="MODEL.bpmn")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE.bpmn", required=True, help="file to write")
    parser.add_argument(
        "--semantics", choices=("standard", "original"),
        help="of its interrupting event sub-processes from now on; original: they suspend and resume",
    )  # fmt: skip
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Write the file and name it."""
    from fame.bpmn.conversion import convert
    from fame.bpmn.reader import read, read_bytes

    definitions = read(arguments.model)
    source = convert(definitions, semantics=arguments.semantics)
    read_bytes(source, file=str(arguments.output))
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    arguments.output.write_bytes(source)
    if arguments.json:
        changed = source != definitions.source
        print_json({"status": "completed", "file": str(arguments.output), "changed": changed})
    else:
        print(arguments.output)
    return 0
