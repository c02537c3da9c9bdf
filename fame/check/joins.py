"""Flows that meet in another way than they parted: joins that wait in vain, merges that let through too often."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import islice

from fame.bpmn.model import Activity, Event, FlowNode, Gateway, Task
from fame.check.findings import Finding
from fame.check.graph import Graph, graph
from fame.check.scope import Subject, Unit

_NEAREST = 10
"""Parallel gateways before a join that are tried as the one whose branches it joins."""


def join_findings(subject: Subject) -> Iterator[Finding]:
    """Of every node where flows meet."""
    for unit in subject.units:
        for scope in map(graph, unit.bodies()):
            for node in scope.body.nodes:
                if len(node.incoming) > 1:
                    yield from _meeting(unit, scope, node)
                    yield from _left_alone(unit, scope, node)


def _meeting(unit: Unit, scope: Graph, node: FlowNode) -> Iterator[Finding]:
    """Flows that a gateway took apart in one way, and that this node puts together in another."""
    joins = isinstance(node, Gateway) and node.kind == "parallel"
    merges = isinstance(node, Activity) or (isinstance(node, Gateway) and node.kind == "exclusive")
    origins = Counter(_origin(scope, node, flow) for flow in node.incoming)
    for origin, number in origins.items():
        gateway = scope.nodes[origin]
        if number < 2 or not isinstance(gateway, Gateway):
            continue
        if joins and gateway.kind in ("exclusive", "event"):
            text = f"waits for {number} flows from {gateway.label}, which takes only one: it may wait for ever"
            yield unit.finding("warning", text, node)
        elif merges and gateway.kind == "parallel":
            text = f"is reached {number} times from {gateway.label}, and what follows it as often"
            yield unit.finding("warning", f"{text}: a parallel gateway would wait for all", node)


def _origin(scope: Graph, node: FlowNode, flow: str) -> str:
    """Where a flow comes from, past elements in a row; the node itself if that goes round."""
    origin = scope.nodes[scope.flows[flow].source]
    seen = {node.id}
    while len(origin.incoming) == 1 and len(origin.outgoing) == 1 and origin.id not in seen:
        seen.add(origin.id)
        origin = scope.nodes[scope.flows[origin.incoming[0]].source]
    return origin.id


def _left_alone(unit: Unit, scope: Graph, join: FlowNode) -> Iterator[Finding]:
    """A parallel join of all branches of a parallel gateway, one of which a token may leave."""
    if not (isinstance(join, Gateway) and join.kind == "parallel"):
        return
    before = (scope.nodes[id] for id in scope.before(join.id))
    forks = (node for node in before if isinstance(node, Gateway) and node.kind == "parallel" and node is not join)
    for fork in islice((one for one in forks if len(one.outgoing) > 1), _NEAREST):
        branches = _branches(scope, fork, join)
        for node in _leaving(scope, join, branches):
            text = f"waits for all flows from {fork.label}, but a token may leave at {node.label}"
            yield unit.finding("warning", f"{text}: then it waits for ever", join)
        if branches:
            return


def _branches(scope: Graph, fork: FlowNode, join: FlowNode) -> list[set[str]]:
    """The nodes of each branch from the fork to the join; none if they do not meet there, and only there."""
    branches = [scope.reach([target], {fork.id, join.id}) for target in scope.following[fork.id]]
    sources = [scope.flows[flow].source for flow in join.incoming]
    entering = [sum(source in branch for source in sources) for branch in branches]
    direct = sources.count(fork.id)
    whole = len(branches) > 1 and sum(entering) + direct == len(sources)
    return branches if whole and entering.count(0) == direct and max(entering) == 1 else []


def _leaving(scope: Graph, join: FlowNode, branches: list[set[str]]) -> Iterator[FlowNode]:
    """Where a token of a branch may take a way from which it never gets to the join, and that ends nothing else."""
    choices = [scope.nodes[id] for branch in branches for id in branch if _chooses(scope, scope.nodes[id])]
    for node in sorted(choices, key=lambda one: (one.line, one.id)):
        ways = scope.following[node.id]
        past = [way for way in ways if way != join.id and not _meets(scope, way, join)]
        if len(past) < len(ways) and any(_is_quiet(scope, scope.reach([way], set())) for way in past):
            yield node


def _meets(scope: Graph, way: str, join: FlowNode) -> bool:
    """Whether a token may get from a node to the join."""
    near = scope.reach([way], {join.id})  # most ways do within a few steps: what is behind the join is not looked at
    return any(join.id in scope.following[id] for id in near)


def _is_quiet(scope: Graph, ids: set[str]) -> bool:
    """Whether nothing there may end or tell what the other branches do."""
    return not any(_acts(scope.nodes[id]) for id in ids)


def _chooses(scope: Graph, node: FlowNode) -> bool:
    """Whether a token takes one of several ways on."""
    if isinstance(node, Gateway):
        return node.kind != "parallel"
    ways = (scope.nodes[id] for id in scope.following[node.id])
    boundary = (way for way in ways if isinstance(way, Event) and way.place == "boundary")
    return any(event.interrupting for event in boundary) or any(flow.condition for flow in scope.leaving(node))


def _acts(node: FlowNode) -> bool:
    """Whether it does something to others: an event with a result, a script that says something, a call."""
    if isinstance(node, Event):
        return bool(node.definitions) and node.place in ("throw", "end")
    if isinstance(node, Task) and node.kind == "script":
        return node.script is not None and any(word in node.script.text for word in ("signal", "publish", "raise"))
    return isinstance(node, Activity)
