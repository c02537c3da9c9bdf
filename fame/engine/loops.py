"""Activities that repeat: multi-instance (standard 13.3.7) and standard loops (13.3.6).

The activity becomes a scope, guarded by its boundary events, with one child scope for each instance. A multi-instance
activity has variables of its own (how many instances there are, are active, are completed), and so has each instance:
``loopCounter`` (it is the n-th that was generated), the item of the collection, and whatever is new in it. An
instance of a standard loop has none; ``loopCounter`` is known to its condition.

`Scope.items` of the activity holds the progress: items, output, how many there are, have started, are completed.
"""

from __future__ import annotations

import reprlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from fame.engine import compensation, faults, scopes, state, steps, waiting
from fame.engine.host import Compiled
from fame.engine.state import Node, Record, Scope
from fame.engine.variables import UNDEFINED, Variables

if TYPE_CHECKING:
    from fame.engine.interpreter import Engine

_COUNTERS = (("nrOf", "numberOf"), ("Instances", "ActiveInstances", "CompletedInstances"))
NAMES = ("loopCounter", *(prefix + name for prefix in _COUNTERS[0] for name in _COUNTERS[1]))
"""The variables that activities which repeat set by themselves."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Loop:
    """How an activity repeats. `instance` is the node that its child scopes stand for."""

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


def begin(engine: Engine, scope: Scope, node: Node) -> None:
    """A token comes to such an activity."""
    loop: Loop = node.loop
    try:
        values, total = extent(loop, scope.variables)
    except BaseException as error:
        faults.fail(engine, scope, node, error)
        return
    if scope.instance.scopes + (1 if loop.sequential else total) > state.SCOPES:
        faults.fail(engine, scope, node, scopes.crowd())
        return
    variables = scope.variables if loop.standard else Variables(scope.variables)
    whole = scopes.child(engine, scope, node, node.body, variables)
    whole.items = {
        "values": values,
        "out": [None] * (total if loop.output else 0),
        "total": total,
        "started": 0,
        "done": 0,
    }
    if node.armed:
        waiting.guard(engine, node.armed, scope, whole)
        if not whole.alive:
            return
    if loop.standard:
        go_round(engine, whole, node, first=True)
        return
    tell_counters(whole)
    whole.tokens = 0
    for _ in range(min(total, 1) if loop.sequential else total):
        begin_instance(engine, whole, node)
    if not total:
        scopes.finish(engine, whole)


def extent(loop: Loop, variables: dict[str, Any]) -> tuple[list[Any] | None, int]:
    """The items that a multi-instance activity is for, and how many instances that makes."""
    if loop.collection is not None:
        found = loop.collection(variables)
        if not isinstance(found, Iterable) or isinstance(found, str | bytes | Mapping):
            raise TypeError(f"the collection is a {type(found).__name__}: a list would be right")
        values = list(found)
        return values, len(values)
    if loop.cardinality is None:
        return None, 0
    return None, whole_number(loop.cardinality(variables))


def whole_number(found: Any) -> int:
    """The number of instances that a cardinality gives, also as a text. Raises ValueError for any other value."""
    number = float(found) if isinstance(found, str) and found.strip().isdecimal() else found
    try:
        if not isinstance(number, bool) and number >= 0 and int(number) == number:
            return int(number)
    except (TypeError, ValueError, OverflowError):
        pass
    raise ValueError(f"the cardinality is {reprlib.repr(found)}: a whole number from 0 on would be right")


def begin_instance(engine: Engine, whole: Scope, node: Node) -> None:
    """One more instance."""
    loop, items = node.loop, whole.items
    items["started"] += 1
    number, variables = items["started"], whole.variables
    if not loop.standard:
        variables = Variables(variables, {"loopCounter": number})
        if items["values"] is not None and loop.element:
            variables.define(loop.element, items["values"][number - 1])
        tell_counters(whole)
    whole.tokens += 1
    assert node.body is not None
    instance = scopes.child(engine, whole, loop.instance, node.body, variables)
    instance.items = number
    engine.ready.append((node.body.opening, instance))


def end_instance(engine: Engine, whole: Scope, instance: Scope) -> None:
    """The last token of an instance is gone."""
    node, items = whole.node, whole.items
    assert node is not None
    loop: Loop = node.loop
    items["done"] += 1
    whole.tokens -= 1
    if loop.instance.undo is not None:
        compensation.remember(whole, Record(loop.instance, instance.variables, instance.done or []))
    elif instance.done:
        compensation.remember(whole, *instance.done)
    if loop.standard:
        go_round(engine, whole, node, first=False)
        return
    tell_counters(whole)
    try:
        if loop.output and loop.result is not None:
            value = loop.result(instance.variables)
            items["out"][instance.items - 1] = None if value is UNDEFINED else value
        enough = loop.completion is not None and bool(loop.completion(instance.variables))
    except BaseException as error:
        faults.fail(engine, whole, loop.instance, error)
        return
    if enough and whole.tokens:
        scopes.proceed(engine, steps.FINISH, scopes.replace(engine, whole, ()))
    elif not enough and loop.sequential and items["started"] < items["total"]:
        begin_instance(engine, whole, node)
    elif not whole.tokens:
        scopes.finish(engine, whole)
    if engine.conditions:
        waiting.check_conditions(engine)


def go_round(engine: Engine, whole: Scope, node: Node, first: bool) -> None:
    """A standard loop: once more, or on."""
    loop, done = node.loop, whole.items["done"]
    again = not (loop.maximum and done >= loop.maximum)
    if again and loop.condition is not None and (loop.before or not first):
        try:
            again = bool(loop.condition(Variables(whole.variables, {"loopCounter": done})))
        except BaseException as error:
            faults.fail(engine, whole, loop.instance, error)
            return
    whole.tokens = 0
    if again:
        begin_instance(engine, whole, node)
    else:
        scopes.finish(engine, whole)


def tell_counters(whole: Scope) -> None:
    """Let the variables say how far the activity is."""
    items = whole.items
    values = (items["total"], items["started"] - items["done"], items["done"])
    assert isinstance(whole.variables, Variables)
    for prefix in _COUNTERS[0]:
        for name, value in zip(_COUNTERS[1], values, strict=True):
            whole.variables.define(prefix + name, value)
