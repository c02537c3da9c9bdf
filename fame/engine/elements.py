"""What each element of BPMN becomes: a table from its kind to the nodes that stand for it."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from fame.bpmn import model
from fame.engine import activities, events, gateways, loops, steps
from fame.engine.events import OBSERVED, address, alternatives, listen, refuse
from fame.engine.host import Compiled
from fame.engine.state import Body, Node, Step
from fame.engine.variables import UNDEFINED
from fame.errors import ModelError

if TYPE_CHECKING:
    from fame.engine.compiler import Wiring


def make(wiring: Wiring, element: model.FlowNode) -> None:
    """Make the nodes of one element."""
    if isinstance(element, model.Event):
        events.make(wiring, element)
    elif isinstance(element, model.Gateway):
        gateway(wiring, element)
    elif isinstance(element, model.SubProcess) and element.triggered_by_event:
        event_sub_process(wiring, element)
    elif isinstance(element, model.Activity):
        activity(wiring, element)


# ---- gateways ------------------------------------------------------------------------------------


_ARRIVALS: dict[str, Step] = {
    "parallel": gateways.arrive,
    "inclusive": gateways.arrive_inclusive,
    "complex": gateways.arrive_complex,
}


def gateway(wiring: Wiring, element: model.Gateway) -> None:
    """A gateway; a join has a port for each flow that comes in."""
    compiler = wiring.compiler
    node = compiler.node(element, steps.pass_on, wiring.file)
    node.slot = compiler.slot(element.id)
    wiring.place(element, node)
    if element.kind == "event":
        node.step = gateways.choose
        compiler.watch(node)
        return
    node.index = node.slot
    if element.kind in _ARRIVALS and len(element.incoming) > 1:
        node.need, step = len(element.incoming), _ARRIVALS[element.kind]
        if element.kind == "complex":
            if element.activation is None:
                raise refuse("a complex gateway that joins needs an activation condition", element, wiring)
            node.run = compiler.expression(element.activation, element, wiring.file)
        for number, flow in enumerate(element.incoming):
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
            if target.loop is not None:
                raise refuse("what an event-based gateway waits for does not repeat", target, wiring)
            slot = wiring.main[target.id].slot
            choice = wiring.compiler.node(target, steps.wait, wiring.file, part=f"@{element.id}")
            choice.kind, choice.keys = "message", wiring.compiler.assignments(target.keys, target, wiring.file)
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


def instantiating(wiring: Wiring, element: model.FlowNode) -> list[Node]:
    """The ways in through an event-based gateway or receive task that starts a process."""
    if isinstance(element, model.Gateway):
        return instantiating_gateway(wiring, element)
    assert isinstance(element, model.Task)
    main, begin = wiring.main[element.id], wiring.compiler.node(element, steps.pass_on, wiring.file, part="/start")
    if main.kind != "message" or element.topic is None:
        raise refuse("what starts a process does not repeat, and has no variables of its own", element, wiring)
    begin.kind, begin.keys = "message", main.keys
    listen(wiring, element, begin, element.topic)
    begin.index = begin.slot = main.slot
    begin.next = main.next
    wiring.compiler.watch(begin)
    return [begin]


def instantiating_gateway(wiring: Wiring, element: model.Gateway) -> list[Node]:
    """The gateway, then the event that came; of a parallel one the others are waited for in the instance."""
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
        targets = dict.fromkeys(wiring.flows[id].target for id in element.outgoing)
        others = [wiring.entries[id] for id in targets if id != choice.id]
        if element.all_events and others:
            begin.join, begin.next = (
                wiring.main[choice.id],
                wiring.compiler.node(element, gateways.fork, wiring.file, part=f"/others/{choice.id}"),
            )
            begin.next.out = (event, *others)
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
        elif isinstance(node, model.Event) and node.place == "catch":
            before.setdefault(node.id, []).extend(events.jumping_to(content, node))
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
        if how.cardinality is None and how.collection is None:
            raise refuse("the multi-instance activity has neither a collection nor a cardinality", element, wiring)
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
        node.step, node.kind = activities.enter, "scope"
        node.body = compiler.body(element, wiring.file, outer=wiring)
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
        node.keys = compiler.assignments(element.keys, element, wiring.file)
        listen(wiring, element, node, element.topic)
        if node.queue:
            wiring.queued.append(node)
    elif element.kind == "send" and (element.topic is not None or not element.operation):
        node.step = steps.send
        if element.topic is None:
            raise refuse("a send task needs a message", element, wiring)
        node.topic, payload = element.topic.qualified, element.topic.payload or element.payload
        node.run = compiler.expression(payload, element, wiring.file) if payload else None
        address(wiring, element, element.topic, node)
    elif element.kind in ("service", "send"):  # of Camunda, which lets a send task call what a service task calls
        if not element.operation:
            raise refuse("a service task needs the name of what it calls", element, wiring)
        node.step, node.kind, node.variable = activities.evaluate, "script", element.result_variable
        node.run = service(wiring, element)
    elif element.kind == "business_rule":
        raise refuse("business rule tasks are not executed: DMN is not supported", element, wiring)


def service(wiring: Wiring, element: model.Task) -> Compiled:
    """The callable that a service task names."""
    try:
        return wiring.compiler.host.service(element.operation, element=element.id, file=wiring.file)
    except ModelError as error:  # the host knows no lines
        raise refuse(error.text, element, wiring) from None


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
    result = element.result_variable if isinstance(element, model.Task) else ""
    if result and all(item.target != result for item in io.outputs):  # a result is meant for the process
        node.outputs += ((result, lambda variables: variables.get(result, UNDEFINED)),)


def event_sub_process(wiring: Wiring, element: model.SubProcess) -> None:
    """An event sub-process: its start events are armed with the scope that it stands in."""
    compiler = wiring.compiler
    handler = compiler.node(element, steps.pass_on, wiring.file)
    handler.kind, handler.slot = "handler", compiler.slot(element.id)
    if compiler.observed:
        handler.act = steps.pass_on
    inner = type(wiring)(compiler, element, wiring.file, wiring)
    handler.body = compiler.body(element, wiring.file, handler=inner)
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
