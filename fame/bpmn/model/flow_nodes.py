"""Flow nodes, sequence flows, and the body of a scope."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Literal, TypeVar

from fame.bpmn.model.elements import (
    Assignment,
    CompensateDefinition,
    DataObject,
    Element,
    EventDefinition,
    Expression,
    IoMapping,
    MessageDefinition,
    SignalDefinition,
    Text,
    Topic,
    texts,
)
from fame.bpmn.model.forms import NOBODY, Human
from fame.dataclasses import dataclass, field, replace

_Kind = TypeVar("_Kind", bound=EventDefinition)


@dataclass(frozen=True, slots=True, kw_only=True)
class SequenceFlow(Element):
    """A sequence flow between two flow nodes, with an optional condition."""

    source: str
    target: str
    condition: Expression | None = None

    def texts(self) -> Iterator[Text]:
        return texts("condition", self.condition)


@dataclass(frozen=True, slots=True, kw_only=True)
class FlowNode(Element):
    """An element that can hold a token.

    Every flow node answers the same questions: what is inside it, what triggers it, where it stands. Those that do not
    concern it have an empty answer here, and are fields of the classes that they concern.

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

    @property
    def body(self) -> Body | None:
        """What is inside a sub-process."""
        return None

    @property
    def definitions(self) -> tuple[EventDefinition, ...]:
        """The triggers or results of an event."""
        return ()

    @property
    def place(self) -> str:
        """Where an event stands: a `EventPosition`."""
        return ""

    @property
    def attached_to(self) -> str:
        """The id of the activity of a boundary event."""
        return ""

    @property
    def interrupting(self) -> bool:
        """Whether an event interrupts the activity or scope that it belongs to."""
        return False

    @property
    def triggered_by_event(self) -> bool:
        """Whether it is an event sub-process."""
        return False

    @property
    def for_compensation(self) -> bool:
        """Whether it is a compensation handler."""
        return False

    @property
    def instantiate(self) -> bool:
        """Whether it starts the process although it is no start event."""
        return False

    @property
    def script(self) -> Expression | None:
        """The script of a task."""
        return None

    @property
    def service(self) -> Topic | None:
        """The ROS service or action that a service task calls."""
        return None

    @property
    def operation(self) -> str:
        """The service that a task names."""
        return ""

    @property
    def default(self) -> str:
        """The id of its default flow."""
        return ""

    @property
    def io(self) -> IoMapping | None:
        """Its mapping of variables."""
        return None

    @property
    def loop(self) -> MultiInstance | StandardLoop | None:
        """How an activity repeats."""
        return None

    def topics(self) -> Iterator[tuple[Topic, bool]]:
        """(topic, whether it is thrown) of each topic that it throws or catches. ROS services are not topics."""
        yield from ()

    def keys_of(self, topic: Topic) -> tuple[tuple[str, Expression], ...]:
        """Return the correlation keys of a message that it catches: variable -> expression over ``msg``."""
        return ()

    def defined(self, kind: type[_Kind]) -> list[_Kind]:
        """Return its event definitions of one kind."""
        return [one for one in self.definitions if isinstance(one, kind)]

    @property
    def catches_compensation(self) -> bool:
        """Whether it is a compensation boundary event."""
        return self.place == "boundary" and bool(self.defined(CompensateDefinition))

    def texts(self) -> Iterator[Text]:
        """Yield every script and expression with its use, but those that read a caught message as ``msg``."""
        for part in (self.io, self.loop):
            yield from part.texts() if part is not None else ()
        yield from texts("mapping", *(item.source for item in (*self.copies_in, *self.copies_out)))
        for topic, _ in self.topics():
            yield from texts("payload", topic.payload)
            yield from texts("value", topic.to)

    def sets(self) -> Iterator[str]:
        """Yield the variables that it sets by name, but those of caught messages and scripts."""
        yield from (item.target for item in (*self.copies_in, *self.copies_out))
        for part in (self.io, self.loop):
            yield from part.sets() if part is not None else ()


EventPosition = Literal["start", "catch", "throw", "end", "boundary"]
PLACES: Mapping[str, EventPosition] = {
    "startEvent": "start",
    "intermediateCatchEvent": "catch",
    "intermediateThrowEvent": "throw",
    "endEvent": "end",
    "boundaryEvent": "boundary",
}
"""XML tag -> value."""
_OnTopic = SignalDefinition | MessageDefinition


def ids_named(nodes: Iterable[FlowNode], name: str) -> list[str]:
    """Return the ids of the nodes with this id, else of those with this label, each once."""
    nodes, label = list(nodes), " ".join(name.split())
    found = [node.id for node in nodes if node.id == name] or [node.id for node in nodes if node.label == label]
    return list(dict.fromkeys(found))


@dataclass(frozen=True, slots=True, kw_only=True)
class Event(FlowNode):
    """An event. Without definitions it is a none event, with several a multiple event (`parallel`: all must occur).

    `interrupting` is isInterrupting of the start event of an event sub-process, or cancelActivity of a boundary event
    (BPMN 2.0, table 10.93). `attached_to` is the activity of a boundary event. `io` is a mapping besides that of a
    caught message: its inputs are visible to the payload only, its outputs are assigned when the event has occurred.
    """

    place: EventPosition = field()  # required: without it, the property of all flow nodes would be its default
    definitions: tuple[EventDefinition, ...] = ()
    attached_to: str = ""
    interrupting: bool = True
    parallel: bool = False
    io: IoMapping | None = None

    @property
    def tag(self) -> str:
        return _TAGS[self.place]

    @property
    def throws(self) -> bool:
        """Whether it throws what its definitions say; else it catches it."""
        return self.place in ("throw", "end")

    def topics(self) -> Iterator[tuple[Topic, bool]]:
        """(topic, whether it is thrown) of its signals and messages."""
        return ((one.topic, self.throws) for one in self.definitions if isinstance(one, _OnTopic))

    def keys_of(self, topic: Topic) -> tuple[tuple[str, Expression], ...]:
        """Return the correlation keys of a message that it catches: variable -> expression over ``msg``."""
        return next((one.keys for one in self.defined(MessageDefinition) if one.topic is topic), ())

    def texts(self) -> Iterator[Text]:
        """Yield those of its definitions, and of all flow nodes."""
        for definition in self.definitions:
            yield from definition.texts()
        yield from FlowNode.texts(self)

    def sets(self) -> Iterator[str]:
        """Yield the variables of its definitions, and those of all flow nodes."""
        for definition in self.definitions:
            yield from definition.sets()
        yield from FlowNode.sets(self)


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

    @property
    def tag(self) -> str:
        return _TAGS[f"{self.kind} gateway"]

    def texts(self) -> Iterator[Text]:
        """Yield its activation condition."""
        yield from texts("condition", self.activation)
        yield from FlowNode.texts(self)


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

    def texts(self) -> Iterator[Text]:
        yield from texts("mapping", self.cardinality, self.collection, self.output_element)
        yield from texts("condition", self.completion)

    def sets(self) -> Iterator[str]:
        """Yield the variables for the item and the results."""
        yield from filter(None, (self.element_variable, self.output_collection))


@dataclass(frozen=True, slots=True, kw_only=True)
class StandardLoop:
    """Repeats while `condition` holds, tested before or after each iteration, at most `maximum` times (0: no limit)."""

    condition: Expression | None = None
    test_before: bool = False
    maximum: int = 0
    line: int = 0

    def texts(self) -> Iterator[Text]:
        return texts("condition", self.condition)

    def sets(self) -> Iterator[str]:
        """It sets no variables by name."""
        yield from ()


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
TASKS: Mapping[str, TaskKind] = {
    "task": "plain",
    "userTask": "user",
    "manualTask": "manual",
    "scriptTask": "script",
    "serviceTask": "service",
    "sendTask": "send",
    "receiveTask": "receive",
    "businessRuleTask": "business_rule",
}
"""XML tag -> value."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Task(Activity):
    """A task.

    script            of a script task, or the expression of a service task
    topic             of a send or receive task, or the ROS service (name, ``pkg/srv/Type``) or action of a service task
    operation         of a service task: registered name, external task topic, or job type
    result_variable   receives the result of the script or service
    keys              correlate the message of a receive task: variable name -> expression over ``msg``
    instantiate       a receive task that starts the process
    human             what a user or manual task says of people
    """

    kind: TaskKind = "plain"
    script: Expression | None = None
    topic: Topic | None = None
    operation: str = ""
    result_variable: str = ""
    keys: tuple[tuple[str, Expression], ...] = ()
    instantiate: bool = False
    human: Human = NOBODY

    @property
    def tag(self) -> str:
        return _TAGS[f"{self.kind} task"]

    def topics(self) -> Iterator[tuple[Topic, bool]]:
        """(topic, whether it is thrown) of a send or receive task."""
        if self.topic is not None and self.service is None:
            yield self.topic, self.kind == "send"

    @property
    def service(self) -> Topic | None:
        """The ROS service or action that a service task calls."""
        return None if self.kind in ("send", "receive") else self.topic

    def keys_of(self, topic: Topic) -> tuple[tuple[str, Expression], ...]:
        """Return the correlation keys of a receive task: variable -> expression over ``msg``."""
        return self.keys

    def texts(self) -> Iterator[Text]:
        """Yield its script, the request of a ROS service, and those of all flow nodes."""
        script = self.script is not None and self.script.language in ("python", "javascript")
        yield from texts("script" if script else "mapping", self.script)
        yield from texts("payload", self.service.payload if self.service is not None else None)
        yield from FlowNode.texts(self)

    def sets(self) -> Iterator[str]:
        """Yield the variable for its result, and those of all flow nodes."""
        yield from filter(None, (self.result_variable,))
        yield from FlowNode.sets(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class CallActivity(Activity):
    """Calls a process by id or library file. A process embedded in the element is one of the file's processes."""

    called: str = ""
    called_expression: Expression | None = None

    def texts(self) -> Iterator[Text]:
        """Yield those of all flow nodes, but its outputs: they see the variables of what it called."""
        yield from texts("mapping", self.called_expression)
        yield from FlowNode.texts(self if self.io is None else replace(self, io=replace(self.io, outputs=())))

    def sets(self) -> Iterator[str]:
        """Return those of all flow nodes, but its inputs: they are variables of what it calls."""
        return FlowNode.sets(self if self.io is None else replace(self, io=replace(self.io, inputs=())))


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """The content of a process or sub-process. `nodes` include event sub-processes and boundary events."""

    nodes: tuple[FlowNode, ...] = ()
    flows: tuple[SequenceFlow, ...] = ()
    data_objects: tuple[DataObject, ...] = ()
    associations: tuple[tuple[str, str], ...] = ()
    """(source, target) ids of associations between flow nodes: compensation event and handler."""

    def bodies(self) -> Iterator[Body]:
        """Itself and those of its sub-processes, at any depth, the outer one first."""
        yield self
        for node in self.nodes:
            if node.body is not None:
                yield from node.body.bodies()

    def walk(self) -> Iterator[FlowNode]:
        """Yield all flow nodes, at any depth, in document order; a sub-process comes before its content."""
        for node in self.nodes:
            yield node
            if node.body is not None:
                yield from node.body.walk()

    def elements(self) -> Iterator[Element]:
        """Yield all flow nodes, sequence flows and data objects, at any depth."""
        for body in self.bodies():
            yield from (*body.nodes, *body.flows, *body.data_objects)

    def calls(self) -> Iterator[CallActivity]:
        """Return all call activities, at any depth."""
        return (node for node in self.walk() if isinstance(node, CallActivity))

    def events(self, place: EventPosition) -> list[Event]:
        """Return the events at one place, of this body alone."""
        return [node for node in self.nodes if isinstance(node, Event) and node.place == place]

    def boundary(self, activity: str) -> list[Event]:
        """Return the boundary events of an activity."""
        return [event for event in self.events("boundary") if event.attached_to == activity]


@dataclass(frozen=True, slots=True, kw_only=True)
class SubProcess(Activity):
    """A sub-process. `resume`: an interrupting event sub-process suspends its scope instead of cancelling it.

    The other fields are those of ad-hoc sub-processes. `active` gives the ids of the elements to start with (None: all
    that can start).
    """

    kind: Literal["embedded", "event", "transaction", "adhoc"] = "embedded"
    body: Body = field()  # required, as `Event.place`
    resume: bool = False
    completion: Expression | None = None
    active: Expression | None = None
    sequential: bool = False
    cancel_remaining: bool = True

    @property
    def tag(self) -> str:
        return {"transaction": "transaction", "adhoc": "adHocSubProcess"}.get(self.kind, "subProcess")

    @property
    def triggered_by_event(self) -> bool:
        """Whether it is an event sub-process."""
        return self.kind == "event"

    def texts(self) -> Iterator[Text]:
        """Yield those of an ad-hoc sub-process, and those of all flow nodes."""
        yield from texts("condition", self.completion)
        yield from texts("mapping", self.active)
        yield from FlowNode.texts(self)


_TAGS: Mapping[str, str] = {
    **{place: tag for tag, place in PLACES.items()},
    **{f"{kind} gateway": tag for tag, kind in GATEWAYS.items()},
    **{f"{kind} task": tag for tag, kind in TASKS.items()},
}
