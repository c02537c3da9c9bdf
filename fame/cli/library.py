"""``fame library``: the behaviours that a model may call."""

from __future__ import annotations

import re
import shutil
import textwrap
from argparse import Namespace
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.arguments import Commands, add_json, command
from fame.cli.output import print_json

if TYPE_CHECKING:
    from fame.check.library import Behaviour

_WORDS = {"subscribe": "hears", "publish": "tells", "call": "asks"}
_WIDTH = 110
"""Columns at most: longer lines are hard to read."""


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "library", run, examples=("fame library", "fame library my_behaviours --json"),
        help="list the behaviours that a model may call: what each needs, its topics, what it does",
    )  # fmt: skip
    parser.add_argument(
        "folders", type=Path, nargs="*", metavar="DIR", help="folders with called processes, besides what is built in"
    )
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Print them, by name."""
    from fame.check.library import behaviours

    found = behaviours(arguments.folders)
    if arguments.json:
        print_json({"status": "completed", "behaviours": [asdict(behaviour) for behaviour in found]})
    else:
        width = min(shutil.get_terminal_size((_WIDTH, 24)).columns, _WIDTH)
        print("\n\n".join("\n".join(_lines(behaviour, width)) for behaviour in found))
    return 0


def _lines(behaviour: Behaviour, width: int) -> Iterator[str]:
    """What a person reads of one behaviour."""
    yield behaviour.name if behaviour.name == behaviour.label else f"{behaviour.name}: {behaviour.label}"
    for paragraph in paragraphs(behaviour.documentation):
        yield from textwrap.wrap(paragraph, width, initial_indent="    ", subsequent_indent="    ")
    facts = [("needs", ", ".join(behaviour.inputs)), ("calls", ", ".join(behaviour.calls))]
    names = max((len(topic.name) for topic in behaviour.topics), default=0)
    facts += [(_WORDS[topic.direction], f"{topic.name:{names}}  {topic.type}") for topic in behaviour.topics]
    for word, text in facts:
        if text:
            yield f"  {word}  {text}".rstrip()


def paragraphs(documentation: str) -> list[str]:
    """The text without the line breaks within sentences: a line that ends with a full stop ends a paragraph."""
    return [" ".join(part.split()) for part in re.split(r"(?<=\.)\s*\n|\n\s*\n", documentation) if part.strip()]
