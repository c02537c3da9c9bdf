"""Ad-hoc sub-processes (standard 13.3.5): activities that begin without being led to, until enough has been done.

By the standard somebody picks one enabled activity after another. Here the model picks: the elements that its
collection names, in that order, or (without one) all that have no incoming flow, in the order of the file. Any of these
may be begun again from outside while it is open (`Engine.activate`). From each, tokens go on along the flows.

Around each activity inside stand two nodes. `admit` is before it: if the order is sequential and another one is at
work, the token waits in ``todo``. `completed` is behind it and its interrupting boundary events: there the completion
condition is asked. When that is true, all that goes on is cancelled; or, where the rest may end, nothing new begins
(``over``).

`Scope.items` holds who is at work (``busy``), the keys of the nodes of tokens that wait (``todo``), and ``over``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from fame.bpmn import model
from fame.engine import faults, scopes, steps
from fame.engine.host import Compiled
from fame.engine.state import Node, Rest, Scope, scopes_of
from fame.errors import MissionError

if TYPE_CHECKING:
    from fame.engine.compiler import Wiring
    from fame.engine.interpreter import Engine


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


def supervise(wiring: Wiring) -> None:
    """Put the nodes around the activities of such a body, before its flows are linked."""
    interrupting: dict[str, list[model.Event]] = {}
    for event in wiring.content.nodes:
        node = wiring.main.get(event.id)
        if isinstance(event, model.Event) and event.place == "boundary" and node is not None and node.interrupting:
            interrupting.setdefault(event.attached_to, []).append(event)
    for activity in activities_of(wiring):
        before = wiring.compiler.node(activity, admit, wiring.file, part="/admit")
        before.next, wiring.entries[activity.id] = wiring.entries[activity.id], before
        for end in (activity, *interrupting.get(activity.id, ())):
            after = wiring.compiler.node(activity, completed, wiring.file, part=f"/completed@{end.id}")
            wiring.link(wiring.exits[end.id], after)
            wiring.exits[end.id] = [after]


def activities_of(wiring: Wiring) -> list[model.Activity]:
    """Those that the sub-process is there for: no handlers."""
    return [node for node in wiring.content.nodes if isinstance(node, model.Activity) and node.id in wiring.exits
            and not node.for_compensation]  # fmt: skip


def open_with(wiring: Wiring, element: model.SubProcess, beginning: list[model.FlowNode]) -> tuple[AdHoc, Node]:
    """What such a body knows of itself, and its first node."""
    compiled = wiring.compiler.optional
    how = AdHoc(
        entries={node.id: wiring.entries[node.id] for node in beginning},
        activities=frozenset(activity.id for activity in activities_of(wiring)),
        chosen=compiled(element.active, element, wiring.file),
        condition=compiled(element.completion, element, wiring.file),
        sequential=element.sequential,
        cancels=element.cancel_remaining,
    )
    return how, wiring.compiler.node(element, begin, wiring.file, part="/begin")


# ---- steps ---------------------------------------------------------------------------------------


def begin(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """The first token of such a scope becomes one for each element that begins."""
    scope.items = {"busy": "", "todo": [], "over": False}
    try:
        entries = chosen_of(how_of(scope), scope.variables)
    except BaseException as error:
        faults.fail(engine, scope, node, error)
        return None
    if not entries:
        scopes.end_token(engine, scope)
        return None
    scope.tokens += len(entries) - 1
    engine.ready.extend((entry, scope) for entry in entries[1:])
    return entries[0]


def chosen_of(how: AdHoc, variables: dict[str, Any]) -> list[Node]:
    """Where it begins. Raises ValueError for what is no list of ids of elements that can."""
    if how.chosen is None:
        return list(how.entries.values())
    ids = how.chosen(variables)
    wrong = [id for id in ids if id not in how.entries] if isinstance(ids, list | tuple) else [ids]
    if wrong:
        raise ValueError(f"{wrong[0]!r} cannot begin: a list of any of {', '.join(how.entries)} would be right")
    return [how.entries[id] for id in ids]


def how_of(scope: Scope) -> AdHoc:
    """What an ad-hoc scope knows of itself."""
    assert scope.body is not None
    how: AdHoc = scope.body.adhoc
    return how


def admit(engine: Engine, scope: Scope, node: Node) -> Node | None:
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


def completed(engine: Engine, scope: Scope, node: Node) -> Node | None:
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
        faults.fail(engine, scope, node, error)
        return None
    if enough:
        conclude(engine, scope, how)
        return None
    if state["todo"]:
        engine.ready.append((NEXT, scope))
    return node.next


def take_next(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """Behind what the last activity led to, the token that waits longest."""
    state = scope.items
    return engine.program.by_key[state["todo"].pop(0)] if state["todo"] and not state["busy"] else None


def conclude(engine: Engine, scope: Scope, how: AdHoc) -> None:
    """Enough has been done: the rest is cancelled, or may end."""
    if how.cancels:
        scopes.proceed(engine, steps.FINISH, scopes.replace(engine, scope, scope.handles))
    else:
        scope.items["over"] = True
        engine.ready.append((SWEEP, scope))


def sweep(engine: Engine, scope: Scope, node: Node) -> None:
    """The token that was enough ends last; so do those that wait for anything but the end of an activity."""
    for child in tuple(scope.children):
        if isinstance(child, Rest) and child.token and child.node.id not in how_of(scope).activities:
            scope.children.pop(child)
            scopes.cancel_rest(engine, child)
            scope.tokens -= 1
    for join, counts in (scope.joins or {}).items():
        scope.tokens -= sum(counts[: join.need])
    scope.joins = None
    scope.tokens -= len(scope.items["todo"])
    scope.items["todo"] = []
    scopes.end_token(engine, scope)


NEXT = Node("", "(next)", take_next)
SWEEP = Node("", "(sweep)", sweep)


# ---- from outside --------------------------------------------------------------------------------


def activate(engine: Engine, element: str) -> None:
    """Let an element of an ad-hoc sub-process begin. Raises MissionError if none is open that could."""
    for scope, entries in _open(engine):
        if element in entries:
            scope.tokens += 1
            engine.ready.append((entries[element], scope))
            return
    can = ", ".join(offers(engine)) or "nothing"
    text = f"stands in no ad-hoc sub-process that is open now, or does not begin there; what can: {can}"
    raise MissionError(text, element=element)


def offers(engine: Engine) -> list[str]:
    """The elements that could be activated now, each once."""
    return list(dict.fromkeys(id for _, entries in _open(engine) for id in entries))


def _open(engine: Engine) -> Iterator[tuple[Scope, dict[str, Node]]]:
    """The ad-hoc scopes in which something may begin, and what."""
    for instance in engine.instances.values():
        for scope in scopes_of(instance.root):
            how: AdHoc | None = scope.body.adhoc if scope.body is not None else None
            if how is not None and scope.items is not None and not scope.items["over"]:
                yield scope, how.entries
