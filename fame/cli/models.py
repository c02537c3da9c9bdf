"""Commands on model files: ``fame split``, ``convert``, ``layout``, ``library`` and ``templates``."""

from __future__ import annotations

import re
import shutil
import textwrap
from argparse import Namespace
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.arguments import Commands, add_json, add_library, command
from fame.cli.output import note, print_json
from fame.errors import ConfigError, ModelError, UnavailableError
from fame.text import write_file

if TYPE_CHECKING:
    from fame.check.library import Behaviour


def add_split(commands: Commands) -> None:
    parser = command(
        commands, "split", run_split, examples=("fame split models/ground_vehicles.bpmn -o out/split",),
        help="write one self-contained, executable .bpmn file per pool of a collaboration",
    )  # fmt: skip
    parser.add_argument("model", type=Path, metavar="MODEL.bpmn")
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", required=True, help="folder for the files")
    add_library(parser)
    add_json(parser)


def run_split(arguments: Namespace) -> int:
    """Write the files and name them, and what else their robots need."""
    from fame.bpmn.library import Library
    from fame.bpmn.pools import pools_of
    from fame.bpmn.reader import read
    from fame.bpmn.split import split
    from fame.check.scope import find_scope
    from fame.check.service_topics import named_files

    definitions, library = read(arguments.model), Library(arguments.library)
    parts = split(definitions, library)
    names: dict[str, str] = {}
    for part in parts:
        other = names.setdefault(part.filename.casefold(), part.name)
        if other != part.name:
            text = f"pools {other!r} and {part.name!r} would be written to one file, {part.filename}: rename one"
            raise ConfigError(text, file=str(arguments.model))
    processes, folder = find_scope(definitions, library).processes, Path(definitions.file).parent
    roots = {pool.name: next(one for one in processes if one.bpmn is pool.process) for pool in pools_of(definitions)}
    needs = {name: named_files(root, folder) for name, root in roots.items()}
    code = _write(arguments, {part.name: (part.filename, _with_diagram(part.source)) for part in parts}, needs=needs)
    for name, files in needs.items():
        if files:
            note(f"{name} needs {', '.join(files)} too, from the folder of its engine (fame engine --files)")
    return code


def _with_diagram(source: bytes) -> bytes:
    """A part with what its diagram lacks, if there is something to draw and the room for that is there."""
    from fame.bpmn.reader import read_bytes
    from fame.rooms import ADD_DIAGRAM, load

    try:
        return bytes(load(ADD_DIAGRAM)(read_bytes(source)))
    except (ModelError, UnavailableError):
        return source


def _write(arguments: Namespace, files: Mapping[str, tuple[str, bytes]], **more: object) -> int:
    """Write files (name -> file name, content) into the folder of a command, and name them."""
    if arguments.output.exists() and not arguments.output.is_dir():
        raise ConfigError("expected a folder, got a file", file=str(arguments.output))
    arguments.output.mkdir(parents=True, exist_ok=True)
    paths = {name: arguments.output / file for name, (file, _) in files.items()}
    for name, path in paths.items():
        write_file(path, files[name][1])
    if arguments.json:
        print_json({"status": "completed", "files": {name: str(path) for name, path in paths.items()}, **more})
    else:
        print(*paths.values(), sep="\n")
    return 0


_CONVERT_EXAMPLES = (
    "fame convert old.bpmn -o new.bpmn",
    "fame convert old.bpmn -o new.bpmn --semantics original",
)


def add_convert(commands: Commands) -> None:
    parser = command(
        commands, "convert", run_convert, examples=_CONVERT_EXAMPLES,
        help="convert a model of the original FaMe, Camunda 8 or Flowable to FAME's form, with the same behaviour",
    )  # fmt: skip
    parser.add_argument("model", type=Path, metavar="MODEL.bpmn")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE.bpmn", required=True, help="file to write")
    parser.add_argument(
        "--semantics", choices=("standard", "original"),
        help="interrupting event sub-processes in the result: standard, or original (they suspend and resume)",
    )  # fmt: skip
    add_json(parser)


def run_convert(arguments: Namespace) -> int:
    """Write the file and name it."""
    from fame.bpmn.conversion import convert
    from fame.bpmn.reader import read, read_bytes

    _check_ending(arguments.output)
    definitions = read(arguments.model)
    source = convert(definitions, semantics=arguments.semantics)
    read_bytes(source, file=str(arguments.output))
    return _write_model(arguments, source, changed=source != definitions.source)


def _check_ending(path: Path) -> None:
    """Raise ConfigError if a file to be written does not end like a model."""
    if path.suffix.lower() not in (".bpmn", ".xml"):
        text = f"expected a file with the ending .bpmn or .xml, got {path.suffix!r}"
        raise ConfigError(text, file=str(path))


_LAYOUT_EXAMPLES = (
    "fame layout generated.bpmn -o mission.bpmn",
    "fame layout mission.bpmn -o mission.bpmn",
    "fame layout mission.bpmn -o again.bpmn --all",
)


def add_layout(commands: Commands) -> None:
    parser = command(
        commands, "layout", run_layout, examples=_LAYOUT_EXAMPLES,
        help="add a diagram to a model that has none, or what its diagram lacks; nothing else of the file changes",
    )  # fmt: skip
    parser.add_argument("model", type=Path, metavar="MODEL.bpmn")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE.bpmn", required=True, help="file to write")
    parser.add_argument("--all", action="store_true", help="lay out everything, also what has a place in the diagram")
    add_json(parser)


def run_layout(arguments: Namespace) -> int:
    """Write the file and name it."""
    from fame.bpmn.reader import read
    from fame.rooms import ADD_DIAGRAM, load

    _check_ending(arguments.output)
    definitions = read(arguments.model)
    source = load(ADD_DIAGRAM)(definitions, again=arguments.all)
    return _write_model(arguments, source, changed=source != definitions.source)


def _write_model(arguments: Namespace, source: bytes, *, changed: bool) -> int:
    write_file(arguments.output, source)
    if arguments.json:
        print_json({"status": "completed", "file": str(arguments.output), "changed": changed})
    else:
        print(arguments.output)
    return 0


_WORDS = {"subscribe": "subscribes", "publish": "publishes", "call": "service"}
_WIDTH = 110
"""Columns at most: longer lines are hard to read."""


def add_library_command(commands: Commands) -> None:
    parser = command(
        commands, "library", run_library, examples=("fame library", "fame library my_behaviours --json"),
        help="list the behaviours that a model can call: inputs, topics, description",
    )  # fmt: skip
    parser.add_argument(
        "folders", type=Path, nargs="*", metavar="DIR", help="folders with called processes, besides the built-in ones"
    )
    add_json(parser)


def run_library(arguments: Namespace) -> int:
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
    """The text output for one behaviour."""
    from fame.bpmn.library import BUILT_IN

    yield behaviour.name if behaviour.name == behaviour.label else f"{behaviour.name}: {behaviour.label}"
    for paragraph in paragraphs(behaviour.documentation):
        yield from textwrap.wrap(paragraph, width, initial_indent="    ", subsequent_indent="    ")
    own = Path(behaviour.file).parent in BUILT_IN
    facts = [("file", Path(behaviour.file).name if own else behaviour.file)]
    facts += [("needs", ", ".join(behaviour.inputs)), ("calls", ", ".join(behaviour.calls))]
    names = max((len(topic.name) for topic in behaviour.topics), default=0)
    facts += [(_WORDS[topic.direction], f"{topic.name:{names}}  {topic.type}") for topic in behaviour.topics]
    for word, text in facts:
        if text:
            yield f"  {word}  {text}".rstrip()


def paragraphs(documentation: str) -> list[str]:
    """Return the text without the line breaks within sentences: a line that ends with a full stop ends a paragraph."""
    return [" ".join(part.split()) for part in re.split(r"(?<=\.)\s*\n|\n\s*\n", documentation) if part.strip()]


def add_templates(commands: Commands) -> None:
    parser = command(
        commands, "templates", run_templates, examples=("fame templates -o .camunda/element-templates",),
        help="write element templates for Camunda Modeler: message types, payloads and behaviours to choose from",
    )  # fmt: skip
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", required=True, help="folder for the files")
    add_library(parser)
    add_json(parser)


def run_templates(arguments: Namespace) -> int:
    """Write the files and name them."""
    from fame.check.element_templates import message_types, templates, write
    from fame.check.library import behaviours

    made = templates(behaviours(arguments.library), message_types(arguments.types))
    return _write(arguments, {name: (f"{name}.json", write(made[name]).encode()) for name in made})
