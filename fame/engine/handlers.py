"""What catches: boundary events, which leave their activity, and event sub-processes, which handle their scope."""

from __future__ import annotations

from fame.engine import scopes, state, suspension
from fame.engine.engine_state import EngineState
from fame.engine.program import Catch, FaultCatch, Node
from fame.engine.scopes import Cancelling
from fame.engine.state import Scope, Wait


def take_boundary(
    engine: EngineState, scope: Scope, node: Node, how: Catch | FaultCatch, owner: Scope | Wait | None
) -> None:
    """A boundary event cancels its activity (`owner`, if it is still at work), or runs beside it.

    `how` says which, as the node's `Catch` or spec.
    """
    scopes.count_event(engine, scope, node)
    cancelling: Cancelling = ()
    if not how.interrupting:
        scope.tokens += 1
    elif isinstance(owner, Scope):
        cancelling = scopes.kill(engine, owner)
    elif owner is not None:
        scope.children.pop(owner, None)
        cancelling = scopes.cancel_wait(engine, owner)
    assert node.next is not None
    scopes.proceed(engine, node.next, scope, cancelling)


def begin_handler(engine: EngineState, scope: Scope, start: Node, how: Catch | FaultCatch) -> None:
    """Run an event sub-process: in place of its scope, while that is suspended, or beside it, as `how` says.

    Raises RecursionError if the instance has too many scopes.
    """
    if how.interrupting and not how.resume:
        open_handler(engine, start, *scopes.replace(engine, scope, (*scope.handles, start.part_of)))
        return
    if scope.instance.scopes >= state.SCOPES:
        raise scopes.too_many()
    scope.tokens += 1
    inner = scopes.open_child(engine, scope, start.part_of, None, scope.variables)
    open_handler(engine, start, inner, suspension.suspend(engine, scope, inner) if how.resume else ())


def open_handler(engine: EngineState, start: Node, scope: Scope, cancelling: Cancelling) -> None:
    """The handler starts, in its scope, when the scripts that were cancelled for it have ended."""
    handler = start.part_of
    if handler.plain_step is not None:
        engine.notify(scope, handler.entered)
    scopes.count_event(engine, scope, start)
    scope.body = handler.body
    assert start.next is not None
    scopes.proceed(engine, start.next, scope, cancelling)
    scopes.arm_scope(engine, scope)
