"""Flow nodes, sequence flows, and the body of a scope."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from fame.bpmn.model.elements import Assignment, DataObject, Element, EventDefinition, Expression, IoMapping, Topic


@dataclass(frozen=True, slots=True, kw_only=True)
class SequenceFlow(Element):
    """A sequence flow between two flow nodes, with an optional condition."""

    source: str
    target: str
    condition: Expression | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class FlowNode(Element):
    """An element that can hold a token.

    `incoming`, `outgoing`: ids of sequence flows, in document order. `data_inputs`, `data_outputs`: ids of the data
    objects that it reads when it starts and writes when it ends. `copies_in`, `copies_out`: assignments between
    variables and its own data inputs and outputs. `required`: data outputs that must have a value when it ends.
    """

    incoming: tuple[str, ...] = ()
    outgoing: tuple[str, ...] = ()
    data_inputs: tuple[str, ...] = ()
    data_outputs: tuple[str, ...] = ()
    copies_in: tuple[Assignment, ...] = ()
    copies_out: tuple[Assignment, ...] = ()
    required: tuple[str, ...] = ()


Place = Literal["start", "catch", "throw", "end", "boundary"]
PLACES: Mapping[str, Place] = {
    "startEvent": "start",
    "intermediateCatchEvent": "catch",
    "intermediateThrowEvent": "throw",
    "endEvent": "end",
    "boundaryEvent": "boundary",
}
"""XML tag -> value."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Event(FlowNode):
    """An event. Without definitions it is a none event, with several a multiple event (`parallel`: all must occur).

    `interrupting` is isInterrupting of the start event of an event sub-process, or cancelActivity of a boundary event
    (BPMN 2.0, table 10.93). `attached_to` is the activity of a boundary event. `io` is a mapping besides that of a
    caught message: its inputs are visible to the payload only, its outputs are assigned when the event has occurred.
    """

    place: Place
    definitions: tuple[EventDefinition, ...] = ()
    attached_to: str = ""
    interrupting: bool = True
    parallel: bool = False
    io: IoMapping | None = None


GatewayKind = Literal["exclusive", "inclusive", "parallel", "event", "complex"]
GATEWAYS: Mapping[str, GatewayKind] = {
    "exclusiveGateway": "exclusive",
    "inclusiveGateway": "inclusive",
    "parallelGateway": "parallel",
    "eventBasedGateway": "event",
    "complexGateway": "complex",
}
"""XML tag -> value."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Gateway(FlowNode):
    """A gateway. `default` is the id of its default flow. `instantiate`: event-based and starts the process.

    `activation` is the activation condition of a complex gateway. `all_events`: a parallel event-based gateway.
    """

    kind: GatewayKind
    default: str = ""
    activation: Expression | None = None
    instantiate: bool = False
    all_events: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class MultiInstance:
    """Multi-instance loop characteristics: `cardinality` instances, or one for each item of `collection`."""

    sequential: bool = False
    cardinality: Expression | None = None
    collection: Expression | None = None
    element_variable: str = ""
    completion: Expression | None = None
    output_collection: str = ""
    output_element: Expression | None = None
    line: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class StandardLoop:
    """Repeats while `condition` holds, tested before or after each iteration, at most `maximum` times (0: no limit)."""

    condition: Expression | None = None
    test_before: bool = False
    maximum: int = 0
    line: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Activity(FlowNode):
    """The fields that tasks, sub-processes and call activities share. `default` is the id of its default flow."""

    default: str = ""
    io: IoMapping | None = None
    loop: MultiInstance | StandardLoop | None = None
    for_compensation: bool = False
    refused: str = ""
    """Why it cannot be executed (a Java class, a connector, DMN ...), or empty."""


TaskKind = Literal["plain", "user", "manual", "script", "service", "send", "receive", "business_rule"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Task(Activity):
    """A task.

    script            of a script task, or the expression of a service task
    topic             of a send or receive task, or the ROS service (name, ``pkg/srv/Type``) or action of a service task
    operation         of a service task: registered name, external task topic, or job type
    result_variable   receives the result of the script or service
    payload           that of `topic`
    keys              correlate the message of a receive task: variable name -> expression over ``msg``
    instantiate       a receive task that starts the process
    """

    kind: TaskKind = "plain"
    script: Expression | None = None
    topic: Topic | None = None
    operation: str = ""
    result_variable: str = ""
    payload: Expression | None = None
    keys: tuple[tuple[str, Expression], ...] = ()
    instantiate: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class CallActivity(Activity):
    """Calls a process by id or library file. A process embedded in the element is one of the file's processes."""

    called: str = ""
    called_expression: Expression | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """The content of a process or sub-process. `nodes` include event sub-processes and boundary events."""

    nodes: tuple[FlowNode, ...] = ()
    flows: tuple[SequenceFlow, ...] = ()
    data_objects: tuple[DataObject, ...] = ()
    associations: tuple[tuple[str, str], ...] = ()
    """(source, target) ids of associations between flow nodes: compensation event and handler."""

    def walk(self) -> Iterator[FlowNode]:
        """All flow nodes, at any depth, in document order; a sub-process comes before its content."""
        for node in self.nodes:
            yield node
            if isinstance(node, SubProcess):
                yield from node.body.walk()

    def elements(self) -> Iterator[Element]:
        """All flow nodes, sequence flows and data objects, at any depth."""
        yield from self.nodes
        yield from self.flows
        yield from self.data_objects
        for node in self.nodes:
            if isinstance(node, SubProcess):
                yield from node.body.elements()


@dataclass(frozen=True, slots=True, kw_only=True)
class SubProcess(Activity):
    """A sub-process. `resume`: an interrupting event sub-process suspends its scope instead of cancelling it.

    The other fields are those of ad-hoc sub-processes. `active` gives the ids of the elements to start with (None: all
    that can start).
    """

    kind: Literal["embedded", "event", "transaction", "adhoc"] = "embedded"
    body: Body
    resume: bool = False
    completion: Expression | None = None
    active: Expression | None = None
    sequential: bool = False
    cancel_remaining: bool = True

    @property
    def triggered_by_event(self) -> bool:
        """Whether it is an event sub-process."""
        return self.kind == "event"
