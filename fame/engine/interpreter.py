"""The interpreter: stimuli, the loop that moves tokens, and the instances.

One first-in-first-out queue `ready` holds (node, scope) for each token that may move, and (None, (topic, message)) for
each message thrown by this robot. A stimulus (`start`, `deliver`, `timer_fired` ...) changes the state and then runs
the queue empty: `run` is the loop, all else hangs on the step functions of the nodes.

Invariants between two stimuli:

- `ready` is empty. A scope's `tokens` is the number of its resting tokens, child scopes, arrivals at joins and held
  tokens, and of the one that waits for scripts to leave.
- What is dead is in no table: `listeners`, `conditions`, `rests` hold the living alone. Entries of a dead scope in
  `ready` are skipped when they come up, never searched for.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from itertools import repeat
from operator import attrgetter
from typing import Any

from fame.engine import activities, adhoc, gateways, scopes, starts, steps, suspension, waiting
from fame.engine.host import Host
from fame.engine.state import Departure, Instance, Listener, Mark, Node, Program, Rest, Scope, Status, Trail
from fame.errors import MissionError

MOVES = 10_000_000
"""Moves of tokens within one stimulus, after which it is taken for a livelock."""

PORTION = 300
"""Moves after which observers hear what happened, if the stimulus lasts that long."""

TRACE = 100_000
"""Moves that are looked at to find the elements of such a loop."""


class Engine:
    """All instances of one robot's program.

    new_variables gives the dict that an instance, or a call with variables of its own, starts with
    moves         bound of the moves within one stimulus
    """

    def __init__(
        self, program: Program, host: Host, new_variables: Callable[[], dict[str, Any]] = dict, *, moves: int = MOVES
    ) -> None:
        self.program, self.host, self.new_variables, self.limit = program, host, new_variables, moves
        self.portion = min(PORTION, moves)
        self.ready: deque[tuple[Node | None, Any]] = deque()
        self.listeners: dict[str, dict[Listener, None]] = {}
        self.conditions: dict[Rest, None] = {}
        self.alert = False  # whether a script's step has consequences: a condition is armed, or it published
        self.rests: dict[int, Rest] = {}  # those that the host names by key: timers, scripts
        self.inclusive: dict[Scope, None] = {}  # scopes in which an inclusive join has an arrival
        self.leaving: dict[int, Departure] = {}  # scripts that are leaving, by key
        self.departing: list[int] = []  # those of them that were cancelled just now; `scopes.proceed` follows
        self.instances: dict[int, Instance] = {}
        self.waiting_starts: dict[Node, deque[tuple[int, Any]]] = {}  # triggers that a full process keeps
        self.gathered: dict[Node, list[starts.Gathered]] = {}  # triggers of parallel multiple start events
        self.armed_starts: dict[int, Node] = {}  # start events with a timer
        self.held: tuple[list[Scope], list[Rest]] | None = None  # all that runs, if the host holds it
        self.counter = 0
        self.at_once = False  # whether the host is to observe each mark by itself
        self.trail: Trail = []  # what happened and is not observed yet
        self.place: Scope | None = None  # where what is noted happens
        self.note: Callable[[Mark], object] = self.observe_mark  # at that place

    # ---- stimuli -------------------------------------------------------------------------------------

    def begin(self, variables: dict[str, Any] | None = None) -> None:
        """Once, when the program is loaded: arm the timers of start events, and start at the none start event.

        Raises MissionError for a timer that says no time.
        """
        for node in self.program.timed:
            key = self.new_key()
            self.armed_starts[key] = node
            try:
                self.host.set_timer(key, node.timer, str(node.run(self.new_variables())))
            except Exception as error:
                raise MissionError(str(error), element=node.id, file=node.file, line=node.line) from error
        if self.program.begin is not None:
            self.start(variables)

    def start(self, variables: dict[str, Any] | None = None) -> Instance:
        """Start an instance at the none start event. Raises MissionError if the process has none."""
        if self.program.begin is None:
            text = "has no none start event, so it starts by its events alone"
            raise MissionError(text, element=self.program.process)
        instance = self.open_instance(self.program.begin, variables)
        self.run()
        return instance

    def deliver(self, topic: str, message: Any) -> None:
        """A signal, or a message for this process, came from outside; unless somebody waits, little is done."""
        if topic in self.listeners or topic in self.program.starts:
            waiting.deliver(self, topic, message)
            self.run()

    def post(self, topic: str, message: Any) -> None:
        """A script published: own catchers get it in its turn, behind which the script's token goes on."""
        self.ready.append((None, (topic, message)))
        self.alert = True

    def stepped(self) -> None:
        """A suspended script went on and waits again: its variables may have changed, and it may have published."""
        if self.conditions:
            waiting.check_conditions(self)
        self.run()

    def timer_fired(self, key: int, last: bool = True) -> None:
        """A timer is due; `last`: it will not be again."""
        start = self.armed_starts.get(key)
        if start is not None:
            if last:
                del self.armed_starts[key]
            starts.trigger(self, start, None)
        elif key in self.rests:
            waiting.fire(self, self.rests.pop(key) if last else self.rests[key])
        self.run()

    def timed(self, key: int) -> Node:
        """The node that a timer is set for."""
        start = self.armed_starts.get(key)
        return start if start is not None else self.rests[key].node

    def script_ended(self, key: int, error: BaseException | None = None) -> None:
        """A suspended script is out: done, failed, or (it was cancelled) gone."""
        departure = self.leaving.pop(key, None)
        if departure is not None:
            departure.scope.leaving = tuple(other for other in departure.scope.leaving if other != key)
            departure.pending -= 1
            if departure.pending == 0:
                self.ready.append((departure.node, departure.scope))
        elif key in self.rests and not self.rests[key].paused:  # of one that is held, what was left is out
            activities.over(self, self.rests[key], error)
        self.run()

    def complete_task(self, element: str, values: dict[str, Any] | None = None, instance: int | None = None) -> None:
        """Somebody did what a user, manual or receive task waits for. Raises MissionError if none waits there."""
        for candidate in self.instances.values():
            if instance not in (None, candidate.key):
                continue
            for rest in candidate.rests():
                if rest.node.id == element and rest.node.kind in ("user", "message") and not rest.due:
                    for name, value in (values or {}).items():
                        rest.scope.variables[name] = value
                    waiting.fire(self, rest)
                    self.stepped()
                    return
        waits = sorted({rest.node.id for item in self.instances.values() for rest in item.rests()})
        raise MissionError(f"waits for nobody; what waits: {', '.join(waits) or 'nothing'}", element=element)

    def activate(self, element: str) -> None:
        """Let an element of an ad-hoc sub-process that is open begin (once more). Raises MissionError."""
        adhoc.activate(self, element)
        self.run()

    def offers(self) -> list[str]:
        """The ids of what `activate` could let begin now."""
        return adhoc.offers(self)

    def restart(self) -> None:
        """Once, after `fame.engine.restore`: start scripts again, and let go on what waited for scripts to leave."""
        for rest in sorted(self.rests.values(), key=attrgetter("key")):
            if rest.started and rest.alive and not rest.paused:
                activities.restart(self, rest)
        self.run()

    def hold(self) -> None:
        """Suspend all instances and bring the robot to its safe state; nothing begins. `release` undoes it."""
        if self.held is None:
            suspension.hold(self)
            self.run()

    def release(self) -> None:
        """Go on after `hold`, whose scripts have to be out."""
        suspension.release(self)
        self.run()

    def stop(self) -> None:
        """Cancel all instances. They end at once; their scripts may still be leaving."""
        for key in self.armed_starts:
            self.host.cancel_timer(key)
        self.armed_starts.clear()
        self.held = None
        self.waiting_starts.clear()
        self.gathered.clear()
        for instance in tuple(self.instances.values()):
            scopes.kill(self, instance.root)
            self.departing.clear()
            self.conclude(instance, "cancelled")
        self.leaving.clear()
        self.ready.clear()
        self.host.make_safe("terminated")
        self.observe()

    # ---- the loop ------------------------------------------------------------------------------------

    def run(self) -> None:
        """Move every token until it rests."""
        ready, pop = self.ready, self.ready.popleft
        left, portion = self.limit, self.portion
        moves = repeat(None, portion)
        self.alert = bool(self.conditions)
        while True:
            while ready:
                node, scope = pop()
                if node is None:
                    waiting.deliver(self, *scope)
                    continue
                if scope.state:
                    if scope.state > 0:
                        scope.held += (node,)
                    continue
                counts = scope.counts
                for _ in moves:
                    counts[node.index] += 1
                    step = node.step  # looked up apart: CPython is slow to call what an attribute holds
                    node = step(self, scope, node)
                    if node is None:
                        break
                else:
                    left, moves = left - portion, repeat(None, portion)
                    self.observe()
                    if left > 0:
                        ready.appendleft((node, scope))
                    else:
                        self.livelock(node, scope)
                        left = self.limit
            if not (self.inclusive and gateways.decide_inclusive(self)):
                break
        if self.trail:
            self.observe()

    def livelock(self, node: Node, scope: Scope) -> None:
        """The tokens of an instance never rest: go on for a while to see over which elements, then fail it."""
        instance, ready = scope.instance, self.ready
        passes: dict[str, int] = {}
        ready.appendleft((node, scope))
        for _ in range(TRACE):
            if not ready:
                break
            follower, place = ready.popleft()
            if follower is None:
                waiting.deliver(self, *place)
            elif place.state > 0:
                place.held += (follower,)
            elif not place.state:
                if place.instance is instance and follower.step is not steps.flow:
                    passes[follower.id] = passes.get(follower.id, 0) + 1
                place.counts[follower.index] += 1
                following = follower.step(self, place, follower)
                if following is not None:
                    ready.appendleft((following, place))
        if instance.status == "running":
            loop = ", ".join(id for id, count in passes.items() if id and count > 1)
            self.abandon(instance, node, f"{self.limit} moves without rest, in a loop over {loop}", "livelock")

    # ---- observation ---------------------------------------------------------------------------------

    def tell(self, scope: Scope, mark: Mark) -> None:
        """Note that something happened; observers hear it when the stimulus has been worked off."""
        if self.place is not scope:
            self.move(scope)
        note = self.note
        note(mark)

    def move(self, scope: Scope) -> None:
        """What is noted from now on happens in that scope."""
        self.place = scope
        if not self.at_once:
            marks: list[Mark] = []
            self.trail.append((scope, marks))
            self.note = marks.append

    def observe(self) -> None:
        """Let the host have all that was noted."""
        if self.trail:
            trail, self.trail, self.place = self.trail, [], None
            self.host.observe(trail)

    def observe_mark(self, mark: Mark) -> None:
        """Let the host know of something that just happened."""
        assert self.place is not None
        self.host.observe([(self.place, [mark])])

    # ---- instances -----------------------------------------------------------------------------------

    def new_key(self) -> int:
        """Identities come from one counter."""
        self.counter += 1
        return self.counter

    def open_instance(self, entry: Node, values: dict[str, Any] | None) -> Instance:
        """Make an instance and put its first token at `entry`."""
        variables = self.new_variables()
        variables.update(values or {})
        instance = Instance(self.new_key(), self.program, variables)
        root = Scope(self.new_key(), None, None, self.program.body, variables)
        root.instance, root.counts, instance.root, instance.scopes = instance, instance.counts, root, 1
        self.instances[instance.key] = instance
        self.host.begun(instance)
        if self.program.observed:
            self.tell(root, (self.program.process, "start", None))
        self.ready.append((entry, root))
        scopes.open_scope(self, root)
        return instance

    def conclude(self, instance: Instance, status: Status) -> None:
        """An instance is over; the oldest trigger that waited for its end takes its place."""
        instance.status = status
        self.instances.pop(instance.key, None)
        if self.program.observed:
            self.tell(instance.root, (self.program.process, "end", status))
        self.host.ended(instance)
        if self.waiting_starts:
            starts.begin_waiting(self)

    def abandon(self, instance: Instance, node: Node, text: str, code: str, cause: BaseException | None = None) -> None:
        """An instance failed: nothing caught its error."""
        instance.error = MissionError(text, element=node.id, file=node.file, line=node.line, code=code)
        instance.error.__cause__ = cause
        scopes.tell_cancelled(self, instance.root)
        last = scopes.replace(self, instance.root, ())
        self.host.make_safe("failed")
        scopes.proceed(self, steps.FAILED, last)

    def check_conditions(self) -> None:
        """Variables changed: look at the armed conditional events."""
        waiting.check_conditions(self)
