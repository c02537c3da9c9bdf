"""Compiles a process into a program: chooses the family that makes the nodes of each element."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from fame.bpmn import model
from fame.engine import adhoc, event_gateways, events, gateways, loops, starts, steps, subprocesses, tasks
from fame.engine.host import Host
from fame.engine.program import Node, Program
from fame.engine.scope_compiler import Compiler, FindProcess, ScopeCompiler

_EVENTS = {
    "start": events.start,
    "catch": events.catch,
    "throw": events.throwing,
    "end": events.throwing,
    "boundary": events.boundary,
}


def compile_program(
    process: model.Process,
    *,
    host: Host,
    library: FindProcess,
    file: str = "",
    texts: Callable[[], str] = str,
    observed: bool = False,
) -> Program:
    """Compile a process and all that it calls. `texts` gives the hash of their texts, or nothing.

    Raises ModelError (file, line, element) for what cannot be executed.
    """
    program = Program(process.id, texts, observed)
    compiler = Compiler(program, host, library, make)
    compiler.admit(process, file)
    program.instances = process.instances
    program.concluded = starts.begin_waiting
    context = ScopeCompiler(compiler, process, file)
    program.body = context.compile()
    starts.make(context)
    _make_keys_unique(program.nodes)
    return program


def make(context: ScopeCompiler, element: model.FlowNode) -> None:
    if isinstance(element, model.Event):
        _EVENTS[element.place](context, element)
    elif isinstance(element, model.Gateway):
        make_gateway = event_gateways.make if element.kind == "event" else gateways.make
        make_gateway(context, element)
    elif isinstance(element, model.SubProcess) and element.triggered_by_event:
        subprocesses.make_handler(context, element)
    elif isinstance(element, model.Activity):
        _activity(context, element)


def _activity(context: ScopeCompiler, element: model.Activity) -> None:
    """Make a task, sub-process or call activity: the node of its work, inside its mapping, inside its loop."""
    if element.refused:
        context.refuse(element.refused, element)
    node = _work(context, element)
    io = element.io
    if io is not None:
        activity = (
            node if isinstance(node.spec, subprocesses.ScopeActivity) else subprocesses.wrapped(context, element, node)
        )
        subprocesses.map_variables(context, element, activity, io)
        node = activity
    node.slot = context.slot(element.id)
    if node.step in tasks.COUNTED_STEPS:
        node.index = node.slot
    context.watch(node)
    if element.loop is not None:
        node = loops.repeated(context, element, element.loop, node)
    context.place(element, node)


def _work(context: ScopeCompiler, element: model.Activity) -> Node:
    """Make the node of an activity without its mapping and loop."""
    if isinstance(element, model.SubProcess):
        return adhoc.make(context, element) if element.kind == "adhoc" else subprocesses.make(context, element)
    if isinstance(element, model.CallActivity):
        return subprocesses.make_call(context, element)
    if isinstance(element, model.Task):
        return tasks.make(context, element)
    return context.node(element, steps.pass_on)


def _make_keys_unique(nodes: Iterable[Node]) -> None:
    """Number the keys that occur more than once: a called process can have the same ids as its caller."""
    seen: dict[str, int] = {}
    for node in nodes:
        seen[node.key] = seen.get(node.key, 0) + 1
        if seen[node.key] > 1:
            node.key += f"#{seen[node.key]}"
