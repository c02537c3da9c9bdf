"""The content of a scope: its flow nodes, flows and data, read and checked to hang together."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Literal

from fame.bpmn.activities import TASKS, read_activity, read_call, read_task
from fame.bpmn.context import Context, boolean, find, truth
from fame.bpmn.data import Moves, read_data_objects, read_moves
from fame.bpmn.dialects import extensions_of
from fame.bpmn.dialects.extensions import Extensions
from fame.bpmn.events import PLACES, Source, Surroundings, read_definitions
from fame.bpmn.expressions import body
from fame.bpmn.model import (
    EMPTY,
    Activity,
    Body,
    CompensateDefinition,
    Event,
    FlowNode,
    Gateway,
    SequenceFlow,
    SubProcess,
)
from fame.bpmn.xml import BPMN, Node, Parts, child, line_of, local, parts_of, text_of

Wiring = Mapping[str, tuple[list[str], list[str]]]
"""Flow node -> ids of its incoming and outgoing sequence flows, in document order."""

_GATEWAYS: Mapping[str, Literal["exclusive", "inclusive", "parallel", "event", "complex"]] = {
    "exclusiveGateway": "exclusive",
    "inclusiveGateway": "inclusive",
    "parallelGateway": "parallel",
    "eventBasedGateway": "event",
    "complexGateway": "complex",
}
_SUB_PROCESSES: Mapping[str, Literal["embedded", "transaction", "adhoc"]] = {
    "subProcess": "embedded",
    "transaction": "transaction",
    "adHocSubProcess": "adhoc",
}
_OTHER = {
    "documentation", "extensionElements", "auditing", "monitoring", "ioSpecification", "ioBinding", "property",
    "laneSet", "incoming", "outgoing", "dataInputAssociation", "dataOutputAssociation", "association", "group",
    "textAnnotation", "resourceRole", "performer", "humanPerformer", "potentialOwner", "correlationSubscription",
    "supports", "categoryValueRef", "multiInstanceLoopCharacteristics", "standardLoopCharacteristics",
    "completionCondition", "sequenceFlow", "dataObject", "dataObjectReference", "dataStoreReference",
}  # fmt: skip
"""What stands in a scope and is no flow node."""
_B = f"{{{BPMN}}}"


def read_body(context: Context, around: Surroundings, element: Node, parts: Parts) -> Body:
    """The content of a process or sub-process.

    Raises ModelError for a flow node that BPMN 2.0 does not have, a sequence flow or boundary event that hangs in the
    air or crosses the border of the scope, a default flow that does not leave its node.
    """
    wiring, flows = _wiring(context, parts)
    nodes = []
    for one in element:
        read = _READERS.get(one.tag)
        if read is not None:
            nodes.append(read(context, around, one, wiring))
        else:
            _pass_over(context, one)
    found = {node.id: node for node in nodes}
    for flow in flows:
        _check_flow(context, flow, found)
    for node, place in zip(nodes, (one for one in element if one.tag in _READERS), strict=True):
        _check_node(context, place, node, found)
    return Body(
        nodes=tuple(nodes),
        flows=tuple(_flow(context, one) for one in flows),
        data_objects=read_data_objects(context, parts),
        associations=tuple(_associations(element, found)),
    )


def _wiring(context: Context, parts: Parts) -> tuple[Wiring, list[Node]]:
    wiring: dict[str, tuple[list[str], list[str]]] = {}
    flows = parts.get("sequenceFlow", [])
    for flow in flows:
        id = context.claim(flow)
        wiring.setdefault(flow.get("sourceRef", ""), ([], []))[1].append(id)
        wiring.setdefault(flow.get("targetRef", ""), ([], []))[0].append(id)
    return wiring, flows


def _pass_over(context: Context, element: Node) -> None:
    if not element.tag.startswith(_B):
        context.note(element, f"<{element.tag}> is not of BPMN: it stays in the file and has no effect")
    elif local(element) not in _OTHER:
        raise context.error(element, f"<{local(element)}> is not a flow element that FAME knows")


# ---- checks ----------------------------------------------------------------------------------------------------------


def _check_flow(context: Context, flow: Node, nodes: Mapping[str, FlowNode]) -> None:
    for end, preposition in (("sourceRef", "from"), ("targetRef", "to")):
        reference = flow.get(end, "")
        if reference in nodes:
            continue
        if not reference:
            raise context.error(flow, f"the sequence flow has no {end}")
        exists = any(one.get("id") == reference for one in flow.getroottree().getroot().iter(*_READERS))
        why = "it crosses the border of its scope" if exists else "there is no such flow node"
        raise context.error(flow, f"the sequence flow goes {preposition} {reference!r}: {why}")


def _check_node(context: Context, element: Node, node: FlowNode, nodes: Mapping[str, FlowNode]) -> None:
    if isinstance(node, Event) and node.place == "boundary":
        host = nodes.get(node.attached_to)
        if host is None:
            text = f"the boundary event is attached to {node.attached_to!r}: there is no such activity in its scope"
            raise context.error(element, text if node.attached_to else "the boundary event is attached to nothing")
        if not isinstance(host, Activity):
            raise context.error(
                element, f"the boundary event is attached to {node.attached_to!r}, which is not an activity"
            )
    default = node.default if isinstance(node, Activity | Gateway) else ""
    if default and default not in node.outgoing:
        raise context.error(element, f"its default flow {default!r} is not one of those that leave it")


# ---- flows -----------------------------------------------------------------------------------------------------------


def _flow(context: Context, element: Node) -> SequenceFlow:
    holder = child(element, "conditionExpression") if len(element) else None
    extensions = extensions_of(context, element) if len(element) else None
    return SequenceFlow(
        id=element.get("id", ""),
        name=element.get("name", ""),
        line=line_of(element),
        documentation=documentation(element) if len(element) else "",
        properties=extensions.rest() if extensions is not None else EMPTY,
        source=element.get("sourceRef", ""),
        target=element.get("targetRef", ""),
        condition=body(context, holder) if holder is not None else None,
    )


def _associations(element: Node, nodes: Mapping[str, FlowNode]) -> Iterator[tuple[str, str]]:
    """Those between its flow nodes, wherever they stand; from compensation event to handler, however drawn."""
    for one in _all_associations(element):
        source, target = find(nodes, one.get("sourceRef")), find(nodes, one.get("targetRef"))
        if source is None or target is None:
            continue
        if _compensates(target) and not _compensates(source):
            source, target = target, source
        yield source.id, target.id


def _all_associations(element: Node) -> Iterator[Node]:
    holder: Node | None = element
    while holder is not None:
        yield from holder.iterchildren(f"{_B}association")
        if local(holder) == "definitions":
            for collaboration in holder.iterchildren(f"{_B}collaboration"):
                yield from collaboration.iterchildren(f"{_B}association")
        holder = holder.getparent()


def _compensates(node: FlowNode) -> bool:
    return (
        isinstance(node, Event)
        and node.place == "boundary"
        and any(isinstance(one, CompensateDefinition) for one in node.definitions)
    )


# ---- flow nodes ------------------------------------------------------------------------------------------------------


def documentation(element: Node) -> str:
    """The text of its documentation."""
    return "\n".join(text_of(one).strip() for one in element.iterchildren(f"{_B}documentation"))


def _common(context: Context, element: Node, parts: Parts, wiring: Wiring, moves: Moves) -> dict[str, Any]:
    id = context.claim(element)
    incoming, outgoing = wiring.get(id, ((), ()))
    return {
        "id": id,
        "name": element.get("name", ""),
        "line": line_of(element),
        "documentation": documentation(element) if "documentation" in parts else "",
        "incoming": tuple(incoming),
        "outgoing": tuple(outgoing),
        "data_inputs": moves.inputs,
        "data_outputs": moves.outputs,
    }


def _prepare(
    context: Context, around: Surroundings, element: Node, wiring: Wiring
) -> tuple[Parts, Extensions, Moves, dict[str, Any]]:
    parts = parts_of(element)
    moves = read_moves(context, around.data, parts)
    return parts, extensions_of(context, element), moves, _common(context, element, parts, wiring, moves)


def _event(context: Context, around: Surroundings, element: Node, wiring: Wiring) -> Event:
    parts, found, moves, common = _prepare(context, around, element, wiring)
    place = PLACES[local(element)]
    source = Source(around, element, common["id"], place, found, moves.assigned_out)
    definitions = read_definitions(context, source, parts)
    interrupting = "cancelActivity" if place == "boundary" else "isInterrupting"
    return Event(
        place=place,
        definitions=definitions,
        attached_to=element.get("attachedToRef", ""),
        interrupting=boolean(context, element, interrupting, True),
        parallel=boolean(context, element, "parallelMultiple"),
        properties=found.rest(),
        **common,
    )


def _gateway(context: Context, around: Surroundings, element: Node, wiring: Wiring) -> Gateway:
    parts, found, _, common = _prepare(context, around, element, wiring)
    activation = parts.get("activationCondition")
    return Gateway(
        kind=_GATEWAYS[local(element)],
        default=element.get("default", ""),
        activation=body(context, activation[0]) if activation else None,
        instantiate=boolean(context, element, "instantiate"),
        all_events=element.get("eventGatewayType") == "Parallel",
        properties=found.rest(),
        **common,
    )


def _task(context: Context, around: Surroundings, element: Node, wiring: Wiring) -> FlowNode:
    parts, found, moves, common = _prepare(context, around, element, wiring)
    return read_task(context, around, element, parts, found, moves, common, TASKS[local(element)])


def _call(context: Context, around: Surroundings, element: Node, wiring: Wiring) -> FlowNode:
    parts, found, moves, common = _prepare(context, around, element, wiring)
    return read_call(context, element, parts, found, moves, common)


def _sub_process(context: Context, around: Surroundings, element: Node, wiring: Wiring) -> SubProcess:
    parts, found, moves, common = _prepare(context, around, element, wiring)
    by_event = boolean(context, element, "triggeredByEvent")
    resume = found.take("resume")
    completion = parts.get("completionCondition")
    return SubProcess(
        kind="event" if by_event else _SUB_PROCESSES[local(element)],
        body=read_body(context, around, element, parts),
        resume=truth(context, element, "resume", resume.value) if resume is not None else False,
        completion=body(context, completion[0]) if completion else None,
        sequential=element.get("ordering") == "Sequential",
        cancel_remaining=boolean(context, element, "cancelRemainingInstances", True),
        properties=found.rest(),
        **common,
        **read_activity(context, element, parts, found, moves),
    )


_Reader = Callable[[Context, Surroundings, Node, Wiring], FlowNode]
_READERS: Mapping[str, _Reader] = {
    **{f"{_B}{tag}": _event for tag in PLACES},
    **{f"{_B}{tag}": _gateway for tag in _GATEWAYS},
    **{f"{_B}{tag}": _task for tag in TASKS},
    **{f"{_B}{tag}": _sub_process for tag in _SUB_PROCESSES},
    f"{_B}callActivity": _call,
}
