"""Elements, expressions, data, topics and event definitions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Literal

from fame.dataclasses import dataclass, field
from fame.errors import display_name

EMPTY: Mapping[str, str] = MappingProxyType({})


def _empty() -> Mapping[str, str]:
    return EMPTY


Language = Literal["python", "javascript", "juel", "feel", "template", "value", "payload"]
"""How a text is evaluated.

python       the statements of a script, or one expression
javascript   a script or expression with the interface of the original FaMe
juel         one ``${...}`` or ``#{...}``, the Camunda 7 expression
feel         ``=...``, the Camunda 8 expression (the text here has no ``=``)
template     text with ``${...}`` inside; gives a str
value        property of a data object: ``${...}``, FEEL after ``=``, else a YAML scalar
payload      flow-style YAML or JSON in which ``${...}`` inserts a value, or FEEL after ``=``
"""


@dataclass(frozen=True, slots=True)
class Expression:
    """A text to evaluate, not yet compiled. `condition`: its result is used as a truth value."""

    text: str
    language: Language = "python"
    line: int = 0
    condition: bool = field(default=False, compare=False)


Use = Literal["script", "condition", "payload", "timer", "mapping", "value"]
"""What an element does with a text."""
Text = tuple[Expression, Use]


def texts(use: Use, *expressions: Expression | None) -> Iterator[Text]:
    """Return those of the expressions that are there, with their use."""
    return ((one, use) for one in expressions if one is not None)


ElementOutcome = Literal["failed", "violated", "waiting", "completed", "cancelled"]
"""What a drawing of a run or a table of its visits counts of an element, the most important first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Element:
    """Fields that all drawn elements have."""

    id: str
    name: str = ""
    line: int = 0
    documentation: str = ""
    properties: Mapping[str, str] = field(default_factory=_empty)
    """Extension properties that FAME does not interpret, for user code and checks."""

    @property
    def label(self) -> str:
        """Its name on one line, or its id if it has no name."""
        return " ".join(self.name.split()) or self.id

    @property
    def display_name(self) -> str:
        """The element as messages show it: ``"Go To" (Activity_14nkpvd)``, or the id alone if it has no name."""
        return display_name(self.id, self.name)

    @property
    def tag(self) -> str:
        """The BPMN tag of a process, pool, flow node or flow: ``callActivity``, ``eventBasedGateway`` ..."""
        name = type(self).__name__
        return name[0].lower() + name[1:]

    def texts(self) -> Iterator[Text]:
        """Yield every script and expression with its use, but those that read a caught message as ``msg``."""
        yield from ()


# ---- data ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class DataObject(Element):
    """A data object reference with the variables that it holds. `state` is its data state, or empty.

    `kind` is how it is drawn: ``object``, ``input`` or ``output`` (of the process), ``store``, ``property`` (not drawn;
    holds one variable, with its own name).
    """

    kind: Literal["object", "input", "output", "store", "property"] = "object"
    values: tuple[tuple[str, Expression], ...] = ()
    state: str = ""
    collection: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """The variables that it holds."""
        return tuple(name for name, _ in self.values)

    def texts(self) -> Iterator[Text]:
        return texts("value", *(value for _, value in self.values))


@dataclass(frozen=True, slots=True)
class Assignment:
    """``target = source`` in a mapping (camunda:in/out, inputParameter, zeebe:input/output, BPMN assignment).

    `in_order`: the source sees the targets of the assignments before it, as in Camunda 8.
    """

    target: str
    source: Expression
    in_order: bool = False


@dataclass(frozen=True, slots=True)
class IoMapping:
    """The input and output mapping of an activity, which then has its own variable scope.

    `all_in`: copy all variables of the outer scope in; `all_out`: copy all inner variables out.
    """

    inputs: tuple[Assignment, ...] = ()
    outputs: tuple[Assignment, ...] = ()
    all_in: bool = False
    all_out: bool = False

    def texts(self) -> Iterator[Text]:
        """Return the sources of its assignments."""
        return texts("mapping", *(item.source for item in (*self.inputs, *self.outputs)))

    def sets(self) -> Iterator[str]:
        """Return the targets of its assignments."""
        return (item.target for item in (*self.inputs, *self.outputs))


# ---- topics ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Topic:
    """The topic of a signal or message event, with the properties that this event gives it.

    name     as ROS 2 allows it: ``weed_found`` (global), ``~/odom`` (in the robot's namespace); see `qualified`
    type     ``pkg/msg/Type``, None if this event gives no type
    payload  of a throw event: flow-style YAML/JSON with ``${...}``; None without payload
    queue    of a catch event: number of messages kept from the start of its scope on; 0 for none
    ttl      how long a thrown message is kept until all receivers have acknowledged it (s); 0: it is sent once
    qos      policy -> value
    to       of a thrown message: name of the receiving robot; None for all robots
    takes    of a catch event: explicit mapping of the caught message (``msg`` in its expressions); may be empty
    label    the name, label or id that `name` is made of; empty for a topic that is written literally
    """

    name: str
    type: str | None = None
    payload: Expression | None = None
    to: Expression | None = None
    queue: int = 0
    ttl: float = 0.0
    private: bool = False
    qos: Mapping[str, str] = field(default_factory=_empty)
    takes: tuple[Assignment, ...] = ()
    label: str = field(default="", compare=False, repr=False)

    @property
    def qualified(self) -> str:
        """The name with its scope: ``/weed_found``, or ``~/odom`` for one in the robot's namespace."""
        if self.name.startswith("~/"):
            return self.name
        return ("~/" if self.private else "/") + self.name.removeprefix("/")

    @property
    def is_renamed(self) -> bool:
        """Whether ROS 2 does not allow the name that people gave it."""
        return self.label not in ("", self.name)


# ---- event definitions -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class EventDefinition:
    """The trigger or result of an event."""

    line: int = 0

    @property
    def trigger(self) -> str:
        """The BPMN name of its kind: ``signal``, ``timer``, ``error`` ..."""
        return type(self).__name__.removesuffix("Definition").lower()

    def texts(self) -> Iterator[Text]:
        """Yield its expressions, but the payload and the receiver of its topic."""
        yield from ()

    def sets(self) -> Iterator[str]:
        """Yield the variables that it sets by name when it occurs."""
        yield from ()


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalDefinition(EventDefinition):
    """A signal: published on a topic for all subscribers."""

    topic: Topic


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageDefinition(EventDefinition):
    """A message to one process. ``keys`` correlate a caught one: variable name -> expression over ``msg``."""

    topic: Topic
    keys: tuple[tuple[str, Expression], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class TimerDefinition(EventDefinition):
    """An ISO 8601 duration, date or cycle; None if the file has no time. Literals have the language ``template``."""

    kind: Literal["duration", "date", "cycle"]
    expression: Expression | None

    def texts(self) -> Iterator[Text]:
        return texts("timer", self.expression)


@dataclass(frozen=True, slots=True, kw_only=True)
class ConditionalDefinition(EventDefinition):
    """Triggers when its condition becomes true; None if the file has no condition."""

    condition: Expression | None

    def texts(self) -> Iterator[Text]:
        return texts("condition", self.condition)


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorDefinition(EventDefinition):
    """An error. A catch event without a code catches all errors.

    `computed` gives the code of a throw event, `message` its text for people. `code_variable` and `message_variable`
    receive code and text of the caught error.
    """

    code: str | None = None
    computed: Expression | None = None
    message: Expression | None = None
    code_variable: str | None = None
    message_variable: str | None = None

    def texts(self) -> Iterator[Text]:
        """Return its computed code, and its text for people."""
        return texts("mapping", self.computed, self.message)

    def sets(self) -> Iterator[str]:
        """Yield the variables for code and text."""
        yield from filter(None, (self.code_variable, self.message_variable))


@dataclass(frozen=True, slots=True, kw_only=True)
class EscalationDefinition(EventDefinition):
    """An escalation, with the code of an error."""

    code: str | None = None
    computed: Expression | None = None
    code_variable: str | None = None

    def texts(self) -> Iterator[Text]:
        """Return its computed code."""
        return texts("mapping", self.computed)

    def sets(self) -> Iterator[str]:
        """Yield the variable for the code."""
        yield from filter(None, (self.code_variable,))


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkDefinition(EventDefinition):
    """A jump to the catching link event of the same name in the same scope."""

    name: str


@dataclass(frozen=True, slots=True, kw_only=True)
class TerminateDefinition(EventDefinition):
    """Ends the scope that contains it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CompensateDefinition(EventDefinition):
    """Compensation of one activity, or (None) of all activities of its scope."""

    activity: str | None = None
    wait: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class CancelDefinition(EventDefinition):
    """Cancels the transaction that contains it."""
