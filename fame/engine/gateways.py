"""Exclusive, parallel, inclusive and complex gateways, compiled. Their steps: `branching` and `joins`."""

from __future__ import annotations

from functools import partial

from fame.bpmn import model
from fame.engine import branching, joins, steps
from fame.engine.branching import Branch
from fame.engine.joins import Port
from fame.engine.program import Node, Step
from fame.engine.scope_compiler import ScopeCompiler

_ARRIVALS: dict[str, Step] = {
    "parallel": joins.arrive,
    "inclusive": joins.arrive_inclusive,
    "complex": joins.arrive_complex,
}


def make(context: ScopeCompiler, gateway: model.Gateway) -> None:
    """A gateway; a join has a port for each flow that comes in."""
    spec = Branch()
    node = context.counted(context.node(gateway, steps.pass_on, spec=spec))
    context.place(gateway, node)
    context.leads[gateway.id] = partial(_lead_on, context, gateway, node)
    if gateway.kind in _ARRIVALS and len(gateway.incoming) > 1:
        spec.need = len(gateway.incoming)
        if gateway.kind == "complex":
            if gateway.activation is None:
                context.refuse("a complex gateway that joins needs an activation condition", gateway)
            spec.activation = context.expression(gateway.activation, gateway)
        for number, flow in enumerate(gateway.incoming):
            port = Port(node, number, spec.need)
            context.ports[flow] = context.node(gateway, _ARRIVALS[gateway.kind], f"/{number}", port)
    if gateway.kind in ("inclusive", "complex"):
        spec.masks = joins.masks(context.content, gateway)


def _lead_on(context: ScopeCompiler, gateway: model.Gateway, node: Node, flows: list[model.SequenceFlow]) -> None:
    """Link a gateway to what follows it."""
    spec: Branch = node.spec
    if not flows:
        node.next = context.node(gateway, steps.end, "/end")
    elif gateway.kind == "parallel":
        spec.targets, node.next = tuple(context.target(flow) for flow in flows), context.target(flows[0])
        node.step = branching.fork if len(flows) > 1 else steps.pass_on
    elif len(flows) == 1 and flows[0].condition is None:
        node.next = context.target(flows[0])
    else:
        node.step = branching.exclusive if gateway.kind == "exclusive" else branching.inclusive
        context.branch(spec, gateway, flows, gateway.default)
        if gateway.kind == "complex":
            asked = [flow for flow in flows if flow.id != gateway.default]
            spec.resets = tuple(way for way, flow in zip(spec.ways, asked, strict=True) if _asks_for_phase(flow))
            node.step = joins.part if spec.resets else node.step
    context.watch(node)


def _asks_for_phase(flow: model.SequenceFlow) -> bool:
    """Whether the condition of a flow that leaves a complex gateway distinguishes its activation from its reset."""
    return flow.condition is not None and "waitingForStart" in flow.condition.text
