"""What each element of BPMN becomes: a table from its kind to the nodes that stand for it."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from fame.bpmn import model
from fame.engine import activities, compensation, data, gateways, loops, steps
from fame.engine.host import Compiled
from fame.engine.state import UNCOUNTED, Body, Node, Step
from fame.errors import ModelError

if TYPE_CHECKING:
    from fame.engine.compiler import Wiring


OBSERVED: Step = steps.pass_on
"""The `act` of nodes that no token comes to, to say that observers are told of them."""


def make(wiring: Wiring, element: model.FlowNode) -> None:
    """Make the nodes of one element."""
    if isinstance(element, model.Event):
        _EVENTS[element.place](wiring, element)
    elif isinstance(element, model.Gateway):
        gateway(wiring, element)
    elif isinstance(element, model.SubProcess) and element.triggered_by_event:
        event_sub_process(wiring, element)
    elif isinstance(element, model.Activity):
        activity(wiring, element)


def refuse(text: str, element: model.Element, wiring: Wiring) -> ModelError:
    """A refusal, by name."""
    return ModelError(text, file=wiring.file, line=element.line, element=element.id)


# ---- events --------------------------------------------------------------------------------------


def trigger(wiring: Wiring, event: model.Event, definition: model.EventDefinition, part: str = "") -> Node:
    """A node that waits for what an event definition says."""
    compiler = wiring.compiler
    node = compiler.node(event, steps.wait, wiring.file, part=part)
    node.interrupting = event.interrupting
    match definition:
        case model.SignalDefinition(topic=topic):
            node.kind = "signal"
            listen(wiring, event, node, topic)
        case model.MessageDefinition(topic=topic, keys=keys):
            node.kind, node.keys = "message", compiler.assignments(keys, event, wiring.file)
            listen(wiring, event, node, topic)
        case model.TimerDefinition(kind=kind, expression=expression):
            node.kind, node.timer = "timer", kind
            node.run = compiler.expression(expression, event, wiring.file)
        case model.ConditionalDefinition(condition=condition):
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
    pairs = [(item.target, item.source) for item in topic.takes]
    node.take = data.receiver(topic, objects, wiring.compiler.assignments(pairs, element, wiring.file))


def start(wiring: Wiring, event: model.Event) -> None:
    """A start event: of the process if it has triggers; of an event sub-process it is made with that."""
    node = wiring.compiler.node(event, steps.pass_on, wiring.file, counted=True)
    wiring.compiler.watch(node)
    wiring.place(event, node)
    triggers = triggers_of(wiring, event)
    for each in triggers:
        each.step = steps.pass_on
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
        case model.ErrorDefinition(code=code):
            node.step, node.code = steps.raise_error, code
        case model.EscalationDefinition(code=code):
            node.step, node.code = steps.escalate, code
        case model.TerminateDefinition():
            node.step = steps.terminate
        case model.CompensateDefinition(activity=activity_id):
            node.step, node.kind, node.code = compensation.compensate, "scope", activity_id
            node.index = UNCOUNTED
        case model.CancelDefinition():
            node.step = compensation.cancel
        case model.LinkDefinition(name=name):
            link(wiring, event, node, name)
        case _:
            raise refuse("cannot be thrown", event, wiring)


def link(wiring: Wiring, event: model.Event, node: Node, name: str) -> None:
    """A link event: a jump to the catching one of the same name in this body (standard 13.4.5)."""
    targets = [
        other
        for other in wiring.content.nodes
        if isinstance(other, model.Event)
        and other.place == "catch"
        and any(isinstance(each, model.LinkDefinition) and each.name == name for each in other.definitions)
    ]
    if len(targets) != 1:
        raise refuse(f"link {name!r} has {len(targets)} catching events in this scope; it needs one", event, wiring)
    wiring.links.append((node, targets[0].id))


def boundary(wiring: Wiring, event: model.Event) -> None:
    """A boundary event: one node for each of its definitions, known to its activity once that is made."""
    compiler = wiring.compiler
    if not event.definitions:
        raise refuse("a boundary event needs a trigger", event, wiring)
    if isinstance(event.definitions[0], model.CompensateDefinition):
        return compensable(wiring, event)
    nodes = triggers_of(wiring, event)
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
    """Let an activity be compensated; what is no scope of its own says by a node behind it that it has completed."""
    main = wiring.main[activity]
    main.undo, node.next = node, wiring.entries[handler]
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


# ---- gateways ------------------------------------------------------------------------------------


def gateway(wiring: Wiring, element: model.Gateway) -> None:
    """A gateway; a join has a port for each flow that comes in."""
    compiler = wiring.compiler
    if element.kind == "complex":
        raise refuse("complex gateways are not executed by this version", element, wiring)
    node = compiler.node(element, steps.pass_on, wiring.file)
    node.slot = compiler.slot(element.id)
    wiring.place(element, node)
    if element.kind == "event":
        if element.instantiate and element.all_events:
            raise refuse("gateways that start a process by all of several events are not executed", element, wiring)
        node.step = gateways.choose
        compiler.watch(node)
        return
    node.index = node.slot
    if element.kind in ("parallel", "inclusive") and len(element.incoming) > 1:
        node.need = len(element.incoming)
        for number, flow in enumerate(element.incoming):
            step: Step = gateways.arrive if element.kind == "parallel" else gateways.arrive_inclusive
            port = compiler.node(element, step, wiring.file, part=f"/{number}")
            port.join, port.need = node, number
            wiring.ports[flow] = port


def link_alternatives(wiring: Wiring, node: Node, element: model.Gateway) -> None:
    """The events that an event-based gateway chooses among."""
    found: list[Node] = []
    for id in element.outgoing:
        target = wiring.model[wiring.flows[id].target]
        if isinstance(target, model.Event) and target.place == "catch" and target.definitions:
            slot = wiring.main[target.id].slot
            choices = alternatives(wiring, target, node, slot)
        elif isinstance(target, model.Task) and target.kind == "receive" and target.topic is not None:
            slot = wiring.main[target.id].slot
            choice = wiring.compiler.node(target, steps.wait, wiring.file, part=f"@{element.id}")
            choice.kind = "message"
            listen(wiring, target, choice, target.topic)
            choice.fire, choice.slot = gateways.fire_alternative, slot
            choices = [choice]
        else:
            raise refuse(f"leads to {target.id}, which is no catching event or receive task", element, wiring)
        for choice in choices:
            choice.via, choice.act = id, OBSERVED if wiring.compiler.observed else None
            choice.guard = wiring.main[target.id]
            choice.next = wiring.main[target.id].next or wiring.main[target.id].alternatives[0].next
        found.extend(choices)
    if not found:
        raise refuse("has no event to wait for", element, wiring)
    node.alternatives = tuple(found)


def instantiating(wiring: Wiring, element: model.Gateway) -> list[Node]:
    """The ways in through an event-based gateway that starts a process: the gateway, then the event that came."""
    found = []
    for choice in wiring.main[element.id].alternatives:
        begin = wiring.compiler.node(element, steps.pass_on, wiring.file, part=f"/start/{choice.id}")
        begin.kind, begin.topic, begin.take, begin.queue = choice.kind, choice.topic, choice.take, choice.queue
        begin.keys, begin.timer, begin.run = choice.keys, choice.timer, choice.run
        begin.index = begin.slot = wiring.main[element.id].slot
        event = wiring.compiler.node(wiring.model[choice.id], steps.pass_on, wiring.file, part=f"/start/{element.id}")
        event.index = event.slot = choice.slot
        begin.next, event.next = event, choice.next
        wiring.compiler.watch(begin)
        wiring.compiler.watch(event)
        found.append(begin)
    return found


def masks(content: model.Body, join: model.Gateway) -> dict[str, int]:
    """For each element of a body, which incoming flows of an inclusive join it reaches without passing the join.

    So for each sequence flow.
    """
    before: dict[str, list[str]] = {}
    for flow in content.flows:
        before.setdefault(flow.target, []).append(flow.id)
        before[flow.id] = [flow.source]
    for node in content.nodes:
        if isinstance(node, model.Event) and node.place == "boundary":
            before.setdefault(node.id, []).append(node.attached_to)
    found: dict[str, int] = {"": 0}
    for number, flow_id in enumerate(join.incoming):
        pending, seen = [flow_id], {join.id}
        while pending:
            id = pending.pop()
            if id not in seen:
                seen.add(id)
                found[id] = found.get(id, 0) | 1 << number
                pending.extend(before.get(id, ()))
    return found


# ---- activities ----------------------------------------------------------------------------------


def activity(wiring: Wiring, element: model.Activity) -> None:
    """A task, sub-process or call activity, with the boundary events that guard it."""
    compiler = wiring.compiler
    if element.refused:
        raise refuse(element.refused, element, wiring)
    node = work(wiring, element)
    io = element.io
    if io is not None and not isinstance(element, model.SubProcess | model.CallActivity):
        node = wrapped(wiring, element, node)
    if io is not None:
        own_variables(wiring, element, node, io)
    node.slot = compiler.slot(element.id)
    if node.step in (steps.pass_on, activities.script, activities.evaluate, steps.send):
        node.index = node.slot
    compiler.watch(node)
    if element.loop is not None:
        node = repeated(wiring, element, element.loop, node)
    wiring.place(element, node)


def repeated(
    wiring: Wiring, element: model.Activity, how: model.MultiInstance | model.StandardLoop, inner: Node
) -> Node:
    """An activity that repeats: a scope, in which the activity itself is run for each instance."""
    compiler = wiring.compiler
    node = compiler.node(element, loops.begin, wiring.file, part="/loop")
    instance = compiler.node(element, steps.pass_on, wiring.file, part="/instance")
    node.kind, instance.kind, node.body = "scope", "instance", Body(element.id)
    inner.next = compiler.node(element, steps.end, wiring.file, part="/instance/end")
    compiler.open(element.id, node.body, inner)
    compiled = partial(compiler.optional, element=element, file=wiring.file)
    if isinstance(how, model.StandardLoop):
        if how.condition is None and not how.maximum:
            raise refuse("a loop needs a condition or a maximum", element, wiring)
        condition = compiled(how.condition)
        node.loop = loops.Loop(
            instance=instance, standard=True, condition=condition, before=how.test_before, maximum=how.maximum
        )
    else:
        node.loop = loops.Loop(
            instance=instance,
            sequential=how.sequential,
            cardinality=compiled(how.cardinality),
            collection=compiled(how.collection),
            element=how.element_variable,
            completion=compiled(how.completion),
            output=how.output_collection,
            result=compiled(how.output_element),
        )
    return node


def work(wiring: Wiring, element: model.Activity) -> Node:
    """The node that does what an activity is for."""
    compiler = wiring.compiler
    node = compiler.node(element, steps.pass_on, wiring.file)
    if isinstance(element, model.SubProcess):
        if element.kind not in ("embedded", "transaction"):
            raise refuse(f"{element.kind} sub-processes are not executed by this version", element, wiring)
        node.step, node.kind = activities.enter, "scope"
        node.body = compiler.body(element.id, element.body, wiring.file, outer=wiring)
    elif isinstance(element, model.CallActivity):
        node.step, node.kind = activities.enter, "scope"
        node.body = compiler.call(element, wiring.file)
    else:
        assert isinstance(element, model.Task)
        task(wiring, element, node)
    return node


def task(wiring: Wiring, element: model.Task, node: Node) -> None:
    """What a task does, by its kind."""
    compiler = wiring.compiler
    if element.script is not None and element.script.language in ("python", "javascript"):
        node.step, node.kind = activities.script, "script"
        node.run = compiler.host.compile(element.script, element=element.id, file=wiring.file, script=True)
    elif element.script is not None:
        node.step, node.kind, node.variable = activities.evaluate, "script", element.result_variable
        node.run = compiler.expression(element.script, element, wiring.file)
    elif element.kind in ("user", "manual"):
        node.step, node.kind, node.fire = steps.wait, "user", steps.fire_catch
    elif element.kind == "receive":
        node.step, node.kind, node.fire = steps.wait, "message", steps.fire_catch
        if element.topic is None:
            raise refuse("a receive task needs a message", element, wiring)
        listen(wiring, element, node, element.topic)
        if node.queue:
            wiring.queued.append(node)
    elif element.kind == "send":
        node.step = steps.send
        if element.topic is None:
            raise refuse("a send task needs a message", element, wiring)
        node.topic, payload = element.topic.qualified, element.topic.payload or element.payload
        node.run = compiler.expression(payload, element, wiring.file) if payload else None
    elif element.kind == "service":
        if not element.operation:
            raise refuse("a service task needs the name of what it calls", element, wiring)
        node.step, node.kind, node.variable = activities.evaluate, "script", element.result_variable
        node.run = service(wiring, element)
    elif element.kind == "business_rule":
        raise refuse("business rule tasks are not executed: DMN is not supported", element, wiring)


def service(wiring: Wiring, element: model.Task) -> Compiled:
    """The callable that a service task names."""
    return wiring.compiler.host.service(element.operation, element=element.id, file=wiring.file)


def wrapped(wiring: Wiring, element: model.Activity, inner: Node) -> Node:
    """A task that has variables of its own runs in a scope of its own."""
    compiler = wiring.compiler
    node = compiler.node(element, activities.enter, wiring.file, part="/own")
    node.kind, node.body = "scope", Body(element.id)
    inner.key += "/inner"
    inner.next = compiler.node(element, steps.end, wiring.file, part="/inner/end")
    compiler.open(element.id, node.body, inner)
    return node


def own_variables(wiring: Wiring, element: model.Activity, node: Node, io: model.IoMapping) -> None:
    """What goes into and out of an activity with a mapping. A call's variables are its own; a task's see through."""
    compiler = wiring.compiler
    node.own, node.shares = True, not isinstance(element, model.CallActivity)
    node.all_in, node.all_out = io.all_in, io.all_out
    node.inputs = compiler.assignments(((item.target, item.source) for item in io.inputs), element, wiring.file)
    node.outputs = compiler.assignments(((item.target, item.source) for item in io.outputs), element, wiring.file)


def event_sub_process(wiring: Wiring, element: model.SubProcess) -> None:
    """An event sub-process: its start events are armed with the scope that it stands in."""
    compiler = wiring.compiler
    handler = compiler.node(element, steps.pass_on, wiring.file)
    handler.kind, handler.slot = "handler", compiler.slot(element.id)
    if compiler.observed:
        handler.act = steps.pass_on
    inner = type(wiring)(compiler, element.body, wiring.file, wiring)
    handler.body = compiler.body(element.id, element.body, wiring.file, handler=inner)
    starts = [item for item in element.body.nodes if isinstance(item, model.Event) and item.place == "start"]
    triggers = [(event, node) for event in starts for node in inner.triggers.get(event.id, ())]
    if not triggers:
        raise refuse("an event sub-process needs a start event with a trigger", element, wiring)
    for event, node in triggers:
        if node.kind == "compensate":
            node.guard, wiring.undo = handler, node
            continue
        node.fire, node.guard, node.index = steps.fire_handler, handler, 0
        node.resume = (element.resume or compiler.original) and event.interrupting
        node.step = steps.pass_on
        wiring.handlers.append(node)


_EVENTS = {"start": start, "catch": catch, "throw": throwing, "end": throwing, "boundary": boundary}
