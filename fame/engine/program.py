"""The program of an engine: linked nodes, compiled once from a process and all processes that it calls.

A *node* is a place where a token can be: most elements are one node, some are several (the ports of a join, the
triggers of a multiple event). A node has a *step*, the function that is called when a token comes to it, and is linked
directly to the node where the token goes next. Each family of elements has a `spec` dataclass for the data that only
its steps need. A node at which tokens wait has a `Catch`, whose `Trigger` wakes the token. A program never changes.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

from fame.dataclasses import dataclass

StepFunction = Callable[[Any, Any, Any], "Node | None"]
"""A function of (`EngineState`, `Scope`, `Node`): gives the node that the token moves to at once, or None if the token
waits or is gone."""

Compiled = Callable[[dict[str, Any]], Any]
"""A compiled text: a script returns None, or a suspended script (a coroutine) if it waits; an expression its value."""

Mark = tuple[str, str, Any]
"""Something that happened, for observers: (element, what, detail), with the words listed in `fame.engine`."""

NO_MARK: Mark = ("", "", None)

UNCOUNTED = 0
"""The slot of nodes that do not complete an element."""


class Node:
    """A place where a token can be. All nodes have this class, because CPython then runs the loop over them fast.

    id, line, file   the element
    key              names the node in snapshots
    step             the function that is called when a token comes
    plain_step       in an observed program: the step without observation; None: this node is not observed
    entered, left    the marks for observers when a token comes, and when the element has completed
    index, slot      the count that grows when a token comes; the count of completions of the element
    next             where the token goes
    part_of          the node whose boundary events catch an error here: itself, unless it is part of an element
    boundary         its boundary events, if it has any
    catch            the trigger that tokens wait for here, if they wait
    body, ended      the body of the scope that it opens, and a function of (engine, outer scope, ended scope), called
                     when that scope has ended, which returns a scope that ends with it, or None
    spec             the data of its family: a dataclass beside the family's steps
    """

    __slots__ = (
        "body", "boundary", "catch", "ended", "entered", "file", "id", "index", "key", "left", "line", "next",
        "part_of", "plain_step", "slot", "spec", "step",
    )  # fmt: skip

    id: str
    key: str
    step: StepFunction
    spec: Any
    line: int
    file: str
    entered: Mark
    left: Mark
    index: int
    slot: int

    def __init__(
        self, id: str, key: str, step: StepFunction, *, line: int = 0, file: str = "", spec: Any = None
    ) -> None:
        self.id, self.key, self.step, self.spec = id, key, step, spec
        self.line, self.file = line, file
        self.plain_step: StepFunction | None = None
        self.entered = self.left = NO_MARK
        self.index = self.slot = UNCOUNTED
        self.next: Node | None = None
        self.part_of: Node = self
        self.boundary: Boundary | None = None
        self.catch: Catch | None = None
        self.body: Body | None = None
        self.ended: Callable[[Any, Any, Any], Any]

    def __repr__(self) -> str:
        return f"<Node {self.key}>"


@dataclass(frozen=True, slots=True)
class Trigger:
    """What wakes a waiting token: functions of (engine, wait) that start, end, suspend and resume its waiting."""

    name: str
    arm: Callable[[Any, Any], object]
    disarm: Callable[[Any, Any], object]
    suspend: Callable[[Any, Any], object]
    resume: Callable[[Any, Any], object]


def nothing(engine: Any, wait: Any) -> None:
    """Do nothing: the function of a trigger that needs no action."""


NO_TRIGGER = Trigger("", nothing, nothing, nothing, nothing)
"""The trigger of a token that other waits wake, as at an event-based gateway."""
USER = Trigger("user", nothing, nothing, nothing, nothing)
"""The trigger of a user or manual task, which a person completes."""


def _no_value(variables: dict[str, Any]) -> Any:
    """Return None: the trigger is neither a timer nor a condition."""


@dataclass(slots=True)
class Catch:
    """What a node waits for, with a token or (boundary events and the like) without one.

    trigger       what wakes it
    fire          called when it occurs: a function of (engine, wait)
    give_up       called when the trigger or its message cannot be evaluated: a function of (engine, wait, error)
    topic         of a signal or message; "" for other triggers
    queue         how many messages are kept for it
    home          the node of the event that its queue belongs to, if another node stands for the same event
    take          stores a message in the variables
    keys          correlation keys of a message: (variable, expression over `msg`)
    value         the time of a timer, or the condition, compiled
    timer         ``duration``, ``date`` or ``cycle``
    parts         armed in its place: alternatives of which the first counts, or triggers of which all are needed
    interrupting  whether it cancels the activity that it is attached to, or the scope that it handles
    resume        whether it suspends that scope instead
    """

    trigger: Trigger
    fire: Callable[[Any, Any], object]
    give_up: Callable[[Any, Any, BaseException], object]
    topic: str = ""
    queue: int = 0
    home: Node | None = None
    take: Callable[[dict[str, Any], Any], None] | None = None
    keys: tuple[tuple[str, Callable[[dict[str, Any]], Any]], ...] = ()
    value: Callable[[dict[str, Any]], Any] = _no_value
    timer: str = ""
    parts: tuple[Node, ...] = ()
    interrupting: bool = True
    resume: bool = False

    @property
    def kept(self) -> int:
        """How many triggers of a start event are kept at most: that of a timer is, while the engine is held."""
        return self.queue or 1


@dataclass(slots=True)
class FaultCatch:
    """Spec of an event that catches errors, escalations, cancellation or compensation: found by search, never armed.

    kind                           ``error``, ``escalation``, ``cancel`` or ``compensate``
    code                           the code that it catches; None: all
    code_variable, message_variable the variables for code and text
    interrupting, resume           as of `Catch`
    """

    kind: str
    interrupting: bool = True
    resume: bool = False
    code: str | None = None
    code_variable: str = ""
    message_variable: str = ""


@dataclass(slots=True)
class Boundary:
    """The boundary events of an activity. `armed`: those with a stimulus; `compensation`: its handler."""

    armed: tuple[Node, ...] = ()
    errors: tuple[Node, ...] = ()
    escalations: tuple[Node, ...] = ()
    cancels: tuple[Node, ...] = ()
    compensation: Node | None = None


@dataclass(frozen=True, slots=True)
class Handler:
    """Spec of an event sub-process, whose scope is a child of the scope that it handles or replaces it."""


@dataclass(frozen=True, slots=True)
class LoopInstance:
    """Spec of one instance of a repeated activity. `passes_on`: its new variables are those of the scope around it."""

    passes_on: bool = False


@dataclass(slots=True)
class Start:
    """Spec of a trigger that starts the process.

    whole  of a parallel multiple start event: the event that it is part of
    event  of a parallel event-based gateway: its event, which a running instance may be waiting for
    """

    whole: Node | None = None
    event: Node | None = None


class Body:
    """The content of a process or sub-process, which a scope runs.

    entries      the first node of each element
    opening      the first node: it arms event sub-processes and queues, and leads to the start
    armed        starts of event sub-processes with a stimulus
    errors       starts of error event sub-processes; `escalations` likewise
    queued       catching events that keep messages from the time that the scope is entered
    compensation start of the event sub-process for compensation
    adhoc        the spec of an ad-hoc sub-process (`fame.engine.adhoc.AdHoc`)
    """

    __slots__ = (
        "adhoc",
        "armed",
        "compensation",
        "entries",
        "errors",
        "escalations",
        "id",
        "opening",
        "queued",
        "transaction",
    )

    def __init__(self, id: str) -> None:
        self.id: str = id
        self.opening: Node
        self.entries: dict[str, Node] = {}
        self.armed: tuple[Node, ...] = ()
        self.errors: tuple[Node, ...] = ()
        self.escalations: tuple[Node, ...] = ()
        self.queued: tuple[Node, ...] = ()
        self.compensation: Node | None = None
        self.adhoc: Any = None
        self.transaction: bool = False


class Program:
    """A compiled process with all processes that it calls. Immutable; any number of engines can run it.

    starts     its start events by topic; `timed`: those with a timer; `begin`: the none start, if there is one
    messages   the topics of its BPMN messages; `shared`: those of which an event keeps messages
    selective  the topics that not every catcher gets: of BPMN messages, and those with a queue
    elements   ``elements[slot]`` is the id whose completions are counted there
    nodes      all nodes, in the order of compilation
    sources    the models of the process and of all that it calls
    instances  how many instances may run at a time; None: any number
    concluded  called with the engine when an instance has ended and queued triggers wait for that
    """

    process: str
    observed: bool

    def __init__(self, process: str, texts: Callable[[], str] = str, observed: bool = False) -> None:
        self.process, self._texts, self.observed = process, texts, observed
        self.sources: list[Any] = []
        self.body: Body
        self.nodes: list[Node] = []
        self.elements: list[str] = [""]
        self.starts: dict[str, tuple[Node, ...]] = {}
        self.timed: tuple[Node, ...] = ()
        self.begin: Node | None = None
        self.messages: set[str] = set()
        self.shared: set[str] = set()
        self.selective: set[str] = set()
        self.instances: int | None = None
        self.concluded: Callable[[Any], object]

    @cached_property
    def hash(self) -> str:
        """The hash of the texts of its models where a robot runs it; else `made`."""
        return self._texts() or self.made

    @cached_property
    def made(self) -> str:
        """The hash of the models that it was compiled from, as this version of FAME reads them."""
        from hashlib import sha256

        return sha256(repr(self.sources).encode()).hexdigest()

    @cached_property
    def body_keys(self) -> dict[Body, str]:
        """For each body the key of the first node that opens it; "" for the body of the process."""
        homes = {node.body: node.key for node in reversed(self.nodes) if node.body is not None}
        return {**homes, self.body: ""}

    @cached_property
    def by_key(self) -> dict[str, Node]:
        return {node.key: node for node in self.nodes}
