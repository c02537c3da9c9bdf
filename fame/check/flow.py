"""Where tokens get and where they do not: what is never reached, gateways without a way out.

Only what can be told from the picture alone. A condition may be false whenever it is asked, and a token may come twice,
so nothing here is an error.
"""

from __future__ import annotations

from collections.abc import Iterator

from fame.bpmn.model import Activity, Event, Expression, FlowNode, Gateway, SequenceFlow
from fame.check.coverage import cover_all
from fame.check.findings import Finding
from fame.check.graph import Graph, graph, is_event, link_of
from fame.check.scope import Subject, Unit
from fame.engine.structure import is_handler


def flow_findings(subject: Subject) -> Iterator[Finding]:
    """Of every scope of every process."""
    for unit in subject.units:
        for scope in map(graph, unit.bodies()):
            yield from _unreached(unit, scope)
            yield from _loose_ends(unit, scope)
            for node in scope.body.nodes:
                yield from _conditions(unit, scope, node)
                if isinstance(node, Gateway):
                    yield from _ways_out(unit, scope, node)


# ---- what is reached -------------------------------------------------------------------------------------------------


def _unreached(unit: Unit, scope: Graph) -> Iterator[Finding]:
    """The first node of each part that no token gets to."""
    reached: set[str] = set()
    scope.reach((node.id for node in scope.beginnings()), reached)
    apart = [node for node in scope.body.nodes if node.id not in reached and not is_handler(node)]
    entered = {id for node in apart for id in scope.following[node.id]}
    for node in sorted(apart, key=lambda one: one.id in entered):  # a circle of nodes has no first: any will do
        part = scope.reach([node.id], reached)
        if part:
            rest = f", nor what follows it ({len(part) - 1})" if len(part) > 1 else ""
            yield unit.finding("warning", f"is never reached{rest}: no flow leads here from a start", node)


def _loose_ends(unit: Unit, scope: Graph) -> Iterator[Finding]:
    """Where a scope has end events, all flows should lead to one (standard 10.5.3); elsewhere what is last ends it."""
    if not any(is_event(node, "end") for node in scope.body.nodes):
        return
    reached = scope.reach((node.id for node in scope.beginnings()), set())
    compensation = {id for association in scope.body.associations for id in association}
    left = {node.attached_to for node in scope.body.nodes if isinstance(node, Event) and node.interrupting}
    for node in scope.body.nodes:
        last = not node.outgoing and node.id in reached and node.id not in compensation | left
        if last and not (is_event(node, "end") or link_of(node) or is_handler(node) or isinstance(node, Gateway)):
            yield unit.finding("warning", "nothing follows it, though other flows lead to an end event", node)


# ---- gateways --------------------------------------------------------------------------------------------------------


def _conditions(unit: Unit, scope: Graph, node: FlowNode) -> Iterator[Finding]:
    """Conditions that nobody asks."""
    default = node.default if isinstance(node, Activity | Gateway) else ""
    blind = isinstance(node, Gateway) and node.kind in ("parallel", "event")
    for flow in scope.leaving(node):
        if flow.condition is not None and flow.id == default:
            yield unit.finding("warning", "is the default flow: its condition is never asked", flow)
        elif flow.condition is not None and _is_quoted(flow.condition):
            text = f"its condition is a text, always true: {flow.condition.text} without its quotes would be right"
            yield unit.finding("warning", text, flow)
        elif flow.condition is not None and blind:
            yield unit.finding("warning", f"its condition is never asked: {node.label} takes no conditions", flow)


def _is_quoted(condition: Expression) -> bool:
    """Whether all of it is one text in quotes, as people write who take the field for a string."""
    text = condition.text
    quoted = len(text) > 2 and text[0] == text[-1] and text[0] in "'\""
    return condition.language == "python" and quoted and text[0] not in text[1:-1]


def _ways_out(unit: Unit, scope: Graph, gateway: Gateway) -> Iterator[Finding]:
    flows = scope.leaving(gateway)
    if not flows and gateway.kind != "event":  # which the compiler refuses
        yield unit.finding("warning", "has no way out: the token ends here", gateway)
    elif flows and gateway.kind in ("exclusive", "inclusive"):
        conditions = [flow.condition for flow in flows if flow.condition is not None]
        if not gateway.default and len(conditions) == len(flows):
            if cover_all(conditions):
                return
            text = "has no way out if none of its conditions is true: mark one of its flows as the default"
            yield unit.finding("warning", text, gateway)
        elif len(flows) > 1:
            yield from _open_flows(unit, gateway, flows)


def _open_flows(unit: Unit, gateway: Gateway, flows: list[SequenceFlow]) -> Iterator[Finding]:
    """Flows of a choice that have no condition, and are not the default."""
    for flow in flows:
        if flow.condition is None and flow.id != gateway.default:
            text = f"has no condition, so {gateway.label} always takes it: give it one, or mark it as the default"
            yield unit.finding("warning", text, flow)
