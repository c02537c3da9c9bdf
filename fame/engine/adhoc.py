"""Ad-hoc sub-processes (standard 13.3.5): activities that start without incoming flow, until a condition holds.

By the standard somebody picks one enabled activity after another. Here the model picks: the elements that its
collection names, in that order, or (without one) all that have no incoming flow, in the order of the file. Any of these
may be begun again from outside while it is open (`Engine.activate`). From each, tokens go on along the flows.

Around each activity inside stand two nodes. `admit` is before it: if the order is sequential and another one is at
work, the token waits in ``todo``. `completed` is behind it and its interrupting boundary events: there the completion
condition is asked. When that is true, all that goes on is cancelled; or, where the rest may end, nothing new begins
(``over``).

`Scope.items` holds the activity at work (``busy``), the keys of the nodes of waiting tokens (``todo``), and ``over``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from fame.bpmn import model
from fame.engine import faults, scopes, steps, subprocesses
from fame.engine.engine_state import EngineState
from fame.engine.program import Compiled, Node
from fame.engine.scope_compiler import ScopeCompiler
from fame.engine.state import Scope, Wait, scopes_of
from fame.errors import MissionError


@dataclass(frozen=True, slots=True, kw_only=True)
class AdHoc:
    """How an ad-hoc sub-process goes about it. `entries`: where what can begin does so, by id; `activities`: ids."""

    entries: dict[str, Node]
    activities: frozenset[str]
    chosen: Compiled | None
    condition: Compiled | None
    sequential: bool
    cancels: bool


# ---- compiling -----------------------------------------------------------------------------------


def make(context: ScopeCompiler, element: model.SubProcess) -> Node:
    """An ad-hoc sub-process."""
    node = subprocesses.opening(context, element)
    inner = ScopeCompiler(context.compiler, element, context.file, context)
    node.body = inner.compile(_supervise)
    first = inner.without_start("an ad-hoc sub-process has no start event: what no flow leads to begins")
    inner.open_with(_begin(inner, element, first) if first else inner.nothing())
    return node


def _supervise(context: ScopeCompiler) -> None:
    """Put the nodes around the activities of such a body, before its flows are linked."""
    interrupting: dict[str, list[model.Event]] = {}
    for event in context.content.nodes:
        node = context.main.get(event.id)
        if not isinstance(event, model.Event) or event.place != "boundary" or node is None:
            continue
        how = node.catch or node.spec  # None: of a compensation event
        if how is not None and how.interrupting:
            interrupting.setdefault(event.attached_to, []).append(event)
    for activity in _activities_of(context):
        before = context.node(activity, admit, "/admit")
        before.next, context.entries[activity.id] = context.entries[activity.id], before
        for end in (activity, *interrupting.get(activity.id, ())):
            context.append(end.id, context.node(activity, completed, f"/completed@{end.id}"))


def _activities_of(context: ScopeCompiler) -> list[model.Activity]:
    """Those that the sub-process is there for: no handlers."""
    activities = (node for node in context.content.nodes if isinstance(node, model.Activity))
    return [node for node in activities if node.id in context.exits and not node.for_compensation]


def _begin(context: ScopeCompiler, element: model.SubProcess, first: list[model.FlowNode]) -> Node:
    """What such a body knows of itself, and its first node."""
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
    """The first token of such a scope becomes one for each element that begins."""
    scope.items = {"busy": "", "todo": [], "over": False}
    try:
        entries = chosen_of(how_of(scope), scope.variables)
    except BaseException as error:
        faults.fail(engine, scope, node, error, again=False)
        return None
    if not entries:
        scopes.end_token(engine, scope)
        return None
    scope.tokens += len(entries) - 1
    engine.ready.extend((entry, scope) for entry in entries[1:])
    return entries[0]


def chosen_of(how: AdHoc, variables: dict[str, Any]) -> list[Node]:
    """Where it begins. Raises ValueError for anything but a list of ids of elements that can begin."""
    if how.chosen is None:
        return list(how.entries.values())
    ids = how.chosen(variables)
    wrong = [id for id in ids if id not in how.entries] if isinstance(ids, list | tuple) else [ids]
    if wrong:
        raise ValueError(f"{wrong[0]!r} cannot begin: expected a list of any of {', '.join(how.entries)}")
    return [how.entries[id] for id in ids]


def how_of(scope: Scope) -> AdHoc:
    """What an ad-hoc scope knows of itself."""
    assert scope.body is not None
    how: AdHoc = scope.body.adhoc
    return how


def admit(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """A token comes to an activity."""
    state = scope.items
    if state["over"]:
        scopes.end_token(engine, scope)
        return None
    if how_of(scope).sequential:
        if state["busy"]:
            state["todo"].append(node.key)
            return None
        state["busy"] = node.id
    return node.next


def completed(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """An activity has completed, or was interrupted."""
    state, how = scope.items, how_of(scope)
    if state["busy"] == node.id:
        state["busy"] = ""
    if state["over"]:
        scopes.end_token(engine, scope)
        return None
    try:
        enough = how.condition is not None and bool(how.condition(scope.variables))
    except BaseException as error:
        faults.fail(engine, scope, node, error, again=False)
        return None
    if enough:
        conclude(engine, scope, how)
        return None
    if state["todo"]:
        engine.ready.append((NEXT, scope))
    return node.next


def take_next(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """Behind what the last activity led to, the token that waits longest."""
    state = scope.items
    return engine.program.by_key[state["todo"].pop(0)] if state["todo"] and not state["busy"] else None


def conclude(engine: EngineState, scope: Scope, how: AdHoc) -> None:
    """Enough has been done: the rest is cancelled, or may end."""
    if how.cancels:
        scopes.proceed(engine, steps.FINISH, *scopes.replace(engine, scope, scope.handles))
    else:
        scope.items["over"] = True
        engine.ready.append((SWEEP, scope))


def sweep(engine: EngineState, scope: Scope, node: Node) -> None:
    """The token that was enough ends last; so do those that wait for anything but the end of an activity."""
    for child in tuple(scope.children):
        if isinstance(child, Wait) and child.token and child.node.id not in how_of(scope).activities:
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
    """Let an element of an ad-hoc sub-process begin. Raises MissionError if none is open that could."""
    for scope, entries in _open(engine):
        if element in entries:
            scope.tokens += 1
            engine.ready.append((entries[element], scope))
            return
    can = ", ".join(offers(engine)) or "nothing"
    text = f"cannot start now: it is in no open ad-hoc sub-process, or does not start there; can start: {can}"
    raise MissionError(text, element=element)


def offers(engine: EngineState) -> list[str]:
    """The elements that could be activated now, each once."""
    return list(dict.fromkeys(id for _, entries in _open(engine) for id in entries))


def _open(engine: EngineState) -> Iterator[tuple[Scope, dict[str, Node]]]:
    """The ad-hoc scopes in which something may begin, and what."""
    for instance in engine.instances.values():
        for scope in scopes_of(instance.root):
            how: AdHoc | None = scope.body.adhoc if scope.body is not None else None
            if how is not None and scope.items is not None and not scope.items["over"]:
                yield scope, how.entries
