"""Compensation: undoing what has completed (standard 13.5.5), and transactions that are cancelled (10.3.5).

A scope keeps a `Record` of each activity that completed in it and can be compensated: by the handler at its boundary,
by the event sub-process for compensation inside it or, failing both, by what was completed in it. Throwing compensation
takes the records of its scope (or of one activity) and undoes them one by one, the latest first, each with the
variables that its activity had; then the thrower goes on, unless it did not wait for that. An event sub-process throws
it for the scope that it handles.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fame.engine import faults, scopes, steps
from fame.engine.host import BpmnError
from fame.engine.state import Node, Record, Scope

if TYPE_CHECKING:
    from fame.engine.interpreter import Engine


def completed(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """What follows a task that can be compensated."""
    remember(scope, Record(node.guard, scope.variables, []))
    return node.next


def remember(scope: Scope, *records: Record) -> None:
    """Keep records in the order of completion."""
    if scope.done is None:
        scope.done = []
    scope.done.extend(records)


def compensate(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """A compensation event: undo what completed in its scope, or (`code`) one activity of it."""
    homes, chosen = [scope], list[Record]()
    if scope.node is not None and scope.node.kind == "handler" and scope.parent is not None:
        homes.append(scope.parent)
    for home in homes:
        done = home.done or []
        chosen += unrolled([record for record in done if node.code in (None, record.node.id)])
        home.done = [record for record in done if node.code not in (None, record.node.id)] or None
    if not chosen:
        scope.counts[node.slot] += 1
        return node.next
    undoing = scopes.child(engine, scope, node, None, scope.variables)
    undoing.done = chosen
    undo_next(engine, undoing)
    return None


def beside(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """Compensation that its thrower does not wait for: another token sees to it (standard, waitForCompletion)."""
    assert node.join is not None
    scope.tokens += 1
    engine.ready.append((node.join, scope))
    return node.next


def unrolled(records: list[Record]) -> list[Record]:
    """Those to undo, in the order of undoing: of an activity without a handler, what was completed in it."""
    found, stack = [], list(records)
    while stack:
        record = stack.pop()
        if handler_of(record.node) is not None:
            found.append(record)
        else:
            stack.extend(record.inner)
    return found


def handler_of(node: Node) -> Node | None:
    """Where the token goes that undoes an activity."""
    return node.undo or (node.body.undo if node.body is not None else None)


def undo_next(engine: Engine, undoing: Scope) -> None:
    """Undo one more activity; after the last one the thrower goes on."""
    if not undoing.done:
        scopes.finish(engine, undoing)
        return
    record = undoing.done.pop(0)
    entry = handler_of(record.node)
    assert entry is not None
    inner = scopes.child(engine, undoing, UNDO, None, record.variables)
    inner.done = record.inner or None
    engine.ready.append((entry, inner))
    if record.node.undo is None:  # the event sub-process for compensation inside it
        if entry.guard.act is not None:
            engine.tell(undoing, entry.guard.entered)
        inner.body, inner.handles = entry.guard.body, (entry.guard,)
        scopes.open_scope(engine, inner)


def cancel(engine: Engine, scope: Scope, node: Node) -> None:
    """A cancel end event: its transaction is cancelled and undone, then leaves by its cancel boundary event."""
    place = scope
    while place.parent is not None and not (place.node and place.node.body and place.node.body.transaction):
        place = place.parent
    if place.parent is not None and place.parent.node is not None and place.parent.node.kind == "instance":
        place = whole_of(place.parent)
    if place.node is None or not place.node.cancels:
        faults.fail(engine, scope, node, BpmnError("cancel", "no cancel boundary event is around it"))
    else:
        scopes.proceed(engine, ROLL_BACK, scopes.replace(engine, place, place.handles))


def whole_of(instance: Scope) -> Scope:
    """A transaction that repeats is cancelled as one: what completed in its instances at work is undone, too."""
    whole = instance.parent
    assert whole is not None
    for each in whole.children:
        for transaction in each.children if isinstance(each, Scope) else ():
            if isinstance(transaction, Scope) and transaction.done:
                remember(whole, *transaction.done)
    return whole


def cancelled(engine: Engine, scope: Scope, node: Node) -> None:
    """A transaction has been undone."""
    assert scope.parent is not None
    assert scope.node is not None
    steps.take_boundary(engine, scope.parent, scope.node.cancels[0], scope)


UNDO = Node("", "(undo)", completed)
UNDO.kind = "undo"
ROLL_BACK = Node("", "(roll back)", compensate)
ROLL_BACK.kind = "scope"
CANCELLED = Node("", "(cancelled)", cancelled)
ROLL_BACK.next = CANCELLED
