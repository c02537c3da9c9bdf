"""``fame diff``: what differs between two versions of a model."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from fame.cli.arguments import Commands, add_json, command
from fame.cli.output import print_json
from fame.errors import ConfigError, ModelError
from fame.text import write_file

_EXAMPLES = (
    "fame diff old.bpmn new.bpmn",
    "fame diff old.bpmn new.bpmn -o changes.svg",
    "fame diff --textconv mission.bpmn",
)


def add(commands: Commands) -> None:
    parser = command(
        commands, "diff", run, examples=_EXAMPLES,
        help="compare two versions of a model by element and meaning; exit code 0: the same, 1: different",
    )  # fmt: skip
    parser.add_argument("old", type=Path, metavar="OLD.bpmn")
    parser.add_argument("new", type=Path, nargs="?", metavar="NEW.bpmn")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="also draw the differences: .svg, or .png"
    )  # fmt: skip
    parser.add_argument(
        "--textconv",
        action="store_true",
        help="print what one model says, in an order of its own; "
        "git diff uses it after: git config diff.bpmn.textconv 'fame diff --textconv'",
    )
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Print the differences, and draw them if asked."""
    from fame.bpmn.reader import read
    from fame.edit.changes import as_json, compare, lines

    if arguments.textconv or arguments.new is None:
        return _textconv(arguments)
    output = arguments.output
    if output is not None and output.suffix.lower() not in (".svg", ".png"):
        raise ConfigError(f"expected a file with the ending .svg or .png, got {output.suffix!r}", file=str(output))
    found = compare(read(arguments.old), read(arguments.new))
    if output is not None:
        from fame.edit.changes import picture

        svg = picture(found)
        write_file(output, svg if output.suffix.lower() == ".svg" else _png(svg))
    if arguments.json:
        print_json({"status": "completed", **as_json(found)})
    else:
        print(*(lines(found) if not found.same else ["No differences in elements, extensions and drawing."]), sep="\n")
    return 0 if found.same else 1


def _textconv(arguments: Namespace) -> int:
    from fame.bpmn.reader import read
    from fame.edit.changes import model_text

    if not arguments.textconv or arguments.new is not None or arguments.output is not None or arguments.json:
        raise ConfigError("expected two models, OLD.bpmn and NEW.bpmn, or --textconv with one")
    try:
        print(model_text(read(arguments.old)), end="")
    except ModelError as error:  # git shows the versions that can be read all the same
        if not arguments.old.is_file():
            raise
        print(f"cannot be read: {error.text}", arguments.old.read_text("utf-8", errors="replace"), sep="\n")
    return 0


def _png(svg: str) -> bytes:
    import io

    from fame.scenario.film_diagram import raster

    written = io.BytesIO()
    raster(svg, 2.0).save(written, "png")
    return written.getvalue()
