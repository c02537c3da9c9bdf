"""Events and flows: what happens when a token comes to a node, and when what it waits for is there.

A *step* gets a token in motion and gives the node that it moves to at once, or None: it rests, waits in line, or is
gone. A *fire* function is called when the stimulus of a rest has come. Both are plain functions that the compiler puts
into nodes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fame.engine import activities, faults, scopes, state, suspension, waiting
from fame.engine.host import BpmnError
from fame.engine.state import Node, Rest, Scope
from fame.engine.variables import UNDEFINED

if TYPE_CHECKING:
    from fame.engine.interpreter import Engine

# ---- passing on ----------------------------------------------------------------------------------


def pass_on(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """None events, plain tasks, merges."""
    return node.next


def flow(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """A sequence flow; these are nodes in observed programs alone."""
    if engine.place is not scope:
        engine.move(scope)
    note = engine.note
    note(node.entered)
    return node.next


def observed(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """The step of an element in an observed program, around its own; a sequence flow behind it is taken at once."""
    act = node.act
    assert act is not None
    if engine.place is not scope:
        engine.move(scope)
    note = engine.note
    note(node.entered)
    following = act(engine, scope, node)
    if following is not None:
        if engine.place is not scope:
            engine.move(scope)
        note = engine.note
        note(node.left)
        if following.step is flow:
            note(following.entered)
            return following.next
    return following


def observed_end(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """The same, of an element at which the token ends: it has completed before what it ends."""
    engine.tell(scope, node.entered)
    engine.tell(scope, node.left)
    act = node.act
    assert act is not None
    return act(engine, scope, node)


# ---- catching ------------------------------------------------------------------------------------


def wait(engine: Engine, scope: Scope, node: Node) -> None:
    """A user, manual or receive task, or a catching event: the token rests until its stimulus comes."""
    rest = waiting.rest(engine, node, scope)
    if rest.alive:
        waiting.arm(engine, rest)


def fire_catch(engine: Engine, rest: Rest) -> None:
    """What a resting token waits for is there."""
    scopes.withdraw(engine, rest)
    scopes.complete(engine, rest.scope, rest.node)


# ---- throwing ------------------------------------------------------------------------------------


def throw(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """Publish; own catchers hear it once the tokens ahead of it rest, then this token goes on."""
    try:
        value = node.run(scope.variables) if node.run is not None else None
        message = engine.host.publish(node.topic, None if value is UNDEFINED else value)
    except BaseException as error:
        return activities.failed(engine, scope, node, error)
    ready = engine.ready
    ready.append((None, (node.topic, message)))
    ready.append((node.next, scope))
    if node.act is not None:
        engine.tell(scope, node.left)
    return None


def send(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """A message for another process: own catchers do not hear it."""
    try:
        value = node.run(scope.variables) if node.run is not None else None
        value = None if value is UNDEFINED else value
        if node.to is None:
            engine.host.publish(node.topic, value)
        else:
            engine.host.send(node.topic, value, node.to(scope.variables))
    except BaseException as error:
        return activities.failed(engine, scope, node, error)
    return node.next


def code_of(node: Node, variables: dict[str, Any]) -> str | None:
    """The code of an error or escalation that is thrown. Raises ValueError for a computed one that is null."""
    if node.run is None:
        return node.code
    code = node.run(variables)
    if code is None or code is UNDEFINED:
        raise ValueError("the code is computed, and there is none: what it is computed of is not set")
    return str(code)


def raise_error(engine: Engine, scope: Scope, node: Node) -> None:
    """An error end event."""
    try:
        code = code_of(node, scope.variables)
    except BaseException as error:
        faults.fail(engine, scope, node, error)
        return
    faults.fail(engine, scope, node, BpmnError(code or ""))


def escalate(engine: Engine, scope: Scope, node: Node) -> None:
    """An escalation: the token is first in line, and goes on unless its scope is cancelled or suspended."""
    try:
        code = code_of(node, scope.variables)
    except BaseException as error:
        activities.failed(engine, scope, node, error)
        return
    if node.act is not None:
        engine.tell(scope, node.left)
    engine.ready.appendleft((node.next, scope))
    faults.escalate(engine, scope, node, code)


# ---- ending --------------------------------------------------------------------------------------


def end(engine: Engine, scope: Scope, node: Node) -> None:
    """A none end event, or an element without a way out."""
    scope.tokens -= 1
    if not scope.tokens:
        scopes.finish(engine, scope)


def terminate(engine: Engine, scope: Scope, node: Node) -> None:
    """Ends the innermost body; of a handler that suspends its scope, that scope with it."""
    if scope.parent is not None and scope.parent.suspender is scope:
        scope = scope.parent
    heir = scopes.replace(engine, scope, scope.handles)
    if scope.parent is None:
        engine.host.make_safe("terminated")
    scopes.proceed(engine, FINISH, heir)


def finish(engine: Engine, scope: Scope, node: Node) -> None:
    """What a terminate goes on with when all that it cancelled is out."""
    scopes.finish(engine, scope)


def conclude_failed(engine: Engine, scope: Scope, node: Node) -> None:
    """What an uncaught error goes on with."""
    scopes.close_scope(engine, scope)
    engine.conclude(scope.instance, "failed")


FINISH = Node("", "(finish)", finish)
FAILED = Node("", "(failed)", conclude_failed)


# ---- boundary events and event sub-processes -----------------------------------------------------


def fire_boundary(engine: Engine, rest: Rest) -> None:
    """A boundary event has come."""
    assert rest.owner is not None
    take_boundary(engine, rest.scope, rest.node, rest.owner)


def take_boundary(engine: Engine, scope: Scope, node: Node, owner: Scope | Rest) -> None:
    """A boundary event cancels its activity, or runs beside it."""
    scopes.happen(engine, scope, node)
    if not node.interrupting:
        scope.tokens += 1
    elif isinstance(owner, Scope):
        scopes.kill(engine, owner)
    else:
        scope.children.pop(owner, None)
        scopes.cancel_rest(engine, owner)
    assert node.next is not None
    scopes.proceed(engine, node.next, scope)


def fire_handler(engine: Engine, rest: Rest) -> None:
    """The start of an event sub-process was triggered."""
    begin_handler(engine, rest.scope, rest.node)


def begin_handler(engine: Engine, scope: Scope, start: Node) -> None:
    """Run an event sub-process: in place of its scope, while that is suspended, or beside it."""
    handler = start.guard
    if start.interrupting and not start.resume:
        open_handler(engine, scopes.replace(engine, scope, (*scope.handles, handler)), start)
        return
    if scope.instance.scopes >= state.SCOPES:
        faults.fail(engine, scope, start, scopes.crowd())
        return
    scope.tokens += 1
    inner = scopes.child(engine, scope, handler, None, scope.variables)
    if start.resume:
        suspension.suspend(engine, scope, inner)
    open_handler(engine, inner, start)


def open_handler(engine: Engine, scope: Scope, start: Node) -> None:
    """The handler starts when all that was cancelled for it is out."""
    handler = start.guard
    if handler.act is not None:
        engine.tell(scope, handler.entered)
    scopes.happen(engine, scope, start)
    scope.body = handler.body
    assert start.next is not None
    scopes.proceed(engine, start.next, scope)
    scopes.open_scope(engine, scope)
