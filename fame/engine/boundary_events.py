"""Boundary events: what they wait for is in `triggers`, what they do to their activity in `handlers`."""

from __future__ import annotations

from fame.bpmn import model
from fame.engine import compensation, handlers, triggers
from fame.engine.engine_state import EngineState
from fame.engine.program import FaultCatch, Node
from fame.engine.scope_compiler import ScopeCompiler
from fame.engine.state import Wait


def fire(engine: EngineState, wait: Wait) -> None:
    """A boundary event has occurred."""
    handlers.take_boundary(engine, wait.scope, wait.node, wait.catch, wait.owner)


def make(context: ScopeCompiler, event: model.Event) -> None:
    """A boundary event: one node for each of its definitions, known to its activity once that is made."""
    if not event.definitions:
        context.refuse("a boundary event needs a trigger", event)
    if isinstance(event.definitions[0], model.CompensateDefinition):
        compensation.compensable(context, event)
        return
    nodes = triggers.triggers_of(context, event, fire)
    _check_cancels(context, event, nodes)
    slot = context.slot(event.id)
    for node in nodes:
        node.slot = slot
        context.watch_event(node)
    context.place(event, nodes[0], nodes)
    context.boundaries.setdefault(event.attached_to, []).extend(nodes)


def _check_cancels(context: ScopeCompiler, event: model.Event, nodes: list[Node]) -> None:
    """Refuse a cancel event at anything but a transaction."""
    host = context.model[event.attached_to]
    cancels = any(isinstance(node.spec, FaultCatch) and node.spec.kind == "cancel" for node in nodes)
    if cancels and getattr(host, "kind", "") != "transaction":
        context.refuse(f"expected a transaction for the cancel event, got {host.id}", event)
