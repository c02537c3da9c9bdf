"""``fame draw``: models as SVG, recordings as films; and the drawings of ``fame run``."""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.arguments import Commands, add_json, add_show, command
from fame.cli.output import note, print_json, progress_line
from fame.errors import ConfigError
from fame.text import write_file

if TYPE_CHECKING:
    from fame.cli.output import ProgressLine
    from fame.scenario import Scenario

_EXAMPLES = (
    "fame draw models/ground_vehicles.bpmn -o out/mission.svg",
    "fame draw models/ground_vehicles.bpmn -o out/path.svg --log out/run.mcap --robot REX",
    "fame draw out/run.mcap -o out/run.gif",
    "fame draw out/run.mcap -o out/run.webp --show diagram",
)


def add(commands: Commands) -> None:
    parser = command(commands, "draw", run, examples=_EXAMPLES)
    parser.add_argument(
        "model", type=Path, nargs="?", metavar="MODEL.bpmn|RUN.mcap", help="what an .svg shows, or a film"
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE", required=True,
        help="file to write: .svg of the model; of a recording a film, .gif, .webp or .mp4 (with ffmpeg), or .png of "
        "its simulated world at the end",
    )  # fmt: skip
    add_show(parser)
    parser.add_argument(
        "--log",
        type=Path,
        metavar="FILE",
        help="recording (.mcap) or log (.jsonl, .csv) of a run",
    )
    parser.add_argument(
        "--robot",
        action="append",
        default=[],
        metavar="NAME",
        help="with --log: the path of this robot only; repeatable",
    )
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Write the drawing and name it."""
    from fame.scenario.films import FILMS, PICTURE

    output, kinds = arguments.output, (".svg", *FILMS, PICTURE)
    if output.suffix.lower() not in kinds:
        text = f"expected a file with the ending {' or '.join(kinds)}, got {output.suffix!r}"
        raise ConfigError(text, file=str(output))
    if output.suffix.lower() == ".svg":
        _draw_model(arguments)
    else:
        _draw_recording(arguments)
    if arguments.json:
        print_json({"status": "completed", "file": str(output)})
    else:
        print(output)
    return 0


def _draw_recording(arguments: Namespace) -> None:
    """Draw the film or picture of a recording, which `--log` may name, too."""
    from fame.log.reading import damage
    from fame.scenario.films import draw_film

    named = [path for path in (arguments.model, arguments.log) if path is not None]
    if len(named) != 1 or arguments.robot or named[0].suffix.lower() != ".mcap":
        text = "is made of a recording: expected RUN.mcap, without a model and --robot; a model is drawn as .svg"
        raise ConfigError(text, file=str(arguments.output))
    with progress_line(sys.stderr, wanted=not arguments.json) as line:
        progress = line.count_frames if line is not None else None
        draw_film(named[0], arguments.output, show=arguments.show, progress=progress)
    for warning in damage(named[0]):
        note(f"fame: {warning}")


def _draw_model(arguments: Namespace) -> None:
    from fame.bpmn.draw.diagram import draw
    from fame.bpmn.reader import read

    if arguments.model is None:
        raise ConfigError("expected a model to draw: fame draw MODEL.bpmn", file=str(arguments.output))
    if arguments.model.suffix.lower() == ".mcap":
        text = "expected a model, got a recording: fame draw MODEL.bpmn --log RUN.mcap draws its path in the model"
        raise ConfigError(text, file=str(arguments.model))
    output, definitions = arguments.output, read(arguments.model)
    if arguments.log is not None:
        from fame.log.reading import damage, run_outcomes

        run = run_outcomes(arguments.log, definitions, robots=arguments.robot)
        lacks = f"{arguments.log}: does not say how the run ended: how it went on is not known"
        for warning in damage(arguments.log) or [lacks] * run.cut:
            note(f"fame: {warning}")
        drawing = draw(definitions, run.tallies, notes=run.notes(definitions))
    elif arguments.robot:
        raise ConfigError("--robot needs --log")
    else:
        drawing = draw(definitions)
    write_file(output, drawing)


# ---- of a run --------------------------------------------------------------------------------------------------------


def check_drawings(arguments: Namespace, scenario: Scenario) -> None:
    """Complain about the drawings that a run is to make, and packages that are missing for them."""
    from fame.bpmn.draw.diagram import is_drawable
    from fame.scenario.films import FILMS, PICTURE, check_film

    for path, endings in ((arguments.picture, (PICTURE,)), (arguments.animate, FILMS)):
        if path is not None:
            check_film(path, endings, arguments.show)
            if path == arguments.animate and arguments.show != "world" and is_drawable(scenario.definitions):
                continue  # a film of the diagram
            if scenario.world is None:
                raise ConfigError("cannot be drawn: the scenario has no world", file=str(path))


def draw_run(arguments: Namespace, drawings: Sequence[Path], logs: Sequence[Path], line: ProgressLine | None) -> None:
    """Make drawings of the recording among the logs of a run."""
    from fame.scenario.films import draw_film

    title = arguments.scenario.stem.replace("_", " ").capitalize()
    for recording in [path for path in logs if path.suffix.lower() == ".mcap" and path.exists()][:1]:
        progress = line.count_frames if line is not None else None
        draw_film(recording, *drawings, title=title, show=arguments.show, progress=progress)
