"""How far tokens can get, given the signals that are thrown: every token takes every path.

A catching event lets a token past once an element that is reached throws its topic. What is reached throws more, so the
walk is repeated until nothing is added (a least fixed point). Whatever is left out of account (conditions, data, how
often) only takes tokens further than they really get: what they do not reach here, they never reach.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

from fame.bpmn.model import Body, CallActivity, Event, FlowNode, MessageDefinition, SignalDefinition, SubProcess
from fame.bpmn.topics import topics_of
from fame.check.endpoints import Topics
from fame.check.graph import Graph, graph_of, is_event
from fame.check.scope import CheckedProcess
from fame.engine.structure import is_handler

Passes = Callable[[FlowNode], bool]
"""Whether a token may pass a node that waits for no topic."""


@dataclass(frozen=True, slots=True)
class Wait:
    """Where tokens of the process `root` wait for topics that nothing throws. `escape`: another path leads on."""

    root: CheckedProcess
    process: CheckedProcess
    node: FlowNode
    topics: frozenset[str]
    escape: bool


@dataclass(slots=True)
class Progress:
    """The reached elements, the thrown topics, and where tokens wait."""

    reached: set[tuple[CheckedProcess, str]] = field(default_factory=set)
    thrown: set[str] = field(default_factory=set)
    waits: list[Wait] = field(default_factory=list)


def progress(roots: Iterable[CheckedProcess], topics: Topics, passes: Passes = lambda node: True) -> Progress:
    """Find how far the tokens of processes that start by themselves can get.

    `topics` are those that are thrown by these processes alone; any other may come at any time.
    """
    roots = list(roots)
    throws: dict[tuple[CheckedProcess, str], set[str]] = defaultdict(set)
    for name, ends in topics.items():
        for end in ends:
            if end.throws:
                throws[end.process, end.node.id].add(name)
    thrown: set[str] = set()
    while True:
        found = Progress(thrown=set(thrown))
        for root in roots:
            _Walk(root, topics.keys(), throws, passes, frozenset(thrown), found).enter(root, root.bpmn.body)
        if found.thrown == thrown:
            return found
        thrown = found.thrown


@dataclass(slots=True)
class _Walk:
    """One walk through a process and all that it calls."""

    root: CheckedProcess
    topics: Iterable[str]
    throws: Mapping[tuple[CheckedProcess, str], set[str]]
    passes: Passes
    thrown: frozenset[str]
    found: Progress
    ended: dict[tuple[CheckedProcess, int], bool] = field(default_factory=dict)

    def enter(self, process: CheckedProcess, body: Body) -> bool:
        """Walk through a body. Returns whether a token may get to its end."""
        key = (process, id(body))
        if key in self.ended:
            return self.ended[key]
        self.ended[key] = False  # of a process that calls itself, until it is known
        graph = graph_of(body)
        pending = [*graph.beginnings(), *filter(is_handler, body.nodes)]
        seen: set[str] = set()
        while pending:
            node = pending.pop()
            if node.id not in seen:
                seen.add(node.id)
                ways = self._ways(process, graph, node)
                pending += ways
                if not ways and not is_handler(node) and self._goes_on(process, node):
                    self.ended[key] = True
        return self.ended[key]

    def _ways(self, process: CheckedProcess, graph: Graph, node: FlowNode) -> list[FlowNode]:
        """The nodes after a reached node."""
        self.found.reached.add((process, node.id))
        self.found.thrown |= self.throws.get((process, node.id), set())
        ways = [graph.nodes[id] for id in graph.following[node.id]]
        boundary = [way for way in ways if is_event(way, "boundary")]
        if self._goes_on(process, node):
            return ways
        waited = self._waited(node)
        if waited:
            choice = [graph.nodes[graph.flows[flow].source] for flow in node.incoming]
            escape = bool(boundary) or any(getattr(one, "kind", "") == "event" for one in choice)
            inside = is_event(node, "start") and graph.body is not self.root.bpmn.body
            escape |= inside or is_event(node, "boundary")
            self.found.waits.append(Wait(self.root, process, node, waited, escape))
        return boundary

    def _goes_on(self, process: CheckedProcess, node: FlowNode) -> bool:
        """Whether a token may pass a node."""
        waited = self._waited(node)
        if not self.passes(node) or (waited and not waited & self.thrown):
            return False
        if isinstance(node, SubProcess):
            return self.enter(process, node.body) or node.kind == "adhoc"
        if isinstance(node, CallActivity):
            callee = next((callee for call, callee in process.calls if call is node), None)
            return callee is None or self.enter(callee, callee.bpmn.body)
        return True

    def _waited(self, node: FlowNode) -> frozenset[str]:
        """The topics of which one must be thrown before a token passes; empty if the token may pass anyway."""
        names = frozenset(topic.qualified for topic, throws in topics_of(node) if not throws)
        others = isinstance(node, Event) and not all(
            isinstance(one, SignalDefinition | MessageDefinition) for one in node.definitions
        )
        return frozenset() if others or not names <= set(self.topics) else names
