"""What a .bpmn file says, as frozen dataclasses: the neutral model.

Readers of dialects make it, everything else reads it. Expressions stay text here; which language they are written in is
decided by the reader, turning them into callables is the work of `fame.scripting`. Names are those of BPMN 2.0. Every
element carries the line of its opening tag in the source, 1-based, 0 if it has none.

A `Body` is what a scope runs: the content of a process or of a sub-process. Flow nodes refer to each other by id alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

from fame.errors import display_name

EMPTY: Mapping[str, str] = MappingProxyType({})


def _empty() -> Mapping[str, str]:
    return EMPTY


Language = Literal["python", "javascript", "juel", "feel", "template", "value", "payload"]
"""How a text is evaluated.

python       statements of a script, or one expression
javascript   the interface of the original FaMe toolchain
juel         a whole ``${...}`` or ``#{...}``, the Camunda 7 expression
feel         ``=...``, the Camunda 8 expression (the text here is without the ``=``)
template     text with ``${...}`` inside: substitution, gives a str
value        property of a data object: ``${...}`` evaluated, else ``=`` FEEL, else a YAML scalar
payload      flow-style YAML or JSON with ``${...}`` inside: values are inserted as values; or ``=`` FEEL
"""


@dataclass(frozen=True, slots=True)
class Expression:
    """A text to evaluate, not yet compiled. `condition`: what it gives is asked whether it is true."""

    text: str
    language: Language = "python"
    line: int = 0
    condition: bool = field(default=False, compare=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Element:
    """Fields that all drawn elements have."""

    id: str
    name: str = ""
    line: int = 0
    documentation: str = ""
    properties: Mapping[str, str] = field(default_factory=_empty)
    """Extension properties without a meaning of their own here (kept for user code and checks)."""

    @property
    def label(self) -> str:
        """Its name on one line, or its id if it has no name."""
        return " ".join(self.name.split()) or self.id

    @property
    def display_name(self) -> str:
        """The element as messages show it: ``"Go To" (Activity_14nkpvd)``, or the id alone if it has no name."""
        return display_name(self.id, self.name)


# ---- data ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class DataObject(Element):
    """A data object reference with the variables that it holds. `state` is its data state, empty if it has none.

    `kind` tells how it is drawn: ``object``, ``input`` and ``output`` (of the process), ``store``, ``property`` (not
    drawn: it holds the one variable that it is named after).
    """

    kind: Literal["object", "input", "output", "store", "property"] = "object"
    values: tuple[tuple[str, Expression], ...] = ()
    state: str = ""
    collection: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """The variables that it holds."""
        return tuple(name for name, _ in self.values)


@dataclass(frozen=True, slots=True)
class Assignment:
    """``target = source``, of a mapping (camunda:in/out, inputParameter, zeebe:input/output, a standard assignment)."""

    target: str
    source: Expression


@dataclass(frozen=True, slots=True)
class IoMapping:
    """What goes into and out of an activity. One that has such a mapping has variables of its own.

    `all_in`, `all_out`: every variable of the outer scope goes in, every one of the inner comes out.
    """

    inputs: tuple[Assignment, ...] = ()
    outputs: tuple[Assignment, ...] = ()
    all_in: bool = False
    all_out: bool = False


# ---- topics ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Topic:
    """What a signal or message event says of its topic.

    name     as drawn: ``weed_found`` (everyone's), ``~/odom`` (the robot's own); see `qualified`
    type     ``pkg/msg/Type``, or None where this event does not say
    payload  of a throw: flow-style YAML/JSON with ``${...}``; None: none given
    queue    of a catch: how many messages it keeps from the time its scope is entered; 0: none
    qos      policy -> value, as written
    to       of a message that is thrown: the name of the robot that it is for; None: it reaches all
    takes    of a catch: explicit mapping of the caught message (``msg`` in its expressions); may be empty
    """

    name: str
    type: str | None = None
    payload: Expression | None = None
    to: Expression | None = None
    queue: int = 0
    private: bool = False
    qos: Mapping[str, str] = field(default_factory=_empty)
    takes: tuple[Assignment, ...] = ()

    @property
    def qualified(self) -> str:
        """The name with its scope: ``/weed_found``, or ``~/odom`` for one in the robot's namespace."""
        name = self.name.removeprefix("~/")
        if self.private or self.name.startswith("~/"):
            return "~/" + name.lstrip("/")
        return "/" + name.lstrip("/")


# ---- event definitions -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class EventDefinition:
    """The trigger or result of an event."""

    line: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalDefinition(EventDefinition):
    """A signal: a topic for everyone who listens."""

    topic: Topic


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageDefinition(EventDefinition):
    """A message to one process, by name; ``keys`` correlate it: key name -> expression over ``msg`` (a catch)."""

    topic: Topic
    keys: tuple[tuple[str, Expression], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class TimerDefinition(EventDefinition):
    """ISO 8601: a duration from now, a date, or a cycle (None: no time yet). Literals have language ``template``."""

    kind: Literal["duration", "date", "cycle"]
    expression: Expression | None


@dataclass(frozen=True, slots=True, kw_only=True)
class ConditionalDefinition(EventDefinition):
    """Fires when its condition becomes true. None: it has none yet."""

    condition: Expression | None


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorDefinition(EventDefinition):
    """An error. A catch without code catches all. Variables that take code and text of what was caught, if named.

    `computed`: an expression that gives the code of a throw.
    """

    code: str | None = None
    computed: Expression | None = None
    code_variable: str | None = None
    message_variable: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class EscalationDefinition(EventDefinition):
    """An escalation, coded like an error."""

    code: str | None = None
    computed: Expression | None = None
    code_variable: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkDefinition(EventDefinition):
    """A jump to the catching link event of the same name in the same body."""

    name: str


@dataclass(frozen=True, slots=True, kw_only=True)
class TerminateDefinition(EventDefinition):
    """Ends the innermost body that it stands in."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CompensateDefinition(EventDefinition):
    """Compensation, of one activity or (None) of all in its scope."""

    activity: str | None = None
    wait: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class CancelDefinition(EventDefinition):
    """Cancels the transaction that it stands in."""


# ---- flow nodes ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class SequenceFlow(Element):
    """From one flow node to another, perhaps under a condition."""

    source: str
    target: str
    condition: Expression | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class FlowNode(Element):
    """What a token can be at.

    `incoming`, `outgoing`: ids of sequence flows, in document order. `data_inputs`, `data_outputs`: ids of the data
    objects that it reads when it starts and writes when it ends; `copies_in`, `copies_out`: what is moved then between
    variables and its own data inputs and outputs. `required`: its data outputs without which it has not ended well.
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
"""By tag."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Event(FlowNode):
    """An event. No definition: a none event; several: a multiple event (all of them if `parallel`).

    `interrupting` is isInterrupting of an event sub-process' start, cancelActivity of a boundary event (standard
    table 10.93 and following). `attached_to` is the activity of a boundary event. `io`: a mapping besides that of a
    caught message: its inputs are for the payload alone, its outputs are assigned when the event has happened.
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
"""By tag."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Gateway(FlowNode):
    """A gateway. `default` is the id of its default flow. `instantiate`: an event-based one that starts a process."""

    kind: GatewayKind
    default: str = ""
    activation: Expression | None = None
    instantiate: bool = False
    all_events: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class MultiInstance:
    """Multi-instance loop characteristics: `cardinality`, or one instance for each item of `collection`."""

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
    """Repeats while `condition` holds, tested before or after each pass, at most `maximum` times (0: no bound)."""

    condition: Expression | None = None
    test_before: bool = False
    maximum: int = 0
    line: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Activity(FlowNode):
    """What tasks, sub-processes and call activities have in common. `default` is the id of its default flow."""

    default: str = ""
    io: IoMapping | None = None
    loop: MultiInstance | StandardLoop | None = None
    for_compensation: bool = False
    refused: str = ""
    """Why it cannot be executed (a Java class, a connector, DMN ...), empty if it can."""


TaskKind = Literal["plain", "user", "manual", "script", "service", "send", "receive", "business_rule"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Task(Activity):
    """A task. `script` is that of a script task, or the expression that a service task evaluates; `topic` that of a
    send or receive task, or the ROS service (name, ``pkg/srv/Type``) or action of a service task; `operation` what a
    service task names (registry name, external task topic or type); `result_variable` takes a script's or service's
    result; `payload` is the same as that of `topic`; `keys` correlate the message of a receive task. `instantiate`: one
    that starts a process.
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
    """Calls a process by id or library file. A process embedded in the element itself is among the file's processes."""

    called: str = ""
    called_expression: Expression | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """What a scope runs. Event sub-processes are among `nodes` (with `triggered_by_event`), boundary events too."""

    nodes: tuple[FlowNode, ...] = ()
    flows: tuple[SequenceFlow, ...] = ()
    data_objects: tuple[DataObject, ...] = ()
    associations: tuple[tuple[str, str], ...] = ()
    """(source, target) ids of directed associations between flow nodes: compensation handlers."""

    def walk(self) -> Iterator[FlowNode]:
        """Every flow node in it, at any depth, in document order; a sub-process before its content."""
        for node in self.nodes:
            yield node
            if isinstance(node, SubProcess):
                yield from node.body.walk()

    def elements(self) -> Iterator[Element]:
        """Every flow node, sequence flow and data object in it, at any depth."""
        yield from self.nodes
        yield from self.flows
        yield from self.data_objects
        for node in self.nodes:
            if isinstance(node, SubProcess):
                yield from node.body.elements()


@dataclass(frozen=True, slots=True, kw_only=True)
class SubProcess(Activity):
    """A sub-process. `resume`: an interrupting event sub-process that suspends its scope instead of cancelling it.

    The rest is of ad-hoc sub-processes. `active`: a list of the ids of elements that begin (None: all that can).
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


@dataclass(frozen=True, slots=True)
class Fault:
    """Why a process cannot be executed: what is wrong with one of its elements. `name`: that of the element."""

    text: str
    element: str = ""
    line: int = 0
    name: str = ""

    @property
    def display_name(self) -> str:
        """The element as messages show it."""
        return display_name(self.element, self.name)


@dataclass(frozen=True, slots=True, kw_only=True)
class Process(Element):
    """A process. `instances`: how many not yet ended may be at a time (None: no bound). `optional`: a mission may be
    completed although the process has never started. `semantics`: ``original`` for
    models of the original FaMe, whose interrupting event sub-processes suspend and resume. `by_prefix`: one of those,
    whose messages fill variables by their names alone where no data object is connected (FORMATS, rules of reading).
    `faults`: why it cannot be executed, by line; what the file says there is left out of the model."""

    body: Body
    executable: bool = True
    instances: int | None = None
    optional: bool = False
    semantics: Literal["standard", "original"] = "standard"
    by_prefix: bool = False
    lanes: tuple[Element, ...] = ()
    faults: tuple[Fault, ...] = ()


# ---- collaboration ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Participant(Element):
    """A pool: a robot, or (`multi_instance`) as many robots as there are. No `process`: a black box. The id may be that
    of a process which the file does not have.

    `minimum` and `maximum` say how many a run shall have: so many if nobody says more, and never more (None: no bound).
    """

    process: str = ""
    multi_instance: bool = False
    minimum: int = 1
    maximum: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageFlow(Element):
    """A message flow between pools or flow nodes of two pools."""

    source: str
    target: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Artifact(Element):
    """A text annotation or a group; its text is its name."""

    kind: Literal["annotation", "group"] = "annotation"


# ---- diagram interchange ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Bounds:
    """Of a shape or label, in diagram units (pixels)."""

    x: float
    y: float
    width: float
    height: float


@dataclass(frozen=True, slots=True)
class Shape:
    """How an element is drawn. `kind` is its BPMN tag, `plane` the number of its diagram, colours are those of CSS.

    `name` is that of the element, which may be one that nothing else in the model tells of (a conversation, what is in
    a choreography). `band`: where a participant stands in a choreography task (its participantBandKind), if it does.
    """

    element: str
    bounds: Bounds
    label: Bounds | None = None
    horizontal: bool = True
    expanded: bool = False
    marker_visible: bool = False
    kind: str = ""
    plane: int = 0
    stroke: str = ""
    fill: str = ""
    name: str = ""
    band: str = ""


@dataclass(frozen=True, slots=True)
class Edge:
    """How a flow or association is drawn: its way points (x, y). `kind`, `plane`, `stroke` as of a shape; `directed`:
    an association with an arrow head."""

    element: str
    waypoints: tuple[tuple[float, float], ...]
    label: Bounds | None = None
    kind: str = ""
    plane: int = 0
    stroke: str = ""
    directed: bool = False


@dataclass(frozen=True, slots=True)
class Note:
    """Something the reader wants to say about the file, not an error.

    `level`: ``warning``, ``note``, or ``reading`` for what is told to those who ask how the file was read. `quirk`: the
    file relies on a habit of the tool that wrote it.
    """

    level: Literal["warning", "note", "reading"]
    text: str
    element: str = ""
    line: int = 0
    quirk: bool = False
    name: str = ""

    @property
    def display_name(self) -> str:
        """The element as messages show it."""
        return display_name(self.element, self.name)


@dataclass(frozen=True, slots=True, kw_only=True)
class Definitions:
    """A whole file.

    `source` is its text as read: what a writer starts from, so that nothing unknown is lost. `artifacts` (text
    annotations, groups; their text is their name) matter for drawing alone. `planes` are the ids of what its diagrams
    show. `collaboration` is the id of what its pools stand in; the parts of one that was split share it.
    """

    file: str
    source: bytes = field(repr=False)
    processes: tuple[Process, ...] = ()
    collaboration: str = ""
    participants: tuple[Participant, ...] = ()
    message_flows: tuple[MessageFlow, ...] = ()
    shapes: tuple[Shape, ...] = field(default=(), repr=False)
    edges: tuple[Edge, ...] = field(default=(), repr=False)
    planes: tuple[str, ...] = field(default=(), repr=False)
    artifacts: tuple[Artifact, ...] = ()
    notes: tuple[Note, ...] = ()

    def process(self, id: str) -> Process | None:
        """The process with this id, if the file has it."""
        return next((process for process in self.processes if process.id == id), None)

    def elements(self) -> Iterator[Element]:
        """Every process, flow node, sequence flow and data object, then pools, message flows and artifacts."""
        for process in self.processes:
            yield process
            yield from process.body.elements()
        yield from self.participants
        yield from self.message_flows
        yield from self.artifacts

    def display_name(self, id: str) -> str:
        """The element with this id as messages show it; the id itself if the file has no such element."""
        return next((element.display_name for element in self.elements() if element.id == id), id)
