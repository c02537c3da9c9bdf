"""A scope as a graph: where tokens begin, and where they may get to from each node."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from fame.bpmn.model import (
    Activity,
    Body,
    CallActivity,
    ErrorDefinition,
    Event,
    FlowNode,
    Gateway,
    LinkDefinition,
    SequenceFlow,
    Task,
    TerminateDefinition,
)
from fame.engine.structure import begins, instantiates


@dataclass(frozen=True, slots=True)
class Graph:
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
        """The flows that leave a node, in document order."""
        return [self.flows[id] for id in node.outgoing]

    def beginnings(self) -> list[FlowNode]:
        """Where tokens come from: start events and their like, else all that has no incoming flow (standard 13.2)."""
        return self.starts() or [node for node in self.body.nodes if begins(node)]

    def starts(self) -> list[FlowNode]:
        """Its start events, and the gateways and receive tasks that start a process."""
        return [node for node in self.body.nodes if is_event(node, "start") or instantiates(node)]

    def reach(self, ids: Iterable[str], seen: set[str]) -> set[str]:
        """What tokens get to from some nodes, these included, without what has been `seen`; that grows by it."""
        found: set[str] = set()
        pending = list(ids)
        while pending:
            id = pending.pop()
            if id not in seen:
                seen.add(id)
                found.add(id)
                pending += self.following[id]
        return found

    def before(self, id: str) -> Iterator[str]:
        """The nodes from which tokens get to a node, the nearest first; itself if it is one of them."""
        seen: set[str] = set()
        pending = deque(self.preceding[id])
        while pending:
            node = pending.popleft()
            if node not in seen:
                seen.add(node)
                yield node
                pending.extend(self.preceding[node])

    def circles(self) -> Iterator[list[FlowNode]]:
        """The sets of nodes from each of which tokens may get to all of the set (Kosaraju's algorithm)."""
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


def graph_of(body: Body) -> Graph:
    """The graph of one scope."""
    following: dict[str, list[str]] = {node.id: [] for node in body.nodes}
    ending = {node.id for node in body.nodes if is_event(node, "end")}
    for flow in body.flows:
        if flow.source not in ending:  # where every token ends
            following[flow.source].append(flow.target)
    landings: dict[str, list[str]] = {}
    for node in body.nodes:
        if is_event(node, "catch"):
            landings.setdefault(link_of(node), []).append(node.id)
    for node in body.nodes:
        if isinstance(node, Event) and node.place == "boundary":
            following[node.attached_to].append(node.id)
        elif is_event(node, "throw") and link_of(node):
            following[node.id] += landings.get(link_of(node), ())
    for source, target in body.associations:
        following[source].append(target)
    preceding: dict[str, list[str]] = {node.id: [] for node in body.nodes}
    for source, targets in following.items():
        for target in targets:
            preceding[target].append(source)
    nodes, flows = {node.id: node for node in body.nodes}, {flow.id: flow for flow in body.flows}
    return Graph(body, nodes, flows, following, preceding)


def is_event(node: FlowNode, place: str) -> bool:
    """Whether it is an event in this place."""
    return isinstance(node, Event) and node.place == place


def link_of(node: FlowNode) -> str:
    """The name of the link of a link event, else nothing."""
    links = [one.name for one in node.definitions if isinstance(one, LinkDefinition)] if isinstance(node, Event) else []
    return links[0] if links else ""


# ---- what a token does at a node -------------------------------------------------------------------------------------


def may_stop(graph: Graph, node: FlowNode) -> bool:
    """Whether a token finds no way out where no condition is true."""
    default = node.default if isinstance(node, Activity | Gateway) else ""
    flows = graph.leaving(node)
    return bool(flows) and not default and all(flow.condition is not None for flow in flows)


def ends_all(node: FlowNode) -> bool:
    """Whether it ends what other tokens do."""
    ends = TerminateDefinition | ErrorDefinition
    return isinstance(node, Event) and any(isinstance(one, ends) for one in node.definitions)


def _says(node: FlowNode, *words: str) -> bool:
    """Whether one of the words stands in its script."""
    return isinstance(node, Task) and node.script is not None and any(word in node.script.text for word in words)


def passes_in_time(node: FlowNode) -> bool:
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
    return not waits and passes_in_time(node)
