"""Triggers that start instances of a process, alone or several together (standard 13.2, 13.5.1).

A trigger starts an instance unless the maximum number is running. A *parallel multiple* start event starts one when all
of its triggers have occurred; until then they are gathered in sets of correlated triggers, with the first message of
each trigger; those that follow begin further sets if the event has a queue. A *parallel* event-based gateway starts an
instance with the first of its events; that instance then waits for the others, and an event that it waits for starts
no other instance.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from operator import itemgetter
from typing import Any

from fame.bpmn import model
from fame.engine import event_gateways, faults, scopes, tasks, waiting
from fame.engine.data import correlates, own_copy
from fame.engine.engine_state import EngineState
from fame.engine.program import Catch, Node, Start
from fame.engine.scope_compiler import ScopeCompiler, instantiates
from fame.engine.state import Arrived, Gathered, Instance, Listener, Scope

# ---- stimuli -------------------------------------------------------------------------------------


def open_instance(engine: EngineState, entry: Node, values: dict[str, Any] | None) -> Instance:
    """Make an instance with its first token at `entry`."""
    variables = engine.new_variables()
    if engine.parameters:
        variables.update({name: own_copy(value) for name, value in engine.parameters.items()})
    if values:
        variables.update(values)
    instance = Instance(engine.new_key(), engine.program, variables)
    root = Scope(engine.new_key(), None, None, engine.program.body, variables)
    root.instance, root.counts, instance.root, instance.scopes = instance, instance.counts, root, 1
    engine.instances[instance.key] = instance
    engine.host.begun(instance)
    if engine.program.observed:
        engine.notify(root, (engine.program.process, "start", None))
    engine.ready.append((entry, root))
    scopes.arm_scope(engine, root)
    return instance


def trigger(engine: EngineState, node: Node, message: Any) -> None:
    """Handle a trigger of a start event: start an instance, keep the trigger, or drop it."""
    if engine.held is not None:
        _keep_held(engine, node, message)
        return
    if engine.starts_no_more:
        return
    arrived: Arrived | None = [(node, message)]
    full = _is_full(engine)
    spec: Start = node.spec
    if full and any(_catch(one).queue for one in (_catch(spec.whole).parts if spec.whole is not None else (node,))):
        _keep(engine, node, message)  # one of several, too: they are gathered when an instance has ended
        return
    if spec.whole is not None:
        arrived, node = _gather(engine, spec.whole, node, message), spec.whole
    if arrived is None:
        return
    if full:
        running = f"{engine.program.instances} instance(s) of {engine.program.process} are already running"
        engine.host.report(node.id, f"trigger dropped: {running}")
    else:
        _begin(engine, node, arrived)


def _is_full(engine: EngineState) -> bool:
    """Return whether as many instances run as may."""
    return engine.program.instances is not None and len(engine.instances) >= engine.program.instances


def _keep(engine: EngineState, node: Node, message: Any) -> None:
    engine.waiting_starts.setdefault(node, deque(maxlen=_catch(node).kept)).append((engine.new_key(), message))


def _keep_held(engine: EngineState, node: Node, message: Any) -> None:
    """Keep a trigger until the engine is released: that of a timer once for all its times, a message in its queue."""
    if _catch(node).trigger is waiting.TIMER:
        if node not in engine.waiting_starts:
            _keep(engine, node, message)
        waiting.count_missed(engine, engine.waiting_starts[node][0][0])
    elif _catch(node).queue:
        _keep(engine, node, message)
    else:
        engine.host.report(node.id, "trigger dropped: the robot is on hold")


def begin_kept(engine: EngineState) -> None:
    """Handle the triggers that are kept, the oldest first, after the engine was held."""
    kept = [(key, node, message) for node, items in engine.waiting_starts.items() for key, message in items]
    engine.waiting_starts.clear()
    for key, node, message in sorted(kept, key=itemgetter(0)):
        waiting.report_missed(engine, key, node)
        trigger(engine, node, message)


def begin_waiting(engine: EngineState) -> None:
    """Start the next instance with the triggers that have waited longest, after one has ended."""
    waiting_starts = engine.waiting_starts
    while waiting_starts and engine.held is None and not _is_full(engine):
        node = min(waiting_starts, key=lambda start: waiting_starts[start][0][0])
        _, message = waiting_starts[node].popleft()
        if not waiting_starts[node]:
            del waiting_starts[node]
        trigger(engine, node, message)


def _begin(engine: EngineState, node: Node, arrived: Arrived) -> None:
    """Start an instance and give it the messages that have arrived."""
    instance = open_instance(engine, node, None)
    for event, message in arrived:
        catch = _catch(event)
        try:
            if catch.take is not None:
                catch.take(instance.root_variables, message)
            correlates(catch.keys, instance.root_variables, message)
        except BaseException as error:
            faults.abandon(engine, instance, event, f"{type(error).__name__}: {error}", "script", error)
            break
    if engine.conditions:
        waiting.check_conditions(engine)


def _gather(engine: EngineState, whole: Node, part: Node, message: Any) -> Arrived | None:
    """Keep one trigger of a parallel multiple event. Returns all of them if it was the last, else None."""
    sets, queue = engine.gathered.setdefault(whole, []), _catch(part).queue
    alike = [each for each in sets if correlates(_catch(part).keys, each[0], message)]
    having = [found for _, found in alike if part in found]
    if having and len(having) >= queue:
        if queue:  # the last ones are kept
            for found, following in zip(having, [*having[1:], {part: message}], strict=True):
                found[part] = following[part]
        return None
    fitting: Gathered | None = next((each for each in alike if part not in each[1]), None)
    if fitting is None:
        fitting = ({}, {})
        correlates(_catch(part).keys, fitting[0], message)
        sets.append(fitting)
    fitting[1][part] = message
    if len(fitting[1]) < len(_catch(whole).parts):
        return None
    sets[:] = [each for each in sets if each is not fitting]
    if not sets:
        del engine.gathered[whole]
    return list(fitting[1].items())


def _catch(node: Node) -> Catch:
    """Return the `Catch` of a start event."""
    assert node.catch is not None
    return node.catch


def is_awaited(node: Node, listeners: Sequence[Listener]) -> bool:
    """Return whether a running instance waits for an event of a parallel gateway, which then starts no other one."""
    event = node.spec.event
    return event is not None and any(listener.node.part_of is event for listener in listeners)


# ---- compiling -----------------------------------------------------------------------------------


def make(context: ScopeCompiler) -> None:
    """Make the starts of the process: start events, gateways and receive tasks."""
    program = context.compiler.program
    for element in context.content.nodes:
        for whole in _ways_in(context, element):
            for node in _catch(whole).parts or (whole,):
                if _catch(whole).trigger is waiting.ALL:
                    node.spec = Start(whole)
                _add(context, node, element)
    if (not program.starts and not program.timed) or context.none_starts():
        program.begin = context.begin()


def _ways_in(context: ScopeCompiler, element: model.FlowNode) -> list[Node]:
    """Return the triggers by which an element starts the process."""
    if element.place == "start":
        nodes = context.triggers.get(element.id, [])
        for node in nodes:
            if node.catch is None:
                context.refuse(f"{node.spec.kind} events cannot start a process", element)
            node.spec = Start()
        return nodes
    if isinstance(element, model.Gateway) and instantiates(element):
        if not element.all_events:
            _keep_nothing(context, [context.flows[id].target for id in element.outgoing])
        return event_gateways.instantiating(context, element)
    if isinstance(element, model.Task) and instantiates(element):
        _keep_nothing(context, [element.id])
        return tasks.instantiating(context, element)
    return []


def _keep_nothing(context: ScopeCompiler, ids: Sequence[str]) -> None:
    """Open no queues in an instance for events that start it: no token comes to them again."""
    starting = {id for id in ids if len(context.model[id].incoming) < 2}
    context.body.queued = tuple(node for node in context.body.queued if node.id not in starting)


def _add(context: ScopeCompiler, node: Node, element: model.FlowNode) -> None:
    """Add one trigger that starts the process."""
    program, catch = context.compiler.program, _catch(node)
    if catch.topic:
        program.starts[catch.topic] = (*program.starts.get(catch.topic, ()), node)
    elif catch.trigger is waiting.TIMER:
        program.timed = (*program.timed, node)
    else:
        context.refuse("conditional events cannot start a process: it has no variables before it starts", element)
