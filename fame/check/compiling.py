"""What the compiler refuses: all of it, not only the first.

Every process is compiled for a host that keeps what is wrong with an expression and goes on. Where an element has a
fault, or the compiler refuses it, a harmless one takes its place in the model, and the process is compiled again. Calls
lead to a process that does nothing, so that each process is compiled by itself: as a start if it is one, as a callee if
it is called.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Set
from dataclasses import replace
from typing import Any, cast

from fame.bpmn.model import (
    Body,
    CallActivity,
    Event,
    Expression,
    FlowNode,
    Process,
    SignalDefinition,
    SubProcess,
    Task,
    Topic,
)
from fame.check.findings import Finding, of_error
from fame.check.scope import Subject, Unit
from fame.engine import Host, compile_program
from fame.errors import ModelError, UnavailableError
from fame.scripting import compile_expression, compile_script

ROUNDS = 100
"""Refusals of one process after which no more are looked for."""

_NOTHING = Process(id="nothing", body=Body(nodes=(Event(id="begin", place="start"),)))
_SOME_TOPIC = Topic("some_topic")
_SOME_SIGNAL = (SignalDefinition(topic=_SOME_TOPIC),)


def compiler_findings(subject: Subject) -> Iterator[Finding]:
    """What keeps each process from being compiled, and the calls that lead nowhere."""
    yield from map(of_error, subject.missing)
    called = subject.called()
    for unit in subject.units:
        for as_callee in (False, True):
            if unit in (called if as_callee else subject.roots):
                yield from _compiled(unit, as_callee)


def _compiled(unit: Unit, as_callee: bool) -> Iterator[Finding]:
    """Compile the process of a unit until nothing more is refused."""
    faults = unit.process.faults
    yield from (Finding("error", fault.text, unit.home.file, fault.line, fault.element) for fault in faults)
    body = _without(unit.process.body, {fault.element for fault in faults})
    host, process = _Host(), replace(unit.process, body=body, faults=())
    for _ in range(ROUNDS):
        refusal = _refusal(process, unit.home.file, as_callee, host)
        if refusal is None:
            break
        yield _placed(unit, refusal)
        body = _without(process.body, {refusal.element})
        if body == process.body:
            break
        process = replace(process, body=body)
    else:
        yield unit.finding("note", f"{ROUNDS} of its elements are refused: no more are looked for", unit.process)
    yield from host.findings


def _refusal(process: Process, file: str, as_callee: bool, host: _Host) -> ModelError | None:
    """Why the process cannot be compiled; None if it can."""
    caller = CallActivity(id=process.id, called=process.id)
    begin = Process(id=process.id, body=Body(nodes=(caller,))) if as_callee else process

    def library(name: str, file: str, call: CallActivity) -> tuple[Process, str]:
        return (process if call is caller else _NOTHING), file

    try:
        compile_program(begin, host=cast(Host, host), library=library, file=file)
    except ModelError as error:
        return error
    return None


def _placed(unit: Unit, error: ModelError) -> Finding:
    """The finding, with the line of the element where the compiler says none."""
    elements = (unit.process, *unit.process.body.walk())
    line = error.line or next((one.line for one in elements if one.id == error.element), 0)
    return Finding("error", error.text, error.file, line, error.element)


class _Host:
    """The world of a compiler that compiles for nobody."""

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


# ---- what takes the place of a refused element -----------------------------------------------------------------------


def _without(body: Body, refused: Set[str]) -> Body:
    """The body with a harmless node in the place of each that is refused; the same if there is none to replace."""
    nodes = []
    for node in body.nodes:
        if isinstance(node, SubProcess):
            node = replace(node, body=_without(node.body, refused))
        nodes += _harmless(node) if node.id in refused else [node]
    return replace(body, nodes=tuple(nodes))


def _harmless(node: FlowNode) -> list[FlowNode]:
    """What the compiler takes in its place, with as much of it as it may take; nothing if it can be left out."""
    if isinstance(node, Event):
        waits = node.place in ("start", "catch", "boundary")
        return [replace(node, definitions=_SOME_SIGNAL if waits else (), parallel=False)]
    if isinstance(node, SubProcess) and node.triggered_by_event:
        return []
    if isinstance(node, SubProcess | CallActivity):  # what is inside is looked at too
        bare = replace(node, loop=None, refused="", for_compensation=False)
        if isinstance(bare, SubProcess) and bare.kind == "adhoc":
            bare = replace(bare, kind="embedded")
        if bare != node:
            return [bare]
    if isinstance(node, Task) and node.kind == "receive" and node.topic is None:
        return [replace(node, topic=_SOME_TOPIC)]
    return [Task(id=node.id, line=node.line, incoming=node.incoming, outgoing=node.outgoing)]
