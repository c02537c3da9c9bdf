"""The state of a run, as data: instances, scopes, waits and mailboxes.

They are identified by integers of one counter and refer to nodes of the program, but to no object of the host.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from typing import Any, Literal

from fame.engine.data import Variables, plain
from fame.engine.program import Body, Catch, LoopInstance, Mark, Node, Program
from fame.errors import MissionError

RUNNING, DEAD = 0, -1
"""States of a scope. A positive state counts the suspensions that hold it."""

DEPTH = 1000
"""Maximum nesting of calls and sub-processes."""
SCOPES = 200_000
"""Maximum number of scopes of an instance: a process that calls itself twice would fill any memory."""
TOKENS = 50_000
"""Tokens of an engine, moving or waiting for a timer, script or message, that count as a livelock: each stimulus takes
longer the more there are, and a loop that forks doubles them each time."""


class Scope:
    """An activation of a body: of a process, sub-process, called process or handler.

    tokens     number of its tokens: in `ready`, waiting, in child scopes and at joins
    children   waits and scopes in it, in the order of entry
    arms       waits of the boundary events of its activity
    handles    event sub-processes that replaced its content by interrupting it, in order
    suspender  the handler that suspends everything in it with a key below `mark`
    cancelling keys of cancelled scripts that the token here waits for
    done       records for compensation, in order; in a compensation: the records still to compensate
    held       nodes of tokens that wait for the end of a suspension
    items      progress of a loop, or of an ad-hoc sub-process
    """

    __slots__ = (
        "arms", "body", "cancelling", "children", "counts", "depth", "done", "handles", "held", "instance", "items",
        "joins", "key", "mail", "mark", "node", "parent", "state", "suspender", "tokens", "variables",
    )  # fmt: skip

    key: int
    parent: Scope | None
    node: Node | None
    body: Body | None
    variables: dict[str, Any]
    tokens: int
    state: int
    depth: int

    def __init__(
        self, key: int, parent: Scope | None, node: Node | None, body: Body | None, variables: dict[str, Any]
    ) -> None:
        self.key, self.parent, self.node, self.body, self.variables = key, parent, node, body, variables
        self.tokens, self.state = 1, RUNNING
        self.children: dict[Scope | Wait, None] = {}
        self.arms: tuple[Wait, ...] = ()
        self.joins: dict[Node, list[int]] | None = None
        self.mail: dict[Node, Mailbox] | None = None
        self.handles: tuple[Node, ...] = ()
        self.done: list[Record] | None = None
        self.suspender: Scope | None = None
        self.mark: int = 0
        self.cancelling: tuple[int, ...] = ()
        self.held: tuple[Node, ...] = ()
        self.items: Any = None
        self.instance: Instance
        self.counts: list[int]
        if parent is None:
            self.depth = 0
        else:
            self.instance, self.counts, self.depth = parent.instance, parent.counts, parent.depth + 1

    @property
    def alive(self) -> bool:
        """Whether it has not ended, suspended or not."""
        return self.state >= 0


Trail = list[tuple[Scope, list[Mark]]]
"""Marks in order: each scope with its marks until the next mark of another scope."""


class Record:
    """A completed activity, with the records inside it (see `fame.engine.compensation`); `depth` levels with itself."""

    __slots__ = ("depth", "inner", "node", "variables")

    node: Node
    variables: dict[str, Any]
    inner: list[Record]
    depth: int

    def __init__(self, node: Node, variables: dict[str, Any], inner: list[Record]) -> None:
        self.node, self.variables, self.inner = node, variables, inner
        self.depth = 1 + max((record.depth for record in inner), default=0)


class Wait:
    """A token that waits, or something armed that holds no token (boundary event, start of an event sub-process).

    catch   the `Catch` of its node
    owner   the scope or wait that it is armed for: of an activity, or of a gateway
    arms    the waits that are armed for it: boundary events, alternatives
    paused  suspensions that hold it
    due     sequence number at which it came due while it was paused, 0 if it did not
    started whether a script of it was started
    true    of a conditional event: the value at the last evaluation
    box     its own queue of messages, if it has one
    """

    __slots__ = (
        "alive",
        "arms",
        "box",
        "catch",
        "due",
        "key",
        "node",
        "owner",
        "paused",
        "scope",
        "started",
        "token",
        "true",
    )

    key: int
    node: Node
    scope: Scope
    token: bool
    owner: Scope | Wait | None
    alive: bool
    true: bool
    started: bool
    paused: int
    due: int

    def __init__(self, key: int, node: Node, scope: Scope, token: bool, owner: Scope | Wait | None = None) -> None:
        self.key, self.node, self.scope, self.token, self.owner = key, node, scope, token, owner
        self.catch: Catch = node.catch  # type: ignore[assignment]  # nodes where tokens wait have one
        self.alive, self.true, self.started = True, False, False
        self.paused = self.due = 0
        self.arms: tuple[Wait, ...] = ()
        self.box: Mailbox | None = None


class Mailbox:
    """Messages kept for one catching event in one activation of its scope, with numbers in the order of arrival.

    passed  whether a token has been at the event, and has left it
    """

    passed: bool

    __slots__ = ("alive", "catch", "key", "messages", "node", "passed", "scope")

    key: int
    node: Node
    scope: Scope
    alive: bool

    def __init__(self, key: int, node: Node, scope: Scope) -> None:
        self.key, self.node, self.scope, self.alive, self.passed = key, node, scope, True, False
        assert node.catch is not None
        self.catch: Catch = node.catch
        self.messages: deque[tuple[int, Any]] = deque(maxlen=self.catch.queue)


InstanceStatus = Literal["running", "completed", "failed", "cancelled"]
Listener = Wait | Mailbox

Arrived = list[tuple[Node, Any]]
"""Triggers of a start and their messages, in the order of arrival."""
Gathered = tuple[dict[str, Any], dict[Node, Any]]
"""Some of the triggers of a parallel multiple start event: values of the correlation keys, and messages by trigger."""


class Instance:
    """One run of the process. It keeps its final variables and counts after its end.

    key, program  its number, and its program
    root          the scope of its process, until it ends
    status        ``running``, ``completed``, ``failed`` or ``cancelled``
    error         of a failed one: what went wrong
    """

    key: int
    program: Program
    root_variables: dict[str, Any]

    def __init__(self, key: int, program: Program, variables: dict[str, Any]) -> None:
        self.key, self.program, self.root_variables = key, program, variables
        self.status: InstanceStatus = "running"
        self.error: MissionError | None = None
        self.counts: list[int] = [0] * len(program.elements)
        self.scopes = 0
        """Number of its open scopes."""
        self.root: Scope

    @property
    def process(self) -> str:
        return self.program.process

    @property
    def variables(self) -> dict[str, Any]:
        """Its variables that are data."""
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

    def waits(self) -> Iterator[Wait]:
        """Yield every waiting token in it, in the order of entry, outermost first."""
        if self.status == "running":
            for scope in scopes_of(self.root):
                for child in scope.children:
                    if isinstance(child, Wait) and child.token:
                        yield child

    @property
    def waiting(self) -> Sequence[str]:
        """Ids of the elements that hold a token: where a token waits, then joins that wait for further tokens."""
        joins = joins_reached(self.root) if self.status == "running" else ()
        return [*(wait.node.id for wait in self.waits()), *(join.id for _, join, _ in joins)]


class Continuation:
    """A token at `node` that continues when cancelled scripts have ended. `pending`: the number still running."""

    __slots__ = ("node", "pending", "scope")

    pending: int
    node: Node
    scope: Scope

    def __init__(self, pending: int, node: Node, scope: Scope) -> None:
        self.pending, self.node, self.scope = pending, node, scope


def pass_on(scope: Scope) -> None:
    """Let the variables of a restored scope pass on new names if it is a pass of a loop: this is no data of theirs."""
    own = scope.parent is not None and scope.variables is not scope.parent.variables
    if own and isinstance(scope.variables, Variables) and scope.node and isinstance(scope.node.spec, LoopInstance):
        scope.variables.passes_on = scope.node.spec.passes_on


def scopes_of(root: Scope) -> Iterator[Scope]:
    """Yield a scope and all scopes in it, outer before inner, in the order of entry; without recursion."""
    stack = [root]
    while stack:
        scope = stack.pop()
        yield scope
        stack.extend(child for child in reversed(tuple(scope.children)) if isinstance(child, Scope))


def joins_reached(root: Scope) -> Iterator[tuple[Scope, Node, list[int]]]:
    """Yield joins that wait for further tokens, with the number of tokens of each incoming flow."""
    for scope in scopes_of(root):
        for join, counts in (scope.joins or {}).items():
            if any(held := counts[: join.spec.need]):
                yield scope, join, held
