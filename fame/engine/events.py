"""Start, intermediate, boundary and end events: throwing, and the effect of a boundary event on its activity.

Their triggers are in `triggers`.
"""

from __future__ import annotations

from typing import Any

from fame.bpmn import model
from fame.dataclasses import dataclass
from fame.engine import compensation, data, event_gateways, faults, handlers, steps, triggers
from fame.engine.data import UNDEFINED
from fame.engine.engine_state import EngineState
from fame.engine.host import BpmnError
from fame.engine.program import Compiled, FaultCatch, Node, StepFunction
from fame.engine.scope_compiler import ScopeCompiler, links_of
from fame.engine.state import Scope, Wait

# ---- steps ---------------------------------------------------------------------------------------


@dataclass(slots=True)
class Throw:
    """Spec of a throwing signal or message event, or a send task.

    topic    the qualified topic
    payload  the value of the message
    to       the receiving robot; None: all
    """

    topic: str
    payload: Compiled | None
    to: Compiled | None = None


@dataclass(slots=True)
class Raise:
    """Spec of a throwing error or escalation event: its code, fixed or computed, and the text of an error."""

    code: str | None
    computed: Compiled | None
    message: Compiled | None = None


def throw(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """Publish. Own catchers receive it when all tokens ahead of this one wait; then this token continues."""
    spec: Throw = node.spec
    try:
        value = spec.payload(scope.variables) if spec.payload is not None else None
        message = engine.host.publish(spec.topic, None if value is UNDEFINED else value)
    except BaseException as error:
        return steps.fail_step(engine, scope, node, error)
    ready = engine.ready
    ready.append((None, (spec.topic, message)))
    ready.append((node.next, scope))
    if node.plain_step is not None:
        engine.notify(scope, node.left)
    return None


def send(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """Send a message to another process; own catchers do not receive it."""
    spec: Throw = node.spec
    try:
        value = spec.payload(scope.variables) if spec.payload is not None else None
        value = None if value is UNDEFINED else value
        if spec.to is None:
            engine.host.publish(spec.topic, value)
        else:
            engine.host.send(spec.topic, value, spec.to(scope.variables))
    except BaseException as error:
        return steps.fail_step(engine, scope, node, error)
    return node.next


def _code_of(spec: Raise, variables: dict[str, Any]) -> str | None:
    """Return the code to throw. Raises ValueError if it is computed and null."""
    if spec.computed is None:
        return spec.code
    code = spec.computed(variables)
    if code is None or code is UNDEFINED:
        raise ValueError("the computed code has no value: a variable in its expression is not set")
    return str(code)


def raise_error(engine: EngineState, scope: Scope, node: Node) -> None:
    """Throw the error of an error end event."""
    try:
        thrown = BpmnError(_code_of(node.spec, scope.variables) or "", _message_of(node.spec, scope.variables))
    except BaseException as error:
        faults.fail(engine, scope, node, error)
        return
    faults.fail(engine, scope, node, thrown)


def _message_of(spec: Raise, variables: dict[str, Any]) -> str:
    """Return the text of an error. If it cannot be computed it says why: the error is thrown all the same."""
    try:
        text = spec.message(variables) if spec.message is not None else None
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # also one that does not end
        return f"(its message: {type(error).__name__}: {error})"
    return "" if text is None or text is UNDEFINED else str(text)


def escalate(engine: EngineState, scope: Scope, node: Node) -> None:
    """Throw an escalation. The token continues first, unless its scope is cancelled or suspended."""
    try:
        code = _code_of(node.spec, scope.variables)
    except BaseException as error:
        steps.fail_step(engine, scope, node, error)
        return
    if node.plain_step is not None:
        engine.notify(scope, node.left)
    engine.ready.appendleft((node.next, scope))
    faults.escalate(engine, scope, node, code)


def fire_boundary(engine: EngineState, wait: Wait) -> None:
    """Take a boundary event that has occurred."""
    handlers.take_boundary(engine, wait.scope, wait.node, wait.catch, wait.owner)


_ENDING = (steps.end, steps.terminate, steps.terminate_all, raise_error, compensation.cancel)
"""Steps at which a token always ends."""

# ---- compiling -----------------------------------------------------------------------------------


def start(context: ScopeCompiler, event: model.Event) -> None:
    """Make a start event with its triggers; that of an event sub-process is made with the sub-process."""
    node = context.counted(context.node(event, steps.pass_on))
    context.watch(node)
    context.place(event, node)
    nodes = triggers.triggers_of(context, event)
    for entry in nodes:
        entry.step = steps.pass_on
        if node.next is not None:  # what the event assigns
            entry.next = node.next
        else:
            context.exits[event.id].append(entry)
        entry.index = entry.slot = node.slot
        context.watch(entry)
    context.triggers[event.id] = nodes


def catch(context: ScopeCompiler, event: model.Event) -> None:
    """Make an intermediate catching event; with several definitions (a multiple event) the first to occur wins."""
    if not event.definitions or isinstance(event.definitions[0], model.LinkDefinition):
        context.passing(event)
    elif len(event.definitions) > 1 and not event.parallel:
        event_gateways.multiple(context, event)
    else:
        (node,) = triggers.triggers_of(context, event)
        if node.catch is None:
            context.refuse(f"an intermediate event cannot catch an {node.spec.kind}; use a boundary event", event)
        node.slot = context.slot(event.id)
        context.watch(node)
        context.place(event, node)
        triggers.keep_queue(context, node)


def boundary(context: ScopeCompiler, event: model.Event) -> None:
    """Make one node for each definition of a boundary event; they are attached when the activity is made."""
    if not event.definitions:
        context.refuse("a boundary event needs a trigger", event)
    if isinstance(event.definitions[0], model.CompensateDefinition):
        compensation.compensable(context, event)
        return
    nodes = triggers.triggers_of(context, event, fire_boundary)
    _check_cancels(context, event, nodes)
    slot = context.slot(event.id)
    for node in nodes:
        node.slot = slot
        context.watch_event(node)
    context.place(event, nodes[0], nodes)
    context.boundaries.setdefault(event.attached_to, []).extend(nodes)


def _check_cancels(context: ScopeCompiler, event: model.Event, nodes: list[Node]) -> None:
    """Refuse a cancel event at any activity but a transaction."""
    host = context.model[event.attached_to]
    cancels = any(isinstance(node.spec, FaultCatch) and node.spec.kind == "cancel" for node in nodes)
    if cancels and host.tag != "transaction":
        context.refuse(f"expected a transaction for the cancel event, got {host.id}", event)


def throwing(context: ScopeCompiler, event: model.Event) -> None:
    """Make an intermediate throw event or an end event."""
    ends: StepFunction = steps.end if event.place == "end" else steps.pass_on
    if len(event.definitions) < 2:
        node = _thrown(context, event, event.definitions[0], ends) if event.definitions else None
        node = node or context.node(event, ends)
        node.slot = context.slot(event.id)
        if not isinstance(node.spec, compensation.Compensate):  # which counts when all is undone
            node.index = node.slot
        context.watch(node, ends=node.step in _ENDING)
        context.place(event, node)
        return
    first = last = context.counted(context.node(event, steps.pass_on))
    context.watch(first)
    for number, definition in enumerate(event.definitions):
        if last.step in _ENDING or any(isinstance(one, model.LinkDefinition) for one in event.definitions[:number]):
            context.refuse("nothing can be thrown after what ends or moves the token: put it last", event)
        last.next = _thrown(context, event, definition, steps.pass_on, f"/{number}")
        last = last.next
        last.part_of = first
    context.place(event, first, [last])


def _thrown(
    context: ScopeCompiler, event: model.Event, definition: model.EventDefinition, ends: StepFunction, part: str = ""
) -> Node:
    """Make the node that throws one event definition. Raises ModelError."""
    match definition:
        case model.SignalDefinition(topic=topic) | model.MessageDefinition(topic=topic):
            step = throw if isinstance(definition, model.SignalDefinition) else send
            payload = context.optional(topic.payload, event)
            if payload is not None and event.io is not None and event.io.inputs:
                payload = data.with_inputs(context.mapping(event.io.inputs, event), payload)
            return context.node(event, step, part, Throw(topic.qualified, payload, context.optional(topic.to, event)))
        case (
            model.ErrorDefinition(code=code, computed=computed)
            | model.EscalationDefinition(code=code, computed=computed)
        ):
            code_of = context.optional(computed, event)
            if isinstance(definition, model.EscalationDefinition):
                return context.node(event, escalate, part, Raise(code, code_of))
            return context.node(
                event, raise_error, part, Raise(code, code_of, context.optional(definition.message, event))
            )
        case model.TerminateDefinition():
            whole = context.compiler.original and context.runs_beside
            return context.node(event, steps.terminate_all if whole else steps.terminate, part)
        case model.CompensateDefinition():
            return compensation.thrown(context, event, definition, ends, part)
        case model.CancelDefinition():
            if not context.transaction:
                context.refuse("a cancel end event is allowed in a transaction only", event)
            return context.node(event, compensation.cancel, part)
        case model.LinkDefinition(name=name):
            return _link(context, event, name, part)
    context.refuse("cannot be thrown", event)


def _link(context: ScopeCompiler, event: model.Event, name: str, part: str) -> Node:
    """Make a throwing link event: a jump to the catching link of that name in this body (standard 10.5.5)."""
    targets = [other for other in context.content.events("catch") if name in links_of(other)]
    if len(targets) != 1:
        context.refuse(f"link {name!r} has {len(targets)} catching events in this scope; it needs one", event)
    node = context.node(event, steps.end if event.place == "end" else steps.pass_on, part)

    def lead() -> None:
        node.next = context.entries[targets[0].id]

    context.when_linked.append(lead)
    return node
