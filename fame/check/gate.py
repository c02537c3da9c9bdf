"""What a run and a deployment refuse before anything moves: the errors of a check, in what is going to run.

Whoever compiles the processes anyway, because it runs them, needs `refuse_literals` alone; whoever sends them to others
`refuse_errors`. Warnings and notes refuse nothing, nor does what is wrong with a process that nobody is to run.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions, Process
from fame.check.findings import Finding, arranged
from fame.check.recursion import recursion_findings
from fame.check.scope import Subject, subject
from fame.check.timers import timer_findings
from fame.check.topics import fit_findings, types_of
from fame.errors import ModelError


def refuse_literals(
    definitions: Definitions, processes: Iterable[Process], library: Library, *, strict: bool = False
) -> None:
    """Refuse what fails whenever a token gets there, though every text by itself can be compiled.

    Times that are none, payloads that do not fit, types that nobody knows, calls without end; if `strict`, payloads
    that read what nothing sets. `processes` are those to be run; what they call is looked at too.
    Raises ModelError for the first of them by file and line.
    """
    about = _running(definitions, processes, library)
    unset: Iterable[Finding] = ()
    if strict:
        from fame.check.variables import variable_findings

        unset = variable_findings(about, types_of(about), strict=True)
    _refuse(about, (*_literals(about), *unset))


def refuse_errors(
    definitions: Definitions, processes: Iterable[Process], library: Library, *, sent: bool = False
) -> None:
    """Refuse the same, and what the compiler refuses.

    `sent`: to robots that may know message types that are not known here, so that these are for them to refuse.
    Raises ModelError for the first of them by file and line.
    """
    from fame.check.compiling import compiler_findings

    about = _running(definitions, processes, library)
    _refuse(about, (*compiler_findings(about), *_literals(about, sent=sent)))


def _running(definitions: Definitions, processes: Iterable[Process], library: Library) -> Subject:
    """The subject that is left of a file if only these processes begin by themselves."""
    run = {
        one.id: True
        for process in processes
        for home, one in library.closure(definitions, process)
        if home is definitions
    }
    pools = tuple(pool for pool in definitions.participants if pool.process in run)
    own = tuple(process for process in definitions.processes if process.id in run)
    return subject(replace(definitions, processes=own, participants=pools), library)


def _literals(about: Subject, *, sent: bool = False) -> Iterator[Finding]:
    yield from timer_findings(about)
    yield from fit_findings(about, sent=sent)
    yield from recursion_findings(about)


def _refuse(about: Subject, findings: Iterable[Finding]) -> None:
    """Raise the first error."""
    files = [about.definitions.file, *(unit.home.file for unit in about.units)]
    for one in arranged((one for one in findings if one.level == "error"), files):
        raise ModelError(one.text, file=one.file, line=one.line, element=one.element)
