"""What an engine works on: a program that never changes, and a state that is data.

A `Program` is compiled once from a process and all that it calls. Its `Node`s are linked directly: a step function and
where the token goes next. Elements that rest have a step that arms them; elements that only pass a token on have one
that gives the next node. The state of a run is `Instance`s, `Scope`s, `Rest`s and `Mailbox`es, named by integers of one
counter; they refer to nodes, and to nothing of the host.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from hashlib import sha256
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

from fame.errors import MissionError

if TYPE_CHECKING:
    from fame.engine.interpreter import Engine

Step = Callable[["Engine", "Scope", "Node"], "Node | None"]
"""What happens when a token comes to a node: gives the node it moves to at once, or None (it rests, or is gone)."""

Mark = tuple[str, str, Any]
"""Something that happened, for observers: (element, what, detail), of the words in `fame.engine`."""

UNMARKED: Mark = ("", "", None)

RUNNING, DEAD = 0, -1
"""States of a scope. A positive state counts the suspensions that hold it."""

DEPTH = 1000
"""How deep calls and sub-processes may nest."""
SCOPES = 200_000
"""How many scopes an instance may have at a time: what calls itself twice would fill any memory."""

UNCOUNTED = 0
"""The slot of nodes whose passing is not the completion of an element."""


class Node:
    """Where a token can be. One element may be several nodes: ports of a join, triggers of a multiple event.

    In it stands what tokens ask of most nodes as they pass. What only few have stands in the class, and is set in those
    few: a node is small, and of a large program more is at hand for the processor.
    """

    __slots__ = (
        "__dict__", "act", "armed", "body", "default", "entered", "file", "fire", "guard", "id", "index",
        "interrupting", "join", "key", "kind", "left", "line", "loop", "need", "next", "out", "outputs", "own", "queue",
        "resume", "run", "slot", "step", "take", "topic", "undo",
    )  # fmt: skip

    def __init__(self, id: str, key: str, step: Step, *, line: int = 0, file: str = "") -> None:
        self.id, self.key, self.step = id, key, step
        self.act: Step | None = None  # in an observed program: what the step is without telling
        self.entered = self.left = UNMARKED  # likewise: what is told when a token comes (or takes this sequence flow)
        self.line, self.file = line, file
        self.index = self.slot = UNCOUNTED  # of `counts`: added to when a token comes here; when it has completed here
        self.next: Node | None = None
        self.out: tuple[Any, ...] = ()  # fork: nodes; exclusive: (condition, node)
        self.default: Node | None = None
        self.guard: Node = self  # whose boundary events catch an error here
        self.kind = ""  # what wakes a token that rests here: signal, message, timer, condition, user, script
        self.fire: Callable[[Engine, Rest], None] | None = None
        self.run: Any = None  # script, payload, condition or timer text, compiled
        self.take: Callable[[dict[str, Any], Any], None] | None = None
        self.topic, self.queue = "", 0
        self.body: Body | None = None
        self.own = False  # whether its body has variables of its own
        self.armed: tuple[Node, ...] = ()  # boundary events that wait for a stimulus
        self.join: Node | None = None  # of a port
        self.need = 0  # of a join: how many flows come in; of a port: which it is
        self.interrupting, self.resume = True, False
        self.outputs: tuple[tuple[str, Any], ...] = ()
        self.undo: Node | None = None  # compensation event at its boundary
        self.loop: Any = None  # of a multi-instance activity or loop: how it repeats

    timer = variable = ""
    required: tuple[str, ...] = ()  # variables that have to be set when an activity has ended
    to: Any = None  # of a message that is thrown: the robot that it is for, compiled
    keys: tuple[tuple[str, Any], ...] = ()  # what correlates a message: variable, expression over `msg`
    shares = True  # whether the variables of its body are chained to those outside
    inputs: tuple[tuple[str, Any], ...] = ()
    all_in = all_out = False  # whether all variables go into, or out of, a called process
    errors: tuple[Node, ...] = ()
    escalations: tuple[Node, ...] = ()
    cancels: tuple[Node, ...] = ()  # cancel boundary events of a transaction
    alternatives: tuple[Node, ...] = ()
    via = ""  # of an alternative: the sequence flow that leads to its event
    code: str | None = None
    code_variable = message_variable = ""
    resets: tuple[Any, ...] = ()  # of a complex gateway: flows to ask at its reset, (condition, node)
    masks: Mapping[str, int] = MappingProxyType({})  # of a join with reachability: id -> flows of the join it reaches

    def __repr__(self) -> str:
        return f"<Node {self.key}>"


class Body:
    """What a scope runs. `opening` is the node that arms its event sub-processes and enters its start."""

    __slots__ = ("adhoc", "armed", "errors", "escalations", "id", "opening", "queued", "transaction", "undo")

    def __init__(self, id: str) -> None:
        self.id = id
        self.opening: Node
        self.armed: tuple[Node, ...] = ()  # starts of event sub-processes that wait for a stimulus
        self.errors: tuple[Node, ...] = ()  # starts of error event sub-processes
        self.escalations: tuple[Node, ...] = ()
        self.queued: tuple[Node, ...] = ()  # catching events that keep messages from the time the scope is entered
        self.undo: Node | None = None  # start of the event sub-process for compensation
        self.adhoc: Any = None  # of an ad-hoc sub-process: how it goes about it
        self.transaction = False


class Program:
    """A process, compiled, with everything it calls. Immutable; any number of engines may run it.

    `starts` are its start events by topic, `timed` those with a timer, `begin` is the none start (None if there is
    none). `elements[slot]` is the id whose completions are counted there. `nodes` are found by their keys.
    """

    def __init__(self, process: str, name: str = "", observed: bool = False) -> None:
        self.process, self.name, self.observed = process, name, observed
        self.sources: list[Any] = []  # the models of the process and all that it calls
        self.body: Body
        self.nodes: list[Node] = []
        self.elements: list[str] = [""]
        self.starts: dict[str, tuple[Node, ...]] = {}
        self.timed: tuple[Node, ...] = ()
        self.begin: Node | None = None
        self.instances: int | None = None

    @cached_property
    def hash(self) -> str:
        """Names what it was compiled from."""
        return self.name or sha256(repr(self.sources).encode()).hexdigest()

    @cached_property
    def by_key(self) -> dict[str, Node]:
        """Its nodes by key."""
        return {node.key: node for node in self.nodes}


class Scope:
    """An activation of a body: of a process, sub-process, called process or handler.

    tokens    those in `ready`, at rest, in child scopes and at joins, together
    children  rests and scopes in it, in the order of entry: what cancellation walks
    arms      boundary events that guard it
    handles   event sub-processes that took its place by interrupting it, the first one first
    suspender the handler that holds everything in it that is older than key `mark`
    leaving   keys of cancelled scripts that what goes on here waits for
    done      what has completed in it and can be compensated, in order; of a compensation: what is still to undo
    held      nodes of tokens that wait for the end of a suspension
    """

    __slots__ = (
        "arms", "body", "children", "counts", "depth", "done", "handles", "held", "instance", "items", "joins",
        "key", "leaving", "mail", "mark", "node", "parent", "state", "suspender", "tokens", "variables",
    )  # fmt: skip

    def __init__(
        self, key: int, parent: Scope | None, node: Node | None, body: Body | None, variables: dict[str, Any]
    ) -> None:
        self.key, self.parent, self.node, self.body, self.variables = key, parent, node, body, variables
        self.tokens, self.state = 1, RUNNING
        self.children: dict[Scope | Rest, None] = {}
        self.arms: tuple[Rest, ...] = ()
        self.joins: dict[Node, list[int]] | None = None
        self.mail: dict[Node, Mailbox] | None = None
        self.handles: tuple[Node, ...] = ()
        self.done: list[Record] | None = None
        self.suspender: Scope | None = None
        self.mark = 0
        self.leaving: tuple[int, ...] = ()
        self.held: tuple[Node, ...] = ()
        self.items: Any = None  # of a multi-instance activity or loop: its progress
        self.instance: Instance
        self.counts: list[int]
        self.depth = 0
        if parent is not None:
            self.instance, self.counts, self.depth = parent.instance, parent.counts, parent.depth + 1

    @property
    def alive(self) -> bool:
        """Whether it goes on, be it suspended."""
        return self.state >= 0


Trail = list[tuple[Scope, list[Mark]]]
"""What happened, in order: each scope with the marks of what happened in it until something happened elsewhere."""


class Record:
    """An activity that has completed, and what had completed in it (see `fame.engine.compensation`)."""

    __slots__ = ("inner", "node", "variables")

    def __init__(self, node: Node, variables: dict[str, Any], inner: list[Record]) -> None:
        self.node, self.variables, self.inner = node, variables, inner


class Rest:
    """A resting token, or something armed that holds none (boundary event, start of an event sub-process, alternative).

    owner   what it guards, or the gateway's rest that it is an alternative of
    arms    what is armed because of it: boundary events, alternatives
    paused  suspensions that hold it
    due     sequence number at which it came due while it was paused, 0 if it did not
    started whether a script of it was begun
    true    of a conditional event: the value at the last look
    box     messages that it keeps while it is paused, if it has a queue of its own
    """

    __slots__ = ("alive", "arms", "box", "due", "key", "node", "owner", "paused", "scope", "started", "token", "true")

    def __init__(self, key: int, node: Node, scope: Scope, token: bool, owner: Scope | Rest | None = None) -> None:
        self.key, self.node, self.scope, self.token, self.owner = key, node, scope, token, owner
        self.alive, self.true, self.started = True, False, False
        self.paused = self.due = 0
        self.arms: tuple[Rest, ...] = ()
        self.box: Mailbox | None = None


class Mailbox:
    """Messages kept for one catching event in one activation of its scope, and the rests that wait at it."""

    __slots__ = ("alive", "key", "messages", "node", "rests", "scope")

    def __init__(self, key: int, node: Node, scope: Scope) -> None:
        self.key, self.node, self.scope, self.alive = key, node, scope, True
        self.messages: deque[tuple[int, Any]] = deque(maxlen=node.queue)
        self.rests: dict[Rest, None] = {}


Status = Literal["running", "completed", "failed", "cancelled"]
Listener = Rest | Mailbox


class Instance:
    """One run of the process. After its end it keeps what it ended with."""

    def __init__(self, key: int, program: Program, variables: dict[str, Any]) -> None:
        self.key, self.program, self.root_variables = key, program, variables
        self.status: Status = "running"
        self.error: MissionError | None = None
        self.counts = [0] * len(program.elements)
        self.scopes = 0  # how many of its scopes live
        self.root: Scope

    @property
    def process(self) -> str:
        """The id of its process."""
        return self.program.process

    @property
    def variables(self) -> dict[str, Any]:
        """Its variables that are data."""
        from fame.engine.variables import plain

        return plain(self.root_variables)

    @property
    def visits(self) -> Counter[str]:
        """How often each element has completed."""
        elements = self.program.elements
        visits: Counter[str] = Counter()
        for slot in range(1, len(elements)):
            if self.counts[slot]:
                visits[elements[slot]] += self.counts[slot]
        return visits

    def rests(self) -> Iterator[Rest]:
        """Every resting token in it, in the order of entry, outermost first."""
        if self.status == "running":
            for scope in scopes_of(self.root):
                for child in scope.children:
                    if isinstance(child, Rest) and child.token:
                        yield child

    @property
    def waiting(self) -> Sequence[str]:
        """Ids of the elements that hold a token: those at which one rests, then joins that wait for others."""
        joins = joins_reached(self.root) if self.status == "running" else ()
        return [*(rest.node.id for rest in self.rests()), *(join.id for _, join, _ in joins)]


class Departure:
    """What goes on when scripts that were cancelled are out: a token at `node`."""

    __slots__ = ("node", "pending", "scope")

    def __init__(self, pending: int, node: Node, scope: Scope) -> None:
        self.pending, self.node, self.scope = pending, node, scope


def scopes_of(root: Scope) -> Iterator[Scope]:
    """A scope and all in it, outer before inner, in the order of entry; without recursion."""
    stack = [root]
    while stack:
        scope = stack.pop()
        yield scope
        stack.extend(child for child in reversed(tuple(scope.children)) if isinstance(child, Scope))


def joins_reached(root: Scope) -> Iterator[tuple[Scope, Node, list[int]]]:
    """Joins that some flows have reached and others not, with how many tokens each flow has brought."""
    for scope in scopes_of(root):
        for join, counts in (scope.joins or {}).items():
            if any(held := counts[: join.need]):
                yield scope, join, held
