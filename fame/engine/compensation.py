"""Compensation of completed activities (standard 13.5.5), and cancelled transactions (10.3.5).

A scope keeps a `Record` of each completed activity that can be compensated: by the handler at its boundary, by the
compensation event sub-process inside it or, with neither, by compensating the activities inside it. A compensation
throw event takes the records of its scope (or of one activity) and compensates them one by one, the latest first, each
with the variables of its activity. Then the throwing token continues, unless it did not wait. In an event sub-process,
the throw event compensates the scope that the event sub-process handles.
"""

from __future__ import annotations

from functools import partial

from fame.bpmn import model
from fame.dataclasses import dataclass
from fame.engine import faults, handlers, scopes, steps
from fame.engine.engine_state import EngineState
from fame.engine.host import BpmnError
from fame.engine.program import Handler, LoopInstance, Node, StepFunction
from fame.engine.scope_compiler import ScopeCompiler, boundary_of
from fame.engine.state import Record, Scope
from fame.text import suggestion

NESTED = 100
"""How deep records may be inside each other: they are stored recursively."""


@dataclass(slots=True)
class Compensate:
    """Spec of a compensation throw event. `activity`: compensate only this one; None: all of the scope."""

    activity: str | None


# ---- steps ---------------------------------------------------------------------------------------


def completed(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """Record that a task which can be compensated has completed."""
    remember(scope, Record(node.part_of, scope.variables, []))
    return node.next


def remember(scope: Scope, *records: Record) -> None:
    """Append records in the order of completion."""
    if scope.done is None:
        scope.done = []
    scope.done.extend(records)


def record_of(node: Node, inner: Scope) -> Record:
    """Return the record of an activity whose scope has ended. Raises RecursionError.

    An activity without a handler stands for the records inside it, at any depth: those are kept side by side.
    """
    records = inner.done or []
    if handler_of(node) is None:
        kept = ([record] if handler_of(record.node) is not None else record.inner for record in records)
        records = [record for each in kept for record in each]
    record = Record(node, inner.variables, records)
    if record.depth > NESTED:
        raise RecursionError(f"compensation handlers of more than {NESTED} completed activities inside each other")
    return record


def compensate(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """Compensate the completed activities of the scope, or one of them."""
    spec: Compensate = node.spec
    homes, chosen = [scope], list[Record]()
    if scope.node is not None and isinstance(scope.node.spec, Handler) and scope.parent is not None:
        homes.append(scope.parent)
    for home in homes:
        done = home.done or []
        chosen += _unrolled([record for record in done if spec.activity in (None, record.node.id)])
        home.done = [record for record in done if spec.activity not in (None, record.node.id)] or None
    if not chosen:
        scope.counts[node.slot] += 1
        return node.next
    undoing = scopes.open_child(engine, scope, node, None, scope.variables)
    undoing.done = chosen
    _undo_next(engine, undoing)
    return None


def beside(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """Continue at once; another token, at the node in `spec`, compensates (``waitForCompletion="false"``)."""
    scope.tokens += 1
    engine.ready.append((node.spec, scope))
    return node.next


def _unrolled(records: list[Record]) -> list[Record]:
    """Return the records to compensate, in order. An activity without a handler stands for the records inside it."""
    unrolled, stack = [], list(records)
    while stack:
        record = stack.pop()
        if handler_of(record.node) is not None:
            unrolled.append(record)
        else:
            stack.extend(record.inner)
    return unrolled


def handler_of(node: Node) -> Node | None:
    """Return the first node of an activity's compensation handler, if it has one."""
    if node.boundary is not None and node.boundary.compensation is not None:
        return node.boundary.compensation
    return node.body.compensation if node.body is not None else None


def _undo_next(engine: EngineState, undoing: Scope) -> None:
    """Compensate the next activity; after the last one the throwing token continues."""
    if not undoing.done:
        scopes.finish(engine, undoing)
        return
    record = undoing.done.pop(0)
    entry = handler_of(record.node)
    assert entry is not None
    inner = scopes.open_child(engine, undoing, UNDO, None, record.variables)
    inner.done = record.inner or None
    engine.ready.append((entry, inner))
    handler = entry.part_of
    if isinstance(handler.spec, Handler):  # the compensation event sub-process inside it
        if handler.plain_step is not None:
            engine.notify(undoing, handler.entered)
        inner.body, inner.handles = handler.body, (handler,)
        scopes.arm_scope(engine, inner)


def _one_undone(engine: EngineState, undoing: Scope, inner: Scope) -> None:
    """Continue after one activity has been compensated."""
    _undo_next(engine, undoing)


def _undone(engine: EngineState, scope: Scope, undoing: Scope) -> None:
    """Complete the throw event: everything has been compensated."""
    assert undoing.node is not None
    scopes.complete(engine, scope, undoing.node)


def cancel(engine: EngineState, scope: Scope, node: Node) -> None:
    """Cancel and compensate the transaction around a cancel end event, then continue at its cancel boundary event."""
    place = scope
    while place.parent is not None and not (place.node and place.node.body and place.node.body.transaction):
        place = place.parent
    around = place.parent.node if place.parent is not None else None
    if place.parent is not None and around is not None and isinstance(around.spec, LoopInstance):
        assert place.parent.parent is not None
        place = place.parent.parent  # a repeated transaction is cancelled as a whole
    if place.node is None or place.node.boundary is None or not place.node.boundary.cancels:
        faults.fail(engine, scope, node, BpmnError("cancel", "no cancel boundary event is around it"), again=False)
    else:
        remember(place, *_inside(place))
        scopes.proceed(engine, ROLL_BACK, *scopes.replace(engine, place, place.handles))


def _inside(scope: Scope) -> list[Record]:
    """Return the records of the active scopes in one: cancelling an activity undoes what completed in it (10.7).

    What is being undone stays so; what an interrupted compensation has not come to follows.
    """
    records, active = list[Record](), [scope]
    for each in active:  # which grows
        inner = [one for one in each.children if isinstance(one, Scope) and one.node is not UNDO]
        for one in inner:
            done = one.done or []
            is_undoing = one.node is not None and isinstance(one.node.spec, Compensate)
            records += reversed(done) if is_undoing else done  # which is in the order to undo
        active += inner
    return records


def _rolled_back(engine: EngineState, scope: Scope, node: Node) -> None:
    """Take the cancel boundary event: the transaction has been compensated."""
    assert scope.parent is not None
    assert scope.node is not None
    assert scope.node.boundary is not None
    event = scope.node.boundary.cancels[0]
    handlers.take_boundary(engine, scope.parent, event, event.spec, scope)


UNDO = Node("", "(undo)", completed)
UNDO.ended = _one_undone
ROLL_BACK = Node("", "(roll back)", compensate, spec=Compensate(None))
ROLL_BACK.ended = _undone
CANCELLED = Node("", "(cancelled)", _rolled_back)
ROLL_BACK.next = CANCELLED

# ---- compiling -----------------------------------------------------------------------------------


def thrown(
    context: ScopeCompiler,
    event: model.Event,
    definition: model.CompensateDefinition,
    ends: StepFunction,
    part: str = "",
) -> Node:
    """Make a compensation throw event."""
    nodes = [node for body in context.compensates for node in body.nodes]
    activities = [node.id for node in nodes if isinstance(node, model.Activity) and not node.for_compensation]
    if definition.activity is not None and definition.activity not in activities:
        known = suggestion(definition.activity, activities)
        context.refuse(f"its activityRef is {definition.activity!r}: expected an activity of its scope; {known}", event)
    undoing = context.node(event, compensate, part if definition.wait else "/beside", Compensate(definition.activity))
    undoing.ended = _undone
    if definition.wait:
        return undoing
    undoing.next = context.node(event, steps.end, "/undone")
    return context.node(event, beside, part, undoing)


def is_compensation_handler(node: model.FlowNode) -> bool:
    """Return whether a node is an event sub-process for compensation."""
    starts = node.body.events("start") if node.triggered_by_event and node.body is not None else []
    return any(event.defined(model.CompensateDefinition) for event in starts)


def compensable(context: ScopeCompiler, event: model.Event) -> None:
    """Make a compensation boundary event and link the handler associated with it."""
    others = [one for one in context.content.boundary(event.attached_to) if one.catches_compensation]
    inside = context.model[event.attached_to].body
    if len(others) > 1 or (inside is not None and any(map(is_compensation_handler, inside.nodes))):
        context.refuse("its activity has another compensation handler: expected one, which may be a sub-process", event)
    targets = [target for source, target in context.content.associations if source == event.id]
    if len(targets) != 1 or len(event.definitions) > 1:
        context.refuse(f"a compensation event needs one handler; it has {len(targets)}", event)
    node = context.counted(context.node(event, steps.pass_on))
    context.watch(node)
    context.when_made.append(partial(_attach, context, event.attached_to, node, targets[0]))


def _attach(context: ScopeCompiler, activity: str, node: Node, handler: str) -> None:
    """Set the compensation handler of an activity, or of each instance of a repeated activity.

    After an activity without a scope of its own, a node records its completion.
    """
    main = context.main[activity]
    boundary_of(context.compensated.get(activity, main)).compensation = node
    node.next = context.entries[handler]
    if main.body is None:
        last = context.node(context.model[activity], completed, "/completed")
        last.part_of = main
        context.append(activity, last)
