"""Run all checks on a file and all that it calls; find which files belong to one mission.

A check is a function of the scope that yields findings. To add one, write it in the module of its subject and add it
to `CHECKS`; `docs/check_errors.md` and `docs/check_warnings.md` list every finding.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions
from fame.check.concurrency import check_shared_variables
from fame.check.control_flow import check_flow, check_joins, check_loops, check_recursion, check_start_and_end_events
from fame.check.elements import (
    check_annotations,
    check_data_objects,
    check_forms,
    check_library,
    check_names,
    check_pools,
    check_reader_notes,
)
from fame.check.events import check_error_handling, check_repeated_calls, check_timers, check_transactions
from fame.check.gate import check_compilation
from fame.check.guidelines import check_effects, check_guidelines
from fame.check.literals import check_literals
from fame.check.scope import CheckScope, Finding, arranged, find_scope
from fame.check.scripts import check_scripts
from fame.check.service_topics import check_services
from fame.check.signals import check_signal_delivery, check_signal_order
from fame.check.topics import check_addressing, check_topic_partners, check_topic_types
from fame.check.value_kinds import check_value_kinds
from fame.check.variables import check_variables
from fame.config.loader import find_object, registered
from fame.errors import ConfigError, expect

GROUP = "fame.checks"
"""Group of the entry points by which packages add checks of their own: functions of the model that give findings."""

Check = Callable[[CheckScope], Iterable[Finding]]

CHECKS: tuple[Check, ...] = (
    check_reader_notes,
    check_library,
    check_annotations,
    check_pools,
    check_compilation,
    check_recursion,
    check_error_handling,
    check_transactions,
    check_repeated_calls,
    check_start_and_end_events,
    check_flow,
    check_joins,
    check_loops,
    check_timers,
    check_topic_types,
    check_topic_partners,
    check_addressing,
    check_signal_order,
    check_signal_delivery,
    check_names,
    check_literals,
    check_variables,
    check_shared_variables,
    check_value_kinds,
    check_scripts,
    check_data_objects,
    check_forms,
    check_services,
    check_effects,
)
"""All checks but `check_guidelines`, in the order of their findings about one line."""


def check(
    definitions: Definitions | str | Path,
    *,
    library: Library | None = None,
    strict: bool = False,
    guidelines: bool = False,
    team: Sequence[Definitions] = (),
    given: Mapping[str, frozenset[str]] = MappingProxyType({}),
    outside: Collection[str] = (),
    bodies: Mapping[str, str] = MappingProxyType({}),
) -> list[Finding]:
    """Return all findings about a file in the order of its lines, then those about the files that it calls.

    `definitions` is a model or its path. Called processes are searched for in `library`. `strict`: a payload that
    reads a variable that nothing sets is an error. `guidelines`: deviations from the modelling guidelines are notes.
    `team`: all files of the mission, this one included (see `parts_of_one_mission`), where the other ends of topics
    may be. `given`: the variables that each process (id) starts with. `outside`: the topics on which somebody else
    publishes. `bodies`: the types of the topics of the robots' bodies (``~/odom``), for fixes.

    Checks of other packages (entry points in the group `GROUP`) are run too.

    Raises ModelError if the model cannot be read, ConfigError for arguments of another type and a check that fails.
    """
    from fame.bpmn.reader import read

    definitions = read(definitions)
    expect(library is None or isinstance(library, Library), "library", library, 'a Library("folder")')
    scope = find_scope(definitions, library or Library(), team=team, strict=strict)
    scope.given, scope.outside, scope.bodies = given, frozenset(outside), bodies
    findings = [finding for one in (*CHECKS, *[check_guidelines] * guidelines) for finding in one(scope)]
    findings += [finding for name, place in registered(GROUP).items() for finding in _added(name, place, definitions)]
    return arranged(map(scope.named, _relevant(scope, findings)), scope.files)


def _added(name: str, place: str, definitions: Definitions) -> Sequence[Finding]:
    """What a check of another package finds. Raises ConfigError if the check itself fails: nothing is known then."""
    try:
        findings = list(find_object(place, Path())(definitions))
    except (Exception, SystemExit) as error:  # whatever the code of a package raises
        raise ConfigError(f"the check {name!r} ({place}) failed: {type(error).__name__}: {error}") from error
    if not all(isinstance(each, Finding) for each in findings):
        raise ConfigError(f"the check {name!r} ({place}) gave something else than findings (fame.check.Finding)")
    return [each if each.file else replace(each, file=definitions.file) for each in findings]


def _relevant(scope: CheckScope, findings: Iterable[Finding]) -> Iterator[Finding]:
    """Leave out notes about called files, and warnings and notes about faulty elements, which are read only in part."""
    faulty = {(process.file, fault.element) for process in scope.processes for fault in process.bpmn.faults}
    for finding in findings:
        complete = (finding.file, finding.element) not in faulty
        here = finding.level == "warning" or finding.file == scope.definitions.file
        if finding.level == "error" or (complete and here):
            yield finding


def parts_of_one_mission(files: Iterable[Definitions]) -> list[list[Definitions]]:
    """Group files by mission: the files of one pool each that `fame split` wrote from one collaboration."""
    missions: dict[object, list[Definitions]] = {}
    for file in files:
        one_pool = len(file.participants) == 1 and bool(file.collaboration)
        mission = missions.setdefault(file.collaboration if one_pool else id(file), [])
        pools = {pool.id for other in mission for pool in other.participants}
        if one_pool and file.participants[0].id in pools:  # from another split, or the same file twice
            mission = missions.setdefault(id(file), [])
        mission.append(file)
    return list(missions.values())
