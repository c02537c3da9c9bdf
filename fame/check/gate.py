"""Errors that keep a model from running: find all that the compiler reports, refuse to run or deploy the model.

A caller that compiles the processes itself, in order to run them, needs `refuse_literals` only; one that sends them to
robots needs `refuse_errors`. Warnings, notes and processes that are not going to run are no reason to refuse.

`check_compilation` reports all errors of the compiler, not only the first. It compiles every process with a host that
collects errors of expressions and continues. An element that has a fault or that the compiler rejects is replaced by a
valid one, and the process is compiled again. Called processes are replaced by one that does nothing, so that each
process is compiled by itself: as a start if it starts by itself, as a callee if it is called.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Set
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from fame.bpmn.library import Library
from fame.bpmn.model import (
    Body,
    CallActivity,
    Definitions,
    Event,
    Expression,
    FlowNode,
    Process,
    SignalDefinition,
    SubProcess,
    Task,
    Topic,
)
from fame.check.control_flow import check_recursion
from fame.check.events import check_timers
from fame.check.literals import check_literals
from fame.check.scope import CheckedProcess, CheckScope, Finding, arranged, find_scope, of_error
from fame.check.service_topics import check_services
from fame.check.topics import check_topic_types
from fame.engine import Host, compile_program
from fame.engine.scope_compiler import NESTED, TOO_DEEP
from fame.errors import ModelError, UnavailableError
from fame.scripting import compile_expression, compile_script


def refuse_literals(
    definitions: Definitions,
    processes: Iterable[Process],
    library: Library,
    *,
    strict: bool = False,
    folder: Path | None = None,
) -> None:
    """Refuse what compiles but always fails when a token gets there.

    That is: invalid times and values of properties, constants that take too long, payloads that do not fit, unknown
    types, endless recursion, services that do not start and, if `strict`, payloads that read variables that nothing
    sets. `processes` are those to be run; those that they call are checked too. `folder`: that of the files of
    services, where it is not that of the model.
    Raises ModelError for the first error by file and line.
    """
    scope = _running(definitions, processes, library, strict=strict, folder=folder)
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
    scope = _running(definitions, processes, library, remote_types=sent)
    _refuse(scope, (*check_compilation(scope), *_literals(scope)))


def _running(
    definitions: Definitions,
    processes: Iterable[Process],
    library: Library,
    *,
    strict: bool = False,
    remote_types: bool = False,
    folder: Path | None = None,
) -> CheckScope:
    """The scope of a file in which only these processes start by themselves."""
    run = {
        one.id for process in processes for home, one in library.closure(definitions, process) if home is definitions
    }
    pools = tuple(pool for pool in definitions.participants if pool.process in run)
    own = tuple(process for process in definitions.processes if process.id in run)
    part = replace(definitions, processes=own, participants=pools)
    return find_scope(part, library, strict=strict, remote_types=remote_types, folder=folder)


def _literals(scope: CheckScope) -> Iterator[Finding]:
    yield from check_timers(scope)
    yield from check_topic_types(scope)
    yield from check_recursion(scope)
    yield from check_services(scope)
    yield from check_literals(scope)


def _refuse(scope: CheckScope, findings: Iterable[Finding]) -> None:
    """Raise the first error."""
    for error in arranged((one for one in findings if one.level == "error"), scope.files):
        error = scope.named(error)
        raise ModelError(error.text, file=error.file, line=error.line, element=error.element, name=error.name)


# ---- all errors of the compiler --------------------------------------------------------------------------------------


_MOST_ERRORS = 100
"""Errors of one process after which the check stops."""

_NOTHING = Process(id="nothing", body=Body(nodes=(Event(id="begin", place="start"),)))
_SOME_TOPIC = Topic("some_topic")
_SOME_SIGNAL = (SignalDefinition(topic=_SOME_TOPIC),)


def check_compilation(scope: CheckScope) -> Iterator[Finding]:
    """Everything that prevents each process from being compiled, and calls of processes that do not exist."""
    yield from map(of_error, scope.missing)
    yield from _too_deep(scope)
    called = scope.called()
    for process in scope.processes:
        for as_callee in (False, True):
            if process in (called if as_callee else scope.roots):
                yield from _compiled(process, as_callee)


def _too_deep(scope: CheckScope) -> Iterator[Finding]:
    """The first element of each start that is too deep, on the way of the compiler: it goes into each call once."""
    for root in scope.roots:
        seen, way = {root}, [(root, _openings(root.bpmn.body, 0))]
        while way:
            process, openings = way[-1]
            node, depth = next(openings, (None, 0))
            callee = process.called_by(node) if node is not None else None
            if node is None:
                way.pop()
            elif depth >= NESTED:
                yield process.finding("error", TOO_DEEP, node)
                break
            elif callee is not None and callee not in seen:
                seen.add(callee)
                way.append((callee, _openings(callee.bpmn.body, depth + 1)))


def _openings(body: Body, depth: int) -> Iterator[tuple[SubProcess | CallActivity, int]]:
    """The sub-processes and calls of a body, and how deep they are."""
    for node in body.nodes:
        if isinstance(node, SubProcess | CallActivity):
            yield node, depth
        if node.body is not None:
            yield from _openings(node.body, depth + 1)


def _compiled(process: CheckedProcess, as_callee: bool) -> Iterator[Finding]:
    """Compile a process again and again until the compiler accepts it."""
    faults = process.bpmn.faults
    yield from (Finding("error", fault.text, process.file, fault.line, fault.element) for fault in faults)
    body = _without(process.bpmn.body, {fault.element for fault in faults})
    host, compiled = _Host(), replace(process.bpmn, body=body, faults=())
    for _ in range(_MOST_ERRORS):
        error = _compile_error(compiled, process.file, as_callee, host)
        if error is None:
            break
        yield _with_line(process, error)
        body = _without(compiled.body, {error.element})
        if body == compiled.body:
            break
        compiled = replace(compiled, body=body)
    else:
        yield process.finding(
            "note", f"{_MOST_ERRORS} of its elements are invalid: the check of this process stops here", process.bpmn
        )
    yield from host.findings


def _compile_error(compiled: Process, file: str, as_callee: bool, host: _Host) -> ModelError | None:
    """The error of the compiler, None if it accepts the process."""
    caller = CallActivity(id=compiled.id, called=compiled.id)
    begin = Process(id=compiled.id, body=Body(nodes=(caller,))) if as_callee else compiled

    def library(name: str, file: str, call: CallActivity) -> tuple[Process, str]:
        return (compiled if call is caller else _NOTHING), file

    try:
        compile_program(begin, host=cast(Host, host), library=library, file=file)
    except ModelError as error:
        return error
    return None


def _with_line(process: CheckedProcess, error: ModelError) -> Finding:
    """The finding, with the line of its element where the compiler gives none."""
    elements = (process.bpmn, *process.bpmn.body.walk())
    line = error.line or next((one.line for one in elements if one.id == error.element), 0)
    return Finding("error", error.text, error.file, line, error.element)


class _Host:
    """A host that collects errors instead of running anything."""

    def __init__(self) -> None:
        self.findings: list[Finding] = []

    def compile(self, expression: Expression, *, element: str, file: str, script: bool = False) -> Callable[..., Any]:
        compiler = compile_script if script else compile_expression
        try:
            return compiler(expression, file=file, element=element)
        except ModelError as error:
            self.findings.append(of_error(error))
        except UnavailableError as error:
            text = f"cannot be checked: {str(error).removeprefix(f'{element}: ')}"
            self.findings.append(Finding("warning", text, file, expression.line, element))
        return _nothing

    def service(self, operation: str, *, element: str, file: str) -> Callable[..., Any]:
        return _nothing


def _nothing(variables: Any) -> None: ...


# ---- replacements of rejected elements -------------------------------------------------------------------------------


def _without(body: Body, rejected: Set[str]) -> Body:
    """The body with a valid node in place of each rejected one; equal to `body` if there is nothing to replace."""
    nodes = []
    for node in body.nodes:
        if isinstance(node, SubProcess):
            node = replace(node, body=_without(node.body, rejected))
        nodes += _replacement(node) if node.id in rejected else [node]
    return replace(body, nodes=tuple(nodes))


def _replacement(node: FlowNode) -> list[FlowNode]:
    """A valid replacement that keeps as much of the node as possible; empty if the node can be left out."""
    if isinstance(node, Event):
        waits = node.place in ("start", "catch", "boundary")
        return [replace(node, definitions=_SOME_SIGNAL if waits else (), parallel=False)]
    if isinstance(node, SubProcess) and node.triggered_by_event:
        return []
    if isinstance(node, SubProcess | CallActivity):  # what is inside is checked too
        bare = replace(node, loop=None, refused="", for_compensation=False)
        if isinstance(bare, SubProcess) and bare.kind == "adhoc":
            bare = replace(bare, kind="embedded")
        if bare != node:
            return [bare]
    if isinstance(node, Task) and node.kind == "receive" and node.topic is None:
        return [replace(node, topic=_SOME_TOPIC)]
    return [Task(id=node.id, line=node.line, incoming=node.incoming, outgoing=node.outgoing)]
