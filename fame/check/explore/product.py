"""The product of robots and network: what may happen in each state of a team.

All transitions of a robot are tables from `Local`, so that a step of the team is a few additions
(`fame.check.explore.transitions`).

Delivery (`Options.delivery`)::

    run   a message reaches all its receivers at once, in the order of sending, as in `fame run`
    fast  messages arrive in any order, but before anything that takes time
    any   messages arrive whenever they like
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from typing import TYPE_CHECKING, Literal

from fame.check.explore.broadcast import Broadcast
from fame.check.explore.host import SUPPOSED, never
from fame.check.explore.local import Local, Successor
from fame.check.explore.network import BEYOND, NetworkContents
from fame.check.explore.stimuli import Stimulus
from fame.check.explore.symmetry import Symmetry
from fame.check.explore.transitions import (
    BITS,
    CUT,
    DEAD,
    FAULT_BITS,
    FAULTS,
    MASK,
    MONITOR_BITS,
    MONITORED,
    THROWN,
    Move,
    Reactions,
    Seen,
    Transition,
    is_observed,
)
from fame.dataclasses import dataclass, field
from fame.engine.encoding import Data

if TYPE_CHECKING:
    from fame.check.explore.properties import Monitors

Delivery = Literal["run", "fast", "any"]
SingleFault = tuple[str, ...]
"""A fault: (``engine``, robot), (``message`` or ``expiry``, topic, receiver) or (``behaviour``, robot, element, code or
"")."""


def silent(states: int, frontier: int) -> None:
    """Show no progress."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """How the product is explored.

    groups    places of robots that nothing tells apart
    required  for each pool of which one robot has to start, but none does by itself: the places of its robots
    monitors  the properties that are judged
    acknowledged  topics whose signals are not lost, but may expire
    unhandled  services, actions and scripts fail, too, where nothing catches that
    given     snapshots of the robots that do not start, but go on, by place
    progress  called with the number of states, and of those that are still to be explored (the frontier)
    """

    delivery: Delivery = "run"
    reduced: bool = True
    faults: bool = False
    unhandled: bool = False
    limit: int = 200_000
    groups: tuple[tuple[int, ...], ...] = ()
    required: tuple[tuple[int, ...], ...] = ()
    monitors: Monitors | None = None
    acknowledged: frozenset[str] = frozenset()
    given: Mapping[int, Data] = field(default_factory=dict)
    stop: Callable[[], bool] = never
    progress: Callable[[int, int], object] = silent


class Product:
    """A team and its network.

    index           the number of each state that the search has found
    flags           what happened on the way for the first time: by kind, robot and detail
    alone           the few transitions of a state that are enough, None if all are needed (`Reduction.alone`)
    first_arrivals  those of its arrivals that are enough
    settled         the states to which a transition leads once robots have taken all steps that no other one notices
    between         the transitions on the way to one of them
    cut             whether a step was met that leads to states which are not explored
    further_faults  whether there are more faults than numbers: what follows on the others is not explored
    certain         (robot, element) of errors that nothing catches and no unknown value decides
    """

    robots: tuple[str, ...]
    locals: tuple[Local, ...]
    cut: bool
    further_faults: bool
    options: Options
    network: NetworkContents

    def __init__(self, robots: Sequence[str], locals: Sequence[Local], options: Options) -> None:
        self.robots, self.locals, self.options = tuple(robots), tuple(locals), options
        self.count: int = len(self.robots)
        self.fault_shift: int = self.count * BITS
        self.mark_shift: int = self.fault_shift + FAULT_BITS
        self.monitor_shift: int = self.mark_shift + len(options.required)
        self.top: int = self.monitor_shift + (MONITOR_BITS if options.monitors is not None else 0)
        self._watched: Set[str] = options.monitors.thrown if options.monitors is not None else frozenset()
        self.marks: dict[int, int] = {
            robot: 1 << (self.mark_shift + place) for place, pool in enumerate(options.required) for robot in pool
        }
        self.hearers: dict[tuple[int, str], tuple[int, ...]] = {}
        self.faults: list[SingleFault] = [()]
        self.network = NetworkContents(self.receivers)
        self.broadcast: Broadcast = Broadcast(self.network, self.receivers, self.receive, options.groups)
        self.symmetry: Symmetry = Symmetry(
            options.groups, self.network, self.top, self._exchanged if options.monitors is not None else None
        )
        self.index: dict[int, int] = {}
        self.flags: dict[tuple[str, int, str], Seen] = {}
        self._own: list[dict[int, tuple[Move, ...]]] = [{DEAD: (), CUT: ()} for _ in self.robots]
        self._hears: list[dict[tuple[int, str, int], tuple[Move, ...]]] = [{} for _ in self.robots]
        self.add_faults: Callable[[int, list[Transition]], None] = lambda state, found: None
        self.alone: Callable[[int], list[Transition] | None] | None = None
        self.first_arrivals: Callable[[int, list[Transition]], list[Transition]] | None = None
        self.settled: Callable[[Transition], Sequence[int]] | None = None
        self.between: Callable[[int, int], Iterator[Transition]] | None = None
        self.cut = self.further_faults = False
        self.certain: set[tuple[int, str]] = set()

    def own(self, robot: int, state: int) -> tuple[Move, ...]:
        """Return what a robot may do by itself in a local state."""
        moves = self._own[robot].get(state)
        if moves is None:
            local = self.locals[robot]
            view, all_codes = local.views[state], self.options.faults or self.options.unhandled
            moves = self._own[robot][state] = tuple(
                move
                for stimulus, element in zip(view.own, view.elements, strict=True)
                if all_codes or (element, stimulus[2]) not in local.unhandled
                for move in self.moves(robot, state, stimulus, local.step(state, stimulus))
            )
        return moves

    def receive(self, robot: int, state: int, topic: str, message: int) -> tuple[Move, ...]:
        """Return what a message does to a robot."""
        key = (state, topic, message)
        moves = self._hears[robot].get(key)
        if moves is None:
            stimulus = ("hear", topic, message)
            ways = self.locals[robot].step(state, stimulus) if state < CUT else (Successor(state, (), (), False),)
            moves = self._hears[robot][key] = self.moves(robot, state, stimulus, ways)
        return moves

    def moves(self, robot: int, state: int, stimulus: Stimulus, ways: Sequence[Successor]) -> tuple[Move, ...]:
        mark = self.marks.get(robot, 0)
        if stimulus[0] == "outside" and stimulus[1] in self._watched:
            ways = [way._replace(events=((stimulus[1], THROWN, None), *way.events)) for way in ways]
        if not self.options.unhandled:
            ways = [way for way in ways if all(kind != SUPPOSED for kind, _ in way.flags)]
        moves = tuple(
            Move(robot, state, way, self.network.sending(robot, way.sent), stimulus, mark if way.begins else 0)
            for way in ways
        )
        self.cut |= any(way.state == CUT for way in ways)
        chosen = stimulus[0] == "end" and stimulus[2] is not None  # a behaviour may raise it, or may not
        unsure = any(kind == "unsure" for way in ways for kind, _ in way.flags)
        if not chosen and not unsure and all(move.failed for move in moves):
            for move in moves:
                move.certain = True
        return moves

    def receivers(self, sender: int, topic: str, only: str = "") -> tuple[int, ...]:
        """Return the robots that take messages on a topic at some time."""
        receivers = self.hearers.get((sender, topic))
        if receivers is None:
            others = (robot for robot in range(self.count) if robot != sender)
            receivers = self.hearers[sender, topic] = tuple(r for r in others if topic in self.locals[r].topics)
        return tuple(robot for robot in receivers if self.robots[robot] == only) if only else receivers

    def transitions(self, state: int) -> list[Transition]:
        """Return all transitions from a state; fewer if others need not be looked at."""
        network = state >> self.top
        transitions: list[Transition] = []
        if network:
            self._arrivals(state, network, transitions)
            if transitions and self.options.delivery == "fast":
                transitions = self._judged(transitions)
                return self.first_arrivals(state, transitions) if self.first_arrivals is not None else transitions
            transitions = self._judged(transitions)
        if self.alone is not None:
            few = self.alone(state)
            if few is not None:
                return few
        rest, own = state, self._own
        for robot in range(self.count):
            old = rest & MASK
            rest >>= BITS
            if own[robot].get(old, True):
                transitions += self.moved(state, robot, old)
        return transitions

    def moved(self, state: int, robot: int, old: int) -> list[Transition]:
        """Return the transitions of a state in which a robot, whose local state is `old`, does something by itself."""
        transitions: list[Transition] = []
        for move in self.own(robot, old):
            if self._watched and move.stimulus[0] == "outside" and not self._throws(state, robot, move.stimulus[1]):
                continue
            new = state + move.difference | move.mark
            if not move.sending:
                transitions.append((new, robot, move, ()))
            elif self.options.delivery == "run":
                spread = self.broadcast.spread(new, (move.sending,))
                transitions += [(after, robot, move, reactions) for after, reactions in spread]
            else:
                transitions.append(
                    (new + (self.network.push(state >> self.top, move.sending) << self.top), robot, move, ())
                )
        return self._judged(transitions)

    def _judged(self, transitions: list[Transition]) -> list[Transition]:
        """The transitions, with what properties make of the events in them."""
        return transitions if self.options.monitors is None else [self.judged(transition) for transition in transitions]

    def judged(self, transition: Transition) -> Transition:
        """Return a transition, with what properties make of its events: those of its robot, then
        those of the others."""
        monitors, (state, robot, move, reactions) = self.options.monitors, transition
        if monitors is None or not is_observed(transition):
            return transition
        before = number = self.monitored(state)
        for mover, done in ((robot, move), *reactions):
            if done.successor.events:
                number = monitors.step(number, mover, done.successor.events)
        number = monitors.read(number)
        return state + ((number - before) << self.monitor_shift), robot, move, reactions

    def _throws(self, state: int, robot: int, topic: str) -> bool:
        assert self.options.monitors is not None
        return self.options.monitors.throws(self.monitored(state), robot, topic)

    def monitored(self, state: int) -> int:
        """Return the number of the joint state of the properties."""
        return state >> self.monitor_shift & MONITORED if self.options.monitors is not None else 0

    def _exchanged(self, state: int, places: Mapping[int, int]) -> int:
        """The difference of a state in the properties when equal robots change places."""
        assert self.options.monitors is not None
        number = self.monitored(state)
        return (self.options.monitors.renamed(number, places) - number) << self.monitor_shift

    def _arrivals(self, state: int, network: int, transitions: list[Transition]) -> None:
        """Messages arrive."""
        for receiver, topic, message, less in self.network.heads(network):
            old = state >> (receiver * BITS) & MASK
            for move in self.receive(receiver, old, topic, message):
                new = state + (less << self.top) + move.difference | move.mark
                if move.sending:
                    new += self.network.push(new >> self.top, move.sending) << self.top
                transitions.append((new, receiver, move, ()))

    def initial(self) -> list[Transition]:
        """Return the states in which all robots have started: before the first delivery all of them have.

        At once (``run``) arrives first what they have sent at their start, then what follows from it.
        """
        starts: list[tuple[int, Reactions]] = [(0, ())]
        for robot, local in enumerate(self.locals):
            ways = self.moves(robot, 0, ("start", None, None), local.start(self.options.given.get(robot)))
            starts = [
                (state + move.difference | move.mark, (*reactions, (robot, move)))
                for state, reactions in starts
                for move in ways
            ]
        transitions: list[Transition] = []
        for state, reactions in starts:
            sendings = [move.sending for _, move in reactions if move.sending]
            spread: list[tuple[int, Reactions]] = [(state, ())]
            if sendings and self.options.delivery == "run":
                spread = self.broadcast.spread(state, sendings)
            elif sendings:
                for sending in sendings:
                    state += self.network.push(state >> self.top, sending) << self.top
                spread = [(state, ())]
            transitions += [(after, *reactions[0], (*reactions[1:], *more)) for after, more in spread]
        return self._judged(transitions)

    def number(self, state: int) -> int | None:
        """Return the number of an explored state, in which equal robots may stand in another order."""
        return self.index.get(self.symmetry.canonical(state))

    def is_final(self, state: int) -> bool:
        """Return whether every instance has ended, and no message is under way."""
        if state >> self.top:
            return False
        for robot in range(self.count):
            old = state & MASK
            state >>= BITS
            if old != DEAD and self.locals[robot].views[old].instances:
                return False
        return True

    def is_cut(self, state: int) -> bool:
        """Return whether a state is one of those that are not explored."""
        beyond = state >> self.top == BEYOND or state >> self.fault_shift & FAULTS == FAULTS
        return beyond or CUT in self.locals_of(state)

    def locals_of(self, state: int) -> list[int]:
        return [state >> (robot * BITS) & MASK for robot in range(self.count)]

    def fault_of(self, state: int) -> SingleFault:
        """Return the fault that has happened, () for none."""
        return self.faults[state >> self.fault_shift & FAULTS]
