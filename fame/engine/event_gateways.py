"""Event-based gateways and multiple events: the first of several events wins (standard 13.4.4)."""

from __future__ import annotations

from functools import partial

from fame.bpmn import model
from fame.dataclasses import dataclass
from fame.engine import scopes, steps, triggers, waiting
from fame.engine.engine_state import EngineState
from fame.engine.program import Node, Start
from fame.engine.scope_compiler import ScopeCompiler
from fame.engine.state import Scope, Wait
from fame.engine.steps import Branch, fork


@dataclass(slots=True)
class Alternative:
    """Spec of one of several alternative events. `via`: the sequence flow to it, of an event-based gateway."""

    via: str = ""


# ---- steps ---------------------------------------------------------------------------------------


def choose(engine: EngineState, scope: Scope, node: Node) -> None:
    """Wait for the first of several events; the oldest queued message wins at once."""
    wait = waiting.wait_at(engine, node, scope)
    if not wait.alive:
        return
    alternatives = tuple(Wait(engine.new_key(), part, scope, False, wait) for part in wait.catch.parts)
    wait.arms += alternatives
    for act in (waiting.take_kept, waiting.arm):
        for alternative in alternatives:
            if alternative.alive:
                act(engine, alternative)


def fire_alternative(engine: EngineState, wait: Wait) -> None:
    """Continue at the alternative that occurred; disarm the others."""
    gateway, node = wait.owner, wait.node
    assert isinstance(gateway, Wait)
    waiting.withdraw(engine, gateway)
    if gateway.node is not node.part_of:  # the alternative of a multiple event is the event itself
        scopes.count(engine, wait.scope, gateway.node)
        if node.plain_step is not None:
            engine.notify(wait.scope, (node.spec.via, "take", None))
            engine.notify(wait.scope, node.entered)
    scopes.complete(engine, wait.scope, node)


# ---- compiling -----------------------------------------------------------------------------------


def multiple(context: ScopeCompiler, event: model.Event) -> None:
    """Make an intermediate catching event with several definitions."""
    choice = context.node(event, choose)
    choice.slot, choice.catch = context.slot(event.id), triggers.catching()
    parts = _alternatives(context, event, choice, choice.slot)
    choice.catch.parts = tuple(parts)
    context.watch(choice)
    triggers.keep_queue(context, choice)
    context.place(event, choice, parts)


def make(context: ScopeCompiler, gateway: model.Gateway) -> None:
    node = context.node(gateway, choose)
    node.slot, node.catch = context.slot(gateway.id), triggers.catching()
    context.watch(node)
    context.place(gateway, node)
    context.leads[gateway.id] = lambda flows: context.when_linked.append(
        partial(_link_alternatives, context, gateway, node)
    )


def _alternatives(context: ScopeCompiler, event: model.Event, owner: Node, slot: int) -> list[Node]:
    nodes = []
    for number, definition in enumerate(event.definitions):
        catch = triggers.part_of_event(fire_alternative)
        node = triggers.trigger(context, event, definition, catch, f"/{number}@{owner.id}")
        if node.catch is None:
            context.refuse(f"an intermediate event cannot catch an {node.spec.kind}; use a boundary event", event)
        node.slot, node.part_of, node.spec = slot, owner, Alternative()
        context.watch_event(node)
        nodes.append(node)
    return nodes


def _link_alternatives(context: ScopeCompiler, gateway: model.Gateway, node: Node) -> None:
    """Make the alternatives of an event-based gateway: the events and receive tasks that it leads to."""
    alternatives: list[Node] = []
    for id in gateway.outgoing:
        target = context.model[context.flows[id].target]
        main = context.main[target.id]
        if isinstance(target, model.Event) and target.place == "catch" and target.definitions:
            choices = _alternatives(context, target, node, main.slot)
        elif isinstance(target, model.Task) and target.kind == "receive" and target.topic is not None:
            choices = [_receive(context, target, target.topic, gateway, main.slot)]
        else:
            context.refuse(f"leads to {target.id}: expected a catching event or a receive task", gateway)
        for choice in choices:
            choice.spec, choice.part_of = Alternative(id), main
            context.watch_event(choice)
            if choice.catch is not None:
                choice.catch.home = triggers.queue_of(context, choice, choice.catch)
            choice.next = main.next or (main.catch.parts[0].next if main.catch is not None else None)
        alternatives.extend(choices)
    if not alternatives:
        context.refuse("has no event to wait for", gateway)
    assert node.catch is not None
    node.catch.parts = tuple(alternatives)


def _receive(context: ScopeCompiler, task: model.Task, topic: model.Topic, gateway: model.Gateway, slot: int) -> Node:
    """Make a receive task that follows an event-based gateway."""
    if task.loop is not None:
        context.refuse("a receive task after an event-based gateway must not repeat", task)
    choice = context.node(task, triggers.wait, f"@{gateway.id}")
    choice.slot, choice.catch = slot, triggers.part_of_event(fire_alternative, waiting.MESSAGE)
    choice.catch.keys = context.assignments(task.keys, task)
    triggers.listen(context, task, choice.catch, topic)
    return choice


def instantiating(context: ScopeCompiler, gateway: model.Gateway) -> list[Node]:
    """Make a gateway that starts the process at the event that occurred; a parallel one then waits for the others."""
    starts: list[Node] = []
    main = context.main[gateway.id]
    for choice in main.catch.parts if main.catch is not None else ():
        begin = context.node(gateway, steps.pass_on, f"/start/{choice.id}", start := Start())
        begin.catch = choice.catch
        begin.index = begin.slot = main.slot
        event = context.node(context.model[choice.id], steps.pass_on, f"/start/{gateway.id}")
        event.index = event.slot = choice.slot
        begin.next, event.next = event, choice.next
        context.watch(begin)
        context.watch(event)
        ids = dict.fromkeys(context.flows[id].target for id in gateway.outgoing)
        others = [context.entries[id] for id in ids if id != choice.id]
        if gateway.all_events and others:
            start.event = context.main[choice.id]
            targets = (event, *others)
            begin.next = context.node(gateway, fork, f"/others/{choice.id}", Branch(targets=targets))
        starts.append(begin)
    return starts
