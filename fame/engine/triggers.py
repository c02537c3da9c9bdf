"""Makes the nodes for triggers of catching events: start, intermediate and boundary."""

from __future__ import annotations

from collections.abc import Callable

from fame.bpmn import model
from fame.engine import data, faults, scopes, steps, waiting
from fame.engine.engine_state import EngineState
from fame.engine.program import NO_TRIGGER, Catch, FaultCatch, Node, Trigger
from fame.engine.scope_compiler import ScopeCompiler
from fame.engine.state import Scope, Wait

# ---- steps ---------------------------------------------------------------------------------------


def wait(engine: EngineState, scope: Scope, node: Node) -> None:
    """Let a token wait at a receive task or catching event."""
    wait = waiting.wait_at(engine, node, scope)
    if wait.alive:
        waiting.arm(engine, wait)


def fire_catch(engine: EngineState, wait: Wait) -> None:
    """Continue a waiting token whose trigger has occurred."""
    waiting.withdraw(engine, wait)
    scopes.complete(engine, wait.scope, wait.node)


def fire_part(engine: EngineState, wait: Wait) -> None:
    """Handle one trigger of a parallel multiple event; the last one fires the event."""
    event = wait.owner
    assert isinstance(event, Wait)
    event.arms = tuple(other for other in event.arms if other is not wait)
    waiting.disarm(engine, wait)
    if not event.arms:
        waiting.fire(engine, event)
        if event.alive and not event.paused:  # a non-interrupting event waits for all of them again
            waiting.arm(engine, event)


# ---- compiling -----------------------------------------------------------------------------------


def catching(fire: Callable[[EngineState, Wait], object] = fire_catch, trigger: Trigger = NO_TRIGGER) -> Catch:
    """Return the `Catch` of an event or task."""
    return Catch(trigger, fire, faults.give_up)


def part_of_event(fire: Callable[[EngineState, Wait], object], trigger: Trigger = NO_TRIGGER) -> Catch:
    """Return the `Catch` of one part of a multiple event or event-based gateway."""
    return Catch(trigger, fire, faults.give_up_part)


def trigger(
    context: ScopeCompiler, event: model.Event, definition: model.EventDefinition, catch: Catch, part: str = ""
) -> Node:
    """Make the node for an event definition. Raises ModelError for a kind that is not executed.

    `catch` contains the reaction of the event, and is completed here; events that catch faults get a `FaultCatch`.
    """
    match definition:
        case model.ErrorDefinition() | model.EscalationDefinition():
            kind = "error" if isinstance(definition, model.ErrorDefinition) else "escalation"
            fault = FaultCatch(kind, event.interrupting or kind == "error")
            fault.code, fault.code_variable = definition.code, definition.code_variable or ""
            fault.message_variable = getattr(definition, "message_variable", None) or ""
            return context.node(event, steps.pass_on, part, fault)
        case model.CancelDefinition():
            return context.node(event, steps.pass_on, part, FaultCatch("cancel"))
        case model.CompensateDefinition():
            return context.node(event, steps.pass_on, part, FaultCatch("compensate", event.interrupting))
    node = context.node(event, wait, part)
    node.catch, catch.interrupting = catch, event.interrupting
    match definition:
        case model.SignalDefinition(topic=topic):
            catch.trigger = waiting.SIGNAL
            listen(context, event, catch, topic)
        case model.MessageDefinition(topic=topic, keys=keys):
            catch.trigger, catch.keys = waiting.MESSAGE, context.assignments(keys, event)
            listen(context, event, catch, topic)
        case model.TimerDefinition(kind=timer, expression=expression):
            if expression is None:
                context.refuse("the timer has no time: expected an ISO 8601 duration, date or cycle", event)
            catch.trigger, catch.timer, catch.value = waiting.TIMER, timer, context.expression(expression, event)
        case model.ConditionalDefinition(condition=condition):
            if condition is None:
                context.refuse("the conditional event has no condition", event)
            catch.trigger, catch.value = waiting.CONDITION, context.expression(condition, event)
        case _:
            name = type(definition).__name__.removesuffix("Definition").lower()
            context.refuse(f"{name} events are not executed by this version", event)
    return node


def triggers_of(
    context: ScopeCompiler, event: model.Event, fire: Callable[[EngineState, Wait], object] = fire_catch
) -> list[Node]:
    """Make a node for each trigger of an event, or one for all if it is a parallel multiple event."""
    definitions = event.definitions
    if len(definitions) == 1:
        return [trigger(context, event, definitions[0], catching(fire))]
    if not event.parallel:
        return [trigger(context, event, each, catching(fire), f"/{n}") for n, each in enumerate(definitions)]
    parts = []
    for number, definition in enumerate(definitions):
        node = trigger(context, event, definition, part_of_event(fire_part), f"/{number}")
        if node.catch is None:
            context.refuse(f"a parallel multiple event cannot wait for an {node.spec.kind}", event)
        parts.append(node)
    whole = context.node(event, wait)
    whole.catch = catching(fire, waiting.ALL)
    whole.catch.parts, whole.catch.interrupting = tuple(parts), event.interrupting
    return [whole]


def listen(context: ScopeCompiler, element: model.FlowNode, catch: Catch, topic: model.Topic) -> None:
    """Set the topic of a `Catch`, and how it stores the message."""
    catch.topic, catch.queue = topic.qualified, topic.queue
    if catch.trigger is waiting.MESSAGE:
        context.compiler.program.messages.add(catch.topic)
    if catch.queue or catch.trigger is waiting.MESSAGE:
        context.compiler.program.selective.add(catch.topic)
    objects = [context.objects[id] for id in element.data_outputs if id in context.objects]
    takes = [
        (name, data.seeing_fields(source) if item.source.language == "feel" else source)
        for item, (name, source) in zip(topic.takes, context.mapping(topic.takes, element), strict=True)
    ]
    catch.take = data.receiver(topic, objects, takes, context.compiler.unfilled)


def keep_queue(context: ScopeCompiler, node: Node) -> None:
    """Register an event with a queue, or its parts: it keeps messages from the start of its scope."""
    for part in (node, *node.catch.parts) if node.catch is not None else ():
        if part.catch is not None and part.catch.queue:
            context.queued.append(part)
            if part.catch.trigger is waiting.MESSAGE:
                context.compiler.program.shared.add(part.catch.topic)


def queue_of(context: ScopeCompiler, choice: Node, catch: Catch) -> Node | None:
    """Return the node of the event that an alternative of an event-based gateway stands for, if it has a queue."""
    same = (node for node in context.queued if node.id == choice.id)
    return next((node for node in same if node.catch is not None and node.catch.topic == catch.topic), None)
