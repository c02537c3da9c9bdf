"""``fame check``: what is wrong or doubtful in models, before anything moves."""

from __future__ import annotations

from argparse import Namespace
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.arguments import Commands, add_json, add_library, command
from fame.cli.output import print_json
from fame.errors import ConfigError, ModelError

if TYPE_CHECKING:
    from fame.check import Finding
    from fame.check.explain import Reading
    from fame.library import Library

_LEVELS = ("error", "warning", "note")
_EXAMPLES = ("fame check models/ground_vehicles.bpmn", "fame check models/*.bpmn --json",
             "fame check --explain foreign.bpmn")  # fmt: skip


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "check", run, examples=_EXAMPLES,
        help="say what is wrong or doubtful in models; exit code 1 if there is an error",
    )  # fmt: skip
    parser.add_argument("models", type=Path, nargs="+", metavar="MODEL.bpmn")
    parser.add_argument("--strict", action="store_true", help="an undefined name in a payload is an error")
    parser.add_argument("--explain", action="store_true", help="say first what each file was read as")
    add_library(parser)
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Check every file and print what was found, in the manner of compilers."""
    from fame.check import summary
    from fame.library import Library

    for path in arguments.models:
        if not path.is_file():
            text = "is a folder; a .bpmn file would be right" if path.is_dir() else "there is no such file"
            raise ConfigError(text, file=str(path))
    library = Library(arguments.library)
    found = [finding for path in arguments.models for finding in _findings(path, library, arguments.strict)]
    readings = [one for path in arguments.models for one in _readings(path, library)] if arguments.explain else []
    failed = any(finding.level == "error" for finding in found)
    if arguments.json:
        print_json(
            {
                "status": "failed" if failed else "completed",
                **{f"{level}s": sum(finding.level == level for finding in found) for level in _LEVELS},
                **({"readings": [asdict(reading) for reading in readings]} if arguments.explain else {}),
                "findings": [asdict(finding) for finding in found],
            }
        )
    else:
        print(*readings, *found, summary(found), sep="\n")
    return 1 if failed else 0


def _readings(path: Path, library: Library) -> list[Reading]:
    """Of one file; none of one that cannot be read, which is a finding."""
    from fame.bpmn.reader import read
    from fame.check.explain import explain

    try:
        return explain(read(path), library=library)
    except ModelError:
        return []


def _findings(path: Path, library: Library, strict: bool) -> list[Finding]:
    """Of one file; that it cannot be read is a finding too."""
    from fame.bpmn.reader import read
    from fame.check import check
    from fame.check.findings import of_error

    try:
        return check(read(path), library=library, strict=strict)
    except ModelError as error:
        return [of_error(error)]
