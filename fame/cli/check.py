"""``fame check``: what is wrong or doubtful in models, before anything moves."""

from __future__ import annotations

import sys
from argparse import Namespace
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.arguments import Commands, add_json, add_library, command
from fame.cli.output import print_json
from fame.errors import ConfigError, ModelError

if TYPE_CHECKING:
    from fame.bpmn.model import Definitions
    from fame.check import Finding

_LEVELS = ("error", "warning", "note")
_EXAMPLES = ("fame check models/ground_vehicles.bpmn", "fame check models/*.bpmn --json",
             "fame check --explain foreign.bpmn")  # fmt: skip


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "check", run, examples=_EXAMPLES,
        help="say what is wrong or doubtful in models; exit code 1 if there is an error",
    )  # fmt: skip
    parser.add_argument(
        "models", type=Path, nargs="+", metavar="MODEL.bpmn",
        help="a file, or - for stdin; what fame split wrote of one mission is checked as one",
    )  # fmt: skip
    parser.add_argument("--strict", action="store_true", help="an undefined name in a payload is an error")
    parser.add_argument("--explain", action="store_true", help="say first what each file was read as")
    add_library(parser)
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Check every file and print what was found, in the manner of compilers."""
    from fame.check import Finding, check, parts_of_one_mission, summary
    from fame.check.explain import explain
    from fame.library import Library

    library = Library(arguments.library)
    files = [_read(path) for path in dict.fromkeys(arguments.models)]
    models = [file for file in files if not isinstance(file, Finding)]
    teams = {id(file): team for team in parts_of_one_mission(models) for file in team}
    found: list[Finding] = []
    for file in files:
        if isinstance(file, Finding):
            found.append(file)
        else:
            found += check(file, library=library, strict=arguments.strict, team=teams[id(file)])
    readings = [one for file in models for one in explain(file, library=library)] if arguments.explain else []
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


def _read(path: Path) -> Definitions | Finding:
    """A model; that it is none is a finding. Raises ConfigError where there is no file at all."""
    from fame.bpmn.reader import read
    from fame.check.findings import of_error

    try:
        if str(path) == "-":
            return read(sys.stdin.buffer.read(), file="<stdin>")
        if not path.exists():
            raise ConfigError("there is no such file", file=str(path))
        if path.is_dir():
            raise ConfigError(f"is a folder; its files would be right: {path / '*.bpmn'}", file=str(path))
        return read(path)
    except ModelError as error:
        return of_error(error)
