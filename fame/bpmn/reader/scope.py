"""Reads the content of a scope: flow nodes, flows and data, with checks of their references."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Literal

from fame.bpmn.model import (
    EMPTY,
    GATEWAYS,
    PLACES,
    TASKS,
    Activity,
    Body,
    Event,
    Expression,
    FlowNode,
    Gateway,
    SequenceFlow,
    SubProcess,
)
from fame.bpmn.reader.activities import read_activity, read_call, read_task
from fame.bpmn.reader.connections import check_connections
from fame.bpmn.reader.context import Context, boolean_property
from fame.bpmn.reader.data import read_data_objects
from fame.bpmn.reader.dialects import read_extensions
from fame.bpmn.reader.events import read_definitions, read_mapping
from fame.bpmn.reader.expressions import condition_of, variable_or_expression
from fame.bpmn.reader.flow_nodes import Connections, ProcessContext, documentation, read_node
from fame.bpmn.reader.xml import BPMN, Node, Parts, attributes, child, line_of, local_id, local_name, resolve

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
"""Elements of a scope that are not flow nodes."""
_B = f"{{{BPMN}}}"
_LEVELS = 64
"""How deep sub-processes may be nested: readers, compiler and checks walk them recursively."""


def read_body(process: ProcessContext, element: Node, parts: Parts) -> Body:
    """Read the content of a process or sub-process.

    Faults are elements that BPMN 2.0 does not define, sequence flows and boundary events whose ends are missing or in
    another scope, default flows that do not leave their node, and what `check_connections` finds.
    """
    context = process.context
    wiring, flows = _wiring(context, element, parts)
    nodes: dict[str, FlowNode] = {}
    for inner in element:
        read = _READERS.get(inner.tag)
        if read is None:
            _check_other(context, inner)
        else:
            node = read(process, inner, wiring)
            nodes[node.id] = node
    body = Body(
        nodes=tuple(_checked(context, node, nodes) for node in nodes.values()),
        flows=tuple(_flow(context, one) for one in flows),
        data_objects=read_data_objects(context, parts),
        associations=tuple(_associations(context, nodes)),
    )
    check_connections(context, body)
    return body


def _wiring(context: Context, element: Node, parts: Parts) -> tuple[Connections, list[Node]]:
    """The sequence flows between nodes of the scope, and the nodes that they connect."""
    wiring: dict[str, tuple[list[str], list[str]]] = {}
    nodes = {one.get("id", "") for one in element if one.tag in _READERS} - {""}
    ids = {context.register(flow): flow for flow in parts.get("sequenceFlow", ())}
    flows = {id: flow for id, flow in ids.items() if _has_both_ends(context, flow, nodes)}
    for id, flow in flows.items():
        wiring.setdefault(flow.get("sourceRef", "").strip(), ([], []))[1].append(id)
        wiring.setdefault(flow.get("targetRef", "").strip(), ([], []))[0].append(id)
    return wiring, list(flows.values())


def _check_other(context: Context, element: Node) -> None:
    if not element.tag.startswith(_B):
        context.note(element, f"<{element.tag}> is not a BPMN element and has no effect")
    elif local_name(element) not in _OTHER:
        context.fault(element, f"<{local_name(element)}> is not a flow element that FAME knows")


# ---- checks ----------------------------------------------------------------------------------------------------------


def _has_both_ends(context: Context, flow: Node, nodes: set[str]) -> bool:
    """Whether both ends of a sequence flow are nodes of its scope. Otherwise it is a fault."""
    for end, preposition in (("sourceRef", "from"), ("targetRef", "to")):
        reference = flow.get(end, "").strip()
        if reference in nodes:
            continue
        text = (
            f"goes {preposition} {reference!r}: {_why_not(context, flow, reference)}" if reference else f"has no {end}"
        )
        context.fault(flow, f"the sequence flow {text}")
        return False
    return True


def _why_not(context: Context, flow: Node, reference: str) -> str:
    """Why a reference does not name a flow node of the same scope."""
    element = context.find_in_file(flow, reference)
    if element is None:
        return "there is no such flow node"
    if element.tag in _READERS:
        return "it crosses the boundary of its scope"
    namespace, _, name = element.tag.rpartition("}")
    if f"{namespace}}}" == _B:
        return f"that is a <{name}>, not a flow node"
    where = f"of namespace {namespace[1:]}" if namespace else "without a namespace"
    return f"that is a <{name}> {where}, which is not a flow node of BPMN 2.0"


def _checked(context: Context, node: FlowNode, nodes: Mapping[str, FlowNode]) -> FlowNode:
    """The node without an invalid default flow; a boundary event without an activity becomes an intermediate event."""
    if isinstance(node, Event) and node.place == "boundary":
        why = _why_not_attached(node.attached_to, nodes.get(node.attached_to))
        if why:
            context.fault(context.elements[node.id], f"the boundary event is attached to {why}")
            return replace(node, place="catch", attached_to="")
    if isinstance(node, Activity | Gateway) and node.default and node.default not in node.outgoing:
        text = f"its default flow {node.default!r} is not one of those that leave it"
        context.fault(context.elements[node.id], text)
        return replace(node, default="")
    return node


def _why_not_attached(id: str, host: FlowNode | None) -> str:
    """Why a boundary event cannot be attached to a node, or empty."""
    if not id:
        return "nothing"
    if host is None:
        return f"{id!r}: there is no such activity in its scope"
    if not isinstance(host, Activity):
        return f"{id!r}, which is not an activity"
    return f"{id!r}, an event sub-process, which cannot have boundary events" if host.triggered_by_event else ""


# ---- flows -----------------------------------------------------------------------------------------------------------


def _flow(context: Context, element: Node) -> SequenceFlow:
    extensions = read_extensions(context, element) if len(element) else None
    return SequenceFlow(
        id=element.get("id", ""),
        name=element.get("name", ""),
        line=line_of(element),
        documentation=documentation(element) if len(element) else "",
        properties=extensions.remaining() if extensions is not None else EMPTY,
        source=element.get("sourceRef", "").strip(),
        target=element.get("targetRef", "").strip(),
        condition=_condition(context, element) if len(element) else None,
    )


def _condition(context: Context, flow: Node) -> Expression | None:
    holder = child(flow, "conditionExpression")
    if holder is None:
        return None
    for name in attributes(holder):
        if name.endswith("}resource"):
            text = f"its condition is the resource {holder.get(name)}; put its text into the condition"
            context.fault(flow, text)
            return None
    return condition_of(context, holder)


def _associations(context: Context, nodes: Mapping[str, FlowNode]) -> Iterator[tuple[str, str]]:
    """(source, target) of the associations between flow nodes of a scope, from compensation event to handler."""
    for association in dict.fromkeys(one for id in nodes for one in context.associations.get(id, ())):
        source, target = resolve(nodes, association.get("sourceRef")), resolve(nodes, association.get("targetRef"))
        if source is None or target is None:
            continue
        if target.catches_compensation and not source.catches_compensation:
            source, target = target, source
        yield source.id, target.id


# ---- flow nodes ------------------------------------------------------------------------------------------------------


def _event(process: ProcessContext, element: Node, wiring: Connections) -> Event:
    node = read_node(process, element, wiring)
    place = PLACES[local_name(element)]
    definitions = read_definitions(node, place)
    return Event(
        place=place,
        definitions=definitions,
        io=read_mapping(node, place, definitions),
        attached_to=local_id(element, "attachedToRef"),
        interrupting=node.flag("cancelActivity" if place == "boundary" else "isInterrupting", True),
        parallel=node.flag("parallelMultiple"),
        properties=node.extensions.remaining(),
        **node.common,
    )


def _gateway(process: ProcessContext, element: Node, wiring: Connections) -> Gateway:
    node = read_node(process, element, wiring)
    activation = node.parts.get("activationCondition")
    return Gateway(
        kind=GATEWAYS[local_name(element)],
        default=node.get("default"),
        activation=condition_of(node.context, activation[0]) if activation else None,
        instantiate=node.flag("instantiate"),
        all_events=node.get("eventGatewayType") == "Parallel",
        properties=node.extensions.remaining(),
        **node.common,
    )


def _task(process: ProcessContext, element: Node, wiring: Connections) -> FlowNode:
    return read_task(read_node(process, element, wiring), TASKS[local_name(element)])


def _call(process: ProcessContext, element: Node, wiring: Connections) -> FlowNode:
    return read_call(read_node(process, element, wiring))


def _sub_process(process: ProcessContext, element: Node, wiring: Connections) -> SubProcess:
    node = read_node(process, element, wiring)
    _limit_levels(process.context, element)
    resume = node.extensions.take("resume")
    completion, active = node.parts.get("completionCondition"), node.extensions.active.strip()
    listed = node.extensions.take("activities") if local_name(element) == "adHocSubProcess" else None
    active = listed.value if listed is not None else active
    kind, body = _SUB_PROCESSES[local_name(element)], read_body(process, element, node.parts)
    starts = body.events("start") if not node.flag("triggeredByEvent") else []
    for event in starts if len(starts) > 1 else ():  # without a none start event it cannot be entered at all
        if event.definitions:
            text = "starts nothing, since a sub-process starts at a none start event: expected an event sub-process"
            process.context.fault(process.context.elements[event.id], text)
    return SubProcess(
        kind="event" if node.flag("triggeredByEvent") else kind,
        body=body,
        resume=boolean_property(node.context, element, "resume", resume.value) if resume is not None else False,
        completion=condition_of(node.context, completion[0]) if completion else None,
        active=variable_or_expression(node.context, element, active) if active else None,
        sequential=node.get("ordering") == "Sequential",
        cancel_remaining=node.flag("cancelRemainingInstances", True),
        **read_activity(node),
    )


def _limit_levels(context: Context, element: Node) -> None:
    """Raise ModelError for a sub-process inside too many others."""
    if sum(local_name(one) in _SUB_PROCESSES for one in element.iterancestors()) >= _LEVELS:
        raise context.error(element, f"expected at most {_LEVELS} sub-processes inside each other, got more")


_READERS: Mapping[str, Callable[[ProcessContext, Node, Connections], FlowNode]] = {
    **{f"{_B}{tag}": _event for tag in PLACES},
    **{f"{_B}{tag}": _gateway for tag in GATEWAYS},
    **{f"{_B}{tag}": _task for tag in TASKS},
    **{f"{_B}{tag}": _sub_process for tag in _SUB_PROCESSES},
    f"{_B}callActivity": _call,
}
