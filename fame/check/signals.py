"""Checks of signals between processes: robots that wait for each other, signals that get lost.

Nothing is reported where a script computes the name of a topic, since it may throw any signal.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import partial

from fame.bpmn.model import Event, FlowNode, SubProcess, Task, TimerDefinition
from fame.bpmn.topics import topics_of
from fame.check.endpoints import TopicEndpoint, Topics, by_topic, level_of, public_topics
from fame.check.findings import Finding, Level
from fame.check.graph import Graph, graph_of, is_event, passes_at_once
from fame.check.reachability import Progress, Wait, progress
from fame.check.scope import CheckedProcess, CheckScope
from fame.errors import MessageError
from fame.iso8601 import parse_duration
from fame.middleware.interface import SIGNAL
from fame.middleware.qos import parse

# ---- robots that wait for each other, signals that are thrown too early ----------------------------------------------


_SAYS = re.compile(r"\b(?:signal|publish|createPublisher)\b")
_SAYS_LITERALLY = re.compile(
    r"""\bsignal\s*\(\s*["']|\bpublish\s*\(\s*["']|\bcreatePublisher\s*\(\s*["'`][\w/]+["'`]\s*,\s*["'`]"""
)
_AWAITS = re.compile(
    r"^(?:\w+\s*=\s*)?await\s+(?:receive|robot\.call|robot\.act|sleep\s*\(\s*0*\.?0*[1-9])", re.MULTILINE
)
"""A top-level statement of a script that takes time."""


def check_signal_order(scope: CheckScope) -> Iterator[Finding]:
    """Find robots that wait for each other and signals that are thrown too early."""
    processes = [process for one in scope.mission for process in one.processes]
    if not any(_may_throw_anything(node) for process in processes for node in process.bpmn.body.walk()):
        roots = [root for one in scope.mission for root in one.roots]
        public, level = public_topics(scope.mission), level_of(scope.mission)
        thrown = {name: ends for name, ends in public.items() if any(end.throws for end in ends)}
        found = (*_deadlocks(roots, thrown, level), *_too_early(roots, public, thrown, level))
        yield from (one for one in found if one.file in scope.files)


def _may_throw_anything(node: FlowNode) -> bool:
    text = node.script.text if isinstance(node, Task) and node.script is not None else ""
    return len(_SAYS.findall(text)) > len(_SAYS_LITERALLY.findall(text))


# ---- robots that wait for each other ---------------------------------------------------------------------------------


def _deadlocks(roots: Sequence[CheckedProcess], thrown: Topics, level: Level) -> Iterator[Finding]:
    found = progress(roots, thrown)
    for wait in found.waits:
        for name in sorted(wait.topics if not wait.escape else ()):
            causes = [cause for end in thrown[name] if end.throws for cause in _before(end, found)]
            if causes:
                yield wait.process.finding(level, f"waits for {name}, {_cause(wait, causes[0])}", wait.node)


def _before(end: TopicEndpoint, found: Progress) -> Iterator[Wait]:
    """Where the throwing process waits before it throws."""
    return (wait for wait in found.waits if end.process in wait.root.closure())


def _cause(wait: Wait, cause: Wait) -> str:
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
        kept = not catches or any(end.topic is None or end.topic.queue for end in catches)
        if not kept and all(
            _only_as_it_begins(roots, end) and _is_early(roots, public, end, catches) for end in throws
        ):
            text = f"throws {name} as the mission begins, before {catches[0].node.display_name} can wait for it"
            yield throws[0].finding(level, f"{text}: signals are not stored, so give the catching event a queue")


def _is_early(
    roots: Sequence[CheckedProcess], public: Topics, thrown: TopicEndpoint, catches: Sequence[TopicEndpoint]
) -> bool:
    """Whether no catching element can be reached at once, before a token is past the throw."""
    at_once = progress(roots, public, partial(_may_pass_before, thrown.node))
    return not any((end.process, end.node.id) in at_once.reached for end in catches)


def _only_as_it_begins(roots: Sequence[CheckedProcess], end: TopicEndpoint) -> bool:
    """Whether a process that starts by itself reaches the endpoint at once and never again."""
    graph = graph_of(end.process.bpmn.body)
    if end.process not in roots or end.node.id not in graph.nodes:
        return False
    before = [graph.nodes[id] for id in graph.before(end.node.id)]
    starts = [node for node in graph.body.nodes if is_event(node, "start")]
    return (
        passes_at_once(end.node)
        and end.node not in before
        and all(passes_at_once(node) and not isinstance(node, SubProcess) for node in before)
        and not any(isinstance(node, Event) and node.definitions for node in starts)
    )


def _may_pass_before(throw: FlowNode, node: FlowNode) -> bool:
    """Whether a token may pass a node at the moment of its arrival, before any token has passed the throw.

    What drivers say takes its time.
    """
    if node is throw or any(topic.qualified.startswith("~/") and not throws for topic, throws in topics_of(node)):
        return False
    if isinstance(node, Event):
        return not any(isinstance(one, TimerDefinition) and _lasts(one) for one in node.definitions)
    if isinstance(node, Task):
        text = node.script.text if node.script is not None and node.script.language == "python" else ""
        return node.kind not in ("user", "manual") and not _AWAITS.search(text)
    return True


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
    for name, ends in public_topics(scope.mission).items():
        yield from _throw_before_catch(scope, name, ends, level)
    for name, ends in by_topic(process for one in scope.mission for process in one.processes).items():
        yield from (one for one in _queues(name, ends) if one.file in scope.files)


def _throw_before_catch(scope: CheckScope, name: str, ends: Sequence[TopicEndpoint], level: Level) -> Iterator[Finding]:
    """A throw directly before the catch of the same signal, which nothing else throws."""
    throws = [end for end in ends if end.throws]
    if len(throws) != 1 or throws[0].process not in scope.processes or _has_twins(scope, throws[0].process):
        return
    for graph in map(graph_of, throws[0].process.bodies()):
        node = _next_wait(graph, throws[0].node) if throws[0].node.id in graph.nodes else None
        for end in ends:
            if end.node is node and end.process is throws[0].process and end.topic is not None and not end.topic.queue:
                only = throws[0].node.display_name
                text = f"waits for {name}, which only {only} throws, immediately before: signals are not stored"
                yield end.finding(level, f"{text}, so give the catching event a queue")


def _has_twins(scope: CheckScope, process: CheckedProcess) -> bool:
    """Whether several robots may run the process: those of a multi-instance pool, or its callers."""
    pools = [pool for pool in process.definitions.participants if pool.process == process.bpmn.id]
    return process not in scope.roots or any(pool.multi_instance for pool in pools)


def _next_wait(graph: Graph, node: FlowNode) -> FlowNode | None:
    """The next catching event or receive task after nodes that do not wait; None if there is none."""
    seen: set[str] = set()
    while node.id not in seen and len(graph.following[node.id]) == 1:
        seen.add(node.id)
        node = graph.nodes[graph.following[node.id][0]]
        if (isinstance(node, Event) and node.place == "catch") or (isinstance(node, Task) and node.kind == "receive"):
            return node
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
            yield end.finding("warning", f"{text}: set qos.depth={kept}, or messages may be lost")
