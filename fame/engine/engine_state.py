"""The state that every step works on: the program, the host, the ready queue, and the tables of waits.

One first-in-first-out queue `ready` holds (node, scope) for each token that may move, and (None, (topic, message)) for
each message thrown by this robot.

Invariants between two stimuli:

- `ready` is empty. A scope's `tokens` is the number of its waiting tokens, child scopes, arrivals at joins and held
  tokens, and of the one that waits for cancelled scripts to end.
- What is dead is in no table: `listeners`, `conditions`, `waits` hold the living alone. Entries of a dead scope in
  `ready` are skipped when they come up, never searched for.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from fame.engine.host import Host
from fame.engine.program import Mark, Node, Program
from fame.engine.state import Continuation, Gathered, Instance, Listener, Scope, Trail, Wait


class EngineState:
    """The tables of one engine.

    listeners       what waits for each topic, in the order of arming
    conditions      armed conditional events, in the order of arming
    unsettled       whether a script's step has consequences: it has published, or a condition is armed
    waits           those that the host names by key: timers, scripts
    inclusive       scopes in which an inclusive join has an arrival
    cancelling      what continues when a cancelled script has ended, by its key
    instances       those that run, by key
    waiting_starts  triggers that a full process keeps
    gathered        triggers of parallel multiple start events
    armed_starts    start events with a timer, by key
    held            all scopes and waits, if the host holds them
    incidents       tokens at elements that have failed, with code and text (`fame.engine.repair`)
    on_incident     called with such a token; without it an uncaught error fails its instance
    new_variables   gives the dict that an instance, or a call with variables of its own, starts with
    parameters      variables that every instance starts with
    at_once         whether the host observes each mark by itself
    settled         called when a stimulus has run to completion, if set
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
        self.gathered: dict[Node, list[Gathered]] = {}
        self.armed_starts: dict[int, Node] = {}
        self.held: tuple[list[Scope], list[Wait]] | None = None
        self.incidents: dict[Wait, tuple[str, str]] = {}
        self.on_incident: Callable[[Wait], object] | None = None
        self.counter: int = 0
        self.at_once = False
        self.settled: Callable[[], object] | None = None
        self._trail: Trail = []
        self.place: Scope | None = None
        """Where what is emitted happens."""
        self.emit: Callable[[Mark], object] = self._observe_mark
        """Notes a mark at that place."""

    def new_key(self) -> int:
        """Identities come from one counter."""
        self.counter += 1
        return self.counter

    def forget_starts(self) -> None:
        """Drop all pending starts and everything that is held."""
        self.armed_starts.clear()
        self.held = None
        self.waiting_starts.clear()
        self.gathered.clear()

    def notify(self, scope: Scope, mark: Mark) -> None:
        """Note that something happened; observers get it at the end of the stimulus."""
        if self.place is not scope:
            self.set_place(scope)
        emit = self.emit
        emit(mark)

    def set_place(self, scope: Scope) -> None:
        """What is emitted from now on happens in that scope."""
        self.place = scope
        if not self.at_once:
            marks: list[Mark] = []
            self._trail.append((scope, marks))
            self.emit = marks.append

    def observe(self) -> None:
        """Let the host have all that was noted."""
        if self._trail:
            trail, self._trail, self.place = self._trail, [], None
            self.host.observe(trail)

    def _observe_mark(self, mark: Mark) -> None:
        """Let the host know of something that just happened."""
        assert self.place is not None
        self.host.observe([(self.place, [mark])])
