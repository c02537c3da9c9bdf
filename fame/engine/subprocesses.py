"""Elements that open a scope: sub-processes, event sub-processes, call activities, tasks with own variables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fame.bpmn import model
from fame.dataclasses import dataclass
from fame.engine import compensation, faults, handlers, scopes, state, steps, waiting
from fame.engine.data import UNDEFINED, chained, plain
from fame.engine.engine_state import EngineState
from fame.engine.program import UNCOUNTED, Body, Compiled, FaultCatch, Handler, Node
from fame.engine.scope_compiler import ScopeCompiler
from fame.engine.state import DEPTH, Record, Scope, Wait


@dataclass(slots=True)
class ScopeActivity:
    """Spec of an activity that opens a scope.

    own              whether it has variables of its own; `shares`: chained to the outer ones
    inputs, outputs  its mapping: (variable, expression)
    all_in, all_out  whether all variables go into, or out of, a called process
    """

    own: bool = False
    shares: bool = True
    inputs: tuple[tuple[str, Compiled], ...] = ()
    outputs: tuple[tuple[str, Compiled], ...] = ()
    all_in: bool = False
    all_out: bool = False


# ---- steps ---------------------------------------------------------------------------------------


def enter(engine: EngineState, scope: Scope, node: Node) -> None:
    """Open the scope of an activity."""
    variables, spec = scope.variables, node.spec
    try:
        if scope.depth >= DEPTH:
            raise RecursionError(f"calls deeper than {DEPTH}")
        if scope.instance.scopes >= state.SCOPES:
            raise scopes.too_many()
        if spec.own:
            variables = _own_variables(engine, spec, variables)
    except BaseException as error:
        faults.fail(engine, scope, node, error)
        return
    assert node.body is not None
    inner = scopes.open_child(engine, scope, node, node.body, variables)
    if node.boundary is not None:
        waiting.arm_all(engine, node.boundary.armed, scope, inner)
    engine.ready.append((node.body.opening, inner))


def _own_variables(engine: EngineState, spec: ScopeActivity, outer: dict[str, Any]) -> dict[str, Any]:
    """Return the variables of an activity with a mapping: chained to the outer ones, or (of a call) separate."""
    inner = {name: source(outer) for name, source in spec.inputs}
    inner = {name: value for name, value in inner.items() if value is not UNDEFINED}
    if spec.shares:
        return chained(outer, inner)
    variables = engine.new_variables()
    variables.update({**plain(outer), **inner} if spec.all_in else inner)
    return variables


def leave(engine: EngineState, scope: Scope, inner: Scope) -> None:
    """Complete an activity whose scope has ended: pass on its results, and continue the token."""
    node = inner.node
    assert node is not None
    spec: ScopeActivity = node.spec
    results: Sequence[tuple[str, Any]] = ()
    if spec.own:
        try:
            results = [(name, source(inner.variables)) for name, source in spec.outputs]
        except BaseException as error:
            faults.fail(engine, scope, node, error)
            return
        if spec.all_out:
            results = [*plain(inner.variables).items(), *results]
    leave_with(engine, scope, inner, results)


def leave_with(engine: EngineState, scope: Scope, inner: Scope, results: Sequence[tuple[str, Any]]) -> None:
    """Set outer variables, and continue the token."""
    node = inner.node
    assert node is not None
    if inner.done or compensation.handler_of(node) is not None:
        try:
            compensation.remember(scope, compensation.record_of(node, inner))
        except RecursionError as error:
            faults.fail(engine, scope, node, error)
            return
    for name, value in results:
        if value is not UNDEFINED:
            scope.variables[name] = value
    scopes.complete(engine, scope, node)
    if results and engine.conditions:
        waiting.check_conditions(engine)


def fire_handler(engine: EngineState, wait: Wait) -> None:
    """Start an event sub-process whose start event has occurred."""
    try:
        handlers.begin_handler(engine, wait.scope, wait.node, wait.catch)
    except RecursionError as error:
        faults.fail(engine, wait.scope, wait.node, error, again=False)


def end_handler(engine: EngineState, scope: Scope, handler: Scope) -> Scope | None:
    """End a handler, and resume the scope that it suspended. Returns that scope if it ends, too."""
    node = handler.node
    assert node is not None
    scopes.count(engine, handler, node)
    if handler.done:
        compensation.remember(scope, Record(node, handler.variables, handler.done))
    scope.tokens -= 1
    if scope.suspender is handler:
        handlers.resume(engine, scope)
    return None if scope.tokens else scope


# ---- compiling -----------------------------------------------------------------------------------


def opening(context: ScopeCompiler, element: model.Activity, part: str = "") -> Node:
    """Make a node that opens a scope, without its body."""
    node = context.node(element, enter, part, ScopeActivity())
    node.ended = leave
    return node


def make(context: ScopeCompiler, element: model.SubProcess) -> Node:
    """Make an embedded sub-process or a transaction."""
    node = opening(context, element)
    inner = ScopeCompiler(context.compiler, element, context.file, context)
    node.body = inner.compile()
    inner.open_with(inner.begin())
    return node


def make_handler(context: ScopeCompiler, element: model.SubProcess) -> None:
    """Make an event sub-process."""
    handler = context.node(element, steps.pass_on, spec=Handler())
    handler.slot, handler.ended = context.slot(element.id), end_handler
    context.watch_event(handler)
    inner = ScopeCompiler(context.compiler, element, context.file, context)
    handler.body = inner.compile()
    starts = element.body.events("start")
    nodes = [(event, node) for event in starts for node in inner.triggers.get(event.id, ())]
    if not nodes:
        context.refuse("an event sub-process needs a start event with a trigger", element)
    for event, node in nodes:
        node.part_of = handler
        if isinstance(node.spec, FaultCatch) and node.spec.kind == "compensate":
            if context.compensation is not None:
                context.refuse("its scope has another event sub-process for compensation: expected one", element)
            context.compensation = node
            continue
        node.index, node.step = UNCOUNTED, steps.pass_on
        catch = node.catch or node.spec
        catch.resume = (element.resume or context.compiler.original) and event.interrupting
        if node.catch is not None:
            node.catch.fire = fire_handler
        context.handlers.append(node)


def make_call(context: ScopeCompiler, element: model.CallActivity) -> Node:
    """Make a call activity. A called process is compiled once, so that a process can call itself."""
    node = opening(context, element)
    compiler = context.compiler
    process, home = compiler.library(element.called, context.file, element)
    key = (home, process.id)
    node.body = compiler.called.get(key)
    if node.body is None:
        node.body = compiler.called[key] = Body(process.id)
        outside = compiler.original, compiler.unfilled
        compiler.admit(process, home)
        inner = ScopeCompiler(compiler, process, home, body=node.body, depth=context.inside(element))
        inner.compile()
        inner.open_with(inner.begin())
        compiler.original, compiler.unfilled = outside
    return node


def wrapped(context: ScopeCompiler, element: model.Activity, task: Node) -> Node:
    """Wrap a task that has its own variables in a scope."""
    node = opening(context, element, "/own")
    node.body = Body(element.id)
    task.key += "/inner"
    task.next = context.node(element, steps.end, "/inner/end")
    context.open_with(task, node.body, element.id)
    return node


def map_variables(context: ScopeCompiler, element: model.Activity, node: Node, io: model.IoMapping) -> None:
    """Set the mapping of an activity. The variables of a call are separate; those of a task are chained."""
    spec: ScopeActivity = node.spec
    spec.own, spec.shares = True, not isinstance(element, model.CallActivity)
    spec.all_in, spec.all_out = io.all_in, io.all_out
    spec.inputs = context.mapping(io.inputs, element)
    spec.outputs = context.mapping(io.outputs, element)
    result = element.result_variable if isinstance(element, model.Task) else ""
    if result and all(item.target != result for item in io.outputs):  # a result is meant for the process
        spec.outputs += ((result, lambda variables: variables.get(result, UNDEFINED)),)
