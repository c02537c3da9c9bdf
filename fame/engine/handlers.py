"""Boundary events, event sub-processes, and suspension of the scopes that they interrupt.

An event sub-process with ``resume=true`` suspends its scope instead of cancelling it. `suspend` holds everything that
is active in the scope when its handler starts, at any depth: scopes count their suspensions in `state`, waits in
`paused`. Tasks are cancelled, to be started again; catching events do not listen; timers continue, and set `due` when
they fire. Event sub-processes that start while the handler runs have greater keys than the handler and are not held.

`hold` suspends all running instances from outside, whatever is suspended in them already, until `release`.
"""

from __future__ import annotations

from operator import attrgetter

from fame.engine import scopes, state, waiting
from fame.engine.engine_state import EngineState
from fame.engine.program import Catch, FaultCatch, Node
from fame.engine.scopes import Cancelling
from fame.engine.state import Scope, Wait


def take_boundary(
    engine: EngineState, scope: Scope, node: Node, catch: Catch | FaultCatch, owner: Scope | Wait | None
) -> None:
    """Start a token at a boundary event, and cancel its activity (`owner`, if still active) if it interrupts.

    `catch` is the `Catch` or the spec of the node.
    """
    scopes.count_event(engine, scope, node)
    cancelling: Cancelling = ()
    if not catch.interrupting:
        scope.tokens += 1
    elif isinstance(owner, Scope):
        cancelling = scopes.kill(engine, owner)
    elif owner is not None:
        scope.children.pop(owner, None)
        cancelling = scopes.cancel_wait(engine, owner)
    assert node.next is not None
    scopes.proceed(engine, node.next, scope, cancelling)


def begin_handler(engine: EngineState, scope: Scope, start: Node, catch: Catch | FaultCatch) -> None:
    """Start an event sub-process that replaces its scope, suspends it, or runs in parallel, as `catch` says.

    Raises RecursionError if the instance has too many scopes.
    """
    if catch.interrupting and not catch.resume:
        open_handler(engine, start, *scopes.replace(engine, scope, (*scope.handles, start.part_of)))
        return
    if scope.instance.scopes >= state.SCOPES:
        raise scopes.too_many()
    scope.tokens += 1
    inner = scopes.open_child(engine, scope, start.part_of, None, scope.variables)
    open_handler(engine, start, inner, suspend(engine, scope, inner) if catch.resume else ())


def open_handler(engine: EngineState, start: Node, scope: Scope, cancelling: Cancelling) -> None:
    """Start a handler in its scope when the scripts that were cancelled for it have ended."""
    handler = start.part_of
    if handler.plain_step is not None:
        engine.notify(scope, handler.entered)
    scopes.count_event(engine, scope, start)
    body = scope.body = handler.body
    assert body is not None
    assert start.next is not None
    if cancelling:
        scopes.proceed(engine, start.next, scope, cancelling)
    else:
        engine.ready.append((start.next, scope))
    if body.armed or body.queued:
        scopes.arm_scope(engine, scope)


# ---- suspension ----------------------------------------------------------------------------------


def suspend(engine: EngineState, scope: Scope, handler: Scope) -> Cancelling:
    """Suspend a scope except `handler` and the other armed event sub-processes."""
    engine.suspensions += 1
    scope.suspender, scope.mark = handler, handler.key
    scope.state += 1
    for inner in _held_scopes(scope):
        inner.state += 1
    cancelling: Cancelling = ()
    for wait in _held_waits(scope):
        cancelling += _pause(engine, wait)
    engine.host.make_safe("suspended")
    return cancelling


def resume(engine: EngineState, scope: Scope) -> None:
    """Resume the scope: the handler has ended normally."""
    scope.suspender = None
    _continue(engine, [scope, *_held_scopes(scope)], _held_waits(scope))


def hold(engine: EngineState, *, safe: bool = True) -> None:
    """Suspend all instances, and let none start, until `release`. No token continues when cancelled scripts end."""
    held = [inner for instance in engine.instances.values() for inner in scopes.subtree(instance.root)]
    waits = _in_order([wait for scope in held for wait in (*scope.arms, *_waits_in(scope))])
    for scope in held:
        scope.state += 1
    for wait in waits:
        _pause(engine, wait)
    engine.held = held, waits
    if safe:
        engine.host.make_safe("suspended")


def release(engine: EngineState) -> None:
    """Continue what was held. Its scripts must have ended."""
    if engine.held is not None:
        (held, waits), engine.held = engine.held, None
        _continue(engine, [scope for scope in held if scope.alive], [wait for wait in waits if wait.alive])


def _continue(engine: EngineState, released: list[Scope], awake: list[Wait]) -> None:
    """Undo one suspension of these scopes and waits."""
    for inner in released:
        inner.state -= 1
        if not inner.state and inner.held:
            engine.ready.extend((node, inner) for node in inner.held)
            inner.held = ()
    for wait in awake:
        wait.paused -= 1
    _fire_due(engine, awake)
    for wait in awake:
        if wait.alive and not wait.paused:
            wait.catch.trigger.resume(engine, wait)


def _held_scopes(scope: Scope) -> list[Scope]:
    """Return the scopes in it, at any depth, that its suspension holds."""
    older = [inner for inner in scope.children if isinstance(inner, Scope) and inner.key < scope.mark]
    return [inner for outer in older for inner in scopes.subtree(outer)]


def _held_waits(scope: Scope) -> list[Wait]:
    """Return the waits that its suspension holds, and what is armed because of them, in the order of arming."""
    waits = [inner for inner in scope.children if isinstance(inner, Wait) and (inner.token or inner.catch.resume)]
    for inner in _held_scopes(scope):
        waits += inner.arms
        waits += _waits_in(inner)
    return _in_order(waits)


def _waits_in(scope: Scope) -> list[Wait]:
    """Return the waits of a scope itself."""
    return [inner for inner in scope.children if isinstance(inner, Wait)]


def _in_order(waits: list[Wait]) -> list[Wait]:
    """Return these waits and what is armed because of them, in the order of arming."""
    for wait in waits:  # which grows
        waits += wait.arms
    return sorted(waits, key=attrgetter("key"))


def _pause(engine: EngineState, wait: Wait) -> Cancelling:
    """Let a wait stop listening (its queue goes on), and cancel its running task, to be started again."""
    wait.paused += 1
    if wait.paused > 1:
        return ()
    wait.catch.trigger.suspend(engine, wait)
    return scopes.cancel_script(engine, wait) if wait.started else ()


def _fire_due(engine: EngineState, waits: list[Wait]) -> None:
    """Fire the waits that came due while they were held, in that order."""
    due = [wait for wait in waits if wait.due and not wait.paused]
    for wait in sorted(due, key=attrgetter("due")):
        wait.due = 0
        waiting.report_missed(engine, wait.key, wait.node)
        waiting.fire(engine, wait)
