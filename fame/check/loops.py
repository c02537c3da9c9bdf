"""Checks of endless loops and endless recursion.

A process is endless if every path through it leads to a call of an endless process. All processes that call themselves
are first taken to be endless; then those with another way out are removed until none is left (a greatest fixed point).
Within a process, the nodes are found from which every path leads to such a call (a least fixed point). Boundary events,
event sub-processes, errors and loops count as ways out, so that no process is blamed wrongly.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from fame.bpmn.model import Body, CallActivity, Event, FlowNode, Gateway, SubProcess
from fame.check.findings import Finding
from fame.check.graph import Graph, ends_all, graph_of, may_stop, passes_at_once, passes_in_time
from fame.check.scope import CheckedProcess, CheckScope

# ---- loops -----------------------------------------------------------------------------------------------------------


def check_loops(scope: CheckScope) -> Iterator[Finding]:
    """Check every process, except those that something else may end."""
    stopped = {callee for process in scope.processes for call, callee in process.calls if call.id in _guarded(process)}
    for process in scope.processes:
        if process not in stopped and not _may_be_ended(process):
            for graph in map(graph_of, process.bodies()):
                yield from _endless_loops(process, graph)


def _guarded(process: CheckedProcess) -> set[str]:
    """The ids of activities that a boundary event may interrupt."""
    events = (node for node in process.bpmn.body.walk() if isinstance(node, Event))
    return {event.attached_to for event in events if event.place == "boundary" and event.interrupting}


def _may_be_ended(process: CheckedProcess) -> bool:
    """Whether another token, a handler or a boundary event may end a scope of the process."""
    guarded = _guarded(process)
    return any(
        ends_all(node) or (isinstance(node, SubProcess) and (node.triggered_by_event or node.id in guarded))
        for node in process.bpmn.body.walk()
    )


def _endless_loops(process: CheckedProcess, graph: Graph) -> Iterator[Finding]:
    for circle in graph.circles():
        inside = {node.id for node in circle}
        closed = all(inside.issuperset(graph.following[node.id]) and not may_stop(graph, node) for node in circle)
        if closed and all(_passes(node) for node in circle):
            names = ", ".join(each.display_name for each in circle[1:])
            text = f"is in a loop{f' with {names}' if names else ''} that no flow leaves and in which nothing waits"
            yield process.finding("warning", f"{text}: it runs forever", circle[0])


def _passes(node: FlowNode) -> bool:
    """Whether every token passes the node without waiting and without an error."""
    if isinstance(node, Gateway) and node.kind != "exclusive":
        return len(node.incoming) < 2 and passes_at_once(node)
    if isinstance(node, CallActivity):
        return False
    if isinstance(node, SubProcess):
        return node.kind != "adhoc" and all(_passes(each) for each in node.body.nodes)
    return passes_at_once(node)


# ---- recursion -------------------------------------------------------------------------------------------------------


Passes = Callable[[FlowNode], bool]
"""Whether a token certainly passes a node."""


def check_recursion(scope: CheckScope) -> Iterator[Finding]:
    """Find endless recursion: errors where nothing waits on the way, so that it fails at once, else warnings."""
    circle = {
        process
        for process in scope.processes
        if any(process in callee.closure() for _, callee in process.calls if callee)
    }
    at_once, in_time = _endless(circle, passes_at_once), _endless(circle, passes_in_time)
    for process in scope.processes:
        for call, callee in process.calls if process in in_time else ():
            if callee in in_time and callee is not None and process in callee.closure():
                callee_name = "itself" if callee is process else f"{callee.bpmn.display_name}, which calls it again,"
                text = f"{process.bpmn.display_name} calls {callee_name} endlessly"
                text += ": every path through it leads to such a call"
                yield process.finding("error" if process in at_once else "warning", text, call)


def _endless(circle: set[CheckedProcess], passes: Passes) -> set[CheckedProcess]:
    endless = set(circle)
    while True:
        ending = {
            process for process in endless if not _meets_always(process.bpmn.body, _calls(process, endless), passes)
        }
        if not ending:
            return endless
        endless -= ending


def _calls(process: CheckedProcess, endless: set[CheckedProcess]) -> set[str]:
    """The ids of the calls of endless processes."""
    return {call.id for call, callee in process.calls if callee in endless and call.loop is None}


def _meets_always(body: Body, calls: set[str], passes: Passes) -> bool:
    """Whether every path through the body leads to one of the calls."""
    graph = graph_of(body)
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
        ways = [other in meeting for other in graph.following[node.id]]
        if not ways or may_stop(graph, node):
            return False
        return any(ways) if _forks(graph, node) and not cut_short else all(ways)

    while more := {node.id for node in reversed(body.nodes) if node.id not in meeting and meets(node)}:
        meeting |= more
    return bool(body.nodes) and all(node.id in meeting for node in graph.beginnings())


def _forks(graph: Graph, node: FlowNode) -> bool:
    """Whether a token takes all outgoing flows."""
    if isinstance(node, Gateway):
        return node.kind == "parallel"
    return all(flow.condition is None for flow in graph.leaving(node))
