"""Repeated activities: multi-instance (standard 13.3.7) and standard loops (13.3.6).

The activity becomes a scope with its boundary events and one child scope for each instance. A multi-instance activity
has variables of its own (number of all, active and completed instances), and so has each instance: ``loopCounter`` (its
number, from 1), the item of the collection, and new variables. A pass of a standard loop has only ``loopCounter``, the
number of completed passes, which its condition can use, too; new variables are those of the scope around the loop.

`Scope.items` of the activity holds the progress: items, output, and the number of all, started and completed instances.
"""

from __future__ import annotations

import reprlib
from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any

from fame.bpmn import model
from fame.dataclasses import dataclass
from fame.engine import compensation, faults, scopes, state, steps, subprocesses, waiting
from fame.engine.data import UNDEFINED, Variables, chained
from fame.engine.engine_state import EngineState
from fame.engine.program import Body, Compiled, LoopInstance, Node
from fame.engine.scope_compiler import ScopeCompiler
from fame.engine.state import Record, Scope

_COUNTERS = (("nrOf", "numberOf"), ("Instances", "ActiveInstances", "CompletedInstances"))
NAMES = ("loopCounter", *(prefix + name for prefix in _COUNTERS[0] for name in _COUNTERS[1]))
"""The variables that the engine sets for repeated activities."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Loop:
    """Spec of a repeated activity. `instance` is the node of its child scopes."""

    instance: Node
    standard: bool = False
    sequential: bool = True
    cardinality: Compiled | None = None
    collection: Compiled | None = None
    element: str = ""
    completion: Compiled | None = None
    output: str = ""
    result: Compiled | None = None
    condition: Compiled | None = None
    before: bool = False
    maximum: int = 0


# ---- steps ---------------------------------------------------------------------------------------


def begin(engine: EngineState, scope: Scope, node: Node) -> None:
    """Open the scope of a repeated activity and start its first instance, or all of them."""
    loop: Loop = node.spec
    try:
        values, total = extent(loop, scope.variables)
        starts = loop.standard and (not loop.before or _goes_on(loop, scope.variables, 0))
        if scope.instance.scopes + (1 if loop.sequential else total) > state.SCOPES:
            raise scopes.too_many()
    except BaseException as error:
        faults.fail(engine, scope, node, error)
        return
    if not loop.sequential and total > state.TOKENS:
        faults.abandon_crowd(engine, scope.instance, node)
        return
    variables = scope.variables if loop.standard else chained(scope.variables, {})
    whole = scopes.open_child(engine, scope, node, node.body, variables)
    whole.items = {
        "values": values,
        "out": [None] * (total if loop.output else 0),
        "total": total,
        "started": 0,
        "done": 0,
    }
    if node.boundary is not None:
        waiting.arm_all(engine, node.boundary.armed, scope, whole)
        if not whole.alive:
            return
    whole.tokens = 0
    if not loop.standard:
        set_counters(whole)
    for _ in range(starts if loop.standard else min(total, 1) if loop.sequential else total):
        begin_instance(engine, whole, node)
    if not loop.standard:
        set_counters(whole)
    if not whole.tokens:
        scopes.finish(engine, whole)


def extent(loop: Loop, variables: dict[str, Any]) -> tuple[list[Any] | None, int]:
    """Return the items of a multi-instance activity (None: by cardinality), and its number of instances."""
    if loop.collection is not None:
        collection = loop.collection(variables)
        if not isinstance(collection, Iterable) or isinstance(collection, str | bytes | Mapping):
            raise TypeError(f"expected a list as collection, got {type(collection).__name__}")
        # The order of a set of texts differs in each process: sorted, the same seed gives the same run.
        values = sorted(collection) if isinstance(collection, set | frozenset) else list(collection)
        return values, len(values)
    if loop.cardinality is None:
        return None, 0
    number = whole_number(loop.cardinality(variables))
    if loop.output and number > state.SCOPES:  # the list of results is made at once
        raise ValueError(f"expected a cardinality of at most {state.SCOPES}, since results are kept, got {number}")
    return None, number


def whole_number(value: Any) -> int:
    """Return the number of instances for a cardinality, a number or digits. Raises ValueError for any other value."""
    number = float(value) if isinstance(value, str) and value.strip().isdecimal() else value
    try:
        if not isinstance(number, bool) and number >= 0 and int(number) == number:
            return int(number)
    except (TypeError, ValueError, OverflowError):
        pass
    raise ValueError(f"expected a whole number from 0 on as cardinality, got {reprlib.repr(value)}")


def begin_instance(engine: EngineState, whole: Scope, node: Node) -> None:
    loop, items = node.spec, whole.items
    items["started"] += 1
    number = items["started"]
    variables = chained(whole.variables, {"loopCounter": number - 1 if loop.standard else number})
    variables.passes_on = loop.standard
    if not loop.standard:
        if items["values"] is not None and loop.element:
            variables.define(loop.element, items["values"][number - 1])
        if loop.sequential:  # of parallel ones once for all
            set_counters(whole)
    whole.tokens += 1
    assert node.body is not None
    instance = scopes.open_child(engine, whole, loop.instance, node.body, variables)
    instance.items = number
    engine.ready.append((node.body.opening, instance))


def end(engine: EngineState, scope: Scope, node: Node) -> None:
    """End the token of an instance, and the instance; if an expression fails, this can be executed again."""
    assert scope.parent is not None
    try:
        _decide(scope.parent, scope)
    except BaseException as error:
        faults.fail(engine, scope, node, error)
        return
    scopes.end_token(engine, scope)


def _decide(whole: Scope, instance: Scope) -> None:
    """Count an instance as completed, take its output, and decide whether it is the last one (``enough``)."""
    assert whole.node is not None
    loop, items = whole.node.spec, whole.items
    items["done"] += 1
    try:
        if loop.standard:
            items["enough"] = not _goes_on(loop, whole.variables, items["done"])
            return
        set_counters(whole)
        if loop.output and loop.result is not None:
            value = loop.result(instance.variables)
            items["out"][instance.items - 1] = None if value is UNDEFINED else value
        items["enough"] = loop.completion is not None and bool(loop.completion(instance.variables))
    except BaseException:
        items["done"] -= 1
        if not loop.standard:
            set_counters(whole)
        raise


def _goes_on(loop: Loop, variables: dict[str, Any], done: int) -> bool:
    """Return whether a standard loop has another iteration."""
    if loop.maximum and done >= loop.maximum:
        return False
    return loop.condition is None or bool(loop.condition(Variables(variables, {"loopCounter": done})))


def end_instance(engine: EngineState, whole: Scope, instance: Scope) -> None:
    """Complete an instance; start the next one, or end the activity."""
    node, items = whole.node, whole.items
    assert node is not None
    loop: Loop = node.spec
    whole.tokens -= 1
    if "enough" not in items:  # its token was dropped
        try:
            _decide(whole, instance)
        except BaseException as error:
            faults.fail(engine, whole, loop.instance, error, again=False)
            return
    enough = items.pop("enough")
    if loop.instance.boundary is not None:
        compensation.remember(whole, Record(loop.instance, instance.variables, instance.done or []))
    elif instance.done:
        compensation.remember(whole, *instance.done)
    if not loop.standard:
        set_counters(whole)
    if enough and whole.tokens:
        scopes.proceed(engine, steps.FINISH, *scopes.replace(engine, whole, ()))
    elif not enough and (loop.standard or (loop.sequential and items["started"] < items["total"])):
        begin_instance(engine, whole, node)
    elif not whole.tokens:
        scopes.finish(engine, whole)
    if engine.conditions:
        waiting.check_conditions(engine)


def leave(engine: EngineState, scope: Scope, whole: Scope) -> None:
    """Leave the loop after its last instance: pass on the results, and continue the token."""
    assert whole.node is not None
    output = whole.node.spec.output
    subprocesses.leave_with(engine, scope, whole, [(output, whole.items["out"])] if output else [])


def set_counters(whole: Scope) -> None:
    """Set the variables that count instances."""
    items = whole.items
    values = (items["total"], items["started"] - items["done"], items["done"])
    assert isinstance(whole.variables, Variables)
    for prefix in _COUNTERS[0]:
        for name, value in zip(_COUNTERS[1], values, strict=True):
            whole.variables.define(prefix + name, value)


# ---- compiling -----------------------------------------------------------------------------------


def repeated(
    context: ScopeCompiler, element: model.Activity, how: model.MultiInstance | model.StandardLoop, inner: Node
) -> Node:
    """Make a repeated activity: a scope in which the activity itself (`inner`) runs once for each instance."""
    node = context.node(element, begin, "/loop")
    instance = context.node(element, steps.pass_on, "/instance", LoopInstance(isinstance(how, model.StandardLoop)))
    node.ended, instance.ended = leave, end_instance
    context.compensated[element.id] = instance
    node.body = Body(element.id)
    inner.next = context.node(element, end, "/instance/end")
    context.open_with(inner, node.body, element.id)
    compiled = partial(context.optional, element=element)
    if isinstance(how, model.StandardLoop):
        if how.condition is None and not how.maximum:
            context.refuse("a loop needs a condition or a maximum", element)
        condition = compiled(how.condition)
        node.spec = Loop(
            instance=instance, standard=True, condition=condition, before=how.test_before, maximum=how.maximum
        )
    else:
        if how.cardinality is None and how.collection is None:
            context.refuse("the multi-instance activity has neither a collection nor a cardinality", element)
        node.spec = Loop(
            instance=instance,
            sequential=how.sequential,
            cardinality=compiled(how.cardinality),
            collection=compiled(how.collection),
            element=how.element_variable,
            completion=compiled(how.completion),
            output=how.output_collection,
            result=compiled(how.output_element),
        )
    return node
