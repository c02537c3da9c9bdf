"""Loops that go round for ever at one moment: no flow leads out of them, and nothing in them waits."""

from __future__ import annotations

from collections.abc import Iterator

from fame.bpmn.model import CallActivity, Event, FlowNode, Gateway, SubProcess
from fame.check.findings import Finding
from fame.check.graph import Graph, graph
from fame.check.recursion import ends_all, may_stop, passes_at_once
from fame.check.scope import Subject, Unit


def loop_findings(subject: Subject) -> Iterator[Finding]:
    """Of every process; nothing is said of one that something else may end."""
    stopped = {callee for unit in subject.units for call, callee in unit.calls if call.id in _guarded(unit)}
    for unit in subject.units:
        if unit not in stopped and not _may_be_ended(unit):
            for scope in map(graph, unit.bodies()):
                yield from _endless(unit, scope)


def _guarded(unit: Unit) -> set[str]:
    """The activities (ids) that a boundary event may interrupt."""
    events = (node for node in unit.process.body.walk() if isinstance(node, Event))
    return {event.attached_to for event in events if event.place == "boundary" and event.interrupting}


def _may_be_ended(unit: Unit) -> bool:
    """Whether something may end a scope of the process from beside: another token, a handler, a boundary event."""
    guarded = _guarded(unit)
    return any(
        ends_all(node) or (isinstance(node, SubProcess) and (node.triggered_by_event or node.id in guarded))
        for node in unit.process.body.walk()
    )


def _endless(unit: Unit, scope: Graph) -> Iterator[Finding]:
    for circle in scope.circles():
        inside = {node.id for node in circle}
        closed = all(inside.issuperset(scope.following[node.id]) and not may_stop(scope, node) for node in circle)
        if closed and all(_passes(node) for node in circle):
            names = ", ".join(each.label for each in circle[1:])
            text = f"is in a loop{f' with {names}' if names else ''} that no flow leaves and where nothing waits"
            yield unit.finding("warning", f"{text}: it goes round for ever", circle[0])


def _passes(node: FlowNode) -> bool:
    """Whether every token passes the node without waiting and without an error."""
    if isinstance(node, Gateway) and node.kind != "exclusive":
        return len(node.incoming) < 2 and passes_at_once(node)
    if isinstance(node, CallActivity):
        return False
    if isinstance(node, SubProcess):
        return node.kind != "adhoc" and all(_passes(each) for each in node.body.nodes)
    return passes_at_once(node)
