"""What BPMN 2.0 forbids to connect or to say twice (table 7.3; chapters 10.3, 10.5 and 10.6; the XML schemas).

What would run as something else than it is drawn is a fault; what runs as it is drawn is a warning.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

from fame.bpmn.model import Activity, Body, CompensateDefinition, FlowNode, Gateway, LinkDefinition, SequenceFlow, Task
from fame.bpmn.reader.context import Context
from fame.bpmn.reader.xml import BPMN, Node, local_name, text_of

_Rule = tuple[Callable[[FlowNode], object], bool, str]
"""The nodes concerned, whether it is a fault, and what is wrong with a flow: {} is the node."""


def _undoes(node: FlowNode) -> bool:
    return isinstance(node, Activity) and node.for_compensation


_SOURCES: Sequence[_Rule] = (
    (lambda one: one.place == "end", False,
     "leaves the end event {}, where every token ends: this flow is never taken"),
    (lambda one: one.place == "throw" and one.defined(LinkDefinition), True,
     "leaves the link event {}: expected it to leave the catching one"),
    (lambda one: one.catches_compensation, True,
     "leaves the compensation event {}: expected an association with a handler"),
    (_undoes, True, "leaves the compensation handler {}: put what follows into a sub-process with it"),
    (lambda one: one.triggered_by_event, True, "leaves the event sub-process {}: put what follows into it"),
)  # fmt: skip
_TARGETS: Sequence[_Rule] = (
    (lambda one: one.place == "start", False,
     "leads into the start event {}, but start events have no incoming flows"),
    (lambda one: one.place == "boundary", True,
     "leads into the boundary event {}: expected an activity, a gateway or another event"),
    (lambda one: one.place == "catch" and one.defined(LinkDefinition), False,
     "leads into the link event {}: expected a gateway before what follows it"),
    (_undoes, True, "leads into the compensation handler {}: expected an association with its event"),
    (lambda one: getattr(one, "instantiate", False), False,
     "leads into {}, which starts no process then: expected instantiate=false"),
)  # fmt: skip


def check_connections(context: Context, body: Body) -> None:
    """Record what is wrong with the sequence flows of a body, and with its compensation."""
    nodes = {node.id: node for node in body.nodes}
    for flow in body.flows:
        for is_fault, text in _problems(flow, nodes[flow.source], nodes[flow.target], body):
            _record(context, flow.id, text, is_fault)
    for event, handler in ((nodes[source], nodes[target]) for source, target in body.associations):
        if event.catches_compensation and not _undoes(handler):
            text = f"is associated with {handler.display_name}: expected an activity with isForCompensation=true"
            _record(context, event.id, text, not isinstance(handler, Activity))
    for node in body.nodes:
        for task in (nodes.get(one.activity or "") for one in node.defined(CompensateDefinition)):
            if isinstance(task, Task) and not any(event.catches_compensation for event in body.boundary(task.id)):
                text = f"compensates {task.display_name}, which has no compensation handler: nothing is undone"
                _record(context, node.id, text, False)


def _record(context: Context, id: str, text: str, is_fault: bool) -> None:
    if is_fault:
        context.fault(context.elements[id], text)
    else:
        context.note(context.elements[id], text, "warning")


def _problems(flow: SequenceFlow, source: FlowNode, target: FlowNode, body: Body) -> Iterator[tuple[bool, str]]:
    for node, rules in ((source, _SOURCES), (target, _TARGETS)):
        yield from ((is_fault, text.format(node.display_name)) for concerns, is_fault, text in rules if concerns(node))
    if flow.condition is not None and not isinstance(source, Activity | Gateway):
        yield False, f"has a condition, but leaves {source.display_name}: expected an exclusive gateway before it"
    if isinstance(source, Gateway) and source.kind == "event":
        if len(target.incoming) > 1:
            yield False, f"leads to {target.display_name}, which has other incoming flows: expected only this one"
        if isinstance(target, Task) and body.boundary(target.id):
            yield (
                True,
                f"leads to {target.display_name}, which has boundary events: expected further events of the gateway",
            )


_ONCE: Mapping[str, str] = {
    **dict.fromkeys(("timeDate", "timeDuration", "timeCycle"), "time"),
    **dict.fromkeys(("standardLoopCharacteristics", "multiInstanceLoopCharacteristics"), "loop"),
    **dict.fromkeys(("conditionExpression", "condition", "loopCondition", "activationCondition"), "condition"),
    "script": "script", "completionCondition": "completion condition", "loopCardinality": "number of instances",
    "ioSpecification": "ioSpecification", "messagePath": "messagePath",
}  # fmt: skip
"""Elements that another may contain once, and what they give."""


def check_single_parts(context: Context, process: Node) -> None:
    """Record elements of a process that would count for nothing, since there is one of their kind before them."""
    for element in process.iter(*(f"{{{BPMN}}}{name}" for name in _ONCE)):
        kind = _ONCE[local_name(element)]
        before = [one for one in element.itersiblings(preceding=True) if _ONCE.get(local_name(one)) == kind]
        if _says(element) and any(map(_says, before)):
            context.fault(
                element, f"has two of <{local_name(before[0])}> and <{local_name(element)}>: expected one {kind}"
            )


def _says(element: Node) -> bool:
    return bool(len(element) or element.attrib or text_of(element).strip())
