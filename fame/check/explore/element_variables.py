"""Variables that elements use besides what their scripts and expressions name, and those of called processes."""

from __future__ import annotations

from collections.abc import Iterator

from fame.bpmn import model
from fame.engine.data import variable_name
from fame.scripting.effects import effects_of, script_effects


def taken(node: model.FlowNode, topic: model.Topic, body: model.Body) -> tuple[str, ...]:
    """Return the variables that a caught message may set."""
    if topic.takes:
        return tuple(item.target for item in topic.takes)
    return (*written_objects(node, body), variable_name(topic.name))


def written_objects(node: model.FlowNode, body: model.Body) -> tuple[str, ...]:
    """Return the variables of the data objects that an element writes."""
    return tuple(name for item in body.data_objects if item.id in node.data_outputs for name in item.names)


def used_besides_texts(node: model.FlowNode, body: model.Body) -> Iterator[str]:
    """Yield the variables that an element uses besides its texts."""
    yield from node.sets()
    yield from node.io.sets() if node.io is not None else ()
    yield from results_read(node)
    for topic, throws in node.topics():
        yield from (name for key, source in node.keys_of(topic) for name in (key, *effects_of(source).reads))
        if not throws:
            yield from taken(node, topic, body)
            yield from (name for item in topic.takes for name in effects_of(item.source).reads)


def results_read(node: model.FlowNode) -> Iterator[str]:
    """Yield the variables of a called process that the output mapping of its call reads."""
    if isinstance(node, model.CallActivity) and node.io is not None:
        yield from (name for item in node.io.outputs for name in effects_of(item.source).reads)


def written_by(process: model.Process) -> Iterator[str]:
    """Yield the variables that a called process may set, or change in place where that is certain."""
    for node in process.body.walk():
        yield from script_effects(node).writes
        yield from used_besides_texts(node, process.body)
        if isinstance(node, model.Task) and node.result_variable:
            yield node.result_variable
    for body in process.body.bodies():
        for item in body.data_objects:
            yield from item.names


def changed_by(process: model.Process) -> Iterator[str]:
    """Yield the variables whose values scripts of a called process may change in place."""
    for node in process.body.walk():
        yield from script_effects(node).changes | script_effects(node).may_change


def assigned_by(process: model.Process) -> Iterator[str]:
    """Yield the variables that scripts of a called process set, or may change in place."""
    for node in process.body.walk():
        yield from script_effects(node).writes | script_effects(node).may_change
