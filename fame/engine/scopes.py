"""Open, end, cancel and replace scopes, and wait for cancelled scripts.

Functions that cancel (`kill`, `replace`, `cancel_wait`) return the keys of the scripts that are still in ``finally``;
`proceed` takes them, and continues a token when the last of them has ended.
"""

from __future__ import annotations

from typing import Any

from fame.engine import state, waiting
from fame.engine.engine_state import EngineState
from fame.engine.program import Body, Node
from fame.engine.state import DEAD, Continuation, Instance, InstanceStatus, Scope, Wait

Cancelling = tuple[int, ...]
"""Keys of cancelled scripts that have not ended."""


def open_child(engine: EngineState, parent: Scope, node: Node, body: Body | None, variables: dict[str, Any]) -> Scope:
    scope = Scope(engine.new_key(), parent, node, body, variables)
    parent.children[scope] = None
    parent.instance.scopes += 1
    return scope


def too_many() -> RecursionError:
    """Return the error of an instance that exceeds `state.SCOPES` scopes."""
    return RecursionError(f"more than {state.SCOPES} calls, sub-processes and handlers at a time")


def arm_scope(engine: EngineState, scope: Scope) -> None:
    """Arm the event sub-processes of a scope, and open the queues of its catching events."""
    body = scope.body
    if body is None:
        return
    if body.queued:
        scope.mail = {node: waiting.open_mailbox(engine, node, scope) for node in body.queued}
    if body.armed:
        waits = []
        for node in body.armed:
            wait = Wait(engine.new_key(), node, scope, False, scope)
            scope.children[wait] = None
            waits.append(wait)
        for wait in waits:
            if wait.alive and not wait.paused:  # a condition that is already true ends or suspends the scope
                waiting.arm(engine, wait)


def close_scope(engine: EngineState, scope: Scope) -> None:
    """Close a scope and disarm its boundary events and everything that waits in it."""
    scope.state = DEAD
    scope.instance.scopes -= 1
    parent = scope.parent
    if parent is not None and parent.mail:
        waiting.pass_activity(engine, scope, parent)
    if scope.arms:
        for arm in scope.arms:
            waiting.disarm(engine, arm)
        scope.arms = ()
    if scope.children:
        for inner in scope.children:
            if inner.__class__ is Wait:
                waiting.disarm(engine, inner)
        scope.children = {}
    if scope.mail:
        for box in scope.mail.values():
            waiting.close_mailbox(engine, box)
        scope.mail = None
    if scope.joins is not None:
        engine.inclusive.pop(scope, None)
        scope.joins = None


def end_token(engine: EngineState, scope: Scope) -> None:
    """End a token, and with the last token its scope."""
    scope.tokens -= 1
    if not scope.tokens:
        finish(engine, scope)


def finish(engine: EngineState, scope: Scope) -> None:
    """End a scope without tokens, and the scopes around it that end with it."""
    following: Scope | None = scope
    while following is not None:
        scope = following
        node, parent = scope.node, scope.parent
        close_scope(engine, scope)
        for handler in scope.handles[::-1]:
            count(engine, scope, handler)
        if parent is None or node is None:
            conclude(engine, scope.instance, "completed")
            return
        parent.children.pop(scope, None)
        ended = node.ended
        following = ended(engine, parent, scope)


def conclude(engine: EngineState, instance: Instance, status: InstanceStatus) -> None:
    """Set the status of an instance that has ended."""
    instance.status = status
    engine.instances.pop(instance.key, None)
    if engine.program.observed:
        engine.notify(instance.root, (engine.program.process, "end", status))
    engine.host.ended(instance)
    del instance.root  # which refers to it: only the search for cycles would free them
    if engine.waiting_starts:
        engine.program.concluded(engine)


def count(engine: EngineState, scope: Scope, node: Node) -> None:
    """Count the completion of an element."""
    scope.counts[node.slot] += 1
    if node.plain_step is not None:
        engine.notify(scope, node.left)


def count_event(engine: EngineState, scope: Scope, node: Node) -> None:
    """Count an event that no token entered: observers see it entered and left."""
    scope.counts[node.slot] += 1
    if node.plain_step is not None:
        engine.notify(scope, node.entered)
        engine.notify(scope, node.left)


def complete(engine: EngineState, scope: Scope, node: Node) -> None:
    """Complete an element at which a token waited: the token continues."""
    scope.counts[node.slot] += 1
    if node.plain_step is not None:
        engine.notify(scope, node.left)
    engine.ready.append((node.next, scope))


# ---- cancellation --------------------------------------------------------------------------------


def replace(engine: EngineState, scope: Scope, handles: tuple[Node, ...]) -> tuple[Scope, Cancelling]:
    """Cancel a scope, and replace it by a new one with one token and the same boundary events."""
    parent = scope.parent
    replacement = Scope(engine.new_key(), parent, scope.node, None, scope.variables)
    replacement.handles, replacement.items, replacement.done = handles, scope.items, scope.done
    if scope.arms:
        replacement.arms, scope.arms = scope.arms, ()
        for arm in replacement.arms:
            arm.owner = replacement
    scope.instance.scopes += 1
    cancelling = kill(engine, scope, notified=False)
    if parent is None:
        replacement.instance, replacement.counts, scope.instance.root = scope.instance, scope.counts, replacement
    else:
        parent.children[replacement] = None
        if parent.suspender is scope:
            parent.suspender = replacement
    return replacement, cancelling


def kill(engine: EngineState, scope: Scope, *, notified: bool = True) -> Cancelling:
    """End a scope and all scopes in it at once. `notified`: observers see its own element cancelled, too."""
    if scope.parent is not None:
        scope.parent.children.pop(scope, None)
    if notified:
        notify_cancelled(engine, scope)
    cancelling: Cancelling = ()
    ended = [scope]
    for dying in ended:  # which grows
        cancelling += dying.cancelling
        for inner in dying.children:
            if inner.__class__ is Wait:
                cancelling += cancel_wait(engine, inner)
            else:
                assert isinstance(inner, Scope)
                notify_cancelled(engine, inner)
                ended.append(inner)
        dying.children = {}
    for dying in ended:
        close_scope(engine, dying)
    return cancelling


def notify_cancelled(engine: EngineState, scope: Scope) -> None:
    """Notify observers that a scope's element, and the event sub-processes that replaced it, are cancelled."""
    if scope.node is not None and scope.node.plain_step is not None and scope.parent is not None:
        engine.notify(scope.parent, (scope.node.id, "cancel", None))
    for handler in scope.handles:
        if handler.plain_step is not None:
            engine.notify(scope, (handler.id, "cancel", None))


def cancel_wait(engine: EngineState, wait: Wait) -> Cancelling:
    cancelling = cancel_script(engine, wait) if wait.started and not wait.paused else ()
    if wait.token and wait.node.plain_step is not None:
        engine.notify(wait.scope, (wait.node.id, "cancel", None))
    waiting.disarm(engine, wait)
    return cancelling


def cancel_script(engine: EngineState, wait: Wait) -> Cancelling:
    """Cancel the script of a wait. What the script publishes while it ends does not delay the current token."""
    ended = engine.host.cancel(wait.key)
    engine.unsettled = bool(engine.conditions)
    return () if ended else (wait.key,)


def proceed(engine: EngineState, node: Node, scope: Scope, cancelling: Cancelling) -> None:
    """Continue a token at `node` when the scripts that were just cancelled have ended."""
    if cancelling:
        continuation = Continuation(len(cancelling), node, scope)
        for key in cancelling:
            engine.cancelling[key] = continuation
            scope.cancelling += (key,)
    else:
        engine.ready.append((node, scope))


def subtree(scope: Scope) -> list[Scope]:
    """Return a scope and all scopes in it, outer ones first."""
    scopes, reached = [scope], 0
    while reached < len(scopes):
        scopes.extend(inner for inner in scopes[reached].children if isinstance(inner, Scope))
        reached += 1
    return scopes
