"""Event sub-processes: armed with the scope that they stand in; `handlers` has what happens when they are triggered."""

from __future__ import annotations

from fame.bpmn import model
from fame.engine import compensation, faults, handlers, scopes, steps, suspension
from fame.engine.engine_state import EngineState
from fame.engine.program import UNCOUNTED, FaultCatch, Handler
from fame.engine.scope_compiler import ScopeCompiler
from fame.engine.state import Record, Scope, Wait

# ---- steps ---------------------------------------------------------------------------------------


def fire(engine: EngineState, wait: Wait) -> None:
    """The start of an event sub-process was triggered."""
    try:
        handlers.begin_handler(engine, wait.scope, wait.node, wait.catch)
    except RecursionError as error:
        faults.fail(engine, wait.scope, wait.node, error)


def ended(engine: EngineState, scope: Scope, handler: Scope) -> Scope | None:
    """The last token of a handler is gone: what it suspended goes on; if that has no token left, it ends too."""
    node = handler.node
    assert node is not None
    scopes.count(engine, handler, node)
    if handler.done:
        compensation.remember(scope, Record(node, handler.variables, handler.done))
    scope.tokens -= 1
    if scope.suspender is handler:
        suspension.resume(engine, scope)
    return None if scope.tokens else scope


# ---- compiling -----------------------------------------------------------------------------------


def make(context: ScopeCompiler, element: model.SubProcess) -> None:
    """An event sub-process."""
    handler = context.node(element, steps.pass_on, spec=Handler())
    handler.slot, handler.ended = context.slot(element.id), ended
    context.watch_event(handler)
    inner = ScopeCompiler(context.compiler, element, context.file, context)
    handler.body = inner.compile()
    starts = [item for item in element.body.nodes if isinstance(item, model.Event) and item.place == "start"]
    nodes = [(event, node) for event in starts for node in inner.triggers.get(event.id, ())]
    if not nodes:
        context.refuse("an event sub-process needs a start event with a trigger", element)
    for event, node in nodes:
        node.part_of = handler
        if isinstance(node.spec, FaultCatch) and node.spec.kind == "compensate":
            context.compensation = node
            continue
        node.index, node.step = UNCOUNTED, steps.pass_on
        how = node.catch or node.spec
        how.resume = (element.resume or context.compiler.original) and event.interrupting
        if node.catch is not None:
            node.catch.fire = fire
        context.handlers.append(node)
