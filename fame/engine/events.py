"""What each event of BPMN becomes: nodes that wait for its triggers, throw its results, or pass a token on."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fame.bpmn import model
from fame.engine import compensation, data, gateways, steps
from fame.engine.state import UNCOUNTED, Node, Step
from fame.errors import ModelError

if TYPE_CHECKING:
    from fame.engine.compiler import Wiring

OBSERVED: Step = steps.pass_on
"""The `act` of nodes that no token comes to, to say that observers are told of them."""


def make(wiring: Wiring, event: model.Event) -> None:
    """Make the nodes of one event."""
    _PLACES[event.place](wiring, event)


def refuse(text: str, element: model.Element, wiring: Wiring) -> ModelError:
    """A refusal, by name."""
    return ModelError(text, file=wiring.file, line=element.line, element=element.id)


def trigger(wiring: Wiring, event: model.Event, definition: model.EventDefinition, part: str = "") -> Node:
    """A node that waits for what an event definition says."""
    compiler = wiring.compiler
    node = compiler.node(event, steps.wait, wiring.file, part=part)
    node.interrupting = event.interrupting or isinstance(definition, model.ErrorDefinition | model.CancelDefinition)
    match definition:
        case model.SignalDefinition(topic=topic):
            node.kind = "signal"
            listen(wiring, event, node, topic)
        case model.MessageDefinition(topic=topic, keys=keys):
            node.kind, node.keys = "message", compiler.assignments(keys, event, wiring.file)
            listen(wiring, event, node, topic)
        case model.TimerDefinition(kind=kind, expression=expression):
            if expression is None:
                raise refuse("the timer has no time: expected a duration, date or cycle of ISO 8601", event, wiring)
            node.kind, node.timer = "timer", kind
            node.run = compiler.expression(expression, event, wiring.file)
        case model.ConditionalDefinition(condition=condition):
            if condition is None:
                raise refuse("the conditional event has no condition", event, wiring)
            node.kind, node.run = "condition", compiler.expression(condition, event, wiring.file)
        case model.ErrorDefinition() | model.EscalationDefinition():
            node.kind = "error" if isinstance(definition, model.ErrorDefinition) else "escalation"
            node.code, node.code_variable = definition.code, definition.code_variable or ""
            node.message_variable = getattr(definition, "message_variable", None) or ""
        case model.CancelDefinition() | model.CompensateDefinition():
            node.kind = "cancel" if isinstance(definition, model.CancelDefinition) else "compensate"
        case _:
            name = type(definition).__name__.removesuffix("Definition").lower()
            raise refuse(f"{name} events are not executed by this version", event, wiring)
    return node


def triggers_of(wiring: Wiring, event: model.Event) -> list[Node]:
    """A node for each trigger of an event; one for all of them if it is a parallel multiple event."""
    several = len(event.definitions) > 1
    nodes = [trigger(wiring, event, each, f"/{n}" if several else "") for n, each in enumerate(event.definitions)]
    if not (several and event.parallel):
        return nodes
    for node in nodes:
        if node.kind in ("error", "escalation", "cancel", "compensate"):
            raise refuse(f"a parallel multiple event cannot wait for an {node.kind}", event, wiring)
        node.fire = gateways.fire_part
    whole = wiring.compiler.node(event, steps.wait, wiring.file)
    whole.kind, whole.alternatives, whole.interrupting = "all", tuple(nodes), event.interrupting
    return [whole]


def listen(wiring: Wiring, element: model.FlowNode, node: Node, topic: model.Topic) -> None:
    """Let a node wait for a topic, and take what the message brings."""
    node.topic, node.queue = topic.qualified, topic.queue
    objects = [wiring.objects[id] for id in element.data_outputs if id in wiring.objects]
    takes = [
        (name, data.seeing_fields(source) if item.source.language == "feel" else source)
        for item in topic.takes
        for name, source in wiring.compiler.assignments([(item.target, item.source)], element, wiring.file)
    ]
    node.take = data.receiver(topic, objects, takes, wiring.compiler.unfilled)


def start(wiring: Wiring, event: model.Event) -> None:
    """A start event: of the process if it has triggers; of an event sub-process it is made with that."""
    node = wiring.compiler.node(event, steps.pass_on, wiring.file, counted=True)
    wiring.compiler.watch(node)
    wiring.place(event, node)
    triggers = triggers_of(wiring, event)
    for each in triggers:
        each.step = steps.pass_on
        if node.next is not None:  # what the event assigns
            each.next = node.next
        else:
            wiring.exits[event.id].append(each)
        each.index = each.slot = node.slot
        wiring.compiler.watch(each)
    wiring.triggers[event.id] = triggers


def catch(wiring: Wiring, event: model.Event) -> None:
    """An intermediate catching event. Several definitions: the first that comes (a multiple event)."""
    compiler = wiring.compiler
    if event.definitions and isinstance(event.definitions[0], model.LinkDefinition):
        return passing(wiring, event)
    if not event.definitions:
        return passing(wiring, event)
    if len(event.definitions) == 1 or event.parallel:
        (node,) = triggers_of(wiring, event)
        node.slot, node.fire = compiler.slot(event.id), steps.fire_catch
        if node.kind in ("error", "escalation"):
            raise refuse(f"an intermediate event cannot catch an {node.kind}; use a boundary event", event, wiring)
        compiler.watch(node)
        wiring.place(event, node)
        wiring.queued += [each for each in (node, *node.alternatives) if each.queue]
        return None
    choice = compiler.node(event, gateways.choose, wiring.file)
    choice.slot = compiler.slot(event.id)
    choice.alternatives = tuple(alternatives(wiring, event, choice, choice.slot))
    compiler.watch(choice)
    wiring.place(event, choice, list(choice.alternatives))
    return None


def alternatives(wiring: Wiring, event: model.Event, owner: Node, slot: int) -> list[Node]:
    """One node for each definition of an event; whichever fires is the event."""
    nodes = [trigger(wiring, event, each, f"/{n}@{owner.id}") for n, each in enumerate(event.definitions)]
    for node in nodes:
        node.fire, node.slot, node.guard = gateways.fire_alternative, slot, owner
        node.act = OBSERVED if wiring.compiler.observed else None
        if node.queue:
            wiring.queued.append(node)
    return nodes


def passing(wiring: Wiring, element: model.FlowNode) -> None:
    """An element that only passes a token on."""
    node = wiring.compiler.node(element, steps.pass_on, wiring.file, counted=True)
    wiring.compiler.watch(node)
    wiring.place(element, node)


def throwing(wiring: Wiring, event: model.Event) -> None:
    """An intermediate throwing event, or an end event: the same, but for what follows."""
    compiler = wiring.compiler
    ends: Step = steps.end if event.place == "end" else steps.pass_on
    if len(event.definitions) < 2:
        node = compiler.node(event, ends, wiring.file, counted=True)
        if event.definitions:
            thrown(wiring, event, event.definitions[0], node)
        compiler.watch(node, ends=node.step in ENDING)
        wiring.place(event, node)
        return
    first = last = compiler.node(event, steps.pass_on, wiring.file, counted=True)
    compiler.watch(first)
    for number, definition in enumerate(event.definitions):
        if last.step in ENDING:
            raise refuse("nothing can be thrown after what ends the token: put it last", event, wiring)
        last.next = compiler.node(event, steps.pass_on, wiring.file, part=f"/{number}")
        last = last.next
        last.guard = first
        thrown(wiring, event, definition, last)
    wiring.place(event, first, [last])


ENDING = (steps.end, steps.terminate, steps.raise_error, compensation.cancel)
"""Steps at which a token ends, whatever follows."""


def thrown(wiring: Wiring, event: model.Event, definition: model.EventDefinition, node: Node) -> None:
    """Let a node throw what an event definition says."""
    match definition:
        case model.SignalDefinition(topic=topic) | model.MessageDefinition(topic=topic):
            signal = isinstance(definition, model.SignalDefinition)
            node.step, node.topic = steps.throw if signal else steps.send, topic.qualified
            node.run = wiring.compiler.optional(topic.payload, event, wiring.file)
            address(wiring, event, topic, node)
            if node.run is not None and event.io is not None and event.io.inputs:
                pairs = ((item.target, item.source) for item in event.io.inputs)
                node.run = data.with_inputs(wiring.compiler.assignments(pairs, event, wiring.file), node.run)
        case model.ErrorDefinition(code=code, computed=computed):
            node.step, node.code = steps.raise_error, code
            node.run = wiring.compiler.optional(computed, event, wiring.file)
        case model.EscalationDefinition(code=code, computed=computed):
            node.step, node.code = steps.escalate, code
            node.run = wiring.compiler.optional(computed, event, wiring.file)
        case model.TerminateDefinition():
            node.step = steps.terminate
        case model.CompensateDefinition(activity=activity_id, wait=wait):
            undoing = node if wait else wiring.compiler.node(event, steps.end, wiring.file, part="/beside")
            undoing.step, undoing.kind, undoing.code = compensation.compensate, "scope", activity_id
            undoing.index = UNCOUNTED
            if not wait:
                node.step, node.join = compensation.beside, undoing
                undoing.next = wiring.compiler.node(event, steps.end, wiring.file, part="/undone")
        case model.CancelDefinition():
            if not wiring.transaction:
                raise refuse("a cancel end event ends a transaction, and stands in none", event, wiring)
            node.step = compensation.cancel
        case model.LinkDefinition(name=name):
            link(wiring, event, node, name)
        case _:
            raise refuse("cannot be thrown", event, wiring)


def address(wiring: Wiring, element: model.FlowNode, topic: model.Topic, node: Node) -> None:
    """Let a message be for one robot, if it says for which."""
    if topic.to is not None:
        node.to = wiring.compiler.expression(topic.to, element, wiring.file)


def link(wiring: Wiring, event: model.Event, node: Node, name: str) -> None:
    """A link event: a jump to the catching one of the same name in this body (standard 10.5.5)."""
    events = (other for other in wiring.content.nodes if isinstance(other, model.Event))
    targets = [other for other in events if other.place == "catch" and name in links_of(other)]
    if len(targets) != 1:
        raise refuse(f"link {name!r} has {len(targets)} catching events in this scope; it needs one", event, wiring)
    wiring.links.append((node, targets[0].id))


def links_of(event: model.Event) -> set[str]:
    """The names of the links that an event throws or catches."""
    return {each.name for each in event.definitions if isinstance(each, model.LinkDefinition)}


def jumping_to(content: model.Body, event: model.Event) -> list[str]:
    """The ids of the events that jump to a catching one."""
    others = (other for other in content.nodes if isinstance(other, model.Event) and other.place == "throw")
    return [other.id for other in others if links_of(event) & links_of(other)]


def boundary(wiring: Wiring, event: model.Event) -> None:
    """A boundary event: one node for each of its definitions, known to its activity once that is made."""
    compiler = wiring.compiler
    if not event.definitions:
        raise refuse("a boundary event needs a trigger", event, wiring)
    if isinstance(event.definitions[0], model.CompensateDefinition):
        return compensable(wiring, event)
    nodes = triggers_of(wiring, event)
    host = wiring.model[event.attached_to]
    if any(node.kind == "cancel" for node in nodes) and getattr(host, "kind", "") != "transaction":
        raise refuse(f"a cancel event guards a transaction, and {host.id} is none", event, wiring)
    slot = compiler.slot(event.id)
    for node in nodes:
        node.slot, node.fire = slot, steps.fire_boundary
        node.act = OBSERVED if compiler.observed else None
    wiring.place(event, nodes[0], nodes)
    wiring.boundaries.setdefault(event.attached_to, []).extend(nodes)
    return None


def compensable(wiring: Wiring, event: model.Event) -> None:
    """A compensation event at the boundary of an activity, and the handler associated with it."""
    handlers = [target for source, target in wiring.content.associations if source == event.id]
    if len(handlers) != 1 or len(event.definitions) > 1:
        raise refuse(f"a compensation event needs one handler; it has {len(handlers)}", event, wiring)
    node = wiring.compiler.node(event, steps.pass_on, wiring.file, counted=True)
    wiring.compiler.watch(node)
    wiring.undos.append((event.attached_to, node, handlers[0]))


def attach_undo(wiring: Wiring, activity: str, node: Node, handler: str) -> None:
    """Let an activity be compensated, or each instance of one that repeats.

    What is no scope of its own says by a node behind it that it has completed.
    """
    main = wiring.main[activity]
    undone = main if main.loop is None else main.loop.instance
    undone.undo, node.next = node, wiring.entries[handler]
    if main.kind != "scope":
        last = wiring.compiler.node(wiring.model[activity], compensation.completed, wiring.file, part="/completed")
        last.guard = main
        wiring.link(wiring.exits[activity], last)
        wiring.exits[activity] = [last]


def attach(activity: Node, nodes: list[Node]) -> None:
    """Let an activity know its boundary events."""
    activity.armed = tuple(node for node in nodes if node.kind not in ("error", "escalation", "cancel"))
    activity.cancels = tuple(node for node in nodes if node.kind == "cancel")
    activity.errors = tuple(node for node in nodes if node.kind == "error")
    activity.escalations = tuple(node for node in nodes if node.kind == "escalation")


_PLACES = {"start": start, "catch": catch, "throw": throwing, "end": throwing, "boundary": boundary}
