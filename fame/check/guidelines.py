"""What has no effect, or another than its author knew; and the guidelines of the FaMe paper (section 3), as notes.

The guidelines say how to draw so that others see what a robot does; deviations are told on request:
G1 robots are pools; G2 the mission is the process of the pool, drawn with a small selection of elements; G3 robots
communicate only by signals; G4 data objects declare the variables of conditions and payloads.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from fame.bpmn.model import (
    Definitions,
    Element,
    FlowNode,
    Gateway,
    MessageFlow,
    Process,
    SubProcess,
    Task,
)
from fame.check.expressions import expressions_in
from fame.check.scope import CheckedProcess, CheckScope, Finding
from fame.engine import gateways, loops
from fame.rooms import SERVICES

_SELECTED_EVENTS = ("signal", "timer", "conditional", "error", "terminate")
_SELECTED_GATEWAYS = ("exclusive", "parallel", "event")
_KINDS = {"business_rule": "business rule", "adhoc": "ad-hoc sub-process", "embedded": "embedded sub-process"}


def check_effects(scope: CheckScope) -> Iterator[Finding]:
    """Find pools, message flows and tasks that do nothing by themselves, and what the original FaMe did otherwise."""
    file = scope.definitions.file
    for pool in scope.definitions.participants:
        if not pool.process:
            text = "is a black box: no robot plays it, and its signals come from outside"
            yield Finding("note", text, file, pool.line, pool.id)
    for flow in scope.definitions.message_flows:
        if not _joins(scope.definitions, flow):
            text = "has no effect: a message flow joins an element that sends a message with one that receives it"
            yield Finding("note", text, file, flow.line, flow.id)
    for process in scope.processes:
        for node in process.nodes():
            if isinstance(node, Task) and (text := _needs(node)):
                yield process.finding("note", text, node)
        yield from _original(process)


def check_guidelines(scope: CheckScope) -> Iterator[Finding]:
    yield from _pools(scope)
    for process in scope.processes:
        for node in process.nodes():
            if outside := _outside(node):
                text = f"{outside} is not among the elements that the guidelines recommend (G2)"
                yield process.finding("note", text, node)
        yield from _undeclared(process)


# ---- what has no effect ----------------------------------------------------------------------------------------------


def _joins(definitions: Definitions, flow: MessageFlow) -> bool:
    """Whether a message flow leads from an element that sends to one that receives."""
    nodes = (node for process in definitions.processes for node in process.body.walk())
    return {(flow.source, True), (flow.target, False)} <= {
        (node.id, throws) for node in nodes for _, throws in node.topics()
    }


def _needs(task: Task) -> str:
    """Why a task does nothing by itself; empty if it does something."""
    if task.kind == "plain":
        return "a plain task does nothing: it completes at once"
    if task.kind == "script" and task.script is None:
        return "has no script: it completes at once"
    if task.kind == "service" and task.operation not in ("", *SERVICES) and task.topic is None:
        return f"needs the service {task.operation!r} where it runs: Simulation(services=...)"
    return ""


# ---- G1, G3: the collaboration ---------------------------------------------------------------------------------------


def _pools(scope: CheckScope) -> Iterator[Finding]:
    definitions = scope.definitions
    shapes: dict[Any, str] = {}
    for pool in definitions.participants:
        process = definitions.process(pool.process)
        if process is not None and not pool.multi_instance:
            twin = shapes.setdefault(_shape(process, _ordinals(process)), pool.label)
            if twin != pool.label:
                text = f"does the same as pool {twin}: use one multi-instance pool for such robots (G1)"
                yield Finding("note", text, definitions.file, pool.line, pool.id)
    for flow in definitions.message_flows:
        if _joins(definitions, flow):
            text = "message flows are outside the guidelines: robots communicate by signals, matched by name (G3)"
            yield Finding("note", text, definitions.file, flow.line, flow.id)


def _ordinals(process: Process) -> Mapping[str, str]:
    """Number the ids of a process in document order: id -> ``#n``."""
    ids = [process.id]
    ids += [element.id for element in process.body.elements()]
    return {id: f"#{number}" for number, id in enumerate(ids)}


def _shape(value: Any, ids: Mapping[str, str]) -> Any:
    """A hashable form of a process without ids, labels, lines, documentation and lanes."""
    if isinstance(value, str):
        return ids.get(value, value)
    if isinstance(value, tuple | list):
        return tuple(_shape(item, ids) for item in value)
    if isinstance(value, Mapping):
        return tuple((key, _shape(item, ids)) for key, item in value.items())
    if not is_dataclass(value):
        return value
    passed = {"line", "documentation", "lanes"} | ({"id", "name"} if isinstance(value, Element) else set())
    return (
        type(value).__name__,
        *(_shape(getattr(value, one.name), ids) for one in fields(value) if one.name not in passed),
    )


# ---- G2: the selection -----------------------------------------------------------------------------------------------


def _outside(node: FlowNode) -> str:
    """The name of the kind of an element outside the selection; empty for elements inside it."""
    if isinstance(node, Task) and node.kind not in ("script", "plain"):
        return f"a {_KINDS.get(node.kind, node.kind)} task"
    if isinstance(node, SubProcess) and node.kind != "event":
        return f"{_article(name := _KINDS.get(node.kind, node.kind))} {name}"
    if isinstance(node, Gateway) and node.kind not in _SELECTED_GATEWAYS:
        return f"{_article(node.kind)} {node.kind} gateway"
    if node.definitions:
        if len(node.definitions) > 1:
            return "a multiple event"
        kind = next((one.trigger for one in node.definitions if one.trigger not in _SELECTED_EVENTS), "")
        return f"{_article(kind)} {kind} event" if kind else ""
    return "a loop" if node.loop is not None else ""


def _article(word: str) -> str:
    return "an" if word[:1] in "aeiou" else "a"


# ---- G4: data --------------------------------------------------------------------------------------------------------


def _undeclared(process: CheckedProcess) -> Iterator[Finding]:
    declared = {name for body in process.bodies() for item in body.data_objects for name in item.names}
    for body in process.bodies():
        for text in expressions_in(body):
            if text.use in ("condition", "payload"):
                for name in sorted(text.reads - declared - {*loops.NAMES, *gateways.NAMES}):
                    does = "decides by" if text.use == "condition" else "sends"
                    message = f"{does} `{name}`, which no data object declares (G4)"
                    yield process.finding("note", message, text.element, text.expression.line)


# ---- models of the original FaMe -------------------------------------------------------------------------------------


def _original(process: CheckedProcess) -> Iterator[Finding]:
    """Interrupting event sub-processes in files of the original FaMe, which suspended the scope."""
    if process.bpmn.semantics == "standard" and process.bpmn.by_prefix:
        for node in suspending(process.bpmn):
            text = "ends its scope; the original FaMe resumed the scope afterwards"
            yield process.finding("warning", f"{text}: for that, set property semantics=original on the process", node)


def suspending(process: Process) -> Iterator[SubProcess]:
    """Yield the event sub-processes that semantics=original affects."""
    for node in process.body.walk():
        if isinstance(node, SubProcess) and node.triggered_by_event and not node.resume:
            yield from [node] * any(start.interrupting for start in node.body.events("start"))
