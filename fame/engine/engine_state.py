"""The state that every step works on: the program, the host, the ready queue, and the tables of waits.

One first-in-first-out queue `ready` holds (node, scope) for each token that may move, and (None, (topic, message)) for
each message thrown by this robot.

Invariants between two stimuli:

- `ready` is empty. A scope's `tokens` counts its waiting tokens, child scopes, arrivals at joins, held tokens, and the
  token that waits for cancelled scripts to end.
- `listeners`, `conditions` and `waits` contain nothing that has ended. Entries of an ended scope in `ready` are skipped
  when their turn comes, never searched for.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from typing import Any

from fame.engine.host import Host
from fame.engine.program import Mark, Node, Program
from fame.engine.state import Continuation, Gathered, Instance, Listener, Scope, Trail, Wait


class EngineState:
    """The tables of one engine.

    listeners       waits and queues for each topic, in the order of arming
    conditions      armed conditional events, in the order of arming
    unsettled       whether a script's step has consequences: it has published, or a condition is armed
    waits           the waits that the host refers to by key: timers, scripts
    inclusive       scopes in which an inclusive join has an arrival
    cancelling      continuations of cancelled scripts that have not ended, by key of the script
    instances       running instances, by key
    waiting_starts  queued triggers of a process that is held, or runs as many instances as it may
    missed          how often a suspended timer has come due, for a report, by key
    gathered        triggers of parallel multiple start events that are not complete
    armed_starts    start events with a timer, by key
    suspensions     scopes that were suspended since the loop last looked at the bound of a livelock
    starts_no_more  whether instances have started each other for too long: no further one starts in this stimulus
    held            all scopes and waits, while the host holds the engine
    untaken         BPMN messages that no event has taken, by topic; those in queues count
    incidents       tokens at elements that have failed, with code and text (`fame.engine.repair`)
    on_incident     called with such a token; if None, an uncaught error fails its instance
    new_variables   gives the dict that an instance, or a call with variables of its own, starts with
    parameters      variables that every instance starts with
    at_once         whether the host receives each mark at once instead of after the stimulus
    settled         called when a stimulus has run to completion
    """

    program: Program
    host: Host
    new_variables: Callable[[], dict[str, Any]]

    def __init__(self, program: Program, host: Host, new_variables: Callable[[], dict[str, Any]] = dict) -> None:
        self.program, self.host, self.new_variables = program, host, new_variables
        self.parameters: dict[str, Any] = {}
        self.ready: deque[tuple[Node | None, Any]] = deque()
        self.listeners: dict[str, dict[Listener, None]] = {}
        self.conditions: dict[Wait, None] = {}
        self.unsettled = False
        self.waits: dict[int, Wait] = {}
        self.inclusive: dict[Scope, None] = {}
        self.cancelling: dict[int, Continuation] = {}
        self.instances: dict[int, Instance] = {}
        self.waiting_starts: dict[Node, deque[tuple[int, Any]]] = {}
        self.missed: Counter[int] = Counter()
        self.gathered: dict[Node, list[Gathered]] = {}
        self.armed_starts: dict[int, Node] = {}
        self.suspensions = 0
        self.starts_no_more: bool = False
        self.held: tuple[list[Scope], list[Wait]] | None = None
        self.untaken: Counter[str] = Counter()
        self.incidents: dict[Wait, tuple[str, str]] = {}
        self.on_incident: Callable[[Wait], object] | None = None
        self.counter: int = 0
        self.restored = 0  # its value when the state was restored: greater keys are of what began since
        self.at_once = False
        self.settled: Callable[[], object] | None = None
        self._trail: Trail = []
        self.place: Scope | None = None
        """The scope of the next marks."""
        self.emit: Callable[[Mark], object] = self._observe_mark
        """Records a mark of that scope."""

    def new_key(self) -> int:
        """Return a new key: all keys come from one counter."""
        self.counter += 1
        return self.counter

    def forget_starts(self) -> None:
        """Drop all pending starts and everything that is held."""
        self.armed_starts.clear()
        self.held = None
        self.waiting_starts.clear()
        self.missed.clear()
        self.gathered.clear()

    def notify(self, scope: Scope, mark: Mark) -> None:
        """Record a mark; observers receive it at the end of the stimulus."""
        if self.place is not scope:
            self.set_place(scope)
        emit = self.emit
        emit(mark)

    def set_place(self, scope: Scope) -> None:
        """Set the scope of the next marks."""
        self.place = scope
        if not self.at_once:
            marks: list[Mark] = []
            self._trail.append((scope, marks))
            self.emit = marks.append

    def observe(self) -> None:
        """Pass all recorded marks to the host."""
        if self._trail:
            trail, self._trail, self.place = self._trail, [], None
            self.host.observe(trail)

    def _observe_mark(self, mark: Mark) -> None:
        """Pass one mark to the host."""
        assert self.place is not None
        self.host.observe([(self.place, [mark])])
