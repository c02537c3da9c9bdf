"""``fame templates``: element templates for Camunda Modeler."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from fame.cli.arguments import Commands, add_json, add_library, command
from fame.cli.output import print_json
from fame.errors import ConfigError


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "templates", run, examples=("fame templates -o .camunda/element-templates",),
        help="write element templates for Camunda Modeler: message types, payloads and behaviours to choose from",
    )  # fmt: skip
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", required=True, help="folder for the files")
    add_library(parser)
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Write the files and name them."""
    from fame.check.element_templates import templates, write
    from fame.check.library import behaviours

    if arguments.output.exists() and not arguments.output.is_dir():
        raise ConfigError("expected a folder, got a file", file=str(arguments.output))
    made = templates(behaviours(arguments.library))
    arguments.output.mkdir(parents=True, exist_ok=True)
    files = {name: arguments.output / f"{name}.json" for name in made}
    for name, path in files.items():
        path.write_text(write(made[name]), encoding="utf-8")
    if arguments.json:
        print_json({"status": "completed", "files": {name: str(path) for name, path in files.items()}})
    else:
        print(*files.values(), sep="\n")
    return 0
