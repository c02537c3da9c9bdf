"""The dialect-neutral form of extension elements, and the properties that FAME defines."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from fame.bpmn.model import EMPTY, Assignment, Expression, IoMapping
from fame.bpmn.reader.context import Context, type_name, whole
from fame.bpmn.reader.expressions import mapped
from fame.bpmn.reader.xml import Node

CHOICES: Mapping[str, tuple[str, ...]] = {
    "history": ("keep_last", "keep_all"),
    "reliability": ("best_effort", "reliable"),
    "durability": ("transient_local", "volatile"),
    "liveliness": ("automatic", "manual_by_topic"),
}
"""Policies with named values, in the order of the original FaMe's codes 0 and 1."""
DURATIONS = ("deadline", "lifespan", "lease_duration")
"""In seconds."""


def policy(context: Context, element: Node, name: str, text: str) -> tuple[str, str] | None:
    """(policy, value): ``("reliability", "best_effort")``, ``("depth", "10")``, ``("deadline", "0.5")``.

    None for a policy or value that there is not, a fault.
    """
    name = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name.strip()).lower()
    value = re.sub(r"(?<=[a-z])(?=[A-Z])|[ -]", "_", text.strip()).lower()
    choices = CHOICES.get(name, ())
    if choices and value in ("0", "1"):
        return name, choices[int(value)]
    if choices:
        fits, right = value in choices, " or ".join(choices)
    elif name == "depth":
        fits, right = value.isdecimal() and int(value) > 0, "a whole number, 1 or more"
    elif name in DURATIONS:
        fits, right = re.fullmatch(r"\d+(\.\d*)?|\.\d+", value) is not None, "a time in seconds"
    else:
        context.fault(element, f"qos policy {name!r} is not known: {', '.join((*CHOICES, 'depth', *DURATIONS))} are")
        return None
    if not fits:
        context.fault(element, f"qos.{name}={text!r}: expected {right}")
    return (name, value) if fits else None


@dataclass(frozen=True, slots=True)
class Property:
    """A name with a text, where the extensions of an element have one. `line` is where it stands."""

    value: str
    line: int


@dataclass(slots=True)
class Extensions:
    """What the extensions of one element say, whatever the dialect. Filled by the adapters, used up by the readers.

    properties      free name -> text: what is left of it when the element is read has no meaning here
    lists           name -> texts of an input parameter that is a list (the oldest FaMe's topics)
    topic ... qos   of a message on a topic; `payload` is flow-style text
    values          of a data object
    inputs, outputs mappings; `own`: variables of its own even without one; `all_in`, `all_out`: everything goes in, out
    called          process of a call activity
    operation       what a service task names; `service` if it is a ROS service, of type `type`
    active          elements with which an ad-hoc sub-process begins
    collection ...  of a multi-instance activity
    code_variable, message_variable   take what was caught
    result, script  variable for the result; text whose value is it
    key             correlation key of a message
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
    own: bool = False
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
    refused: str = ""

    def take(self, name: str) -> Property | None:
        """The property of that name, used up; None if there is none or it is empty."""
        found = self.properties.pop(name, None)
        return found if found is not None and found.value.strip() else None

    def rest(self) -> Mapping[str, str]:
        """The properties that nobody took."""
        if not self.properties:
            return EMPTY
        return MappingProxyType({name: found.value for name, found in self.properties.items()})

    def mapping(self) -> IoMapping | None:
        """What goes into and out of an activity, None if it has no variables of its own."""
        if not (self.inputs or self.outputs or self.own):
            return None
        return IoMapping(tuple(self.inputs), tuple(self.outputs), self.all_in, self.all_out)


@dataclass(slots=True)
class TopicProperties:
    """What an event or task says of its topic: `fame.bpmn.model.Topic` without its name."""

    type: str | None
    payload: Expression | None
    to: Expression | None
    queue: int
    private: bool
    qos: Mapping[str, str]


def topic_properties(context: Context, element: Node, found: Extensions, kind: str = "msg") -> TopicProperties:
    """Uses up ``type``, ``payload``, ``to``, ``queue``, ``scope``, ``qos.<policy>``: the form of the paper, and ours.

    A value that none of them can have is a fault.
    """
    given, payload, to, queue, scope = (found.take(name) for name in ("type", "payload", "to", "queue", "scope"))
    if scope is not None and scope.value.strip().lower() != "robot":
        context.fault(element, f"scope={scope.value!r}: expected robot (a topic of the robot's own), or nothing")
    qos = dict(found.qos)
    for name in [name for name in found.properties if name.startswith("qos.")]:
        said = found.take(name)
        meant = policy(context, element, name.removeprefix("qos."), said.value) if said is not None else None
        qos.update([meant] if meant is not None else ())
    payload = payload or found.payload
    text = given.value if given is not None else found.type
    return TopicProperties(
        type=type_name(context, element, text, kind) if text else None,
        payload=Expression(payload.value.strip(), "payload", payload.line)
        if payload and payload.value.strip()
        else None,
        to=mapped(to.value, to.line) if to is not None and to.value.strip() else None,
        queue=whole(context, element, "queue", queue.value, 0) if queue else 0,
        private=scope is not None,
        qos=MappingProxyType(qos) if qos else EMPTY,
    )


def data_values(found: Extensions) -> tuple[tuple[str, Expression], ...]:
    """Uses up all properties: on a data object every name is one of a variable that it holds."""
    named = [*found.values, *found.properties.items()]
    found.properties = {}
    return tuple((name, Expression(value.value.strip(), "value", value.line)) for name, value in named)
