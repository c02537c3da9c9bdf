"""Checks of signals between processes: robots that wait for each other, signals that get lost.

Nothing is reported of a topic that a script may throw, too, by a name that it computes.

`progress` finds how far tokens can get, given the signals that are thrown: every token takes every path. A catching
event lets a token past once an element that is reached throws its topic. What is reached throws more, so the walk is
repeated until nothing is added (a least fixed point). Conditions, data and counts are ignored, which only takes tokens
further than they really get: what they do not reach here, they never reach.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial

from fame.bpmn.model import Body, FlowNode, MessageDefinition, TimerDefinition
from fame.check.endpoints import TopicEndpoint, Topics, by_topic, level_of, public_topics
from fame.check.events import executed
from fame.check.graph import FlowGraph, graph_of, passes_at_once
from fame.check.scope import CheckedProcess, CheckScope, Finding, Fix, Level
from fame.dataclasses import dataclass, field
from fame.errors import MessageError
from fame.iso8601 import parse_duration
from fame.middleware.interface import SIGNAL
from fame.middleware.qos import parse
from fame.scripting.effects import computed_topics, script_effects

_AWAITS = re.compile(
    r"^(?:\w+\s*=\s*)?await\s+(?:receive|robot\.call|robot\.act|sleep\s*\(\s*0*\.?0*[1-9])", re.MULTILINE
)
"""A top-level statement of a script that takes time."""

Passes = Callable[[FlowNode], bool]
"""Whether a token may pass a node that waits for no topic."""


# ---- how far tokens get ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class TopicWait:
    """Where tokens of the process `root` wait for topics that nothing throws. `escape`: another path leads on."""

    root: CheckedProcess
    process: CheckedProcess
    node: FlowNode
    topics: frozenset[str]
    escape: bool


@dataclass(slots=True)
class Reach:
    """The reached elements, the thrown topics, and where tokens wait."""

    reached: set[tuple[CheckedProcess, str]] = field(default_factory=set)
    thrown: set[str] = field(default_factory=set)
    waits: list[TopicWait] = field(default_factory=list)


def progress(roots: Iterable[CheckedProcess], topics: Topics, passes: Passes = lambda node: True) -> Reach:
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
        reach = Reach(thrown=set(thrown))
        for root in roots:
            _Walk(root, topics.keys(), throws, passes, frozenset(thrown), reach).walk()
        if reach.thrown == thrown:
            return reach
        thrown = reach.thrown


_Place = tuple[CheckedProcess, FlowGraph, FlowNode]


@dataclass(slots=True)
class _Walk:
    """One walk through a process and all processes that it calls, without recursion.

    pending  reached nodes, and whether a token passes them
    inside   bodies that were entered, and the nodes that tokens pass at their end; those that `ended`
    """

    root: CheckedProcess
    topics: Iterable[str]
    throws: Mapping[tuple[CheckedProcess, str], set[str]]
    passes: Passes
    thrown: frozenset[str]
    found: Reach
    pending: list[tuple[_Place, bool]] = field(default_factory=list)
    seen: set[tuple[CheckedProcess, int, str]] = field(default_factory=set)
    inside: dict[tuple[CheckedProcess, int], list[_Place]] = field(default_factory=dict)
    ended: set[tuple[CheckedProcess, int]] = field(default_factory=set)

    def walk(self) -> None:
        """Follow the tokens from the start of the process."""
        self._enter(self.root, self.root.bpmn.body)
        while self.pending:
            place, passes = self.pending.pop()
            process, graph, node = place
            key = process, id(graph.body), node.id
            if passes:
                self._pass(place)
            elif key not in self.seen:
                self.seen.add(key)
                self._reach(place)

    def _enter(self, process: CheckedProcess, body: Body) -> None:
        """Go to where tokens start in a body, once."""
        if (process, id(body)) not in self.inside:
            self.inside[process, id(body)] = []
            graph = graph_of(body)
            self._go(process, graph, [*graph.beginnings(), *(node for node in body.nodes if node.triggered_by_event)])

    def _go(self, process: CheckedProcess, graph: FlowGraph, nodes: Iterable[FlowNode]) -> None:
        self.pending += [((process, graph, node), False) for node in nodes]

    def _pass(self, place: _Place) -> None:
        """Go to the nodes after one; without such nodes, a token is at the end of the body."""
        process, graph, node = place
        ways = [graph.nodes[id] for id in graph.following[node.id]]
        self._go(process, graph, ways)
        key = process, id(graph.body)
        if not ways and not node.triggered_by_event and key not in self.ended:
            self.ended.add(key)
            self.pending += [(outer, True) for outer in self.inside[key]]

    def _reach(self, place: _Place) -> None:
        """Go as far as a token gets from a node."""
        process, graph, node = place
        self.found.reached.add((process, node.id))
        self.found.thrown |= self.throws.get((process, node.id), set())
        boundary = [way for way in map(graph.nodes.__getitem__, graph.following[node.id]) if way.place == "boundary"]
        waited = self._waited(node)
        if not self.passes(node) or (waited and not waited & self.thrown):
            self._go(process, graph, boundary)
            if waited:
                choice = [graph.nodes[graph.flows[flow].source] for flow in node.incoming]
                escape = bool(boundary) or any(one.tag == "eventBasedGateway" for one in choice)
                inside = node.place == "start" and graph.body is not self.root.bpmn.body
                escape |= inside or node.place == "boundary"
                self.found.waits.append(TopicWait(self.root, process, node, waited, escape))
            return
        inner = _inside(process, node)
        if inner is not None:
            callee, body = inner
            self._go(process, graph, boundary)
            self._enter(callee, body)
            self.inside[callee, id(body)].append(place)
        if inner is None or (callee, id(body)) in self.ended or node.tag == "adHocSubProcess":
            self.pending.append((place, True))

    def _waited(self, node: FlowNode) -> frozenset[str]:
        """The topics of which one must be thrown before a token passes; empty if the token may pass anyway."""
        names = frozenset(topic.qualified for topic, throws in node.topics() if not throws)
        others = len(node.definitions) > len(list(node.topics()))
        return frozenset() if others or not names <= set(self.topics) else names


def _inside(process: CheckedProcess, node: FlowNode) -> tuple[CheckedProcess, Body] | None:
    """The body that a token enters at a node, and its process; None if the node has none, or it is not known."""
    if node.body is not None:
        return process, node.body
    callee = process.called_by(node)
    return None if callee is None else (callee, callee.bpmn.body)


# ---- robots that wait for each other ---------------------------------------------------------------------------------


def check_signal_order(scope: CheckScope) -> Iterator[Finding]:
    """Find robots that wait for each other and signals that are thrown too early."""
    roots = [root for one in scope.mission for root in one.roots]
    public, level = _known(scope), level_of(scope.mission)
    thrown = {name: ends for name, ends in public.items() if any(end.throws for end in ends)}
    taken = computed_topics(_nodes(scope), "subscribe")
    awaited = {name: ends for name, ends in thrown.items() if not name.startswith(taken)}
    findings = (*_deadlocks(roots, thrown, level), *_too_early(roots, public, awaited, level))
    yield from (one for one in findings if one.file in scope.files)


def _known(scope: CheckScope) -> Topics:
    """The topics on which nothing throws but what is known: no script that computes their names, no scenario."""
    computed = computed_topics(_nodes(scope), "publish")
    topics = public_topics(scope.mission).items()
    return {name: ends for name, ends in topics if name not in scope.outside and not name.startswith(computed)}


def _nodes(scope: CheckScope) -> Iterator[FlowNode]:
    return (node for one in scope.mission for process in one.processes for node in process.nodes())


def _deadlocks(roots: Sequence[CheckedProcess], thrown: Topics, level: Level) -> Iterator[Finding]:
    reach = progress(roots, thrown)
    for wait in reach.waits:
        for name in sorted(wait.topics if not wait.escape else ()):
            throwing = [end.process for end in thrown[name] if end.throws]
            causes = [one for process in throwing for one in reach.waits if process in one.root.closure()]
            if causes:  # the throwing process waits before it throws
                yield wait.process.finding(level, f"waits for {name}, {_cause(wait, causes[0])}", wait.node)


def _cause(wait: TopicWait, cause: TopicWait) -> str:
    if cause.root is wait.root:
        return f"which only {_label(wait.root)} itself throws, later: it waits forever"
    other = ", ".join(sorted(cause.topics))
    return f"but {_label(cause.root)}, which throws it, waits for {other} first: they wait for each other"


def _label(process: CheckedProcess) -> str:
    """The name of a process as people know it: that of its pool, else its own."""
    pool = next((pool for pool in process.definitions.participants if pool.process == process.bpmn.id), None)
    return (pool or process.bpmn).label


# ---- signals that are thrown too early -------------------------------------------------------------------------------


def _too_early(roots: Sequence[CheckedProcess], public: Topics, thrown: Topics, level: Level) -> Iterator[Finding]:
    """Signals that are thrown only as the mission begins, before any catching event can be reached."""
    for name, ends in thrown.items():
        throws, catches = [end for end in ends if end.throws], [end for end in ends if not end.throws]
        drawn = [end for end in catches if end.topic is not None]
        if not catches or len(drawn) < len(catches) or not all(_only_as_it_begins(roots, end) for end in throws):
            continue
        at_once = [progress(roots, public, partial(_may_pass_before, end.node)) for end in throws]
        reached = any((end.process, end.node.id) in reach.reached for end in catches for reach in at_once)
        entered = [end for end in drawn if any(_is_entered(end, reach) for reach in at_once)]
        if not reached and not any(end.topic.queue for end in entered if end.topic is not None):
            text = f"throws {name} as the mission begins, before {catches[0].node.display_name} can wait for it"
            advice = _GIVE_A_QUEUE if entered else _SAY_IT_AGAIN
            same = entered and entered[0].process.file == throws[0].process.file
            yield throws[0].finding(level, f"{text}: {advice}", _queue(entered[0]) if same else None)


_GIVE_A_QUEUE = "signals are not stored, so give the catching event a queue"
_SAY_IT_AGAIN = "signals are not stored, and a queue there begins too late: throw it later, or until it is acknowledged"


def _is_entered(end: TopicEndpoint, at_once: Reach) -> bool:
    """Whether the scope of an element, of a boundary event its activity, is entered: from then on a queue keeps."""
    if end.node.attached_to:
        return (end.process, end.node.attached_to) in at_once.reached
    body = next(body for body in end.process.bodies() if end.node in body.nodes)
    return any((end.process, node.id) in at_once.reached for node in body.nodes)


def _only_as_it_begins(roots: Sequence[CheckedProcess], end: TopicEndpoint) -> bool:
    """Whether a process that starts by itself reaches the endpoint at once and never again."""
    graph = graph_of(end.process.bpmn.body)
    if end.process not in roots or end.node.id not in graph.nodes:
        return False
    before = [graph.nodes[id] for id in graph.before(end.node.id)]
    starts = graph.body.events("start")
    return (
        passes_at_once(end.node)
        and end.node not in before
        and all(passes_at_once(node) and node.body is None for node in before)
        and not any(node.definitions for node in starts)
    )


def _may_pass_before(throw: FlowNode, node: FlowNode) -> bool:
    """Whether a token may pass a node at the moment of its arrival, before any token has passed the throw.

    What drivers say takes its time.
    """
    if node is throw or any(topic.qualified.startswith("~/") and not throws for topic, throws in node.topics()):
        return False
    text = node.script.text if node.script is not None and node.script.language == "python" else ""
    waits = node.tag in ("userTask", "manualTask") or _AWAITS.search(text)
    return not waits and not any(map(_lasts, node.defined(TimerDefinition)))


def _lasts(timer: TimerDefinition) -> bool:
    """Whether the duration of a timer is certainly not zero."""
    try:
        text = timer.expression.text if timer.expression is not None else "PT0S"
        return timer.kind == "duration" and parse_duration(text) != parse_duration("PT0S")
    except ValueError:
        return False


# ---- signals that get lost -------------------------------------------------------------------------------------------


def check_signal_delivery(scope: CheckScope) -> Iterator[Finding]:
    """Find signals that are lost although an element catches them."""
    level = level_of(scope.mission)
    for name, ends in _known(scope).items():
        yield from _throw_before_catch(scope, name, ends, level)
    for name, ends in by_topic(process for one in scope.mission for process in one.processes).items():
        yield from (one for one in _queues(name, ends) if one.file in scope.files)
    for process in scope.processes:
        for graph in map(graph_of, process.bodies()):
            yield from _passed_twice(process, graph)


def _throw_before_catch(scope: CheckScope, name: str, ends: Sequence[TopicEndpoint], level: Level) -> Iterator[Finding]:
    """A throw directly before the catch of the same signal, which nothing else throws."""
    throws = [end for end in ends if end.throws]
    if len(throws) != 1 or throws[0].process not in scope.processes or _has_twins(scope, throws[0].process):
        return
    called = [callee for process in scope.processes for _, callee in process.calls]
    for graph in map(graph_of, throws[0].process.bodies()):
        here = throws[0].process if throws[0].node.id in graph.nodes else None
        wait = _next_wait(here, graph, throws[0].node, set()) if here is not None else None
        for end in ends:
            inside = end.process is not here or end.node.id not in graph.nodes  # its scope is entered after the throw
            if wait == (end.process, end.node) and end.topic is not None and (inside or not end.topic.queue):
                if end.process is not here and called.count(end.process) > 1:
                    continue  # where another one calls it, it may be in time
                only = throws[0].node.display_name
                text = f"waits for {name}, which only {only} throws, immediately before"
                advice = _SAY_IT_AGAIN if inside else _GIVE_A_QUEUE
                yield end.finding(level, f"{text}: {advice}", None if inside else _queue(end))


def _queue(end: TopicEndpoint) -> Fix:
    return Fix(f"add queue = 1 to {end.node.label}", end.node.id, "property", "1", "queue")


def _has_twins(scope: CheckScope, process: CheckedProcess) -> bool:
    """Whether several robots may run the process: those of a multi-instance pool, or its callers."""
    pools = [pool for pool in process.definitions.participants if pool.process == process.bpmn.id]
    return process not in scope.roots or any(pool.multi_instance for pool in pools)


def _next_wait(
    process: CheckedProcess, graph: FlowGraph, node: FlowNode, seen: set[tuple[str, str]]
) -> tuple[CheckedProcess, FlowNode] | None:
    """Return the next catching event or receive task after nodes that do not wait, also in an activity, and its
    process; or None."""
    while (process.file, node.id) not in seen and len(graph.following[node.id]) == 1:
        seen.add((process.file, node.id))
        node = graph.nodes[graph.following[node.id][0]]
        if node.tag in ("intermediateCatchEvent", "receiveTask"):
            return process, node
        inner = _inside(process, node) if len(graph.following[node.id]) < 2 else None
        starts = inner[1].events("start") if inner is not None else []
        found = _next_wait(inner[0], graph_of(inner[1]), starts[0], seen) if inner and len(starts) == 1 else None
        if found is not None:
            return found
        if not passes_at_once(node):
            return None
    return None


def _queues(name: str, ends: Sequence[TopicEndpoint]) -> Iterator[Finding]:
    """Catching events whose queue is longer than that of the middleware."""
    policies: dict[str, str] = {}
    for end in sorted(ends, key=lambda one: one.throws):  # where they differ, that of the throw holds
        policies |= end.topic.qos if end.topic is not None else {}
    try:
        profile = parse(policies, SIGNAL)
    except MessageError:  # reported as an error
        return
    for end in ends:
        kept = end.topic.queue if end.topic is not None and not end.throws else 0
        if kept > profile.depth and profile.history != "keep_all":
            text = f"queues up to {kept} messages of {name}, but its qos.depth is {profile.depth}"
            fix = Fix(f"set qos.depth = {kept}", end.node.id, "property", str(kept), "qos.depth")
            yield end.finding("warning", f"{text}: set qos.depth={kept}, or messages may be lost", fix)


def _passed_twice(process: CheckedProcess, graph: FlowGraph) -> Iterator[Finding]:
    """Catching events whose queue keeps a signal that is caught before: by an event or a script, also inside of an
    activity, in what it calls, or while it runs."""
    reported: set[tuple[str, str]] = set()
    events = [one for one in graph.body.nodes if one.place == "boundary" and not one.interrupting]
    starting = {id for node in graph.starts() for id in (node.id, *graph.following[node.id]) if node.instantiate}
    for node in (one for one in graph.body.nodes if one.id not in starting):  # an instance keeps not what starts it
        beside = [one for one in events if one.attached_to == node.id]
        inside = [one for _, one in executed(process, node, set())]
        handlers = (
            start for one in inside if one.triggered_by_event and one.body for start in one.body.events("start")
        )
        catchers = [one for one in (*beside, *inside) if one.place in ("catch", "boundary", "") and not one.body]
        caught = {name: one for one in (*handlers, *catchers) for name in (*_kept(one), *script_effects(one).awaits)}
        for id in graph.reach(graph.following[node.id], {node.id}) if caught else ():
            later = graph.nodes[id]
            kept = [name for name, queue in _kept(later).items() if queue and name in caught
                    and not (_takes_messages(later) and _takes_messages(caught[name]))]  # fmt: skip
            if (
                kept and later.place in ("catch", "") and (id, node.id) not in reported
            ):  # in a loop each before the other
                reported.add((node.id, id))
                text = f"keeps the {kept[0]} that {caught[kept[0]].display_name} catches, too: one signal passes both"
                yield process.finding("warning", f"its queue {text}", later)


def _kept(node: FlowNode) -> dict[str, int]:
    """The topics that an element catches, each with its queue."""
    return {topic.qualified: topic.queue for topic, throws in node.topics() if not throws}


def _takes_messages(node: FlowNode) -> bool:
    """Whether an element catches messages: each is for one of them."""
    return node.tag == "receiveTask" or bool(node.defined(MessageDefinition))
