"""Steps that all families share: passing on, splitting, assigning, ending, and observation.

A *step* takes a token and returns the node that it moves to at once, or None if it waits, is in the ready queue, or has
ended.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from fame.dataclasses import dataclass, field
from fame.engine import faults, scopes, waiting
from fame.engine.data import UNDEFINED
from fame.engine.engine_state import EngineState
from fame.engine.host import BpmnError
from fame.engine.program import Compiled, Node
from fame.engine.state import Scope

# ---- passing on ----------------------------------------------------------------------------------


def pass_on(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """Pass a token on: none events, plain tasks, merges."""
    return node.next


def flow(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """Take a sequence flow, which is a node only in observed programs."""
    if engine.place is not scope:
        engine.set_place(scope)
    emit = engine.emit
    emit(node.entered)
    return node.next


def observed(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """Call the step of an element and notify observers; take a following sequence flow at once."""
    step = node.plain_step
    assert step is not None
    if engine.place is not scope:
        engine.set_place(scope)
    emit = engine.emit
    emit(node.entered)
    following = step(engine, scope, node)
    if following is not None:
        if engine.place is not scope:
            engine.set_place(scope)
        emit = engine.emit
        emit(node.left)
        if following.step is flow:
            emit(following.entered)
            return following.next
    return following


def observed_end(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """Observe an element that ends the token: it completes before the scope that it ends."""
    engine.notify(scope, node.entered)
    engine.notify(scope, node.left)
    step = node.plain_step
    assert step is not None
    return step(engine, scope, node)


def fail_step(engine: EngineState, scope: Scope, node: Node, error: BaseException) -> Node | None:
    """Fail an element that was counted when the token entered it."""
    engine.unsettled = bool(engine.conditions)
    scope.counts[node.index] -= 1
    faults.fail(engine, scope, node, error)
    return None


def settle(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """Continue a token after a script that has published, or changed variables while conditional events are armed.

    After a message the token goes to the back of the queue, like that of a throw event; else it stays first, and the
    conditions are evaluated before it continues.
    """
    if node.plain_step is not None:
        engine.notify(scope, node.left)
    ready, engine.unsettled = engine.ready, bool(engine.conditions)
    if ready and ready[-1][0] is None:
        ready.append((node.next, scope))
    else:
        ready.appendleft((node.next, scope))
    if engine.conditions:
        waiting.check_conditions(engine)
    return None


# ---- splitting -----------------------------------------------------------------------------------

ConditionalFlow = tuple[Compiled | None, Node]
"""A sequence flow: its condition (None: always) and its target."""


@dataclass(slots=True)
class Branch:
    """Spec of a gateway, or of the fork after an element with several outgoing flows.

    ways        conditional flows; `targets`: flows without conditions
    default     target of the default flow
    need        of a join: the number of incoming flows; `ports`: where tokens arrive by them
    reach       of a join: gives by element or flow the incoming flows that a token there can reach (bit mask)
    masks       of an inclusive or complex join: the same, computed
    activation  of a complex gateway: its activation condition
    resets      of a complex gateway: flows whose conditions are evaluated again at its reset
    """

    ways: tuple[ConditionalFlow, ...] = ()
    targets: tuple[Node, ...] = ()
    default: Node | None = None
    need: int = 0
    ports: tuple[Node, ...] = ()
    reach: Callable[[], dict[str, int]] = dict
    masks: dict[str, int] = field(default_factory=dict)
    activation: Compiled | None = None
    resets: tuple[ConditionalFlow, ...] = ()


def exclusive(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """Take the first flow whose condition is true, else the default flow, else fail."""
    variables = scope.variables
    spec: Branch = node.spec
    try:
        for condition, target in spec.ways:
            if condition is None or condition(variables):
                return target
    except BaseException as error:
        return fail_step(engine, scope, node, error)
    return spec.default or fail_step(engine, scope, node, _no_flow())


def fork(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """Split into one token for each outgoing flow of a parallel gateway, or of another element."""
    targets: tuple[Node, ...] = node.spec.targets
    scope.tokens += len(targets) - 1
    push = engine.ready.append
    for target in targets[1:]:
        push((target, scope))
    return targets[0]


def inclusive(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """Split into one token for each flow whose condition is true, else take the default flow, else fail."""
    return take_all(engine, scope, node, scope.variables)


def take_all(engine: EngineState, scope: Scope, node: Node, variables: dict[str, Any]) -> Node | None:
    """Split as `inclusive` does, with conditions over these variables."""
    spec: Branch = node.spec
    try:
        chosen = [target for condition, target in spec.ways if condition is None or condition(variables)]
    except BaseException as error:
        return fail_step(engine, scope, node, error)
    if not chosen:
        return spec.default or fail_step(engine, scope, node, _no_flow())
    scope.tokens += len(chosen) - 1
    for target in chosen[1:]:
        engine.ready.append((target, scope))
    return chosen[0]


def _no_flow() -> BpmnError:
    """Return the error of a gateway without a flow to take."""
    return BpmnError("no_flow", "no condition is true and there is no default flow")


# ---- assigning -----------------------------------------------------------------------------------


@dataclass(slots=True)
class Assignments:
    """Spec of the data associations of an activity or event.

    values    (variable, expression)
    required  variables that must be set when an activity has ended
    """

    values: tuple[tuple[str, Callable[[dict[str, Any]], Any]], ...]
    required: tuple[str, ...] = ()


def assign(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """Assign data objects before an activity or throw event starts, or after it has ended."""
    variables = scope.variables
    spec: Assignments = node.spec
    try:
        for name, source in spec.values:
            value = source(variables)
            if value is not UNDEFINED:
                variables[name] = value
        for name in spec.required:
            if name not in variables:
                engine.host.output_missing(node.id, name)
    except BaseException as error:
        faults.fail(engine, scope, node, error)
        return None
    return settle(engine, scope, node) if engine.unsettled else node.next


# ---- opening and ending --------------------------------------------------------------------------


def arm_first(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """Arm the event sub-processes and queues of a scope before its first element."""
    scopes.arm_scope(engine, scope)
    if scope.state:  # a condition was true already
        engine.ready.appendleft((node.next, scope))
        return None
    return node.next


def end(engine: EngineState, scope: Scope, node: Node) -> None:
    """End a token at a none end event, or at an element without outgoing flow."""
    scope.tokens -= 1
    if not scope.tokens:
        scopes.finish(engine, scope)


def terminate(engine: EngineState, scope: Scope, node: Node) -> None:
    """End the innermost scope; in a handler that suspends its scope, that scope as well."""
    if scope.parent is not None and scope.parent.suspender is scope:
        scope = scope.parent
    _end_at_once(engine, scope)


def terminate_all(engine: EngineState, scope: Scope, node: Node) -> None:
    """End all instances of the participant, as the original FaMe does from a handler that runs beside its scope."""
    for instance in tuple(engine.instances.values()):
        _end_at_once(engine, instance.root)


def _end_at_once(engine: EngineState, scope: Scope) -> None:
    replacement, cancelling = scopes.replace(engine, scope, scope.handles)
    if scope.parent is None:
        engine.host.make_safe("terminated")
    scopes.proceed(engine, FINISH, replacement, cancelling)


def finish(engine: EngineState, scope: Scope, node: Node) -> None:
    """End the scope when everything that was cancelled has ended."""
    scopes.finish(engine, scope)


ABANDONED = Node("", "(abandoned)", end)
"""The target of a token that a person drops at a migration: it ends."""
FINISH = Node("", "(finish)", finish)
