"""Single faults: an engine dies, a message is lost or expires, a behaviour fails or never ends.

A fault is added to the transitions of every state in which none has happened yet; the number of the fault is part of
the states after it, so that what each one leads to can be told apart.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

from fame.check.explore.graph import Explored
from fame.check.explore.local import Successor
from fame.check.explore.product import Product, SingleFault
from fame.check.explore.stimuli import Stimulus
from fame.check.explore.transitions import BITS, DEAD, FAULTS, Move, Reactions, Transition
from fame.check.explore.views import element_of


class Faults:
    """Adds the faults of one product; they are numbered in `Product.faults`."""

    def __init__(self, product: Product) -> None:
        self.product = product
        self._numbers: dict[SingleFault, int] = {}

    def _happens(self, fault: SingleFault) -> int:
        """The difference of a state when a fault happens; what follows on one without a number is not explored."""
        product = self.product
        number = self._numbers.get(fault, FAULTS)
        if number == FAULTS and len(product.faults) < FAULTS:
            number = self._numbers[fault] = len(product.faults)
            product.faults.append(fault)
        elif number == FAULTS:
            product.cut = product.further_faults = True
        return number << product.fault_shift

    def add(self, state: int, transitions: list[Transition]) -> None:
        """Add what a single fault may do now; an error that is not caught is a fault of its behaviour."""
        product = self.product
        for transition in tuple(transitions):
            new, robot, move, reactions = transition
            failed = next(((one, done) for one, done in ((robot, move), *reactions) if done.failed), None)
            if failed is not None:
                transitions.remove(transition)
                transitions.append((new + self._happens(self._failure(*failed)), robot, move, reactions))
            elif move.sending and product.options.delivery == "run":
                transitions += self._losses(state, robot, move, reactions)
            elif move.stimulus[0] == "hear":
                transitions += self._loss(state, robot, move)
        for robot, old in enumerate(product.locals_of(state)):
            view = product.locals[robot].views[old]
            if view.instances or view.own or view.hears:  # it runs, or may still start
                died = Move(robot, old, Successor(DEAD, (), (), False), 0, ("die", None, None))
                fault = self._happens(("engine", product.robots[robot]))
                transitions.append((state + died.difference + fault, robot, died, ()))
            transitions += self._blocks(state, robot, old)

    def _failure(self, robot: int, move: Move) -> SingleFault:
        text = next(what for kind, what in move.successor.flags if kind == "error")
        element, _, error = text.partition("\n")
        code = error.partition(";")[0].removeprefix("error ").removesuffix(" was not caught")
        return ("behaviour", self.product.robots[robot], element, code)

    def _missed(self, topic: object, receiver: int) -> SingleFault:
        """A message does not arrive: a signal that is acknowledged is only late, until its time to live is over."""
        kind = "expiry" if topic in self.product.options.acknowledged else "message"
        return (kind, str(topic), self.product.robots[receiver])

    def _losses(self, state: int, robot: int, move: Move, reactions: Reactions) -> Iterator[Transition]:
        """One of the deliveries that happen at once is lost."""
        product = self.product
        for place, (receiver, reaction) in enumerate(reactions):
            _, topic, message = reaction.stimulus
            fault = self._happens(self._missed(topic, receiver))
            lost = Move(receiver, 0, Successor(0, (), (), False), 0, ("loss", topic, message))
            for after, others in product.broadcast.spread(state + move.difference | move.mark, (move.sending,), place):
                yield after + fault, robot, move, (*others[:place], (receiver, lost), *others[place:])

    def _loss(self, state: int, robot: int, move: Move) -> Iterator[Transition]:
        """A message under way is lost."""
        product, (_, topic, message) = self.product, move.stimulus
        old = state >> (robot * BITS) & DEAD
        lost = Move(robot, old, Successor(old, (), (), False), 0, ("loss", topic, message))
        fault = self._happens(self._missed(topic, robot))
        for receiver, other, number, less in product.network.heads(state >> product.top):
            if (receiver, other, number) == (robot, topic, message):
                yield state + (less << product.top) + fault, robot, lost, ()

    def _blocks(self, state: int, robot: int, old: int) -> Iterator[Transition]:
        """A behaviour that runs now never ends."""
        product, local = self.product, self.product.locals[robot]
        if old == DEAD:
            return
        for kind, key, code in local.views[old].own:
            if kind == "end" and code is None:
                stimulus: Stimulus = ("block", key, None)
                fault = self._happens(("behaviour", product.robots[robot], element_of(local.views[old], stimulus), ""))
                for move in product.moves(robot, old, stimulus, local.step(old, stimulus)):
                    yield state + move.difference + fault, robot, move, ()


def outcomes(product: Product, explored: Explored, good: bytearray) -> dict[SingleFault, int | None]:
    """Fault -> number of the first state from which the others cannot end any more; None if they always can."""
    doomed: dict[SingleFault, int | None] = {fault: None for fault in product.faults if fault}
    first: dict[SingleFault, int] = defaultdict(lambda: len(explored.states))
    for at in explored.stuck:
        fault = product.fault_of(explored.states[at])
        if fault:
            first[fault] = min(first[fault], at)
    doomed.update(first)
    for at in range(len(explored.offsets) - 1):
        fault = product.fault_of(explored.states[at])
        if fault and not good[at] and doomed[fault] is None:
            doomed[fault] = at
    return doomed
