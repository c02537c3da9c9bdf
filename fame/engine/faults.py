"""Propagation of errors and escalations until they are caught (docs/semantics.md; standard 13.5.2).

From the failing activity outwards: first its boundary events, then the event sub-processes of its scope; then the
activity of that scope counts as failed, through sub-processes and calls alike. An error inside an event sub-process
propagates from outside the scope that it handles.
"""

from __future__ import annotations

from typing import Any

from fame.bpmn.model import SubProcess
from fame.engine import handlers, repair, scopes, state, waiting
from fame.engine.engine_state import EngineState
from fame.engine.host import BpmnError, is_from_outside
from fame.engine.program import FaultCatch, Handler, Node
from fame.engine.state import Instance, Scope, Wait, scopes_of
from fame.errors import MODULE_NOT_FOUND, MissionError


def fail(
    engine: EngineState, scope: Scope, node: Node, error: BaseException, *, again: bool = True, wait: Wait | None = None
) -> None:
    """Find what catches the error of an element; without one the instance fails, or an incident is kept.

    `again`: its token has left the node, which can be executed again. `wait`: what could not be evaluated, withdrawn.
    """
    if isinstance(error, KeyboardInterrupt) and is_from_outside(error):
        raise error
    code = error.code if isinstance(error, BpmnError) else "script"
    text = str(error) or type(error).__name__
    if node.part_of.plain_step is not None:
        engine.notify(scope, (node.id, "fail", code))
    failing: Node | None = node.part_of
    place: Scope | None = scope
    inner: Scope | None = None  # the scope that the failing activity is, if it is one
    if isinstance(node.part_of.spec, Handler):  # the trigger of an event sub-process is part of it
        inner, failing, place = _outside(scope)
    while place is not None and failing is not None:
        catcher = _matching(failing.boundary.errors, code) if failing.boundary is not None else None
        if catcher is not None:
            _set_variables(catcher, place, code, text)
            _report_caught(engine, node, catcher, error)
            handlers.take_boundary(engine, place, catcher, catcher.spec, inner)
            break
        handler = _matching(place.body.errors, code) if place.body is not None else None
        if handler is not None:
            _set_variables(handler, place, code, text)
            _report_caught(engine, node, handler, error)
            handlers.open_handler(engine, handler, *scopes.replace(engine, place, (*place.handles, handler.part_of)))
            break
        inner, failing, place = _outside(place)
    else:
        description = _describe(error, code) + _called_at(scope, node)
        if wait is not None and not wait.token and engine.on_incident is not None:
            repair.keep_armed(engine, wait, description, code)
        elif again and engine.on_incident is not None:
            repair.keep_failed(engine, scope, wait.node if wait is not None else node, description, code)
        else:
            abandon(engine, scope.instance, node, description, code, error)
    if engine.conditions:
        waiting.check_conditions(engine)


def give_up(engine: EngineState, wait: Wait, error: BaseException) -> None:
    """Turn a waiting token into an error: its trigger or its message could not be evaluated."""
    waiting.withdraw(engine, wait)
    fail(engine, wait.scope, wait.node, error, wait=wait)


def give_up_part(engine: EngineState, wait: Wait, error: BaseException) -> None:
    """Turn an alternative or trigger into an error of its event or gateway, as `give_up` does."""
    assert isinstance(wait.owner, Wait)
    waiting.withdraw(engine, wait.owner)
    fail(engine, wait.scope, wait.node, error, wait=wait.owner)


def fail_token(engine: EngineState, element: str, error: BaseException) -> None:
    """Raise an error in place of what a held token does at an element. Raises MissionError if no token is there."""
    token, scope = repair.token_at(engine, element)
    assert token.node is not None
    if isinstance(token, Wait):
        waiting.withdraw(engine, token)
    else:
        scopes.kill(engine, token, notified=False)
    fail(engine, scope, token.node, error)


def abandon(
    engine: EngineState, instance: Instance, node: Node, text: str, code: str, cause: BaseException | None = None
) -> None:
    """Fail an instance because of an uncaught error."""
    instance.error = MissionError(text, element=node.id, file=node.file, line=node.line, code=code)
    instance.error.__cause__ = cause
    scopes.notify_cancelled(engine, instance.root)
    last, cancelling = scopes.replace(engine, instance.root, ())
    engine.host.make_safe("failed")
    scopes.proceed(engine, FAILED, last, cancelling)


def abandon_crowd(engine: EngineState, instance: Instance, node: Node) -> None:
    """Fail an instance that has too many tokens."""
    abandon(engine, instance, node, f"more than {state.TOKENS} tokens at a time: does a loop fork them?", "livelock")


def conclude_failed(engine: EngineState, scope: Scope, node: Node) -> None:
    """Conclude the failure of an instance after an uncaught error."""
    scopes.close_scope(engine, scope)
    scopes.conclude(engine, scope.instance, "failed")


FAILED = Node("", "(failed)", conclude_failed)


def fail_without_token(engine: EngineState, variables: dict[str, Any], element: str, error: BaseException) -> None:
    """Raise the error of a callback that an element's script has registered (see `Engine.fail_callback`).

    If the scope has ended, nothing can fail any more: the error is reported.
    """
    known = [scope for instance in engine.instances.values() for scope in scopes_of(instance.root)]
    places = [scope for scope in known if scope.variables is variables]
    holder = _body_of(engine, element)
    inside = [scope for scope in places if scope.body is not None and scope.body.id == holder]
    if places:
        real = next(node for node in engine.program.nodes if node.id == element)
        no_token = Node(element, element, real.step, line=real.line, file=real.file)  # without boundary events
        no_token.plain_step = real.plain_step
        fail(engine, inside[-1] if inside else places[0], no_token, error, again=False)
    else:
        code = error.code if isinstance(error, BpmnError) else "script"
        engine.host.report(element, f"a callback failed after its scope had ended: {_describe(error, code)}")


def _body_of(engine: EngineState, element: str) -> str:
    """Return the id of the process or sub-process that contains an element."""
    for process in engine.program.sources:
        for owner in (process, *(node for node in process.body.walk() if isinstance(node, SubProcess))):
            if any(node.id == element for node in owner.body.nodes):
                return str(owner.id)
    return ""


def escalate(engine: EngineState, scope: Scope, node: Node, code: str | None) -> None:
    """Propagate an escalation; the throwing token continues unless an interrupting event caught it."""
    place: Scope | None = scope
    while place is not None:
        handler = _matching(place.body.escalations, code) if place.body is not None else None
        if handler is not None and not (handler.spec.resume and place.suspender is not None):
            _set_variables(handler, place, code or "", "")
            try:
                handlers.begin_handler(engine, place, handler, handler.spec)
            except RecursionError as error:
                fail(engine, place, handler, error, again=False)
            break
        inner, activity, place = _outside(place)
        boundary = activity.boundary if activity is not None else None
        catcher = _matching(boundary.escalations, code) if boundary is not None else None
        if catcher is not None and place is not None:
            _set_variables(catcher, place, code or "", "")
            handlers.take_boundary(engine, place, catcher, catcher.spec, inner)
            break
    else:
        engine.host.report(node.id, f"escalation {code or 'without code'} was not caught")
    if engine.conditions:
        waiting.check_conditions(engine)


def _outside(scope: Scope) -> tuple[Scope, Node | None, Scope | None]:
    """Return what a fault of a scope affects: that scope, its activity, and the scope around the activity.

    For an event sub-process this is the scope that it handles, which may be that of an event sub-process as well.
    """
    while scope.node is not None and isinstance(scope.node.spec, Handler) and scope.parent is not None:
        scope = scope.parent
    return scope, scope.node, scope.parent


def _called_at(scope: Scope, node: Node) -> str:
    """Return the place of the call, for an element of another file."""
    call: Node | None = None
    place: Scope | None = scope
    while place is not None:
        if place.node is not None and place.node.file not in ("", node.file):  # "": of compensation
            call = place.node
        place = place.parent
    return f"; called at {call.id} ({call.file}:{call.line})" if call is not None else ""


def _matching(catchers: tuple[Node, ...], code: str | None) -> Node | None:
    """Return the catcher of a code: an exact match comes before one that catches all codes."""
    for catcher in catchers:
        if catcher.spec.code == code and code is not None:
            return catcher
    for catcher in catchers:
        if catcher.spec.code is None:
            return catcher
    return None


def _set_variables(catcher: Node, scope: Scope, code: str, text: str) -> None:
    """Set the variables that the catching event declares for code and text."""
    wanted: FaultCatch = catcher.spec
    if wanted.code_variable:
        scope.variables[wanted.code_variable] = code
    if wanted.message_variable:
        scope.variables[wanted.message_variable] = text


def _report_caught(engine: EngineState, node: Node, catcher: Node, error: BaseException) -> None:
    """Report a mistake of a script that is caught as any error, unless a variable receives its code or text."""
    catch: FaultCatch = catcher.spec
    if not (isinstance(error, BpmnError) or catch.code or catch.code_variable or catch.message_variable):
        text = f"caught by {catcher.id}, which catches every error: {_describe(error, 'script')}"
        engine.host.report(node.id, text)


def _describe(error: BaseException, code: str) -> str:
    """Return the message of an uncaught error."""
    if isinstance(error, BpmnError):
        message = f": {error.message}" if error.message not in ("", code) else ""
        return f"error {code or 'without code'} was not caught{message}"
    if isinstance(error, MemoryError):
        return f"MemoryError: {str(error) or 'the script needs more memory than there is'}"
    if isinstance(error, ModuleNotFoundError):
        return f"ModuleNotFoundError: {error}: {MODULE_NOT_FOUND}"
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
