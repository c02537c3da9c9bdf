"""Errors and escalations: how they climb until something catches them (DESIGN section 3; standard 13.5.2).

From the failing activity outwards: its boundary events, then the event sub-process of its scope; then the activity
that this scope is has failed, through sub-processes and calls alike. What fails in a handler has failed outside the
scope that it handles.
"""

from __future__ import annotations

import dis
from typing import TYPE_CHECKING

from fame.engine import scopes, steps, waiting
from fame.engine.host import BpmnError
from fame.engine.state import Node, Scope

if TYPE_CHECKING:
    from fame.engine.interpreter import Engine

_RAISE = (dis.opmap["RAISE_VARARGS"], dis.opmap["RERAISE"])


def fail(engine: Engine, scope: Scope, node: Node, error: BaseException) -> None:
    """An element failed: find who catches it, else the instance fails."""
    if isinstance(error, KeyboardInterrupt) and is_from_outside(error):
        raise error
    code = error.code if isinstance(error, BpmnError) else "script"
    text = str(error) or type(error).__name__
    if node.guard.act is not None:
        engine.tell(scope, (node.id, "fail", code))
    failing: Node | None = node.guard
    place: Scope | None = scope
    inner: Scope | None = None  # the scope that the failing activity is, if it is one
    if node.guard.kind == "handler":  # the trigger of an event sub-process is part of it
        inner, failing, place = outside(scope)
    while place is not None and failing is not None:
        catcher = matching(failing.errors, code)
        if catcher is not None:
            note(catcher, place, code, text)
            scopes.happen(engine, place, catcher)
            if inner is not None:
                scopes.kill(engine, inner)
            assert catcher.next is not None
            scopes.proceed(engine, catcher.next, place)
            break
        handler = matching(place.body.errors, code) if place.body is not None else None
        if handler is not None:
            note(handler, place, code, text)
            steps.open_handler(engine, scopes.replace(engine, place, (*place.handles, handler.guard)), handler)
            break
        inner, failing, place = outside(place)
    else:
        engine.abandon(scope.instance, node, describe(error, code) + _called_at(scope, node), code, error)
    if engine.conditions:
        waiting.check_conditions(engine)


def outside(scope: Scope) -> tuple[Scope, Node | None, Scope | None]:
    """What fails with a scope: that scope, the activity that it is, and the scope of this.

    With an event sub-process fails what it handles, which may be one as well.
    """
    while scope.node is not None and scope.node.kind == "handler" and scope.parent is not None:
        scope = scope.parent
    return scope, scope.node, scope.parent


def _called_at(scope: Scope, node: Node) -> str:
    """What stands in another file was called: where the mission did so."""
    call: Node | None = None
    place: Scope | None = scope
    while place is not None:
        if place.node is not None and place.node.file != node.file:
            call = place.node
        place = place.parent
    return f"; called at {call.id} ({call.file}:{call.line})" if call is not None else ""


def escalate(engine: Engine, scope: Scope, node: Node, code: str | None) -> None:
    """An escalation climbs likewise; the thrower goes on unless something interrupting caught it."""
    place: Scope | None = scope
    while place is not None:
        handler = matching(place.body.escalations, code) if place.body is not None else None
        if handler is not None and not (handler.resume and place.suspender is not None):
            note(handler, place, code or "", "")
            steps.begin_handler(engine, place, handler)
            break
        inner, activity, place = outside(place)
        catcher = matching(activity.escalations, code) if activity is not None else None
        if catcher is not None and place is not None:
            note(catcher, place, code or "", "")
            steps.take_boundary(engine, place, catcher, inner)
            break
    else:
        engine.host.report(node.id, f"escalation {code or 'without code'} was not caught")
    if engine.conditions:
        waiting.check_conditions(engine)


def matching(catchers: tuple[Node, ...], code: str | None) -> Node | None:
    """The catcher of a code: an exact one beats one that catches all."""
    for catcher in catchers:
        if catcher.code == code and code is not None:
            return catcher
    for catcher in catchers:
        if catcher.code is None:
            return catcher
    return None


def note(catcher: Node, scope: Scope, code: str, text: str) -> None:
    """Set the variables in which a catching event wants code and text."""
    if catcher.code_variable:
        scope.variables[catcher.code_variable] = code
    if catcher.message_variable:
        scope.variables[catcher.message_variable] = text


def describe(error: BaseException, code: str) -> str:
    """An uncaught error, in words."""
    if isinstance(error, BpmnError):
        said = f": {error.message}" if error.message not in ("", code) else ""
        return f"error {code or 'without code'} was not caught{said}"
    if isinstance(error, MemoryError):
        return f"MemoryError: {str(error) or 'there is no memory for what it wants to keep'}"
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__


def is_from_outside(error: KeyboardInterrupt) -> bool:
    """Whether it is a person's Ctrl-C, that came between two instructions, and not one that a script raised."""
    trace = error.__traceback__
    if trace is None:
        return False
    while trace.tb_next is not None:
        trace = trace.tb_next
    return trace.tb_frame.f_code.co_code[trace.tb_lasti] not in _RAISE
