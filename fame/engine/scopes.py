"""Scopes: how they open, end, are cancelled and replaced, and what waits for what is cancelled.

Whoever cancels (`kill`, `replace`, `cancel_rest`) says what goes on afterwards through `proceed`: at once, or when the
last of the cancelled scripts is out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fame.engine import activities, compensation, loops, state, suspension, waiting
from fame.engine.state import DEAD, Body, Departure, Node, Record, Rest, Scope

if TYPE_CHECKING:
    from fame.engine.interpreter import Engine


def child(engine: Engine, parent: Scope, node: Node, body: Body | None, variables: dict[str, Any]) -> Scope:
    """A new scope inside another."""
    scope = Scope(engine.new_key(), parent, node, body, variables)
    parent.children[scope] = None
    parent.instance.scopes += 1
    return scope


def crowd() -> RecursionError:
    """The error of an instance that would have too many scopes at a time."""
    return RecursionError(f"more than {state.SCOPES} calls, sub-processes and handlers at a time")


def open_scope(engine: Engine, scope: Scope) -> None:
    """Arm what listens as long as the scope lives: event sub-processes, and queues of catching events."""
    body = scope.body
    if body is None:
        return
    if body.queued:
        keep_messages(engine, scope, body.queued)
    if body.armed:
        rests = []
        for node in body.armed:
            rest = Rest(engine.new_key(), node, scope, False, scope)
            scope.children[rest] = None
            rests.append(rest)
        for rest in rests:
            if rest.alive and not rest.paused:  # a condition that is true already ends or suspends the scope
                waiting.arm(engine, rest)


def keep_messages(engine: Engine, scope: Scope, nodes: tuple[Node, ...]) -> None:
    """Let catching events have their queues."""
    scope.mail = {node: waiting.mailbox(engine, node, scope) for node in nodes}


def close_scope(engine: Engine, scope: Scope) -> None:
    """The opposite, with all that guards it."""
    scope.state = DEAD
    scope.instance.scopes -= 1
    if scope.arms:
        for arm in scope.arms:
            waiting.disarm(engine, arm)
        scope.arms = ()
    if scope.children:
        for inner in scope.children:
            if inner.__class__ is Rest:
                waiting.disarm(engine, inner)
        scope.children = {}
    if scope.mail:
        for box in scope.mail.values():
            waiting.drop(engine, box)
        scope.mail = None
    if scope.joins is not None:
        engine.inclusive.pop(scope, None)
        scope.joins = None


def end_token(engine: Engine, scope: Scope) -> None:
    """A token ends; with the last one, the scope."""
    scope.tokens -= 1
    if not scope.tokens:
        finish(engine, scope)


def finish(engine: Engine, scope: Scope) -> None:
    """The last token of a scope is gone: the scope ends, and so may those around it."""
    while True:
        node, parent = scope.node, scope.parent
        close_scope(engine, scope)
        for handler in scope.handles[::-1]:
            count(engine, scope, handler)
        if parent is None:
            engine.conclude(scope.instance, "completed")
            return
        parent.children.pop(scope, None)
        assert node is not None
        if node.kind == "instance":
            loops.end_instance(engine, parent, scope)
            return
        if node.kind == "undo":
            compensation.undo_next(engine, parent)
            return
        if node.kind != "handler":
            activities.leave(engine, parent, node, scope)
            return
        count(engine, scope, node)
        if scope.done:
            compensation.remember(parent, Record(node, scope.variables, scope.done))
        parent.tokens -= 1
        if parent.suspender is scope:
            suspension.resume(engine, parent)
        if parent.tokens:
            return
        scope = parent


def count(engine: Engine, scope: Scope, node: Node) -> None:
    """An element has completed."""
    scope.counts[node.slot] += 1
    if node.act is not None:
        engine.tell(scope, node.left)


def happen(engine: Engine, scope: Scope, node: Node) -> None:
    """An event at which no token came has happened: it is entered and left in one."""
    scope.counts[node.slot] += 1
    if node.act is not None:
        engine.tell(scope, node.entered)
        engine.tell(scope, node.left)


def complete(engine: Engine, scope: Scope, node: Node) -> None:
    """An element at which a token rested has completed: the token goes on."""
    scope.counts[node.slot] += 1
    if node.act is not None:
        engine.tell(scope, node.left)
    engine.ready.append((node.next, scope))


# ---- cancellation --------------------------------------------------------------------------------


def replace(engine: Engine, scope: Scope, handles: tuple[Node, ...]) -> Scope:
    """Cancel what goes on in a scope; a new one takes its place, with one token, under the same guards."""
    parent = scope.parent
    heir = Scope(engine.new_key(), parent, scope.node, None, scope.variables)
    heir.handles, heir.items, heir.done = handles, scope.items, scope.done
    if scope.arms:
        heir.arms, scope.arms = scope.arms, ()
        for arm in heir.arms:
            arm.owner = heir
    scope.instance.scopes += 1
    kill(engine, scope, False)
    if parent is None:
        heir.instance, heir.counts, scope.instance.root = scope.instance, scope.counts, heir
    else:
        parent.children[heir] = None
        if parent.suspender is scope:
            parent.suspender = heir
    return heir


def kill(engine: Engine, scope: Scope, told: bool = True) -> None:
    """Mark a subtree dead at once; `told`: observers hear that its own element was cancelled, too."""
    if scope.parent is not None:
        scope.parent.children.pop(scope, None)
    if told:
        tell_cancelled(engine, scope)
    doomed = [scope]
    for victim in doomed:  # which grows
        if victim.leaving:
            engine.departing.extend(victim.leaving)
        for inner in victim.children:
            if inner.__class__ is Rest:
                cancel_rest(engine, inner)
            else:
                assert isinstance(inner, Scope)
                tell_cancelled(engine, inner)
                doomed.append(inner)
        victim.children = {}
    for victim in doomed:
        close_scope(engine, victim)


def tell_cancelled(engine: Engine, scope: Scope) -> None:
    """Observers hear that the element of a scope was cancelled, and the event sub-processes that took its place."""
    if scope.node is not None and scope.node.act is not None and scope.parent is not None:
        engine.tell(scope.parent, (scope.node.id, "cancel", None))
    for handler in scope.handles:
        if handler.act is not None:
            engine.tell(scope, (handler.id, "cancel", None))


def cancel_rest(engine: Engine, rest: Rest) -> None:
    """A token at rest is cancelled."""
    if rest.started and not rest.paused:
        leave_script(engine, rest)
    if rest.token and rest.node.act is not None:
        engine.tell(rest.scope, (rest.node.id, "cancel", None))
    waiting.disarm(engine, rest)


def leave_script(engine: Engine, rest: Rest) -> None:
    """Cancel the script of a rest; if it takes its time, `proceed` will wait for it."""
    if not engine.host.cancel(rest.key):
        engine.departing.append(rest.key)
    engine.alert = bool(engine.conditions)  # what it published on its way out is no matter of the token at work


def withdraw(engine: Engine, rest: Rest) -> None:
    """A token leaves its rest, or what was armed fires for the last time."""
    rest.scope.children.pop(rest, None)
    waiting.disarm(engine, rest)


def proceed(engine: Engine, node: Node, scope: Scope) -> None:
    """A token goes to `node` when all that was just cancelled is out."""
    if engine.departing:
        departure = Departure(len(engine.departing), node, scope)
        for key in engine.departing:
            engine.leaving[key] = departure
            scope.leaving += (key,)
        engine.departing = []
    else:
        engine.ready.append((node, scope))


def subtree(scope: Scope) -> list[Scope]:
    """A scope and all scopes in it, outer ones first."""
    found, reached = [scope], 0
    while reached < len(found):
        found.extend(inner for inner in found[reached].children if isinstance(inner, Scope))
        reached += 1
    return found
