"""``fame check``: what is wrong or doubtful in models and scenarios, before anything moves."""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.cli.arguments import BackendNames, Commands, add_from_room, add_json, add_library, command, positive
from fame.cli.network import connected, interface
from fame.cli.output import coloured, print_json
from fame.dataclasses import asdict, dataclass, field
from fame.errors import ConfigError, ModelError
from fame.rooms import EXPLORE_OPTIONS, EXPLORE_RUN, load
from fame.text import similar_file

if TYPE_CHECKING:
    from fame.bpmn.library import Library
    from fame.bpmn.model import Definitions
    from fame.check import Finding
    from fame.check.contract import ContractEndpoint

_LEVELS = ("error", "warning", "note")
_NOT_EXPLORED = ("guidelines", "explain", "against_graph")
"""Options of other looks at a model than at its runs."""
_EXAMPLES = ("fame check models/ground_vehicles.bpmn", "fame check models/*.bpmn --json",
             "fame check examples/delivery.yaml", "fame check --explain foreign.bpmn",
             "fame check --against-graph examples/warehouse.yaml",
             "fame check --explore models/ground_vehicles.bpmn",
             "fame check --explore examples/convoy.yaml --faults")  # fmt: skip


def add(commands: Commands) -> None:
    parser = command(commands, "check", run, examples=_EXAMPLES)
    parser.add_argument(
        "models", type=Path, nargs="*", metavar="FILE",
        help="a model (.bpmn), - for one from stdin, or a scenario (.yaml) with its model; the files that fame split "
             "wrote of one mission are checked together; without any, the scenarios of the project (fame.yaml)",
    )  # fmt: skip
    parser.add_argument("--strict", action="store_true", help="treat an undefined name in a payload as an error")
    parser.add_argument(
        "--guidelines", action="store_true",
        help="also note deviations from the modelling guidelines of the FaMe paper (docs/checks.md explains them)",
    )  # fmt: skip
    parser.add_argument(
        "--explain", action="store_true",
        help="first print how FAME interprets each element, and the topics, services and actions of each robot",
    )  # fmt: skip
    parser.add_argument(
        "--against-graph", action="store_true",
        help="compare the topics, services and actions with those of the running nodes",
    )  # fmt: skip
    parser.add_argument(
        "--wait", type=positive, default=5.0, metavar="S", help="with --against-graph: how long to wait for nodes (5)"
    )
    parser.add_argument(
        "--middleware",
        choices=BackendNames(),
        metavar="dds|zenoh|ros",
        default="dds",
        help="with --against-graph: how to reach the nodes (dds); ros also receives the arguments after --ros-args",
    )
    parser.add_argument(
        "--interface", type=interface, metavar="IFACE",
        help="with --against-graph: use this network interface, by name or address (default: this machine only)",
    )  # fmt: skip
    add_library(parser)
    add_json(parser)
    explored = parser.add_argument_group("exploration")
    explored.add_argument(
        "--explore", action="store_true",
        help="explore every reachable state of each mission: deadlocks, lost signals, missions that never complete",
    )  # fmt: skip
    parser.set_defaults(unexplored=lambda arguments: None)
    add_from_room(explored, EXPLORE_OPTIONS)


def run(arguments: Namespace) -> int:
    """Check (or explore) every file and print the findings, one line each."""
    if arguments.explore:
        return _explore(arguments)
    arguments.unexplored(arguments)
    from fame.check import summary
    from fame.check.explain import readings

    files = _checked(arguments)
    for file in files:
        if file.scenario is not None and not _failed(file.found):
            from fame.scenario.scenario import scenario_findings

            file.found += scenario_findings(file.scenario, library=arguments.library, strict=arguments.strict)
    if arguments.against_graph:
        _compare(files, arguments)
    found = list(dict.fromkeys(finding for file in files for finding in file.found))  # scenarios may share a model
    explained = [(file.model, file.library) for file in files if file.model is not None and arguments.explain]
    how = [one for model, library in explained for one in readings(model, library=library)]
    contract = [one for model, library in explained for one in _contract(model, library)]
    failed = _failed(found)
    if arguments.json:
        print_json(
            {
                "status": "failed" if failed else "completed",
                **{f"{level}s": sum(finding.level == level for finding in found) for level in _LEVELS},
                **({"readings": [asdict(reading) for reading in how]} if arguments.explain else {}),
                **({"contract": [one.to_json() for one in contract]} if arguments.explain else {}),
                "findings": [asdict(finding) for finding in found],
            }
        )
    else:
        for line in (*how, *contract, *found, summary(found)):
            print(coloured(str(line), sys.stdout))
    return 1 if failed else 0


def _checked(arguments: Namespace) -> list[_File]:
    """Read every file, and check its model, that of one pool together with those of the same mission."""
    from fame.check import check, parts_of_one_mission

    files = [_read(path, arguments.library) for path in dict.fromkeys(arguments.models)]
    models = [file.model for file in files if file.model is not None]
    teams = {id(model): team for team in parts_of_one_mission(models) for model in team}
    for file in files:
        if file.model is not None:
            options = {"strict": arguments.strict, "guidelines": arguments.guidelines, **file.given}
            file.found += check(file.model, library=file.library, team=teams[id(file.model)], **options)
    return files


def _contract(model: Definitions, library: Library) -> list[ContractEndpoint]:
    """The contract of a model; empty if an error of the model prevents it, which is reported elsewhere."""
    from fame.check.contract import contract_of

    try:
        return contract_of(model, library)
    except ModelError:
        return []


def _compare(files: Sequence[_File], arguments: Namespace) -> None:
    """Add what the running graph lacks to the findings of files without errors."""
    from fame.check.contract import compare

    reach = Namespace(middleware=arguments.middleware, network=arguments.interface)
    with connected(reach) as (scheduler, middleware):
        for file in files:
            if file.model is not None and not _failed(file.found):
                contract = _contract(file.model, file.library)
                file.found += compare(contract, middleware, scheduler, arguments.wait)


def _explore(arguments: Namespace) -> int:
    """Explore files that have no errors."""
    from fame.check import summary

    explore = load(EXPLORE_RUN)
    for name in _NOT_EXPLORED:
        if getattr(arguments, name):
            raise ConfigError(f"--{name.replace('_', '-')} does not go with --explore: run fame check twice")
    if Path("-") in arguments.models:
        raise ConfigError("--explore needs files, not stdin")
    for path, file in zip(dict.fromkeys(arguments.models), _checked(arguments), strict=True):
        if errors := [finding for finding in file.found if finding.level == "error"]:
            for finding in errors:
                print(coloured(str(finding), sys.stderr), file=sys.stderr)
            raise ConfigError("has errors: nothing is explored", file=str(path))
        if warned := [finding for finding in file.found if finding.level == "warning"]:
            print(f"fame: {path}: {summary(warned)} of the model itself: fame check {path}", file=sys.stderr)
    code: int = explore(arguments)
    return code


def _failed(found: Iterable[Finding]) -> bool:
    return any(finding.level == "error" for finding in found)


@dataclass(slots=True)
class _File:
    """A file that is checked: its model if it can be read, and the scenario that names it if there is one.

    `given`: what the scenario gives to the check (`fame.scenario.plan.known_to_check`)."""

    library: Library
    model: Definitions | None = None
    scenario: Path | None = None
    given: Mapping[str, Any] = field(default_factory=dict)
    found: list[Finding] = field(default_factory=list)


def _read(path: Path, folders: Sequence[Path]) -> _File:
    """A model, or a scenario with its model; that it is neither is a finding. Raises ConfigError where no file is."""
    from fame.bpmn.library import Library
    from fame.bpmn.reader import read
    from fame.check.scope import of_error
    from fame.properties.diagram import draws_properties
    from fame.properties.files import beside

    if str(path) != "-":
        _expect_file(path)
    file = _File(Library(folders))
    try:
        if str(path) == "-":
            file.model = read(sys.stdin.buffer.read(), file="<stdin>")
        elif path.suffix.lower() in (".yaml", ".yml"):
            from fame.scenario.plan import known_to_check, read_scenario

            scenario_plan = read_scenario(path)
            file.scenario, file.library = path, Library([*folders, *scenario_plan.library])
            file.model = read(scenario_plan.model)
            file.given = known_to_check(scenario_plan, file.model)
        else:
            file.model = read(path)
            file.scenario = path if beside(path) or draws_properties(file.model, file.library) else None
    except (ModelError, ConfigError) as error:
        file.found.append(of_error(error))
    return file


def _expect_file(path: Path) -> None:
    """Raise ConfigError where no file is."""
    if not path.exists():
        raise ConfigError(f"there is no such file{similar_file(path)}", file=str(path))
    if path.is_dir():
        raise ConfigError(f"expected files, got a folder: {path / '*.bpmn'}", file=str(path))
