"""Checks of values that are written in the model: of properties, and of constant expressions."""

from __future__ import annotations

import ast
import difflib
from collections.abc import Iterator, Mapping, Sequence, Set

from fame.bpmn.extension_properties import (
    AD_HOC,
    ANY,
    CATCHES,
    EVENT_SUB_PROCESSES,
    PROCESSES,
    PROPERTIES,
    REPETITIONS,
    SERVICES,
    THROWS,
    TIMERS,
)
from fame.bpmn.model import Element, Expression, FlowNode, MultiInstance, TimerDefinition
from fame.check.expressions import constant, expressions_in
from fame.check.scope import CheckedProcess, CheckScope, Finding, Fix
from fame.engine.loops import whole_number
from fame.robot.mission import MISSED, RETRIES

_VALUES: Mapping[str, Sequence[str]] = {"retry": RETRIES, "missed": MISSED}
"""The known values of properties; the readers of these take any other value for the default."""


def check_literals(scope: CheckScope) -> Iterator[Finding]:
    """Find unknown values of properties, and constants that cannot be computed in time."""
    for process in scope.processes:
        yield from _values(process, process.bpmn, set(PROPERTIES[PROCESSES]))
        for node in process.nodes():
            if not _VALUES.keys().isdisjoint(node.properties):
                yield from _values(process, node, set(properties_of(node)))
        for text in (text for body in process.bodies() for text in expressions_in(body)):
            endless = constant(text.expression)[1]
            if endless:
                yield process.finding("error", f"cannot be computed: {endless}", text.element, text.expression.line)
        for node in process.nodes():
            if isinstance(node.loop, MultiInstance) and node.loop.cardinality is not None:
                yield from _cardinality(process, node, node.loop.cardinality)


def _cardinality(process: CheckedProcess, node: FlowNode, expression: Expression) -> Iterator[Finding]:
    """A constant number of instances that the engine refuses whenever a token comes."""
    try:
        number = ast.literal_eval(expression.text)
    except (ValueError, SyntaxError, RecursionError, MemoryError):
        number = constant(expression)[0]
    if number is not None:
        try:
            whole_number(number)
        except ValueError as error:
            yield process.finding("error", str(error), node, expression.line)


def _values(process: CheckedProcess, element: Element, known: Set[str]) -> Iterator[Finding]:
    for name, values in _VALUES.items():
        value = element.properties.get(name) if name in known else None
        if value is not None and value not in values:
            nearest = difflib.get_close_matches(value.strip().lower(), values, 1, 0.4)
            fixes = [Fix(f"set {name} = {one}", element.id, "property", one, name) for one in nearest]
            text = f"property {name}={value!r}: expected {', '.join(values[:-1])} or {values[-1]}"
            yield process.finding("error", text, element, fix=next(iter(fixes), None))


def properties_of(node: FlowNode) -> Iterator[str]:
    """Return the names of the properties that have a meaning at a node."""
    yield from PROPERTIES[ANY]
    for _, thrown in node.topics():
        yield from PROPERTIES[THROWS if thrown else CATCHES]
    if node.triggered_by_event:
        yield from PROPERTIES[EVENT_SUB_PROCESSES]
    if node.service is not None:
        yield from PROPERTIES[SERVICES]
    elif node.script is not None:
        yield "retry"  # of what its script calls
    if node.defined(TimerDefinition):
        yield from PROPERTIES[TIMERS]
    if node.tag == "adHocSubProcess":
        yield from PROPERTIES[AD_HOC]
    if node.loop is not None:
        yield from PROPERTIES[REPETITIONS]
