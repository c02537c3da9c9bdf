"""The dialect-neutral form of extension elements, and the properties that FAME defines."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from types import MappingProxyType

from fame.bpmn.model import EMPTY, Assignment, Expression, FormField, IoMapping
from fame.bpmn.reader.context import Context, message_type, whole_number
from fame.bpmn.reader.expressions import mapping_source
from fame.bpmn.reader.xml import Node, line_of
from fame.bpmn.topics import TTL
from fame.dataclasses import dataclass, field
from fame.text import as_number

QOS_CHOICES: Mapping[str, tuple[str, ...]] = {
    "history": ("keep_last", "keep_all"),
    "reliability": ("best_effort", "reliable"),
    "durability": ("transient_local", "volatile"),
    "liveliness": ("automatic", "manual_by_topic"),
}
"""Policies with named values, in the order of the original FaMe's codes 0 and 1."""
QOS_DURATIONS: tuple[str, ...] = ("deadline", "lifespan", "lease_duration")
"""In seconds."""


def qos_policy(context: Context, element: Node, name: str, text: str) -> tuple[str, str] | None:
    """Policy and value of ROS 2: ``("reliability", "best_effort")``, ``("depth", "10")``, ``("deadline", "0.5")``.

    None for an unknown policy or value, which is a fault.
    """
    name = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name.strip()).lower()
    value = re.sub(r"(?<=[a-z])(?=[A-Z])|[ -]", "_", text.strip()).lower()
    choices = QOS_CHOICES.get(name, ())
    if choices and value in ("0", "1"):
        return name, choices[int(value)]
    if choices:
        fits, right = value in choices, " or ".join(choices)
    elif name == "depth":
        fits, right = value.isdecimal() and int(value) > 0, "a whole number, 1 or more"
    elif name in QOS_DURATIONS:
        fits, right = re.fullmatch(r"\d+(\.\d*)?|\.\d+", value) is not None, "a time in seconds"
    else:
        policies = ", ".join((*QOS_CHOICES, "depth", *QOS_DURATIONS))
        context.fault(element, f"unknown QoS policy {name!r}: expected one of {policies}")
        return None
    if not fits:
        context.fault(element, f"qos.{name}={text!r}: expected {right}")
    return (name, value) if fits else None


@dataclass(frozen=True, slots=True)
class Property:
    """The text of a named extension property, and its line."""

    value: str
    line: int


@dataclass(slots=True)
class Extensions:
    """The extensions of one element in dialect-neutral form. Adapters fill it, readers consume it.

    properties      name -> text; what the readers do not consume has no meaning here
    lists           name -> texts of an input parameter that is a list (topics of the oldest FaMe)
    topic ... qos   of a message on a topic; `payload` is flow-style text
    values          of a data object
    inputs, outputs mappings; `own_scope`: has a variable scope even without them; `all_in`, `all_out`: all variables
    called          process of a call activity
    operation       operation of a service task; `service` if it is a ROS service, of type `type`
    active          elements that start with an ad-hoc sub-process
    collection ...  of a multi-instance activity
    code_variable, message_variable   receive code and text of the caught error or escalation
    result, script  variable for the result; expression that gives it
    key             correlation key of a message
    users, groups   who may complete a task; `form` its fields, `linked` the id of its form elsewhere
    refused         why the element cannot be executed
    """

    properties: dict[str, Property] = field(default_factory=dict)
    lists: dict[str, list[Property]] = field(default_factory=dict)
    topic: str = ""
    type: str = ""
    payload: Property | None = None
    qos: dict[str, str] = field(default_factory=dict)
    values: list[tuple[str, Property]] = field(default_factory=list)
    inputs: list[Assignment] = field(default_factory=list)
    outputs: list[Assignment] = field(default_factory=list)
    own_scope: bool = False
    all_in: bool = False
    all_out: bool = False
    called: str = ""
    operation: str = ""
    service: bool = False
    active: str = ""
    collection: str = ""
    element_variable: str = ""
    output_collection: str = ""
    output_element: str = ""
    code_variable: str | None = None
    message_variable: str | None = None
    result: str = ""
    script: Expression | None = None
    key: Expression | None = None
    users: list[str] = field(default_factory=list)
    groups: list[str] = field(default_factory=list)
    form: tuple[FormField, ...] = ()
    linked: str = ""
    refused: str = ""

    def put(self, context: Context, node: Node, name: str, value: str) -> None:
        """Note a property; of two with one name the last counts."""
        if name in self.properties and self.properties[name].value != value:
            context.note(node, f"has two properties {name!r}: only the last one counts", "warning")
        self.properties[name] = Property(value, line_of(node))

    def take(self, name: str) -> Property | None:
        """Remove and return the property of that name; None if it is missing or empty."""
        found = self.properties.pop(name, None)
        return found if found is not None and found.value.strip() else None

    def remaining(self) -> Mapping[str, str]:
        """Return the properties that no reader has taken."""
        if not self.properties:
            return EMPTY
        return MappingProxyType({name: found.value for name, found in self.properties.items()})

    def mapping(self) -> IoMapping | None:
        """Return the mapping of an activity, None if it has no variable scope."""
        if not (self.inputs or self.outputs or self.own_scope):
            return None
        return IoMapping(tuple(self.inputs), tuple(self.outputs), self.all_in, self.all_out)


@dataclass(slots=True)
class TopicProperties:
    """The properties of an event's or task's topic: `fame.bpmn.model.Topic` without its name."""

    type: str | None
    payload: Expression | None
    to: Expression | None
    queue: int
    ttl: float
    private: bool
    qos: Mapping[str, str]
    keys: tuple[tuple[str, Expression], ...] = ()
    """Correlation keys of a caught message: variable -> expression over ``msg``."""


def take_topic_properties(context: Context, element: Node, found: Extensions, kind: str = "msg") -> TopicProperties:
    """Take ``type``, ``payload``, ``to``, ``queue``, ``delivery``, ``ttl``, ``correlate``, ``scope``, ``qos.<policy>``.

    An invalid value is a fault.
    """
    given, payload, to, queue, scope = (found.take(name) for name in ("type", "payload", "to", "queue", "scope"))
    if scope is not None and scope.value.strip().lower() != "robot":
        context.fault(element, f"scope={scope.value!r}: expected robot (a topic of one robot) or no property")
    qos = dict(found.qos)
    for name in [name for name in found.properties if name.startswith("qos.")]:
        given_value = found.take(name)
        read = qos_policy(context, element, name.removeprefix("qos."), given_value.value) if given_value else None
        qos.update([read] if read is not None else ())
    payload = payload or found.payload
    text = given.value if given is not None else found.type
    return TopicProperties(
        type=message_type(context, element, text, kind) if text else None,
        payload=Expression(payload.value.strip(), "payload", payload.line)
        if payload and payload.value.strip()
        else None,
        to=mapping_source(to.value, to.line) if to is not None and to.value.strip() else None,
        queue=whole_number(context, element, "queue", queue.value, 0) if queue else 0,
        ttl=_ttl(context, element, found.take("delivery"), found.take("ttl")),
        private=scope is not None,
        qos=MappingProxyType(qos) if qos else EMPTY,
        keys=tuple(_keys(context, element, found.take("correlate"))),
    )


def _ttl(context: Context, element: Node, delivery: Property | None, ttl: Property | None) -> float:
    """The time to live of acknowledged signals (s); 0 without ``delivery=acknowledged``."""
    if delivery is not None and delivery.value.strip().lower() != "acknowledged":
        context.fault(element, f"delivery={delivery.value!r}: expected acknowledged or no property")
    elif ttl is not None and delivery is None:
        context.note(element, "its property 'ttl' has no effect without delivery=acknowledged", "warning")
    elif delivery is not None:
        return _seconds(context, element, ttl.value) if ttl is not None else TTL
    return 0.0


def _seconds(context: Context, element: Node, text: str) -> float:
    if not 0 < (seconds := as_number(text)) < math.inf:
        context.fault(element, f"ttl={text!r}: expected a time in seconds, more than 0")
        return TTL
    return seconds


WORD = re.compile(r"\w+")
"""Names, and numbers, of an expression."""
PATH = r"[^\W\d]\w*(?:\.\w+)*"
"""A variable, or a field of one."""
_KEY = re.compile(rf"\s*({PATH})\s*(?:=\s*({PATH}))?\s*")


def _keys(context: Context, element: Node, given: Property | None) -> Iterator[tuple[str, Expression]]:
    """The correlation keys ``order_id``, ``order.id`` (field ``id``) or ``order_id = order.number``, with commas."""
    for text in given.value.split(",") if given is not None else ():
        match = _KEY.fullmatch(text)
        if match is None or given is None:
            said = f"correlate={given.value if given is not None else text!r}"
            context.fault(element, f"{said}: expected variables of the process, or variable = field of the message")
            return
        field = match[2] or match[1].rpartition(".")[2]
        yield match[1], Expression(f"${{msg.{field}}}", "juel", given.line)


def take_data_values(found: Extensions) -> tuple[tuple[str, Expression], ...]:
    """Take all properties: those of a data object are the variables that it holds."""
    named = [*found.values, *found.properties.items()]
    found.properties = {}
    return tuple((name, Expression(value.value.strip(), "value", value.line)) for name, value in named)
