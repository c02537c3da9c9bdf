"""Ad-hoc sub-processes (standard 13.3.5): activities that start without incoming flow, until a condition holds.

In the standard a person picks one enabled activity after another. Here the model picks: the elements that its
collection names, in that order, or (without one) all that have no incoming flow, in the order of the file. While the
sub-process is open, each of these can be started again from outside (`Engine.activate`). Tokens follow the flows.

Each activity inside has two more nodes. `admit` comes before it: if the order is sequential and another activity is
running, the token waits in ``todo``. `completed` comes after it and after its interrupting boundary events, and
evaluates the completion condition. When that is true, the remaining activities are cancelled; if they may end instead,
no new one starts (``over``).

`Scope.items` holds the running activity (``busy``), the node keys of waiting tokens (``todo``), and ``over``.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from fame.bpmn import model
from fame.dataclasses import dataclass
from fame.engine import faults, scopes, steps, subprocesses
from fame.engine.engine_state import EngineState
from fame.engine.program import Compiled, Node
from fame.engine.scope_compiler import ScopeCompiler
from fame.engine.state import Scope, Wait, scopes_of
from fame.errors import MissionError


@dataclass(frozen=True, slots=True, kw_only=True)
class AdHoc:
    """Spec of an ad-hoc sub-process.

    entries     first nodes of the elements that can start, by id
    activities  ids of its activities
    chosen      its collection of ids to start; None: all
    condition   its completion condition
    sequential  whether one activity runs at a time
    cancels     whether completion cancels the remaining activities
    """

    entries: dict[str, Node]
    activities: frozenset[str]
    chosen: Compiled | None
    condition: Compiled | None
    sequential: bool
    cancels: bool


# ---- compiling -----------------------------------------------------------------------------------


def make(context: ScopeCompiler, element: model.SubProcess) -> Node:
    """Make the node of an ad-hoc sub-process."""
    node = subprocesses.opening(context, element)
    inner = ScopeCompiler(context.compiler, element, context.file, context)
    node.body = inner.compile(_supervise)
    first = inner.without_start("an ad-hoc sub-process has no start event: elements without incoming flow start")
    inner.open_with(_begin(inner, element, first) if first else inner.nothing())
    return node


def _supervise(context: ScopeCompiler) -> None:
    """Add the nodes before and after each activity, before the flows are linked."""
    interrupting: dict[str, list[model.Event]] = {}
    for event in context.content.events("boundary"):
        node = context.main.get(event.id)
        if node is None:
            continue
        catch = node.catch or node.spec  # None: of a compensation event
        if catch is not None and catch.interrupting:
            interrupting.setdefault(event.attached_to, []).append(event)
    for activity in _activities_of(context):
        before = context.node(activity, admit, "/admit")
        before.next, context.entries[activity.id] = context.entries[activity.id], before
        for end in (activity, *interrupting.get(activity.id, ())):
            context.append(end.id, context.node(activity, completed, f"/completed@{end.id}"))


def _activities_of(context: ScopeCompiler) -> list[model.Activity]:
    """Return the activities of the sub-process, without compensation handlers and event sub-processes."""
    activities = (node for node in context.content.nodes if isinstance(node, model.Activity))
    return [node for node in activities if node.id in context.exits and not node.for_compensation]


def _begin(context: ScopeCompiler, element: model.SubProcess, first: list[model.FlowNode]) -> Node:
    """Set the spec of the body, and make its first node."""
    context.body.adhoc = AdHoc(
        entries={node.id: context.entries[node.id] for node in first},
        activities=frozenset(activity.id for activity in _activities_of(context)),
        chosen=context.optional(element.active, element),
        condition=context.optional(element.completion, element),
        sequential=element.sequential,
        cancels=element.cancel_remaining,
    )
    return context.node(element, begin, "/begin")


# ---- steps ---------------------------------------------------------------------------------------


def begin(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """Replace the first token by one token for each element that starts."""
    scope.items = {"busy": "", "todo": [], "over": False}
    try:
        entries = chosen_of(spec_of(scope), scope.variables)
    except BaseException as error:
        faults.fail(engine, scope, node, error)
        return None
    if not entries:
        scopes.end_token(engine, scope)
        return None
    scope.tokens += len(entries) - 1
    engine.ready.extend((entry, scope) for entry in entries[1:])
    return entries[0]


def chosen_of(spec: AdHoc, variables: dict[str, Any]) -> list[Node]:
    """Return the first nodes of the elements to start. Raises ValueError if the ids are not a list of such elements."""
    if spec.chosen is None:
        return list(spec.entries.values())
    ids = spec.chosen(variables)
    listed = isinstance(ids, list | tuple)
    wrong = [id for id in ids if not isinstance(id, str) or id not in spec.entries] if listed else [ids]
    if wrong:
        raise ValueError(f"{wrong[0]!r} cannot start: expected a list of any of {', '.join(spec.entries)}")
    return [spec.entries[id] for id in ids]


def spec_of(scope: Scope) -> AdHoc:
    """Return the spec of the ad-hoc sub-process of a scope."""
    assert scope.body is not None
    spec: AdHoc = scope.body.adhoc
    return spec


def admit(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """Let a token into an activity, or keep it until the running one has completed."""
    state = scope.items
    if state["over"]:
        scopes.end_token(engine, scope)
        return None
    if spec_of(scope).sequential:
        if state["busy"]:
            state["todo"].append(node.key)
            return None
        state["busy"] = node.id
    return node.next


def completed(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """Evaluate the completion condition after an activity that completed or was interrupted."""
    state, spec = scope.items, spec_of(scope)
    if state["busy"] == node.id:
        state["busy"] = ""
    if state["over"]:
        scopes.end_token(engine, scope)
        return None
    try:
        enough = spec.condition is not None and bool(spec.condition(scope.variables))
    except BaseException as error:
        faults.fail(engine, scope, node, error)
        return None
    if enough:
        conclude(engine, scope, spec)
        return None
    if state["todo"]:
        engine.ready.append((NEXT, scope))
    return node.next


def take_next(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """Start the token that has waited longest, after the tokens that follow the last activity."""
    state = scope.items
    return engine.program.by_key[state["todo"].pop(0)] if state["todo"] and not state["busy"] else None


def conclude(engine: EngineState, scope: Scope, spec: AdHoc) -> None:
    """Cancel the remaining activities, or let them end: the completion condition is true."""
    if spec.cancels:
        scopes.proceed(engine, steps.FINISH, *scopes.replace(engine, scope, scope.handles))
    else:
        scope.items["over"] = True
        engine.ready.append((SWEEP, scope))


def sweep(engine: EngineState, scope: Scope, node: Node) -> None:
    """End all tokens but those of running activities; the token that met the completion condition ends last."""
    for child in tuple(scope.children):
        if isinstance(child, Wait) and child.token and child.node.id not in spec_of(scope).activities:
            scope.children.pop(child)
            scopes.cancel_wait(engine, child)
            scope.tokens -= 1
    for join, counts in (scope.joins or {}).items():
        scope.tokens -= sum(counts[: join.spec.need])
    scope.joins = None
    scope.tokens -= len(scope.items["todo"])
    scope.items["todo"] = []
    scopes.end_token(engine, scope)


NEXT = Node("", "(next)", take_next)
SWEEP = Node("", "(sweep)", sweep)


# ---- from outside --------------------------------------------------------------------------------


def activate(engine: EngineState, element: str) -> None:
    """Start an element of an open ad-hoc sub-process. Raises MissionError if it cannot start in any."""
    for scope, entries in _open(engine):
        if element in entries:
            scope.tokens += 1
            engine.ready.append((entries[element], scope))
            return
    can = ", ".join(offers(engine)) or "nothing"
    text = f"cannot start now: it is in no open ad-hoc sub-process, or does not start there; can start: {can}"
    raise MissionError(text, element=element)


def offers(engine: EngineState) -> list[str]:
    """Return the ids of the elements that `activate` can start now, without repetition."""
    return list(dict.fromkeys(id for _, entries in _open(engine) for id in entries))


def _open(engine: EngineState) -> Iterator[tuple[Scope, dict[str, Node]]]:
    """Yield the open ad-hoc scopes, with the elements that can start in them."""
    for instance in engine.instances.values():
        for scope in scopes_of(instance.root):
            spec: AdHoc | None = scope.body.adhoc if scope.body is not None else None
            if spec is not None and scope.items is not None and not scope.items["over"]:
                yield scope, spec.entries
