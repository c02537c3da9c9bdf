"""A file with all that it calls, looked at by every check; and which files are one mission."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions
from fame.bpmn.pools import pools_of
from fame.check.addressing import addressing_findings
from fame.check.common_mistakes import slip_findings
from fame.check.compiling import compiler_findings
from fame.check.delivery import delivery_findings
from fame.check.error_handling import catching_findings
from fame.check.findings import Finding, arranged, of_error
from fame.check.flow import flow_findings
from fame.check.guidelines import guideline_findings
from fame.check.joins import join_findings
from fame.check.kinds import kind_findings
from fame.check.legacy_habits import unfinished_findings
from fame.check.loops import loop_findings
from fame.check.names import name_findings
from fame.check.order import order_findings
from fame.check.recursion import recursion_findings
from fame.check.scope import Subject, subject
from fame.check.script_mistakes import script_findings
from fame.check.start_end import start_end_findings
from fame.check.subscriptions import subscription_findings
from fame.check.timers import timer_findings
from fame.check.topics import topic_findings, types_of
from fame.check.variables import variable_findings
from fame.errors import ModelError, expect


def check(
    definitions: Definitions | str | Path,
    *,
    library: Library | None = None,
    strict: bool = False,
    team: Sequence[Definitions] = (),
) -> list[Finding]:
    """All findings about a file, in the order of its lines; then those about the files that it calls.

    `library` is where called processes are looked for. `strict`: a payload that reads what nothing sets is an error.
    `team` are all files of one mission, this one among them (see `parts_of_one_mission`): their robots may be at the
    other ends of topics. The model may be a path. Raises ModelError for one that cannot be read, ConfigError for what
    is no model or library.
    """
    from fame.bpmn.reader import read

    definitions = read(definitions)
    expect(library is None or isinstance(library, Library), "library", library, 'a Library("folder")')
    library = library or Library()
    about = subject(definitions, library)
    all_of_them = [about if one is definitions else subject(one, library) for one in team]
    found = [
        *_reader_notes(about),
        *_pool_errors(definitions),
        *compiler_findings(about),
        *recursion_findings(about),
        *catching_findings(about),
        *start_end_findings(about),
        *flow_findings(about),
        *join_findings(about),
        *loop_findings(about),
        *timer_findings(about),
        *topic_findings(about, all_of_them),
        *addressing_findings(about),
        *order_findings(about, all_of_them or [about]),
        *delivery_findings(about, all_of_them or [about]),
        *name_findings(about),
        *variable_findings(about, types_of(about), strict=strict),
        *kind_findings(about, types_of(about)),
        *script_findings(about),
        *slip_findings(about),
        *guideline_findings(about),
        *unfinished_findings(about),
        *subscription_findings(about),
    ]
    return arranged(_told(about, found), [definitions.file, *(unit.home.file for unit in about.units)])


def _told(about: Subject, found: Iterable[Finding]) -> Iterator[Finding]:
    """All errors, and what is doubtful; not of an element with a fault, since the model has half of it, and of other
    files no notes."""
    faulty = {(unit.home.file, fault.element) for unit in about.units for fault in unit.process.faults}
    for finding in found:
        whole = (finding.file, finding.element) not in faulty
        here = finding.level == "warning" or finding.file == about.definitions.file
        if finding.level == "error" or (whole and here):
            yield finding


def parts_of_one_mission(files: Iterable[Definitions]) -> list[list[Definitions]]:
    """Files by mission: those that `fame split` wrote of one collaboration, a pool in each, are together."""
    missions: dict[object, list[Definitions]] = {}
    for file in files:
        one_pool = len(file.participants) == 1 and bool(file.collaboration)
        of_it = missions.setdefault(file.collaboration if one_pool else id(file), [])
        pools = {pool.id for other in of_it for pool in other.participants}
        if one_pool and file.participants[0].id in pools:  # that of another split, or the same file twice
            of_it = missions.setdefault(id(file), [])
        of_it.append(file)
    return list(missions.values())


def _reader_notes(about: Subject) -> Iterator[Finding]:
    """What the reader had to say of each file; a note that it has at many places is told at the first."""
    for home in {id(unit.home): unit.home for unit in about.units}.values() or (about.definitions,):
        counts = Counter(note.text for note in home.notes if note.level == "note")
        for note in home.notes:
            if note.level == "warning":
                yield Finding("warning", note.text, home.file, note.line, note.element)
            elif note.level == "note" and note.text in counts:
                more = counts.pop(note.text) - 1
                text = f"{note.text}, here and in {more} more place{'s' * (more > 1)}" if more else note.text
                yield Finding("note", text, home.file, note.line, note.element)


def _pool_errors(definitions: Definitions) -> Iterator[Finding]:
    """Pools that no robot can be found for; a file of processes alone is a library, and needs none."""
    pools = definitions.participants
    while pools or not definitions.processes:
        try:
            pools_of(replace(definitions, participants=pools))
        except ModelError as error:
            yield of_error(error)
            remaining = tuple(pool for pool in pools if pool.id != error.element)
            if len(remaining) < len(pools):
                pools = remaining
                continue
        return
