"""Delivery at once (``run``): a message reaches all its receivers, then their answers do, in the order of sending.

What comes of a message depends on the local states of its receivers alone, so it is computed once for each of them.
Equal robots may answer a message in any order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import permutations

from fame.check.explore.network import NetworkContents, Receivers, Sent
from fame.check.explore.transitions import BITS, CUT, MASK, Move, Reactions

MOST_IN_CASCADE = 200
"""Deliveries that one step may lead to at once."""
MOST_ORDERS = 24
"""Orders in which equal robots answer one message."""


class ImmediateMessage:
    """A message that is delivered at once.

    mask      the bits of its receivers in a state of the team
    arrivals  what comes of it, by these bits
    """

    origin: int
    topic: str
    number: int
    receivers: tuple[int, ...]

    __slots__ = ("arrivals", "mask", "number", "origin", "receivers", "topic")

    def __init__(self, origin: int, topic: str, number: int, receivers: tuple[int, ...]) -> None:
        self.origin, self.topic, self.number, self.receivers = origin, topic, number, receivers
        self.mask: int = sum(MASK << (receiver * BITS) for receiver in receivers)
        self.arrivals: dict[int, list[_Arrival]] = {}


_Queue = tuple[ImmediateMessage, ...]
_Arrival = tuple[int, int, Reactions, _Queue]
"""What comes of a message: difference of the state, marks, moves of the receivers, their answers."""
_Spreading = tuple[int, _Queue, Reactions, int]
"""A delivery at once, in its course: state, messages to come with their senders, what was done, deliveries so far."""


class Broadcast:
    """Delivers at once what is sent in a network.

    receivers  the robots that take messages of a robot on a topic
    receive    the moves of a robot in a local state as a message on a topic reaches it
    groups     places of robots that nothing tells apart
    """

    network: NetworkContents
    receivers: Receivers
    receive: Callable[[int, int, str, int], tuple[Move, ...]]
    groups: Sequence[tuple[int, ...]]

    def __init__(
        self,
        network: NetworkContents,
        receivers: Receivers,
        receive: Callable[[int, int, str, int], tuple[Move, ...]],
        groups: Sequence[tuple[int, ...]],
    ) -> None:
        self.network, self.receivers, self.receive, self.groups = network, receivers, receive, groups
        self._firsts: dict[int, _Queue] = {}
        self._messages: dict[tuple[int, tuple[str, int, str]], ImmediateMessage] = {}

    def spread(self, state: int, sendings: Sequence[int], lost: int = -1) -> list[tuple[int, Reactions]]:
        """Deliver at once what was sent and what follows, in the order of sending; one delivery may be lost."""
        first = tuple(one for sending in sendings for one in self._first(sending))
        done: list[tuple[int, Reactions]] = []
        pending: list[_Spreading] = [(state, first, (), 0)]
        while pending:
            state, queue, reactions, deliveries = pending.pop()
            head, rest = queue[0], queue[1:]
            arrivals = head.arrivals.get(state & head.mask) if lost < 0 else None
            if arrivals is None:
                arrivals = self._delivered(state, head, lost - deliveries)
                if lost < 0:
                    head.arrivals[state & head.mask] = arrivals
            deliveries += len(head.receivers)
            for difference, mark, added, answer in arrivals:
                after, more = state + difference | mark, rest + answer if answer else rest
                if not more:
                    done.append((after, reactions + added))
                elif deliveries > MOST_IN_CASCADE:
                    self.network.piles.add((more[0].origin, more[0].topic, more[0].receivers[0]))
                    done.append((after & ~more[0].mask | more[0].mask // MASK * CUT, reactions + added))
                else:
                    pending.append((after, more, reactions + added, deliveries))
        return done

    def _first(self, sending: int) -> _Queue:
        """The messages of a sending."""
        first = self._firsts.get(sending)
        if first is None:
            first = self._firsts[sending] = self._sent_by(*self.network.sent[sending])
        return first

    def _sent_by(self, sender: int, sent: Sent) -> _Queue:
        """The messages that a robot sends."""
        queue = []
        for sending in sent:
            message = self._messages.get((sender, sending))
            if message is None:
                topic, number, only = sending
                made = ImmediateMessage(sender, topic, number, self.receivers(sender, topic, only))
                message = self._messages[sender, sending] = made
            queue.append(message)
        return tuple(queue)

    def _delivered(self, state: int, message: ImmediateMessage, lost: int) -> list[_Arrival]:
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
        if len(answers) < 2 or not self.groups:
            return
        for group in self.groups:
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
