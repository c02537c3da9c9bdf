"""The scripts and expressions of a process, and the variables that each of them reads and writes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from fame.bpmn.model import (
    Activity,
    Body,
    CallActivity,
    ConditionalDefinition,
    DataObject,
    Element,
    Event,
    Expression,
    FlowNode,
    Gateway,
    MultiInstance,
    SequenceFlow,
    StandardLoop,
    SubProcess,
    Task,
    TimerDefinition,
)
from fame.bpmn.topics import topics_of
from fame.errors import ModelError
from fame.scripting import code_names, script_names

Use = Literal["script", "condition", "payload", "timer", "mapping", "value"]
Found = tuple[Expression | None, Use]


@dataclass(frozen=True, slots=True)
class ExpressionUse:
    """A script or expression, its element and use, and the variables that it reads and writes.

    `code`: the functions, classes and modules that it leaves for later scripts.
    """

    expression: Expression
    element: Element
    use: Use
    reads: frozenset[str]
    writes: frozenset[str]
    code: frozenset[str] = frozenset()


def expressions_in(body: Body) -> Iterator[ExpressionUse]:
    """Every script and expression of a body; those of its sub-processes belong to their own bodies."""
    elements: list[Element] = [*body.data_objects, *body.flows, *body.nodes]
    for element in elements:
        for expression, use in _texts(element):
            if expression is not None:
                reads, writes = names_of(expression, use == "script")
                code = _code_of(expression) if use == "script" else frozenset[str]()
                yield ExpressionUse(expression, element, use, reads - _own(element, expression), writes, code)


def _own(element: Element, value: Expression) -> set[str]:
    """The name of the data object's value itself: ``x: ${x}`` only declares it."""
    if not isinstance(element, DataObject):
        return set()
    return {name for name, expression in element.values if expression is value}


def names_of(expression: Expression, script: bool = False) -> tuple[frozenset[str], frozenset[str]]:
    """The names that a text reads and writes; none if it is invalid, which the compiler reports."""
    try:
        return script_names(expression, script=script)
    except (ModelError, RecursionError):  # the one is told by the compiler, the other is nested too deeply
        return frozenset(), frozenset()


def _code_of(script: Expression) -> frozenset[str]:
    try:
        return code_names(script)
    except (ModelError, RecursionError):
        return frozenset()


def _texts(element: Element) -> Iterator[Found]:
    if isinstance(element, DataObject):
        yield from ((expression, "value") for _, expression in element.values)
    elif isinstance(element, SequenceFlow):
        yield element.condition, "condition"
    elif isinstance(element, Gateway):
        yield element.activation, "condition"
    elif isinstance(element, Event):
        yield from _of_event(element)
    elif isinstance(element, Activity):
        yield from _of_activity(element)
    if isinstance(element, FlowNode):
        yield from ((item.source, "mapping") for item in (*element.copies_in, *element.copies_out))
        yield from ((topic.payload, "payload") for topic, _ in topics_of(element))
        yield from ((topic.to, "value") for topic, _ in topics_of(element))


def _of_event(event: Event) -> Iterator[Found]:
    if event.io is not None:
        yield from ((item.source, "mapping") for item in (*event.io.inputs, *event.io.outputs))
    for definition in event.definitions:
        if isinstance(definition, TimerDefinition):
            yield definition.expression, "timer"
        elif isinstance(definition, ConditionalDefinition):
            yield definition.condition, "condition"


def _of_activity(activity: Activity) -> Iterator[Found]:
    if activity.io is not None:
        yield from ((item.source, "mapping") for item in activity.io.inputs)
        if not isinstance(activity, CallActivity):  # those of a call see the variables of what was called
            yield from ((item.source, "mapping") for item in activity.io.outputs)
    if isinstance(activity, Task):
        script = activity.script is not None and activity.script.language in ("python", "javascript")
        yield activity.script, "script" if script else "mapping"
        if activity.payload is not None and not list(topics_of(activity)):
            yield activity.payload, "payload"
    elif isinstance(activity, CallActivity):
        yield activity.called_expression, "mapping"
    elif isinstance(activity, SubProcess):
        yield activity.completion, "condition"
        yield activity.active, "mapping"
    if isinstance(activity.loop, StandardLoop):
        yield activity.loop.condition, "condition"
    elif isinstance(activity.loop, MultiInstance):
        loop = activity.loop
        yield from ((one, "mapping") for one in (loop.cardinality, loop.collection, loop.output_element))
        yield loop.completion, "condition"
