"""Stubborn sets of robots: a few robots whose moves are enough in a state, since no other one can interfere (Valmari).

Robots meet only on topics. A move *touches* its robot and the receivers of all that follows at once. A set of robots is
stubborn if no run of the others alone can touch what its moves touch: whatever the others do may as well happen after
them. It is found from one robot by adding those that may interfere, until none is left. What a robot may send, while
the others can only send some topics, is known from where its tokens are (`Outlook`): they pass an event only if a
message for it can come.

Every run of the full search is a part of a run of the reduced one, with independent moves in another order: deadlocks,
ends, errors, lost signals, entered elements and missions that never complete are the same. For that a stubborn set has
a move to a state that is still to be explored, so that nothing is put off forever; none of its moves fails, is cut or
is named by a property; and one of its robots runs an instance, so that no end of the mission is passed over.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence, Set

from fame.bpmn import model
from fame.check.explore.local import Local
from fame.check.explore.product import Product
from fame.check.explore.transitions import CUT, Transition, is_observed

TRIED = 2_000
"""States after which stubborn sets are looked for only if that was worth it."""
WORTH = 0.02
"""Share of these states in which one has to be found."""
_MAY_SEND = re.compile(r"\b(signal|publish|send)\b")
"""What a script says that sends something, on whatever topic."""


class Outlook:
    """What one robot may send in the future, by where its tokens are.

    `number` gives the bit of a topic, so that a set of topics is an integer.
    """

    def __init__(self, local: Local, number: Callable[[str], int]) -> None:
        self._local, self._number = local, number
        self._throws, self._awaits = dict[str, int](), dict[str, int]()
        self._known: bool = local.liveness.applies
        self.catches: int = self._bits(local.topics)
        self._free: int = self._bits({*local.outside})
        self._starts: tuple[str, ...] = tuple(one.id for nodes in local.program.starts.values() for one in nodes)
        for body in local.bodies:
            for node in body.nodes:
                self._add(node)
        self._all = self._bits(local.host.types.keys())

    def _bits(self, topics: Set[str]) -> int:
        return sum(self._number(topic) for topic in topics)

    def _add(self, node: model.FlowNode) -> None:
        """Note what a node throws, and what it waits for if nothing else lets a token pass."""
        caught = []
        for topic, throws in node.topics():
            if throws:
                self._throws[node.id] = self._throws.get(node.id, 0) | self._number(topic.qualified)
            else:
                caught.append(self._number(topic.qualified))
        definitions = node.definitions if isinstance(node, model.Event) else caught
        if caught and len(caught) == len(definitions):
            awaits = 0
            for topics in caught:
                awaits |= topics
            self._awaits[node.id] = self._awaits.get(node.id, 0) | awaits
        elif isinstance(node, model.Task) and node.script is not None and _MAY_SEND.search(node.script.text):
            self._known = False

    def sends(self, state: int, given: int) -> int:
        """Return the topics that the robot may send from a local state on, if others only send those in `given`."""
        view = self._local.views[state]
        passing = given | self._free | self._bits(view.stored)
        flow, sent, size = self._local.liveness, 0, -1
        places = {element for element, _ in view.waiting} | {one for one in view.elements if one} | {*self._starts}
        if not self._known or not places <= flow.elements:
            idle = not view.own and not self._bits(view.listens) & passing
            return 0 if idle else self._all
        while size < (size := len(places)):  # what the robot sends it may also take itself
            pending = list(places)
            while pending:
                at = pending.pop()
                sent |= self._throws.get(at, 0)
                after = flow.aside[at]
                if not (awaits := self._awaits.get(at, 0)) or awaits & (passing | sent):
                    after = after | flow.after[at]
                pending += after - places
                places |= after
        return sent


class Stubborn:
    """Finds stubborn sets of a product with delivery `run`. Sets of robots and of topics are integers."""

    def __init__(self, product: Product) -> None:
        self.product = product
        self._topics: dict[str, int] = {}
        made = {id(local): Outlook(local, self._number) for local in product.locals}
        self._outlooks = [made[id(local)] for local in product.locals]
        self._known: list[dict[tuple[int, int], tuple[int, int]]] = [{} for _ in product.locals]
        self._tried = self._found = 0

    def _number(self, topic: str) -> int:
        return self._topics.setdefault(topic, 1 << len(self._topics))

    def transitions(self, state: int) -> list[Transition] | None:
        """Return the transitions of the smallest stubborn set that is known and leads on; None if
        it has all of them."""
        if self._tried >= TRIED and self._found < WORTH * self._tried:
            return None
        product, olds = self.product, self.product.locals_of(state)
        moves = [product.own(robot, old) for robot, old in enumerate(olds)]
        moving = sum(1 << robot for robot, own in enumerate(moves) if own)
        if moving & (moving - 1) == 0:
            return None
        self._tried += 1
        alone = [self._sent(robot, old, 0) for robot, old in enumerate(olds)]
        ways: dict[int, list[Transition]] = {}
        sets = dict[int, int]()
        for robot in _members(moving):
            if product.locals[robot].views[olds[robot]].instances:
                chosen = self._closure(state, olds, robot, moving, alone, ways)
                if chosen != moving:
                    sets[chosen] = sum(len(ways[one]) for one in _members(chosen))
                    if sets[chosen] == 1:
                        break
        for chosen in sorted(sets, key=sets.__getitem__):
            transitions = [one for robot in _members(chosen) for one in ways[robot]]
            if self._leads_on(state, transitions):
                self._found += 1
                return transitions
        return None

    def _leads_on(self, state: int, transitions: Sequence[Transition]) -> bool:
        """Whether one leads to a state that is still to be explored, and none fails, is cut, or named by a property."""
        product = self.product
        if any(done.failed for _, _, move, reactions in transitions for done in (move, *(one for _, one in reactions))):
            return False
        if product.options.monitors is not None and any(map(is_observed, transitions)):
            return False
        if product.cut and any(product.is_cut(new) for new, *_ in transitions):
            return False
        at, index, canonical, settled = product.index[state], product.index, product.symmetry.canonical, product.settled
        return any(
            index.get(canonical(new), len(index)) > at
            for one in transitions for new in (settled(one) if settled else one[:1])
        )  # fmt: skip

    def _closure(
        self, state: int, olds: Sequence[int], seed: int, moving: int, alone: Sequence[tuple[int, int]],
        ways: dict[int, list[Transition]],
    ) -> int:  # fmt: skip
        """The robots that can move of a stubborn set with the robot `seed`; `ways` gets the transitions of each."""
        chosen, touched = 0, 1 << seed
        while True:
            while new := touched & moving & ~chosen:
                for robot in _members(new):
                    chosen |= 1 << robot
                    touched |= self._touched(state, robot, olds[robot], ways)
            if chosen == moving:
                return moving
            interfering = self._interfering(olds, touched, alone)
            if not interfering:
                return chosen
            touched |= interfering

    def _touched(self, state: int, robot: int, old: int, ways: dict[int, list[Transition]]) -> int:
        """The robots that the moves of a robot touch."""
        if robot not in ways:
            ways[robot] = self.product.moved(state, robot, old)
        touched = 1 << robot
        for _, _, _, reactions in ways[robot]:
            for other, _ in reactions:
                touched |= 1 << other
        return touched

    def _interfering(self, olds: Sequence[int], touched: int, alone: Sequence[tuple[int, int]]) -> int:
        """Of the robots that are not touched, those that may send to one that is, if only such robots move.

        `alone`: what each may send if nothing reaches it, and the receivers of that.
        """
        given = interfering = 0
        for robot, (sent, receivers) in enumerate(alone):
            if not touched >> robot & 1:
                given |= sent
                if receivers & touched:
                    interfering |= 1 << robot
        if interfering:
            return interfering
        before = -1
        while given != before:
            before = given
            for robot, outlook in enumerate(self._outlooks):
                reached = outlook.catches & given
                if reached and not touched >> robot & 1:
                    sent, receivers = self._sent(robot, olds[robot], reached)
                    given |= sent
                    if receivers & touched:
                        interfering |= 1 << robot
        return interfering

    def _sent(self, robot: int, old: int, given: int) -> tuple[int, int]:
        """What a robot may send if only topics in `given` reach it, and the receivers of that."""
        key = (old, given)
        known = self._known[robot].get(key)
        if known is None:
            sent = self._outlooks[robot].sends(old, given) if old < CUT else 0
            known = self._known[robot][key] = (sent, self._receivers(robot, sent))
        return known

    def _receivers(self, robot: int, topics: int) -> int:
        """The robots that may receive what a robot sends."""
        receivers = 0
        for topic, bit in self._topics.items():
            for receiver in self.product.receivers(robot, topic) if topics & bit else ():
                receivers |= 1 << receiver
        return receivers


def _members(robots: int) -> Iterator[int]:
    """The places of the robots in a set."""
    while robots:
        lowest = robots & -robots
        yield lowest.bit_length() - 1
        robots ^= lowest
