"""Start and end events: sequence flows that lead the wrong way, end events without a start event (standard 10.5.2)."""

from __future__ import annotations

from collections.abc import Iterator

from fame.bpmn.model import SubProcess
from fame.check.findings import Finding
from fame.check.graph import Graph, graph, is_event
from fame.check.scope import Subject, Unit


def start_end_findings(subject: Subject) -> Iterator[Finding]:
    """Of every scope of every process."""
    for unit in subject.units:
        unordered = {
            id(node.body)
            for node in unit.process.body.walk()
            if isinstance(node, SubProcess) and node.kind in ("adhoc", "event")
        }
        for scope in map(graph, unit.bodies()):
            yield from _wrong_way(unit, scope)
            if id(scope.body) not in unordered:  # the one has no start event, the other cannot be without
                yield from _no_start(unit, scope)


def _wrong_way(unit: Unit, scope: Graph) -> Iterator[Finding]:
    for flow in scope.body.flows:
        source, target = scope.nodes[flow.source], scope.nodes[flow.target]
        if is_event(source, "end"):
            text = f"leaves the end event {source.label}, where every token ends: this flow is never taken"
            yield unit.finding("warning", text, flow)
        elif is_event(target, "start"):
            text = f"leads into the start event {target.label}, but start events take no flows: lead it to what follows"
            yield unit.finding("warning", text, flow)


def _no_start(unit: Unit, scope: Graph) -> Iterator[Finding]:
    beginnings = scope.beginnings()
    if any(is_event(node, "end") for node in scope.body.nodes) and beginnings and not scope.starts():
        text = "begins without a start event, though there are end events: draw a start event that leads here"
        yield unit.finding("warning", text, beginnings[0])
