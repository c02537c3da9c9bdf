"""The states of a whole team: the robots' local states and the messages under way, breadth first.

A state of the team is one integer: a field for each robot's local state, one for a fault, a bit for each pool that has
to start (1 once it has), above them the number of what the network holds. All transitions of a robot are tables from
`Local`, so that a step of the team is a few additions.

Delivery (`Options.delivery`)::

    run   a message reaches all its receivers at once, in the order of sending, as in `fame run`
    fast  messages arrive in any order, but before anything that takes time
    any   messages arrive whenever they like

In a `bag` network a message waits until its receiver listens.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise, permutations
from typing import Literal

from fame.check.explore.graph import Explored
from fame.check.explore.local import Local, Stimulus, Way
from fame.check.explore.network import Kind, Network, Sent
from fame.engine.snapshot import Data

BITS = 20
MASK = (1 << BITS) - 1
DEAD = MASK
"""The local state of a robot whose engine has died."""
FAULT_BITS = 10
FAULTS = (1 << FAULT_BITS) - 1

MOST_IN_CASCADE = 200
"""Deliveries that one step may lead to at once."""
MOST_ORDERS = 24
"""Orders in which equal robots answer one message."""

Delivery = Literal["run", "fast", "any"]


class Move:
    """A way that a robot may go, ready to be added to a state of the team.

    difference  of the team's state, without what is sent
    sending     number of what is sent, 0 for nothing
    mark        the bit of its pool, if it starts an instance of one that has to start
    flags       what to report, once; None if that is done
    failed      whether an error was not caught in it
    ends        differences to where the robot is after further steps of its own, see `Reduction.ends`; None if unknown
    """

    mark: int
    sending: int
    state: int
    stimulus: Stimulus
    way: Way

    __slots__ = ("difference", "ends", "failed", "flags", "mark", "sending", "state", "stimulus", "way")

    def __init__(self, robot: int, old: int, way: Way, sending: int, stimulus: Stimulus, mark: int = 0) -> None:
        self.mark = mark
        self.difference: int = (way.state - old) << (robot * BITS)
        self.sending, self.state, self.stimulus, self.way = sending, way.state, stimulus, way
        self.flags = way.flags or None
        self.failed: bool = any(kind == "error" for kind, _ in way.flags)
        self.ends: tuple[int, ...] | None = None


Reactions = tuple[tuple[int, Move], ...]
"""What the receivers of a message did, at once: (robot, move)."""


class Message:
    """A message that is delivered at once.

    mask      the bits of its receivers in a state of the team
    arrivals  what comes of it, by these bits
    """

    __slots__ = ("arrivals", "mask", "number", "origin", "receivers", "topic")

    def __init__(self, origin: int, topic: str, number: int, receivers: tuple[int, ...]) -> None:
        self.origin, self.topic, self.number, self.receivers = origin, topic, number, receivers
        self.mask: int = sum(MASK << (receiver * BITS) for receiver in receivers)
        self.arrivals: dict[int, list[_Arrival]] = {}


_Queue = tuple[Message, ...]
_Arrival = tuple[int, int, Reactions, _Queue]
"""What comes of a message: difference of the state, marks, moves of the receivers, their answers."""
_Pending = tuple[tuple[str, tuple[int, ...]], ...]
"""Messages on their way to one robot: (topic, message numbers) of each channel."""
_Spreading = tuple[int, _Queue, Reactions, int]
"""A delivery at once, in its course: state, messages to come with their senders, what was done, deliveries so far."""
Transition = tuple[int, int, Move, Reactions]
"""(new state, robot, its move, moves of others that follow at once)"""
Fault = tuple[str, ...]
"""A fault: (``engine``, robot), (``message``, topic, receiver) or (``behaviour``, robot, element, code or "")."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """How the product is explored.

    groups    places of robots that nothing tells apart
    required  for each pool of which one robot has to start, but none does by itself: the places of its robots
    given     snapshots of the robots that do not start, but go on, by place
    """

    delivery: Delivery = "run"
    network: Kind = "fifo"
    reduced: bool = True
    faults: bool = False
    limit: int = 200_000
    groups: tuple[tuple[int, ...], ...] = ()
    required: tuple[tuple[int, ...], ...] = ()
    given: Mapping[int, Data] = field(default_factory=dict)
    stop: Callable[[], bool] = lambda: False


@dataclass(slots=True)
class Seen:
    """The first occurrence of something: the state before, the robot and its move, and what followed."""

    at: int
    transition: Transition | None


class Product:
    """A team and its network. `explore` finds the states, `flags` what happened on the way for the first time."""

    options: Options
    network: Network

    def __init__(self, robots: Sequence[str], locals: Sequence[Local], options: Options) -> None:
        self.robots, self.locals, self.options = tuple(robots), tuple(locals), options
        self.count: int = len(self.robots)
        self.fault_shift: int = self.count * BITS
        self.mark_shift: int = self.fault_shift + FAULT_BITS
        self.top: int = self.mark_shift + len(options.required)
        self.marked: int = (1 << len(options.required)) - 1
        self.marks: dict[int, int] = {
            robot: 1 << (self.mark_shift + place) for place, pool in enumerate(options.required) for robot in pool
        }
        self.hearers: dict[tuple[int, str], tuple[int, ...]] = {}
        self.flags: dict[tuple[str, int, str], Seen] = {}
        self.faults: list[Fault] = [()]
        self.network = Network(options.network, self.receivers)
        self._own: list[dict[int, tuple[Move, ...]]] = [{DEAD: ()} for _ in self.robots]
        self._hears: list[dict[tuple[int, str, int], tuple[Move, ...]]] = [{} for _ in self.robots]
        self._alone: list[dict[int, tuple[Move, ...] | None]] = [{DEAD: None} for _ in self.robots]
        self.add_faults: Callable[[int, list[Transition]], None] = lambda state, found: None
        self.reduction: Callable[[int, int], tuple[Move, ...]] | None = None
        self.shortcuts: Callable[[int, int], tuple[int, ...]] | None = None
        self._ends_at: list[dict[int, tuple[int, ...]]] = [{} for _ in self.robots]
        self.path: Callable[[int, int, int], list[Move]] = lambda robot, state, end: []
        self._index: dict[int, int] = {}
        self._firsts: dict[int, _Queue] = {}
        self._answering: dict[tuple[int, int, _Pending], bool] = {}
        self._messages: dict[tuple[int, tuple[str, int, str]], Message] = {}

    # ---- tables --------------------------------------------------------------------------------------

    def own(self, robot: int, state: int) -> tuple[Move, ...]:
        """What a robot may do by itself in a local state."""
        found = self._own[robot].get(state)
        if found is None:
            local = self.locals[robot]
            found = self._own[robot][state] = tuple(
                move
                for stimulus in local.views[state].own
                for move in self.moves(robot, state, stimulus, local.step(state, stimulus))
            )
        return found

    def receive(self, robot: int, state: int, topic: str, message: int) -> tuple[Move, ...]:
        """What a message does to a robot."""
        key = (state, topic, message)
        found = self._hears[robot].get(key)
        if found is None:
            stimulus = ("hear", topic, message)
            ways = self.locals[robot].step(state, stimulus) if state != DEAD else (Way(DEAD, (), (), False),)
            found = self._hears[robot][key] = self.moves(robot, state, stimulus, ways)
        return found

    def moves(self, robot: int, state: int, stimulus: Stimulus, ways: Sequence[Way]) -> tuple[Move, ...]:
        mark = self.marks.get(robot, 0)
        return tuple(
            Move(robot, state, way, self.network.sending(robot, way.sent), stimulus, mark if way.begins else 0)
            for way in ways
        )

    def receivers(self, sender: int, topic: str, only: str = "") -> tuple[int, ...]:
        """The robots that take messages on a topic at some time."""
        found = self.hearers.get((sender, topic))
        if found is None:
            others = (robot for robot in range(self.count) if robot != sender)
            found = self.hearers[sender, topic] = tuple(r for r in others if topic in self.locals[r].topics)
        return tuple(robot for robot in found if self.robots[robot] == only) if only else found

    # ---- transitions ---------------------------------------------------------------------------------

    def transitions(self, state: int) -> list[Transition]:
        """All transitions from a state; fewer if others need not be looked at."""
        network = state >> self.top
        found: list[Transition] = []
        if network:
            self._arrivals(state, network, found)
            if found and self.options.delivery == "fast":
                return self._first_arrivals(state, found) if self.reduction is not None else found
        if self.reduction is not None:
            few = self._reduced(state)
            if few is not None:
                return few
        sync = self.options.delivery == "run"
        rest, own, push, top = state, self._own, self.network.push, self.top
        for robot in range(self.count):
            old = rest & MASK
            rest >>= BITS
            moves = own[robot].get(old)
            for move in self.own(robot, old) if moves is None else moves:
                new = state + move.difference | move.mark
                if not move.sending:
                    found.append((new, robot, move, ()))
                elif sync:
                    found += [(after, robot, move, reactions) for after, reactions in self.spread(new, move.sending)]
                else:
                    found.append((new + (push(network, move.sending) << top), robot, move, ()))
        return found

    def _arrivals(self, state: int, network: int, found: list[Transition]) -> None:
        """Messages arrive."""
        bag = self.options.network == "bag"
        for receiver, topic, message, less in self.network.heads(network):
            old = state >> (receiver * BITS) & MASK
            if bag and old != DEAD and topic not in self.locals[receiver].views[old].listens:
                continue
            for move in self.receive(receiver, old, topic, message):
                new = state + (less << self.top) + move.difference | move.mark
                if move.sending:
                    new += self.network.push(new >> self.top, move.sending) << self.top
                found.append((new, receiver, move, ()))

    def _first_arrivals(self, state: int, found: list[Transition]) -> list[Transition]:
        """The arrivals at one robot, if those at others lead to no more messages, and lead to states not yet explored.

        Nothing but arrivals happens now, so robots that send nothing in them may as well receive their messages later.
        """
        waiting: dict[int, _Pending] = {}
        for (_, topic, receiver), messages in self.network.content(state >> self.top):
            waiting[receiver] = (*waiting.get(receiver, ()), (topic, messages))
        if len(waiting) < 2:
            return found
        answering = [one for one, all in waiting.items() if self._answers(one, state >> (one * BITS) & MASK, all)]
        if len(answering) > 1:
            return found
        first = answering[0] if answering else found[0][1]
        chosen = [one for one in found if one[1] == first]
        at, index = self._index[state], self._index
        ahead = all(index.get(self.canonical(one[0]), len(index)) > at for one in chosen)
        return chosen if ahead else found

    def _answers(self, robot: int, old: int, waiting: _Pending) -> bool:
        """Whether a robot may send something as these messages arrive, in any order of their channels."""
        key = (robot, old, waiting)
        found = self._answering.get(key)
        if found is None:
            found = False
            for place, (topic, messages) in enumerate(waiting):
                left = ((topic, messages[1:]),) if len(messages) > 1 else ()
                rest = (*waiting[:place], *left, *waiting[place + 1 :])
                moves = self.receive(robot, old, topic, messages[0])
                if any(move.sending or self._answers(robot, move.state, rest) for move in moves):
                    found = True
                    break
            self._answering[key] = found
        return found

    def _reduced(self, state: int) -> list[Transition] | None:
        """The moves of one robot that no other can influence or notice, if they lead to states not yet explored."""
        rest, index = state, self._index
        at = index[state]
        for robot in range(self.count):
            old = rest & MASK
            rest >>= BITS
            table = self._alone[robot]
            if old in table:
                moves = table[old]
            else:
                assert self.reduction is not None
                moves = table[old] = self.reduction(robot, old) or None
            if moves is not None:
                found: list[Transition] = [(state + move.difference | move.mark, robot, move, ()) for move in moves]
                ahead = [index.get(self.canonical(one[0]), len(index)) for one in found if one[0] != state]
                if ahead and min(ahead) > at:
                    return found
        return None

    def spread(self, state: int, sending: int, lost: int = -1) -> list[tuple[int, Reactions]]:
        """Deliver at once what was sent and what follows, in the order of sending; one delivery may be lost."""
        first = self._firsts.get(sending)
        if first is None:
            sender, sent = self.network.sent[sending]
            first = self._firsts[sending] = self._sent_by(sender, sent)
        done: list[tuple[int, Reactions]] = []
        pending: list[_Spreading] = [(state, first, (), 0)]
        while pending:
            state, queue, reactions, deliveries = pending.pop()
            head, rest = queue[0], queue[1:]
            found = head.arrivals.get(state & head.mask) if lost < 0 else None
            if found is None:
                found = self._delivered(state, head, lost - deliveries)
                if lost < 0:
                    head.arrivals[state & head.mask] = found
            deliveries += len(head.receivers)
            for difference, mark, added, answer in found:
                after, more = state + difference | mark, rest + answer if answer else rest
                if not more:
                    done.append((after, reactions + added))
                elif deliveries > MOST_IN_CASCADE:
                    self.network.piles.add((more[0].origin, more[0].topic, more[0].receivers[0]))
                else:
                    pending.append((after, more, reactions + added, deliveries))
        return done

    def _sent_by(self, sender: int, sent: Sent) -> _Queue:
        """The messages that a robot sends."""
        found = []
        for one in sent:
            message = self._messages.get((sender, one))
            if message is None:
                topic, number, only = one
                made = Message(sender, topic, number, self.receivers(sender, topic, only))
                message = self._messages[sender, one] = made
            found.append(message)
        return tuple(found)

    def _delivered(self, state: int, message: Message, lost: int) -> list[_Arrival]:
        """A message reaches all its receivers but the one with number `lost`: what may come of it.

        The local states of the receivers alone decide.
        """
        branches: list[tuple[int, int, Reactions, tuple[tuple[int, int], ...]]] = [(0, 0, (), ())]
        for place, receiver in enumerate(message.receivers):
            if place == lost:
                continue
            grown = []
            moves = self.receive(receiver, state >> (receiver * BITS) & MASK, message.topic, message.number)
            for difference, mark, reactions, answers in branches:
                for move in moves:
                    more = (*answers, (receiver, move.sending)) if move.sending else answers
                    grown.append((difference + move.difference, mark | move.mark, (*reactions, (receiver, move)), more))
            branches = grown
        return [
            (difference, mark, reactions, self._answer(order))
            for difference, mark, reactions, answers in branches
            for order in self._orders(answers)
        ]

    def _answer(self, answers: tuple[tuple[int, int], ...]) -> _Queue:
        """What receivers send, in the order in which they answer."""
        return tuple(one for robot, number in answers for one in self._sent_by(robot, self.network.sent[number][1]))

    def _orders(self, answers: tuple[tuple[int, int], ...]) -> Iterator[tuple[tuple[int, int], ...]]:
        """The orders in which receivers answer: that of the robots, and any other of robots that are alike."""
        yield answers
        if len(answers) < 2 or not self.options.groups:
            return
        for group in self.options.groups:
            places = [place for place, (robot, _) in enumerate(answers) if robot in group]
            if len(places) < 2:
                continue
            for number, order in enumerate(permutations(places)):
                if number >= MOST_ORDERS:
                    break
                if number:
                    changed = list(answers)
                    for place, other in zip(places, order, strict=True):
                        changed[place] = answers[other]
                    yield tuple(changed)

    # ---- steps that no other robot notices -----------------------------------------------------------

    def settled(self, transition: Transition) -> Sequence[int]:
        """The states to which a transition leads once the robots have gone on as far as nobody notices."""
        new, robot, move, reactions = transition
        if self.shortcuts is None:
            return (new,)
        if not reactions and move.stimulus[0] != "hear":
            if move.sending and new >> self.top and self.options.delivery == "fast":
                return (new,)
            ends = self._ends(robot, move)
            return [new + difference for difference in ends] if ends else (new,)
        if new >> self.top and self.options.delivery == "fast":  # messages arrive before anybody goes on
            return (new,)
        found, rest = [new], new
        for one, table in enumerate(self._ends_at):
            old = rest & MASK
            rest >>= BITS
            known = table.get(old)
            if known is None:
                known = table[old] = self.shortcuts(one, old)
            if known:
                found = [state + ((end - old) << (one * BITS)) for state in found for end in known]
        return found

    def _ends(self, robot: int, move: Move) -> tuple[int, ...]:
        if move.ends is None:
            assert self.shortcuts is not None
            old = move.state
            move.ends = tuple((end - old) << (robot * BITS) for end in self.shortcuts(robot, old))
        return move.ends

    def between(self, state: int, end: int) -> Iterator[Transition]:
        """The transitions from a state to one to which the robots have gone on from there, see `settled`."""
        for robot in range(self.count):
            old, new = (one >> (robot * BITS) & MASK for one in (state, end))
            for move in self.path(robot, old, new) if old != new else ():
                state += move.difference
                yield state, robot, move, ()

    def number(self, state: int) -> int | None:
        """The number of an explored state, in which equal robots may stand in another order."""
        return self._index.get(self.canonical(state))

    # ---- equal robots --------------------------------------------------------------------------------

    def canonical(self, state: int) -> int:
        """The same state with robots that nothing tells apart in the order of their local states."""
        for group in self.options.groups:
            order = self.order(state, group)
            if order is not None:
                state = self.permuted(state, group, order)
        return state

    def order(self, state: int, group: tuple[int, ...]) -> tuple[int, ...] | None:
        """The places of a group in the order of what they are at; None if they are in order."""
        found = [state >> (robot * BITS) & MASK for robot in group]
        if not state >> self.top:
            if all(first <= second for first, second in pairwise(found)):
                return None
            return tuple(sorted(range(len(group)), key=found.__getitem__))
        content = self.network.content(state >> self.top)
        inside = set(group)

        def signature(place: int) -> tuple[int, str]:
            robot = group[place]
            parts = [
                (topic, -1 if sender in inside else sender, -1 if receiver in inside else receiver,
                 receiver == robot, messages)
                for (sender, topic, receiver), messages in content
                if robot in (sender, receiver)
            ]  # fmt: skip
            return found[place], repr(sorted(parts))

        order = tuple(sorted(range(len(group)), key=signature))
        return None if order == tuple(range(len(group))) else order

    def permuted(self, state: int, group: tuple[int, ...], order: tuple[int, ...]) -> int:
        """The state in which the robot at `order[k]` of the group has taken place k."""
        found = [state >> (robot * BITS) & MASK for robot in group]
        network = state >> self.top
        for place, robot in enumerate(group):
            state += (found[order[place]] - found[place]) << (robot * BITS)
        if network:
            places = {group[old]: group[new] for new, old in enumerate(order)}
            state += (self.network.renamed(network, places) - network) << self.top
        return state

    # ---- the search ----------------------------------------------------------------------------------

    def initial(self) -> list[Transition]:
        """The states in which all robots have started: before the first delivery all of them have."""
        starts: list[tuple[int, Reactions]] = [(0, ())]
        for robot, local in enumerate(self.locals):
            ways = self.moves(robot, 0, ("start", None, None), local.start(self.options.given.get(robot)))
            starts = [
                (state + move.difference | move.mark, (*reactions, (robot, move)))
                for state, reactions in starts
                for move in ways
            ]
        found: list[Transition] = []
        for state, reactions in starts:
            worlds: list[tuple[int, Reactions]] = [(state, reactions)]
            for _, move in reactions:
                if move.sending and self.options.delivery == "run":
                    worlds = [(after, (*so_far, *more)) for before, so_far in worlds
                              for after, more in self.spread(before, move.sending)]  # fmt: skip
                elif move.sending:
                    push, top = self.network.push, self.top
                    worlds = [(one + (push(one >> top, move.sending) << top), reactions) for one, reactions in worlds]
            found += [
                (after, all_reactions[0][0], all_reactions[0][1], all_reactions[1:]) for after, all_reactions in worlds
            ]
        return found

    def explore(self) -> Explored:
        """Find all states, breadth first, within the limit."""
        options, explored, index = self.options, Explored(), self._index
        states, parents, targets, offsets = explored.states, explored.parents, explored.targets, explored.offsets
        sorts, shortens = self.canonical if options.groups else None, self.shortcuts is not None
        for transition in self.initial():
            if self._report(-1, transition):
                continue
            for state in self.settled(transition):
                state = sorts(state) if sorts else state
                if state not in index:
                    index[state] = len(states)
                    states.append(state)
                    parents.append(-1)
        at = 0
        while at < len(states):
            if len(states) > options.limit or (not at & 255 and options.stop()):
                explored.cut = "states" if len(states) > options.limit else "seconds"
                break
            found = self.transitions(states[at])
            if options.faults:
                if states[at] >> self.fault_shift & FAULTS:
                    found = [transition for transition in found if not _is_failure(transition)]
                else:
                    self.add_faults(states[at], found)
            for transition in found:
                _, _, move, reactions = transition
                if (move.flags is not None or reactions or move.failed) and self._report(at, transition):
                    continue
                for new in self.settled(transition) if shortens else (transition[0],):
                    state = sorts(new) if sorts else new
                    number = index.get(state)
                    if number is None:
                        number = index[state] = len(states)
                        states.append(state)
                        parents.append(at)
                    elif number == at and move.stimulus[0] not in ("outside", "hear"):
                        explored.loops.append(at)
                    targets.append(number)
            offsets.append(len(targets))
            explored.transitions += len(found)
            if self.is_final(states[at]):
                explored.final.append(at)
            elif not found:
                explored.stuck.append(at)
            at += 1
        return explored

    def _report(self, at: int, transition: Transition) -> bool:
        """Note what a transition reports for the first time. Whether it ends in an error that nobody catches."""
        _, robot, move, reactions = transition
        failed = False
        for one, done in ((robot, move), *reactions):
            if done.flags is not None:
                for kind, what in done.flags:
                    self.flags.setdefault((kind, one, what), Seen(at, transition))
                done.flags = None
            failed |= done.failed
        return failed and not transition[0] >> self.fault_shift & FAULTS

    def is_final(self, state: int) -> bool:
        """Whether every instance has ended, and no message is under way."""
        if state >> self.top and self.options.network == "fifo":
            return False
        for robot in range(self.count):
            old = state & MASK
            state >>= BITS
            if old != DEAD and self.locals[robot].views[old].instances:
                return False
        return True

    def locals_of(self, state: int) -> list[int]:
        """The local state of each robot."""
        return [state >> (robot * BITS) & MASK for robot in range(self.count)]

    def fault_of(self, state: int) -> Fault:
        """The fault that has happened, () for none."""
        return self.faults[state >> self.fault_shift & FAULTS]


def _is_failure(transition: Transition) -> bool:
    """Whether a step fails by itself, and nothing catches that: a second fault."""
    _, _, move, _ = transition
    kind, _, code = move.stimulus
    return move.failed and kind == "end" and code is not None
