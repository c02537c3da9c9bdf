"""Refuse to run or deploy a model that has errors, before anything starts.

Whoever compiles the processes itself, in order to run them, needs `refuse_literals` only; whoever sends them to robots
needs `refuse_errors`. Warnings, notes and processes that are not going to run refuse nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions, Process
from fame.check.findings import Finding, arranged
from fame.check.loops import check_recursion
from fame.check.scope import CheckScope, find_scope
from fame.check.timers import check_timers
from fame.check.topics import check_topic_types
from fame.errors import ModelError


def refuse_literals(
    definitions: Definitions, processes: Iterable[Process], library: Library, *, strict: bool = False
) -> None:
    """Refuse what compiles but always fails when a token gets there.

    That is: invalid times, payloads that do not fit, unknown types, endless recursion and, if `strict`, payloads that
    read variables that nothing sets. `processes` are those to be run; those that they call are checked too.
    Raises ModelError for the first error by file and line.
    """
    scope = _running(definitions, processes, library, strict=strict)
    unset: Iterable[Finding] = ()
    if strict:
        from fame.check.variables import check_variables

        unset = check_variables(scope)
    _refuse(scope, (*_literals(scope), *unset))


def refuse_errors(
    definitions: Definitions, processes: Iterable[Process], library: Library, *, sent: bool = False
) -> None:
    """Refuse the same and all errors of the compiler.

    `sent`: to robots that may know other message types, so that unknown types are left to them.
    Raises ModelError for the first error by file and line.
    """
    from fame.check.compilation import check_compilation

    scope = _running(definitions, processes, library, remote_types=sent)
    _refuse(scope, (*check_compilation(scope), *_literals(scope)))


def _running(
    definitions: Definitions,
    processes: Iterable[Process],
    library: Library,
    *,
    strict: bool = False,
    remote_types: bool = False,
) -> CheckScope:
    """The scope of a file in which only these processes start by themselves."""
    run = {
        one.id for process in processes for home, one in library.closure(definitions, process) if home is definitions
    }
    pools = tuple(pool for pool in definitions.participants if pool.process in run)
    own = tuple(process for process in definitions.processes if process.id in run)
    part = replace(definitions, processes=own, participants=pools)
    return find_scope(part, library, strict=strict, remote_types=remote_types)


def _literals(scope: CheckScope) -> Iterator[Finding]:
    yield from check_timers(scope)
    yield from check_topic_types(scope)
    yield from check_recursion(scope)


def _refuse(scope: CheckScope, findings: Iterable[Finding]) -> None:
    """Raise the first error."""
    for one in arranged((one for one in findings if one.level == "error"), scope.files):
        one = scope.named(one)
        raise ModelError(one.text, file=one.file, line=one.line, element=one.element, name=one.name)
