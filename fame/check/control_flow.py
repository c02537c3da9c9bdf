"""Checks of control flow: unreachable elements, gateways without a way out, joins that wait forever, endless loops.

Only the diagram is examined, no values. Every condition may be false, and tokens may come more than once, so none of
these findings is an error, except endless recursion.

A process is endless if every path through it leads to a call of an endless process. All processes that call themselves
are first taken to be endless; then those with another way out are removed until none is left (a greatest fixed point).
Within a process, the nodes are found from which every path leads to such a call (a least fixed point). Boundary events,
event sub-processes, errors and loops count as ways out, so that no process is reported wrongly.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from itertools import islice

from fame.bpmn.model import (
    Activity,
    Body,
    CompensateDefinition,
    Expression,
    FlowNode,
    Gateway,
    SequenceFlow,
    SubProcess,
)
from fame.check.expressions import cover_all
from fame.check.graph import FlowGraph, ends_all, graph_of, link_of, may_stop, passes_at_once, passes_in_time
from fame.check.scope import CheckedProcess, CheckScope, Finding, Fix, Level

_Passes = Callable[[FlowNode], bool]
"""Whether a token certainly passes a node."""

# ---- reachable elements ----------------------------------------------------------------------------------------------


def check_flow(scope: CheckScope) -> Iterator[Finding]:
    """Check the flow nodes of every process and sub-process."""
    called = scope.called()
    for process in scope.processes:
        if process not in called:
            yield from _undone_by_nobody(process, "warning" if scope.has_pool(process) else "note")
        for graph in map(graph_of, process.bodies()):
            yield from _unreached(process, graph)
            yield from _loose_ends(process, graph)
            for node in graph.body.nodes:
                yield from _conditions(process, graph, node)
                if isinstance(node, Gateway):
                    yield from _ways_out(process, graph, node)


def _unreached(process: CheckedProcess, graph: FlowGraph) -> Iterator[Finding]:
    """The first node of each unreachable part."""
    reached: set[str] = set()
    graph.reach((node.id for node in graph.beginnings()), reached)
    apart = [node for node in graph.body.nodes if node.id not in reached and not node.triggered_by_event]
    entered = {id for node in apart for id in graph.following[node.id]}
    for node in sorted(apart, key=lambda one: one.id in entered):  # a circle of nodes has no first: any will do
        part = graph.reach([node.id], reached)
        if part:
            rest = f", nor what follows it ({len(part) - 1})" if len(part) > 1 else ""
            yield process.finding("warning", f"is never reached{rest}: no flow leads here from a start", node)


def _undone_by_nobody(process: CheckedProcess, level: Level) -> Iterator[Finding]:
    """Compensation event sub-processes of a process that nothing calls (standard 10.7.1: they undo an activity)."""
    for node in process.bpmn.body.nodes:
        begins = node.body.nodes if isinstance(node, SubProcess) and node.triggered_by_event else ()
        if any(start.place == "start" and start.defined(CompensateDefinition) for start in begins):
            text = "runs only where a call activity calls this process: it undoes a completed activity"
            yield process.finding(level, text, node)


def _loose_ends(process: CheckedProcess, graph: FlowGraph) -> Iterator[Finding]:
    """Paths without an end event, in a scope that has end events (standard 10.5.3)."""
    if not any(node.place == "end" for node in graph.body.nodes):
        return
    reached = graph.reach((node.id for node in graph.beginnings()), set())
    compensation = {id for association in graph.body.associations for id in association}
    left = {node.attached_to for node in graph.body.nodes if node.interrupting}
    for node in graph.body.nodes:
        last = not node.outgoing and node.id in reached and node.id not in compensation | left
        if last and not (node.place == "end" or link_of(node) or node.triggered_by_event or isinstance(node, Gateway)):
            yield process.finding("warning", "has no outgoing flow, although other paths lead to an end event", node)


# ---- gateways --------------------------------------------------------------------------------------------------------


def _conditions(process: CheckedProcess, graph: FlowGraph, node: FlowNode) -> Iterator[Finding]:
    """Conditions that are never evaluated or always true."""
    blind = node.tag in ("parallelGateway", "eventBasedGateway")
    for flow in graph.leaving(node):
        if flow.condition is not None and flow.id == node.default:
            text = "is the default flow: its condition is never evaluated"
            yield process.finding("warning", text, flow, fix=_conditional(flow, ""))
        elif flow.condition is not None and _is_quoted(flow.condition):
            expected = _NEGATIONS[flow.condition.language][0] + flow.condition.text[1:-1]
            text = f"its condition is a text in quotes, always true: expected {expected}"
            yield process.finding("warning", text, flow, fix=_conditional(flow, expected))
        elif flow.condition is not None and blind:
            text = f"its condition is never evaluated: {node.display_name} takes no conditions"
            yield process.finding("warning", text, flow, fix=_conditional(flow, ""))


def _conditional(flow: SequenceFlow, condition: str) -> Fix:
    return Fix(f"make its condition {condition}" if condition else "remove it", flow.id, "condition", condition)


def _is_quoted(condition: Expression) -> bool:
    """Whether the whole condition is one string literal."""
    text = condition.text
    quoted = len(text) > 2 and text[0] == text[-1] and text[0] in "'\""
    return condition.language in _NEGATIONS and quoted and text[0] not in text[1:-1]


_NEGATIONS = {"python": ("", "not (", ") and not ("), "feel": ("=", "not(", ") and not(")}
"""Language of conditions that a fix writes -> what a condition begins with, and what a negated one, and the next."""


def _ways_out(process: CheckedProcess, graph: FlowGraph, gateway: Gateway) -> Iterator[Finding]:
    flows = graph.leaving(gateway)
    if not flows and gateway.kind != "event":  # which the compiler refuses
        yield process.finding("warning", "has no outgoing flow: the token ends here", gateway)
    elif flows and gateway.kind in ("exclusive", "inclusive"):
        conditions = [flow.condition for flow in flows if flow.condition is not None]
        if not gateway.default and len(conditions) == len(flows):
            if cover_all(conditions):
                return
            text = "has no way out if none of its conditions is true: mark one of its flows as the default"
            fix = Fix(f"make {flows[-1].label} the default", gateway.id, "default", flows[-1].id)
            yield process.finding("warning", text, gateway, fix=fix)
        elif len(flows) > 1:
            yield from _open_flows(process, gateway, flows)


def _open_flows(process: CheckedProcess, gateway: Gateway, flows: list[SequenceFlow]) -> Iterator[Finding]:
    """Flows of a choice that have no condition and are not the default."""
    for flow in flows:
        if flow.condition is None and flow.id != gateway.default:
            text = (
                f"has no condition, so {gateway.display_name} always takes it: give it one, or mark it as the default"
            )
            others = [one.condition for one in flows if one not in (flow,) and one.id != gateway.default]
            known = [one.text for one in others if one is not None and one.language in _NEGATIONS]
            languages = {one.language for one in others if one is not None}
            fix = Fix("mark it as the default", gateway.id, "default", flow.id) if not gateway.default else None
            if gateway.default and known and len(known) == len(others) and len(languages) == 1:
                mark, negation, following = _NEGATIONS[languages.pop()]
                fix = _conditional(flow, f"{mark}{negation}{following.join(known)})")
            yield process.finding("warning", text, flow, fix=fix)


# ---- start and end events --------------------------------------------------------------------------------------------


def check_start_and_end_events(scope: CheckScope) -> Iterator[Finding]:
    """Check the start and end events of every process and sub-process."""
    for process in scope.processes:
        unordered = {
            id(node.body) for node in process.nodes() if node.triggered_by_event or node.tag == "adHocSubProcess"
        }
        for graph in map(graph_of, process.bodies()):
            if id(graph.body) not in unordered:  # the one has no start event, the other cannot be without
                yield from _no_start(process, graph)


def _no_start(process: CheckedProcess, graph: FlowGraph) -> Iterator[Finding]:
    beginnings = graph.beginnings()
    if any(node.place == "end" for node in graph.body.nodes) and beginnings and not graph.starts():
        text = "has no start event before it, although there are end events: add a start event"
        yield process.finding("warning", text, beginnings[0])


# ---- joins -----------------------------------------------------------------------------------------------------------


_NEAREST = 10
"""Parallel gateways before a join that are examined as its possible fork."""


def check_joins(scope: CheckScope) -> Iterator[Finding]:
    """Check every node with several incoming flows."""
    for process in scope.processes:
        for graph in map(graph_of, process.bodies()):
            for node in graph.body.nodes:
                if len(node.incoming) > 1:
                    yield from _mismatch(process, graph, node)
                    yield from _incomplete_join(process, graph, node)


def _mismatch(process: CheckedProcess, graph: FlowGraph, node: FlowNode) -> Iterator[Finding]:
    """Flows that are split by one kind of gateway and joined by another."""
    joins = node.tag == "parallelGateway"
    merges = isinstance(node, Activity) or node.tag == "exclusiveGateway"
    origins = Counter(_origin(graph, node, flow) for flow in node.incoming)
    for origin, number in origins.items():
        gateway = graph.nodes[origin]
        if number < 2:
            continue
        if joins and gateway.tag in ("exclusiveGateway", "eventBasedGateway"):
            text = f"waits for {number} flows from {gateway.display_name}, which takes only one: it may wait forever"
            yield process.finding("warning", text, node)
        elif merges and gateway.tag == "parallelGateway":
            text = f"is reached {number} times from {gateway.display_name}, so what follows it runs {number} times"
            yield process.finding("warning", f"{text}: use a parallel gateway to join the flows", node)


def _origin(graph: FlowGraph, node: FlowNode, flow: str) -> str:
    """The node where a sequence of elements begins; the node itself if the sequence is a loop."""
    origin = graph.nodes[graph.flows[flow].source]
    seen = {node.id}
    while len(origin.incoming) == 1 and len(origin.outgoing) == 1 and origin.id not in seen:
        seen.add(origin.id)
        origin = graph.nodes[graph.flows[origin.incoming[0]].source]
    return origin.id


def _incomplete_join(process: CheckedProcess, graph: FlowGraph, join: FlowNode) -> Iterator[Finding]:
    """A parallel join of a fork whose branches a token may leave."""
    if join.tag != "parallelGateway":
        return
    before = (graph.nodes[id] for id in graph.before(join.id))
    forks = (node for node in before if node.tag == "parallelGateway" and node is not join)
    for fork in islice((one for one in forks if len(one.outgoing) > 1), _NEAREST):
        branches = _branches(graph, fork, join)
        for node in _leaving(graph, join, branches):
            text = f"waits for all flows from {fork.display_name}, but a token may leave at {node.display_name}"
            yield process.finding("warning", f"{text}: then it waits forever", join)
        if branches:
            return


def _branches(graph: FlowGraph, fork: FlowNode, join: FlowNode) -> list[set[str]]:
    """The nodes of each branch from the fork to the join; empty unless all branches meet there and only there."""
    branches = [graph.reach([target], {fork.id, join.id}) for target in graph.following[fork.id]]
    sources = [graph.flows[flow].source for flow in join.incoming]
    entering = [sum(source in branch for source in sources) for branch in branches]
    direct = sources.count(fork.id)
    whole = len(branches) > 1 and sum(entering) + direct == len(sources)
    return branches if whole and entering.count(0) == direct and max(entering) == 1 else []


def _leaving(graph: FlowGraph, join: FlowNode, branches: list[set[str]]) -> Iterator[FlowNode]:
    """Nodes where a token may take a path that never leads to the join and does not affect the other branches."""
    choices = [graph.nodes[id] for branch in branches for id in branch if _chooses(graph, graph.nodes[id])]
    for node in sorted(choices, key=lambda one: (one.line, one.id)):
        ways = graph.following[node.id]
        past = [way for way in ways if way != join.id and not _meets(graph, way, join)]
        quiet = (way for way in past if not any(_acts(graph.nodes[id]) for id in graph.reach([way], set())))
        if len(past) < len(ways) and any(quiet):  # none of what is there affects the other branches
            yield node


def _meets(graph: FlowGraph, way: str, join: FlowNode) -> bool:
    """Whether a path leads from a node to the join."""
    near = graph.reach([way], {join.id})  # most ways do within a few steps: what is behind the join is not looked at
    return any(join.id in graph.following[id] for id in near)


def _chooses(graph: FlowGraph, node: FlowNode) -> bool:
    """Whether a token takes one of several paths."""
    if isinstance(node, Gateway):
        return node.kind != "parallel"
    ways = (graph.nodes[id] for id in graph.following[node.id])
    boundary = (way for way in ways if way.place == "boundary")
    return any(event.interrupting for event in boundary) or any(flow.condition for flow in graph.leaving(node))


def _acts(node: FlowNode) -> bool:
    """Whether it may affect other branches: an event with a result, a script that throws or publishes, a call."""
    if node.tag == "scriptTask":
        return node.script is not None and any(word in node.script.text for word in ("signal", "publish", "raise"))
    return isinstance(node, Activity) or (bool(node.definitions) and node.place in ("throw", "end"))


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
    return {node.attached_to for node in process.nodes() if node.place == "boundary" and node.interrupting}


def _may_be_ended(process: CheckedProcess) -> bool:
    """Whether another token, a handler or a boundary event may end a scope of the process."""
    guarded = _guarded(process)
    return any(
        ends_all(node) or node.triggered_by_event or (node.body is not None and node.id in guarded)
        for node in process.nodes()
    )


def _endless_loops(process: CheckedProcess, graph: FlowGraph) -> Iterator[Finding]:
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
        return len(node.incoming) < 2 and node.activation is None and passes_at_once(node)
    if node.body is not None:
        return node.tag != "adHocSubProcess" and all(_passes(each) for each in node.body.nodes)
    return passes_at_once(node)


# ---- recursion -------------------------------------------------------------------------------------------------------


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


def _endless(circle: set[CheckedProcess], passes: _Passes) -> set[CheckedProcess]:
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


def _meets_always(body: Body, calls: set[str], passes: _Passes) -> bool:
    """Whether every path through the body leads to one of the calls."""
    graph = graph_of(body)
    if any(node.triggered_by_event for node in body.nodes):
        return False
    guarded = {node.attached_to for node in body.nodes}
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
        return any(ways) if forks(graph, node) and not cut_short else all(ways)

    while more := {node.id for node in reversed(body.nodes) if node.id not in meeting and meets(node)}:
        meeting |= more
    return bool(body.nodes) and all(node.id in meeting for node in graph.beginnings())


def forks(graph: FlowGraph, node: FlowNode) -> bool:
    """Return whether a token takes all outgoing flows."""
    if isinstance(node, Gateway):
        return node.kind == "parallel"
    return all(flow.condition is None for flow in graph.leaving(node))
