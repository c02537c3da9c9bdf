"""Flows that meet in another way than they parted: joins that wait in vain, merges that let through too often."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from fame.bpmn.model import Activity, Event, FlowNode, Gateway, Task
from fame.check.findings import Finding
from fame.check.graph import Graph, graph
from fame.check.subject import Subject, Unit


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
    for fork in scope.body.nodes:
        if isinstance(fork, Gateway) and fork.kind == "parallel" and fork is not join:
            for node in _leaving(scope, join, _branches(scope, fork, join)):
                text = f"waits for all flows from {fork.label}, but a token may leave at {node.label}"
                yield unit.finding("warning", f"{text}: then it waits for ever", join)


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
    for branch in branches:
        for node in scope.body.nodes:
            ways = scope.following[node.id] if node.id in branch and _chooses(scope, node) else ()
            onward = [scope.reach([way], set()) for way in ways]
            past = [way for way in onward if join.id not in way]
            if len(past) < len(onward) and any(not any(_acts(scope.nodes[id]) for id in way) for way in past):
                yield node


def _chooses(scope: Graph, node: FlowNode) -> bool:
    """Whether a token takes one of several ways on."""
    if isinstance(node, Gateway):
        return node.kind != "parallel"
    boundary = (event for event in scope.body.nodes if isinstance(event, Event) and event.attached_to == node.id)
    return any(event.interrupting for event in boundary) or any(flow.condition for flow in scope.leaving(node))


def _acts(node: FlowNode) -> bool:
    """Whether it may end or tell what the other branches do: an event with a result, a script that says something."""
    if isinstance(node, Event):
        return bool(node.definitions) and node.place in ("throw", "end")
    if isinstance(node, Task) and node.kind == "script":
        return node.script is not None and any(word in node.script.text for word in ("signal", "publish", "raise"))
    return isinstance(node, Activity)
