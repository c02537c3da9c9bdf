"""Calls without end: processes that call themselves whatever way a token takes.

A process is endless if every way through it meets a call of an endless process. All that call themselves are taken for
endless, then those with a way past are struck out until none is left (a greatest fixed point). Within a process the
nodes are found from which every way meets such a call (a least fixed point). What a token may do besides, such as a
boundary event, an event sub-process, an error or a loop, counts as a way past, so that nothing is blamed wrongly.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from fame.bpmn.model import (
    Activity,
    Body,
    CallActivity,
    ErrorDefinition,
    Event,
    FlowNode,
    Gateway,
    SubProcess,
    Task,
    TerminateDefinition,
)
from fame.check.findings import Finding
from fame.check.graph import Graph, graph, link_of
from fame.check.scope import Subject, Unit

Passes = Callable[[FlowNode], bool]
"""Whether a token passes a node for certain."""


def recursion_findings(subject: Subject) -> Iterator[Finding]:
    """Errors where nothing on the way waits, so that it fails at once; else warnings."""
    circle = {unit for unit in subject.units if any(unit in callee.closure() for _, callee in unit.calls if callee)}
    at_once, in_time = _endless(circle, passes_at_once), _endless(circle, _in_time)
    for unit in subject.units:
        for call, callee in unit.calls if unit in in_time else ():
            if callee in in_time and callee is not None and unit in callee.closure():
                whom = "itself" if callee is unit else f"{callee.process.id}, which calls it again,"
                text = f"{unit.process.id} calls {whom} without end: every way through it meets such a call"
                yield unit.finding("error" if unit in at_once else "warning", text, call)


def _endless(circle: set[Unit], passes: Passes) -> set[Unit]:
    endless = set(circle)
    while True:
        ending = {unit for unit in endless if not _meets_always(unit.process.body, _calls(unit, endless), passes)}
        if not ending:
            return endless
        endless -= ending


def _calls(unit: Unit, endless: set[Unit]) -> set[str]:
    """The calls of endless processes, by id."""
    return {call.id for call, callee in unit.calls if callee in endless and call.loop is None}


def _meets_always(body: Body, calls: set[str], passes: Passes) -> bool:
    """Whether every token that begins in the body meets one of the calls."""
    scope = graph(body)
    if any(isinstance(node, SubProcess) and node.triggered_by_event for node in body.nodes):
        return False
    guarded = {node.attached_to for node in body.nodes if isinstance(node, Event) and node.place == "boundary"}
    cut_short = any(ends_all(node) for node in body.nodes)
    meeting: set[str] = set()

    def meets(node: FlowNode) -> bool:
        if node.id in calls or node.id in guarded or not passes(node):
            return node.id in calls
        if isinstance(node, SubProcess):
            if node.kind == "adhoc" and (node.active is not None or node.completion is not None):
                return False
            return _meets_always(node.body, calls, passes)
        ways = [other in meeting for other in scope.following[node.id]]
        if not ways or may_stop(scope, node):
            return False
        return any(ways) if _forks(scope, node) and not cut_short else all(ways)

    while more := {node.id for node in reversed(body.nodes) if node.id not in meeting and meets(node)}:
        meeting |= more
    return bool(body.nodes) and all(node.id in meeting for node in scope.beginnings())


def _forks(scope: Graph, node: FlowNode) -> bool:
    """Whether a token goes each way out."""
    if isinstance(node, Gateway):
        return node.kind == "parallel"
    return all(flow.condition is None for flow in scope.leaving(node))


def may_stop(scope: Graph, node: FlowNode) -> bool:
    """Whether a token finds no way out where no condition is true."""
    default = node.default if isinstance(node, Activity | Gateway) else ""
    flows = scope.leaving(node)
    return bool(flows) and not default and all(flow.condition is not None for flow in flows)


def ends_all(node: FlowNode) -> bool:
    """Whether it ends what other tokens do."""
    ends = TerminateDefinition | ErrorDefinition
    return isinstance(node, Event) and any(isinstance(one, ends) for one in node.definitions)


def _says(node: FlowNode, *words: str) -> bool:
    """Whether one of the words stands in its script."""
    return isinstance(node, Task) and node.script is not None and any(word in node.script.text for word in words)


def _in_time(node: FlowNode) -> bool:
    """Whether a token passes it sooner or later, without an error that could be meant as the way out."""
    return not ends_all(node) and not _says(node, "raise")


def passes_at_once(node: FlowNode) -> bool:
    """Whether a token passes it so, and without waiting."""
    if isinstance(node, Event):
        waits = node.place in ("catch", "boundary") and not link_of(node)
    elif isinstance(node, Task):
        waits = node.kind not in ("plain", "send", "script") or _says(node, "await", "next(")
    else:
        waits = isinstance(node, CallActivity) or (isinstance(node, Gateway) and node.kind == "event")
    return not waits and _in_time(node)
