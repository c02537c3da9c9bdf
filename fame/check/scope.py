"""The input and output of checks: a scope, and findings.

A scope is the processes of a file and all that they call. Findings are sorted by file and line.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Literal

from fame.bpmn.library import Library
from fame.bpmn.model import Body, CallActivity, Definitions, Element, FlowNode, Process
from fame.dataclasses import dataclass, field, replace
from fame.errors import ConfigError, ModelError, display_name

Level = Literal["error", "warning", "note"]
"""error: it cannot run; warning: it runs, but probably not as intended; note: something to know."""

FixKind = Literal["property", "default", "condition", "signal", "message", "error", "catcher"]

LEVELS: tuple[Level, ...] = ("error", "warning", "note")


@dataclass(frozen=True, slots=True)
class Fix:
    """A change of one element that ends a finding, if it was meant so.

    `text` is what a button says. `kind` is what gets the `value`: an extension ``property`` of this name (in place of
    `instead`), the ``default`` flow of a gateway, the ``condition`` of a flow (none, if it is empty), the name of the
    ``signal`` or ``message`` or the code of the ``error`` of an event; or a ``catcher`` of the error is added.
    """

    text: str
    element: str
    kind: FixKind
    value: str
    name: str = ""
    instead: str = ""


@dataclass(frozen=True, slots=True)
class Finding:
    """One problem or note.

    `line` is 1-based, 0 if unknown; `element` is the id of an element, empty for the file; `name` is its label;
    `column` is 1-based, 0 if unknown.
    """

    level: Level
    text: str
    file: str = ""
    line: int = 0
    element: str = ""
    name: str = ""
    column: int = 0
    fix: Fix | None = field(default=None, compare=False, repr=False)

    def __str__(self) -> str:
        """One line: ``mission.bpmn:12: warning: "Sure?" (Gateway_1): ...``."""
        line = f"{self.line}:{self.column}" if self.column else str(self.line) if self.line else ""
        place = ":".join(part for part in (self.file, line) if part)
        return ": ".join(part for part in (place, self.level, display_name(self.element, self.name), self.text) if part)


def of_error(error: ModelError | ConfigError) -> Finding:
    """Return the finding that reports an error."""
    return Finding("error", error.text, error.file, error.line, error.element, error.name, error.column)


def arranged(findings: Iterable[Finding], files: Iterable[str]) -> list[Finding]:
    """Sort by file (in the order of `files`), line and level; remove duplicates."""
    order = {file: place for place, file in enumerate(dict.fromkeys(files))}
    return sorted(
        dict.fromkeys(findings), key=lambda one: (order.get(one.file, len(order)), one.line, LEVELS.index(one.level))
    )


def summary(findings: Iterable[Finding]) -> str:
    """Count the findings of each level.

    >>> summary([Finding("error", "a"), Finding("note", "b"), Finding("note", "c")]), summary([])
    ('1 error, 2 notes', 'No problems found.')
    """
    counts = Counter(finding.level for finding in findings)
    parts = [f"{counts[level]} {level}{'s' if counts[level] > 1 else ''}" for level in LEVELS if counts[level]]
    return ", ".join(parts) or "No problems found."


@dataclass(frozen=True, slots=True, eq=False)
class CheckedProcess:
    """A process and the file that contains it. `folder`: that of the files of services, of the mission that runs it.
    `calls`: each call activity and its process, None if that is missing."""

    definitions: Definitions
    bpmn: Process
    folder: Path
    calls: list[tuple[CallActivity, CheckedProcess | None]] = field(default_factory=list)

    @property
    def file(self) -> str:
        return self.definitions.file

    def finding(self, level: Level, text: str, element: Element, line: int = 0, fix: Fix | None = None) -> Finding:
        """Return a finding at one of its elements; `line` if it differs from that of the element."""
        return Finding(level, text, self.file, line or element.line, element.id, fix=fix)

    def bodies(self) -> Iterator[Body]:
        """Return its body and those of its sub-processes at any depth."""
        return self.bpmn.body.bodies()

    def nodes(self) -> Iterator[FlowNode]:
        """Return all flow nodes at any depth."""
        return self.bpmn.body.walk()

    def called_by(self, call: FlowNode) -> CheckedProcess | None:
        """Return the process that one of its call activities calls; None for any other node."""
        return next((callee for other, callee in self.calls if other is call), None)

    def closure(self) -> list[CheckedProcess]:
        """Return the process and all that it calls, directly or not, each once, breadth first."""
        closure = {self: None}
        pending = [self]
        for process in pending:
            new = [callee for _, callee in process.calls if callee is not None and callee not in closure]
            closure |= dict.fromkeys(new)
            pending += dict.fromkeys(new)
        return list(closure)


@dataclass(slots=False, eq=False)
class CheckScope:
    """The input of one check.

    processes      those of the file first, then those they call
    roots          processes of the file that start by themselves: those of pools, those that no other one of the scope
                   calls, and of a cycle of calls that nothing else calls the first
    pools          ids of the processes that have a pool: nothing else gives them variables
    missing        why called processes could not be found
    doubtful       calls that may mean another process than the one that is called
    supplied       the names by which the file calls processes of FAME's own library
    mission        the scopes of all files of the mission, this one included
    strict         a payload that reads a variable nothing sets is an error
    remote_types   the processes run elsewhere, where other message types may be known
    given          variables that a scenario sets when a process starts, by its id
    outside        topics on which a scenario publishes
    bodies         types of the topics of the robots' bodies, by name (``~/odom``)
    """

    definitions: Definitions
    processes: tuple[CheckedProcess, ...]
    roots: tuple[CheckedProcess, ...]
    pools: frozenset[str]
    missing: tuple[ModelError, ...]
    supplied: frozenset[str] = frozenset()
    doubtful: tuple[Finding, ...] = ()
    mission: tuple[CheckScope, ...] = ()
    strict: bool = False
    remote_types: bool = False
    given: Mapping[str, frozenset[str]] = field(default_factory=dict)
    outside: frozenset[str] = frozenset()
    bodies: Mapping[str, str] = field(default_factory=dict)

    def has_pool(self, process: CheckedProcess) -> bool:
        return process.definitions is self.definitions and process.bpmn.id in self.pools

    def called(self) -> set[CheckedProcess]:
        """Return the processes that another one calls."""
        return {callee for process in self.processes for _, callee in process.calls if callee is not None}

    def named(self, finding: Finding) -> Finding:
        name = finding.name or self._names.get(finding.file, {}).get(finding.element, "")
        return replace(finding, name=name)

    @cached_property
    def _names(self) -> dict[str, dict[str, str]]:
        """The names of the elements of each file, by id."""
        return {
            file: {element.id: element.name for element in definitions.elements()}
            for file, definitions in self.files.items()
        }

    @cached_property
    def files(self) -> dict[str, Definitions]:
        """The files, by name: the checked one first."""
        files = {self.definitions.file: self.definitions}
        return files | {process.file: process.definitions for process in self.processes}


def find_scope(
    definitions: Definitions,
    library: Library,
    *,
    team: Sequence[Definitions] = (),
    strict: bool = False,
    remote_types: bool = False,
    folder: Path | None = None,
) -> CheckScope:
    """Return the scope of a file; called processes are searched for in `library`. `team`: all files of its mission.
    `folder`: that of the files of services, where it is not that of the file."""
    scope = _scope(definitions, library, folder)
    scope.mission = tuple(scope if one is definitions else _scope(one, library) for one in team) or (scope,)
    scope.strict, scope.remote_types = strict, remote_types
    return scope


def _scope(definitions: Definitions, library: Library, folder: Path | None = None) -> CheckScope:
    folder = folder or Path(definitions.file).parent
    own = [CheckedProcess(definitions, process, folder) for process in definitions.processes]
    known = {_key(process): process for process in own}
    missing: list[ModelError] = []
    pending = list(own)
    for process in pending:
        for call in process.bpmn.body.calls():
            callee = _callee(process, call, library, known, missing)
            process.calls.append((call, callee))
            if callee is not None and callee not in pending:
                pending.append(callee)
    pools = frozenset(pool.process for pool in definitions.participants if pool.process)
    calls = (pair for process in own for pair in process.calls)
    supplied = {one.called for one, to in calls if to is not None and library.is_own(definitions, to.definitions)}
    doubtful = (
        found for process in pending for call, to in process.calls for found in _doubt(process, call, to, library)
    )
    return CheckScope(
        definitions,
        processes=tuple(pending),
        roots=tuple(_roots(own, pools)),
        pools=pools,
        missing=tuple(missing),
        supplied=frozenset(supplied),
        doubtful=tuple(doubtful),
    )


def _doubt(
    process: CheckedProcess, call: CallActivity, called: CheckedProcess | None, library: Library
) -> Iterator[Finding]:
    others = library.passed_over(process.definitions, call) if called is not None else []
    if others:
        text = f"calls {call.called!r} of the file of that name, which {' and '.join(others)} has, too"
        yield process.finding("warning", text, call)


def _key(process: CheckedProcess) -> tuple[str, str]:
    return process.file, process.bpmn.id


def _callee(
    process: CheckedProcess,
    call: CallActivity,
    library: Library,
    known: dict[tuple[str, str], CheckedProcess],
    missing: list[ModelError],
) -> CheckedProcess | None:
    try:
        definitions, called = library.find(process.definitions, call)
    except ModelError as error:
        missing.append(error)
        return None
    callee = CheckedProcess(definitions, called, process.folder)
    return known.setdefault(_key(callee), callee)


def _roots(own: list[CheckedProcess], pools: frozenset[str]) -> list[CheckedProcess]:
    """The processes of pools, and the fewest of the others, the first ones, from which all are called."""
    roots: list[CheckedProcess] = []
    covered: set[CheckedProcess] = set()
    for process in sorted(own, key=lambda one: one.bpmn.id not in pools):
        if process.bpmn.id in pools or process not in covered:
            closure = process.closure()
            roots = [root for root in roots if root.bpmn.id in pools or root not in closure]
            roots.append(process)
            covered.update(closure)
    return roots
