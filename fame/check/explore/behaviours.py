"""Which called processes are explored as one step.

A step ends at some time, later than all that others do in the same instant, and nobody outside notices its inside. So
what is called is no step if it touches a topic of the team, throws an escalation, may wait for what never comes (other
branches at a join, a condition), or may end or fail without having waited. Where that is not certain it is explored
whole, which costs states.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Set

from fame.bpmn import model
from fame.bpmn.library import Library, calls_of
from fame.check.explore.graph import reachable
from fame.check.explore.team_facts import ends_of
from fame.scripting.effects import script_effects

_WAITING = ("user", "manual", "receive", "service")


def is_step(library: Library, home: model.Definitions, process: model.Process, shared: Set[str]) -> bool:
    """Return whether a called process is a step. Raises ModelError for calls of unknown processes.

    shared  the topics between robots of the team, or from one to itself
    """
    inside = library.closure(home, process)
    if any(_is_open(one) or any(topic in shared for topic, _ in ends_of(one)) for _, one in inside):
        return False
    calls = {call.id: library.find(file, call)[1].id for file, one in inside for call in calls_of(one)}
    passed, before = set[str](), -1  # calls of what may end at once
    while len(passed) > before:
        before, at_once = len(passed), {one.id for _, one in inside if _may_end_at_once(one.body, passed)}
        passed = {call for call, callee in calls.items() if callee in at_once}
    return not _may_end_at_once(process.body, passed)


def _is_open(process: model.Process) -> bool:
    """Whether it throws or catches an escalation, or a token may wait in it for other tokens or for a condition.

    An inclusive join goes on when no other token can come.
    """
    incoming = Counter(flow.target for body in process.body.bodies() for flow in body.flows)
    return any(
        node.defined(model.ConditionalDefinition) or node.defined(model.EscalationDefinition)
        or (isinstance(node, model.Gateway) and node.kind in ("parallel", "complex") and incoming[node.id] > 1)
        for node in process.body.walk()
    )  # fmt: skip


def _may_end_at_once(body: model.Body, calls: Set[str]) -> bool:
    """Whether a token may get to an end of a body, or raise an error, without passing what takes time.

    calls  those that a token may pass at once
    """
    nodes, left = {node.id: node for node in body.nodes}, {flow.source for flow in body.flows}
    passed = {id for id, node in nodes.items() if not _takes_time(node, calls)}
    flows = [flow for flow in body.flows if flow.source in passed]
    later = {flow.target for flow in body.flows}
    later |= {node.id for node in body.nodes if node.attached_to or node.triggered_by_event}
    entered = reachable(nodes.keys() - later, lambda id: [flow.target for flow in flows if flow.source == id])
    return any(_raises(nodes[id]) for id in entered) or bool(entered & passed - left)


def _raises(node: model.FlowNode) -> bool:
    """Whether an element may raise an error, on purpose and at once."""
    effects = script_effects(node)
    raises = effects.fails or effects.computes_code or bool(effects.codes)
    return (raises and not _waits(node)) or (node.place == "end" and bool(node.defined(model.ErrorDefinition)))


def _waits(node: model.FlowNode) -> bool:
    """Whether a script takes time. One in JavaScript may call ``next`` later, of which nothing is known: it counts."""
    return script_effects(node).waits or (node.script is not None and node.script.language == "javascript")


def _takes_time(node: model.FlowNode, calls: Set[str]) -> bool:
    """Whether a token never leaves an element in the instant in which it enters it; what is repeated may be nothing."""
    if isinstance(node.loop, model.MultiInstance) or (node.loop is not None and node.loop.test_before):
        return False
    match node:
        case model.SubProcess():
            return not _may_end_at_once(node.body, calls)
        case model.CallActivity():
            return node.id not in calls
        case model.Task():
            return node.kind in _WAITING or bool(node.operation) or _waits(node)
        case model.Gateway():
            return node.kind == "event"
    return node.place == "catch"
