"""Signals that get lost though somebody catches them: thrown just before, or more than the middleware keeps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from fame.bpmn.model import Event, FlowNode, Task
from fame.check.findings import Finding, Level
from fame.check.graph import Graph, graph
from fame.check.recursion import passes_at_once
from fame.check.scope import Subject, Unit
from fame.check.topics import End, level_of, public_topics, table
from fame.errors import MessageError
from fame.middleware.interface import SIGNAL
from fame.middleware.qos import parse


def delivery_findings(subject: Subject, team: Sequence[Subject]) -> Iterator[Finding]:
    """Of the topics of a file; `team`: all files of the mission, this one among them."""
    level = level_of(team)
    for name, ends in public_topics(team).items():
        yield from _one_after_the_other(subject, name, ends, level)
    for name, ends in table(unit for one in team for unit in one.units).items():
        yield from (one for one in _queues(name, ends) if one.file in {unit.home.file for unit in subject.units})


def _one_after_the_other(subject: Subject, name: str, ends: Sequence[End], level: Level) -> Iterator[Finding]:
    """A throw and then a catch of the same signal, which nobody else throws."""
    throws = [end for end in ends if end.throws]
    if len(throws) != 1 or throws[0].unit not in subject.units or _has_twins(subject, throws[0].unit):
        return
    for scope in map(graph, throws[0].unit.bodies()):
        node = _next_wait(scope, throws[0].node) if throws[0].node.id in scope.nodes else None
        for end in ends:
            if end.node is node and end.unit is throws[0].unit and end.topic is not None and not end.topic.queue:
                text = f"waits for {name}, which only {throws[0].node.label} throws, just before: a signal is not kept"
                yield end.finding(level, f"{text}, unless the catching event has a queue")


def _has_twins(subject: Subject, unit: Unit) -> bool:
    """Whether several robots may be at it: those of a multi-instance pool, or the callers of a process."""
    pools = [pool for pool in unit.home.participants if pool.process == unit.process.id]
    return unit not in subject.roots or any(pool.multi_instance for pool in pools)


def _next_wait(scope: Graph, node: FlowNode) -> FlowNode | None:
    """The catching event or receive task that a token comes to next, past what does not wait; None if there is none."""
    seen: set[str] = set()
    while node.id not in seen and len(scope.following[node.id]) == 1:
        seen.add(node.id)
        node = scope.nodes[scope.following[node.id][0]]
        if (isinstance(node, Event) and node.place == "catch") or (isinstance(node, Task) and node.kind == "receive"):
            return node
        if not passes_at_once(node):
            return None
    return None


def _queues(name: str, ends: Sequence[End]) -> Iterator[Finding]:
    """Catching events that keep more messages than the middleware does."""
    policies: dict[str, str] = {}
    for end in sorted(ends, key=lambda one: one.throws):  # where they differ, that of the throw holds
        policies |= end.topic.qos if end.topic is not None else {}
    try:
        profile = parse(policies, SIGNAL)
    except MessageError:  # which is told as an error
        return
    for end in ends:
        kept = end.topic.queue if end.topic is not None and not end.throws else 0
        if kept > profile.depth and profile.history != "keep_all":
            text = f"keeps up to {kept} messages of {name}, but its qos.depth is {profile.depth}"
            yield end.finding("warning", f"{text}: more of them at once get lost; qos.depth={kept} keeps them")
