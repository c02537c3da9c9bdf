"""``fame draw``: a model as it was drawn, with the path of a run on it."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from fame.cli.arguments import Commands, add_json, command
from fame.cli.output import print_json
from fame.errors import ConfigError

_EXAMPLES = (
    "fame draw models/ground_vehicles.bpmn -o out/mission.svg",
    "fame draw models/ground_vehicles.bpmn -o out/path.svg --log out/run.jsonl",
)


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "draw", run, examples=_EXAMPLES,
        help="draw a model as SVG, with the path of a run on it if given its log",
    )  # fmt: skip
    parser.add_argument("model", type=Path, metavar="MODEL.bpmn")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE.svg", required=True, help="file to write")
    parser.add_argument(
        "--log",
        type=Path,
        metavar="FILE",
        help="the .jsonl or .csv log of a run: what was completed, failed, cancelled, or still waits",
    )
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Write the drawing and name it."""
    from fame.bpmn.draw.diagram import draw
    from fame.bpmn.reader import read

    output = arguments.output
    if output.suffix.lower() != ".svg":
        raise ConfigError(f"expected a file with the ending .svg, got {output.suffix!r}", file=str(output))
    definitions = read(arguments.model)
    if arguments.log is not None:
        from fame.log import outcomes

        drawing = draw(definitions, outcomes(arguments.log, definitions))
    else:
        drawing = draw(definitions)
    output.parent.mkdir(parents=True, exist_ok=True)
    output.write_text(drawing, encoding="utf-8")
    if arguments.json:
        print_json({"status": "completed", "file": str(output)})
    else:
        print(output)
    return 0
