"""Suspension: what an event sub-process with ``resume=true`` does to its scope instead of cancelling it.

`suspend` holds everything that goes on in the scope when its handler begins, at any depth: scopes count the
suspensions that hold them in `state`, rests in `paused`. Tasks are cancelled, to be started again; catches are deaf;
timers run on and leave a mark in `due`. What begins in the scope while the handler runs (other event sub-processes) is
younger than the handler, and so not held.

`hold` does the same from outside to all that runs, whatever is suspended in it already, until `release`.
"""

from __future__ import annotations

from operator import attrgetter
from typing import TYPE_CHECKING

from fame.engine import activities, scopes, waiting
from fame.engine.state import Rest, Scope

if TYPE_CHECKING:
    from fame.engine.interpreter import Engine


def suspend(engine: Engine, scope: Scope, handler: Scope) -> None:
    """Hold all that goes on in a scope, but for `handler` and the other event sub-processes that wait there."""
    scope.suspender, scope.mark = handler, handler.key
    scope.state += 1
    for inner in held_scopes(scope):
        inner.state += 1
    for resting in held_rests(scope):
        pause(engine, resting)
    engine.host.make_safe("suspended")


def resume(engine: Engine, scope: Scope) -> None:
    """The handler has ended normally: all goes on."""
    scope.suspender = None
    go_on(engine, [scope, *held_scopes(scope)], held_rests(scope))


def hold(engine: Engine) -> None:
    """Hold all instances, and let none begin, until `release`."""
    scopes_held = [inner for instance in engine.instances.values() for inner in scopes.subtree(instance.root)]
    rests = in_order([rest for scope in scopes_held for rest in (*scope.arms, *rests_in(scope))])
    for scope in scopes_held:
        scope.state += 1
    for resting in rests:
        pause(engine, resting)
    engine.departing = []  # nothing goes on when they are out
    engine.held = scopes_held, rests
    engine.host.make_safe("suspended")


def release(engine: Engine) -> None:
    """What was held goes on. Its scripts have to be out."""
    if engine.held is not None:
        (held, rests), engine.held = engine.held, None
        go_on(engine, [scope for scope in held if scope.alive], [rest for rest in rests if rest.alive])


def go_on(engine: Engine, released: list[Scope], awake: list[Rest]) -> None:
    """Undo one suspension of these scopes and rests."""
    for inner in released:
        inner.state -= 1
        if not inner.state and inner.held:
            engine.ready.extend((node, inner) for node in inner.held)
            inner.held = ()
    for resting in awake:
        resting.paused -= 1
    fire_due(engine, awake)
    for resting in awake:
        if resting.alive and not resting.paused:
            revive(engine, resting)


def held_scopes(scope: Scope) -> list[Scope]:
    """The scopes in it, at any depth, that its suspension holds."""
    older = [inner for inner in scope.children if isinstance(inner, Scope) and inner.key < scope.mark]
    return [inner for outer in older for inner in scopes.subtree(outer)]


def held_rests(scope: Scope) -> list[Rest]:
    """The rests that its suspension holds, and what is armed because of them, in the order of arming."""
    found = [inner for inner in scope.children if isinstance(inner, Rest) and (inner.token or inner.node.resume)]
    for inner in held_scopes(scope):
        found += inner.arms
        found += rests_in(inner)
    return in_order(found)


def rests_in(scope: Scope) -> list[Rest]:
    """The rests of a scope itself."""
    return [inner for inner in scope.children if isinstance(inner, Rest)]


def in_order(found: list[Rest]) -> list[Rest]:
    """These rests and what is armed because of them, in the order of arming."""
    for resting in found:  # which grows
        found += resting.arms
    return sorted(found, key=attrgetter("key"))


def pause(engine: Engine, resting: Rest) -> None:
    """It stops listening (its queue does not); a running task is cancelled, to be started again."""
    resting.paused += 1
    if resting.paused == 1:
        if resting.started:
            scopes.leave_script(engine, resting)
        waiting.deafen(engine, resting)


def fire_due(engine: Engine, rests: list[Rest]) -> None:
    """Let those fire that came due while they were held, in due order."""
    due = [resting for resting in rests if resting.due and not resting.paused]
    for resting in sorted(due, key=attrgetter("due")):
        resting.due = 0
        waiting.fire(engine, resting)


def revive(engine: Engine, resting: Rest) -> None:
    """A rest that was held waits again; a task starts again; the handler's own trigger is armed anew."""
    kind = resting.node.kind
    if kind in ("signal", "message"):
        waiting.listen(engine, resting)
    elif kind == "condition":
        resting.true = False
        waiting.arm(engine, resting)
    elif kind == "timer":
        if resting.node.resume and resting.key not in engine.rests:
            waiting.set_timer(engine, resting)
    elif kind == "all":
        if not resting.arms:
            waiting.arm(engine, resting)
    elif resting.started:
        activities.restart(engine, resting)
