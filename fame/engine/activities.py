"""Tasks, sub-processes and call activities: how they start, wait and end."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fame.engine import compensation, faults, scopes, state, waiting
from fame.engine.state import DEPTH, Node, Record, Rest, Scope
from fame.engine.variables import UNDEFINED, Variables, plain

if TYPE_CHECKING:
    from fame.engine.interpreter import Engine

# ---- tasks ---------------------------------------------------------------------------------------


def script(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """A script task: over at once, or suspended."""
    run = node.run
    try:
        suspended = run(scope.variables)
    except BaseException as error:
        return failed(engine, scope, node, error)
    if suspended is None:
        return settle(engine, scope, node) if engine.alert else node.next
    return suspend(engine, scope, node, suspended)


def evaluate(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """A task that evaluates an expression, or calls a service that is a function, and may keep the result."""
    try:
        value = node.run(scope.variables)
    except BaseException as error:
        return failed(engine, scope, node, error)
    if hasattr(value, "send") and hasattr(value, "throw"):
        return suspend(engine, scope, node, value)
    if node.variable:
        scope.variables[node.variable] = value
    return settle(engine, scope, node) if engine.alert else node.next


def assign(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """Data objects at an association of an activity or throwing event: before it starts, after it has ended."""
    variables = scope.variables
    try:
        for name, source in node.inputs:
            value = source(variables)
            if value is not UNDEFINED:
                variables[name] = value
        for name in node.required:
            if name not in variables:
                engine.host.lacks(node.id, name)
    except BaseException as error:
        faults.fail(engine, scope, node, error)
        return None
    return settle(engine, scope, node) if engine.alert else node.next


def settle(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """Variables may have changed while conditional events are armed, or the script has published.

    Behind its own message the token goes to the back of the queue, like that of a throwing event; else it stays first,
    and the conditions are looked at before it goes on.
    """
    ready = engine.ready
    if node.act is not None:
        engine.tell(scope, node.left)
    engine.alert = bool(engine.conditions)
    if ready and ready[-1][0] is None:
        ready.append((node.next, scope))
    else:
        ready.appendleft((node.next, scope))
    if engine.conditions:
        waiting.check_conditions(engine)
    return None


def failed(engine: Engine, scope: Scope, node: Node, error: BaseException) -> Node | None:
    """A step that counts as it is entered has not completed after all."""
    scope.counts[node.index] -= 1
    faults.fail(engine, scope, node, error)
    return None


def suspend(engine: Engine, scope: Scope, node: Node, suspended: Any) -> Node | None:
    """A script waits: its token rests, and the host drives it on."""
    scope.counts[node.index] -= 1
    engine.alert = bool(engine.conditions)
    drive(engine, waiting.rest(engine, node, scope), suspended)
    if engine.conditions:
        waiting.check_conditions(engine)
    return None


def restart(engine: Engine, rest: Rest) -> None:
    """A script that a suspension cancelled starts again, with the variables as they are now."""
    scope, node = rest.scope, rest.node
    engine.rests.pop(rest.key, None)
    rest.key, rest.started = engine.new_key(), False
    try:
        suspended = node.run(scope.variables)
    except BaseException as error:
        scopes.withdraw(engine, rest)
        faults.fail(engine, scope, node, error)
        return
    if suspended is None:
        scopes.withdraw(engine, rest)
        scopes.complete(engine, scope, node)
    else:
        drive(engine, rest, suspended)
    if engine.conditions:
        waiting.check_conditions(engine)


def drive(engine: Engine, rest: Rest, suspended: Any) -> None:
    """Hand a suspended script to the host."""
    if not rest.alive:  # a conditional boundary event fired as it was armed
        suspended.close()
        return
    engine.rests[rest.key] = rest
    rest.started = True
    engine.host.run(rest.key, suspended)
    engine.alert = bool(engine.conditions)


def over(engine: Engine, rest: Rest, error: BaseException | None) -> None:
    """A suspended script is over: done or failed."""
    scopes.withdraw(engine, rest)
    if error is None:
        scopes.complete(engine, rest.scope, rest.node)
    else:
        faults.fail(engine, rest.scope, rest.node, error)
    if engine.conditions:
        waiting.check_conditions(engine)


# ---- sub-processes and calls ---------------------------------------------------------------------


def enter(engine: Engine, scope: Scope, node: Node) -> None:
    """A sub-process or call activity, or a task with variables of its own."""
    if scope.depth >= DEPTH:
        faults.fail(engine, scope, node, RecursionError(f"calls deeper than {DEPTH}"))
        return
    if scope.instance.scopes >= state.SCOPES:
        faults.fail(engine, scope, node, scopes.crowd())
        return
    variables = scope.variables
    if node.own:
        try:
            variables = own_variables(engine, node, variables)
        except BaseException as error:
            faults.fail(engine, scope, node, error)
            return
    assert node.body is not None
    inner = scopes.child(engine, scope, node, node.body, variables)
    if node.armed:
        waiting.guard(engine, node.armed, scope, inner)
    engine.ready.append((node.body.opening, inner))


def own_variables(engine: Engine, node: Node, outer: dict[str, Any]) -> dict[str, Any]:
    """The variables of an activity with a mapping: chained to those outside, or (of a call) apart from them."""
    inner = {name: source(outer) for name, source in node.inputs}
    inner = {name: value for name, value in inner.items() if value is not UNDEFINED}
    if node.shares:
        return Variables(outer, inner)
    variables = engine.new_variables()
    variables.update({**plain(outer), **inner} if node.all_in else inner)
    return variables


def opening(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """First node of a body in which something listens as long as it lives."""
    scopes.open_scope(engine, scope)
    if scope.state:  # a condition was true already
        engine.ready.appendleft((node.next, scope))
        return None
    return node.next


def leave(engine: Engine, scope: Scope, node: Node, inner: Scope) -> None:
    """What `enter` began has ended: its results go out, and the token goes on."""
    try:
        found = results(node, inner) if node.outputs or node.all_out or node.loop is not None else ()
    except BaseException as error:
        faults.fail(engine, scope, node, error)
        return
    if inner.done or compensation.handler_of(node) is not None:
        compensation.remember(scope, Record(node, inner.variables, inner.done or []))
    for name, value in found:
        if value is not UNDEFINED:
            scope.variables[name] = value
    scopes.complete(engine, scope, node)
    if found and engine.conditions:
        waiting.check_conditions(engine)


def results(node: Node, inner: Scope) -> list[tuple[str, Any]]:
    """What an activity that repeats, or has a mapping, gives to the variables outside."""
    if node.loop is not None:
        return [(node.loop.output, inner.items["out"])] if node.loop.output else []
    mapped = [(name, source(inner.variables)) for name, source in node.outputs]
    return [*plain(inner.variables).items(), *mapped] if node.all_out else mapped
