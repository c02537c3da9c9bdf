"""A body as a graph: where tokens start, and where they can get from each node."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping

from fame.bpmn.model import Body, ErrorDefinition, FlowNode, LinkDefinition, SequenceFlow, TerminateDefinition
from fame.dataclasses import dataclass
from fame.engine.scope_compiler import begins, instantiates


@dataclass(frozen=True, slots=True)
class FlowGraph:
    """A body, its nodes and flows by id; `following`: node -> where its tokens may get to in one step; `preceding`: the
    other way round.

    By sequence flows, by links, from an activity to its boundary events, from those to compensation handlers.
    """

    body: Body
    nodes: Mapping[str, FlowNode]
    flows: Mapping[str, SequenceFlow]
    following: Mapping[str, list[str]]
    preceding: Mapping[str, list[str]]

    def leaving(self, node: FlowNode) -> list[SequenceFlow]:
        """Return the flows that leave a node, in document order."""
        return [self.flows[id] for id in node.outgoing]

    def beginnings(self) -> list[FlowNode]:
        """Where tokens start: at start events, else at all nodes without incoming flow (standard 13.2)."""
        return self.starts() or [node for node in self.body.nodes if begins(node)]

    def starts(self) -> list[FlowNode]:
        """Return its start events, and the gateways and receive tasks that start a process."""
        return [node for node in self.body.nodes if node.place == "start" or instantiates(node)]

    def reach(self, ids: Iterable[str], seen: set[str]) -> set[str]:
        """Return the nodes that tokens reach from some nodes (included), without those in `seen`, which is extended."""
        reached: set[str] = set()
        pending = list(ids)
        while pending:
            id = pending.pop()
            if id not in seen:
                seen.add(id)
                reached.add(id)
                pending += self.following[id]
        return reached

    def before(self, id: str) -> Iterator[str]:
        """Yield the nodes from which tokens reach a node, nearest first; includes the node itself
        if it is in a loop."""
        seen: set[str] = set()
        pending = deque(self.preceding[id])
        while pending:
            node = pending.popleft()
            if node not in seen:
                seen.add(node)
                yield node
                pending.extend(self.preceding[node])

    def circles(self) -> Iterator[list[FlowNode]]:
        """Yield the strongly connected components (Kosaraju's algorithm)."""
        order = list[str]()
        seen = set[str]()
        for node in self.body.nodes:
            pending = [(node.id, False)]
            while pending:
                id, left = pending.pop()
                if left:
                    order.append(id)
                elif id not in seen:
                    seen.add(id)
                    pending += [(id, True), *((other, False) for other in self.following[id])]
        place = {node.id: number for number, node in enumerate(self.body.nodes)}
        taken = set[str]()
        for id in reversed(order):
            pending_ids, circle = [id], list[str]()
            while pending_ids:
                other = pending_ids.pop()
                if other not in taken:
                    taken.add(other)
                    circle.append(other)
                    pending_ids += self.preceding[other]
            if len(circle) > 1 or (circle and id in self.following[id]):
                yield [self.nodes[one] for one in sorted(circle, key=place.__getitem__)]


def graph_of(body: Body) -> FlowGraph:
    following: dict[str, list[str]] = {node.id: [] for node in body.nodes}
    ending = {node.id for node in body.nodes if node.place == "end"}
    for flow in body.flows:
        if flow.source not in ending:  # where every token ends
            following[flow.source].append(flow.target)
    landings: dict[str, list[str]] = {}
    for node in body.nodes:
        if node.place == "catch":
            landings.setdefault(link_of(node), []).append(node.id)
    for node in body.nodes:
        if node.place == "boundary":
            following[node.attached_to].append(node.id)
        elif node.place == "throw" and link_of(node):
            following[node.id] += landings.get(link_of(node), ())
    for source, target in body.associations:
        following[source].append(target)
    preceding: dict[str, list[str]] = {node.id: [] for node in body.nodes}
    for source, targets in following.items():
        for target in targets:
            preceding[target].append(source)
    nodes, flows = {node.id: node for node in body.nodes}, {flow.id: flow for flow in body.flows}
    return FlowGraph(body, nodes, flows, following, preceding)


def link_of(node: FlowNode) -> str:
    """Return the name of a link event, else empty."""
    return next((one.name for one in node.defined(LinkDefinition)), "")


# ---- what a token does at a node -------------------------------------------------------------------------------------


def may_stop(graph: FlowGraph, node: FlowNode) -> bool:
    """Return whether a token may find no outgoing flow because all have conditions."""
    flows = graph.leaving(node)
    return bool(flows) and not node.default and all(flow.condition is not None for flow in flows)


def ends_all(node: FlowNode) -> bool:
    """Return whether it ends other tokens."""
    return bool(node.defined(TerminateDefinition) or node.defined(ErrorDefinition))


def _contains(node: FlowNode, *words: str) -> bool:
    """Whether its script contains one of the words."""
    return node.script is not None and any(word in node.script.text for word in words)


def passes_in_time(node: FlowNode) -> bool:
    """Return whether a token passes it sooner or later, and certainly without an error."""
    return not ends_all(node) and not _contains(node, "raise")


_WAITING = {
    "intermediateCatchEvent", "boundaryEvent", "eventBasedGateway", "callActivity", "userTask", "manualTask",
    "serviceTask", "receiveTask", "businessRuleTask",
}  # fmt: skip
"""Where a token waits for something outside of its process."""


def passes_at_once(node: FlowNode) -> bool:
    """Return whether a token certainly passes it without waiting."""
    waits = (node.tag in _WAITING and not link_of(node)) or _contains(node, "await", "next(")
    return not waits and passes_in_time(node)
