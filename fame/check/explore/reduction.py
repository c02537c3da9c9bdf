"""Partial-order reduction: steps that need not be interleaved with others are explored alone.

Two kinds of steps of one robot may go first, because whatever else happens may as well happen afterwards:

- all its own steps, if no message has an effect on it now nor after any of them (it hears nothing, or drops all
  triggers, since its instances run already), and it sends nothing in them;
- one step of one token, if nothing can cancel that token, and the step touches no variable that another token may
  touch before (parallel branches commute).

Neither may send, report or start anything, nor change which messages the robot takes. The search explores such steps
alone only if each of them leads to a state that it has still to explore, so that nothing is put off forever; one that
changes nothing does not count. Which of its steps these are depends on the robot alone, so the search goes through all
of them at once where it can (`Reduction.settled`), and keeps only the states behind them.

With delivery ``run``, a few robots may be enough where none can go alone (`fame.check.explore.stubborn`).
With delivery ``fast``, messages that wait for several robots arrive at one of them first, if at most one answers.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

from fame.check.explore.graph import shortest
from fame.check.explore.independence import Structure
from fame.check.explore.product import Product
from fame.check.explore.stubborn import Stubborn
from fame.check.explore.transitions import BITS, CUT, DEAD, MASK, Move, Transition

MOST_BETWEEN = 1_000
"""Local states of one robot that are gone through at once."""

_Pending = tuple[tuple[str, tuple[int, ...]], ...]
"""Messages on their way to one robot: (topic, message numbers) of each channel."""


class Reduction:
    """Finds the steps of one product that may be explored alone."""

    def __init__(self, product: Product) -> None:
        self.product = product
        structures = {id(local): Structure.of(local) for local in product.locals}
        self._structures = [structures[id(local)] for local in product.locals]
        self._index, self._canonical = product.index, product.symmetry.canonical
        self._fast: bool = product.options.delivery == "fast"
        self._alone: list[dict[int, tuple[Move, ...] | None]] = [{DEAD: None, CUT: None} for _ in product.locals]
        self._ends: list[dict[int, tuple[int, ...]]] = [{DEAD: (), CUT: ()} for _ in product.locals]
        watched = product.options.monitors is not None and product.options.monitors.watches
        whole = product.options.delivery != "run" or product.options.faults or product.count < 2 or watched
        self._stubborn = None if whole else Stubborn(product)
        self._answering: dict[tuple[int, int, _Pending], bool] = {}

    # ---- fewer transitions ---------------------------------------------------------------------------

    def alone(self, state: int) -> list[Transition] | None:
        """Return the moves of one robot, or of a few, that no other can influence, if they lead to
        states not yet explored."""
        rest, index, canonical = state, self._index, self._canonical
        at = index[state]
        for robot, table in enumerate(self._alone):
            old = rest & MASK
            rest >>= BITS
            if old in table:
                moves = table[old]
            else:
                moves = table[old] = self.moves(robot, old) or None
            if moves is not None:
                transitions: list[Transition] = [
                    (state + move.difference | move.mark, robot, move, ()) for move in moves
                ]
                ahead = [index.get(canonical(one[0]), len(index)) for one in transitions if one[0] != state]
                if ahead and min(ahead) > at:
                    return transitions
        return self._stubborn.transitions(state) if self._stubborn is not None else None

    def first_arrivals(self, state: int, transitions: list[Transition]) -> list[Transition]:
        """Return the arrivals at one robot, if those at others lead to no more messages, and lead
        to states not yet explored.

        Nothing but arrivals happens now, so robots that send nothing in them may as well receive their messages later.
        """
        product = self.product
        waiting: dict[int, _Pending] = {}
        for (_, topic, receiver), messages in product.network.content(state >> product.top):
            waiting[receiver] = (*waiting.get(receiver, ()), (topic, messages))
        if len(waiting) < 2:
            return transitions
        answering = [one for one, all in waiting.items() if self._answers(one, state >> (one * BITS) & MASK, all)]
        if len(answering) > 1:
            return transitions
        first = answering[0] if answering else transitions[0][1]
        chosen = [one for one in transitions if one[1] == first]
        at, index = self._index[state], self._index
        ahead = all(index.get(self._canonical(one[0]), len(index)) > at for one in chosen)
        return chosen if ahead else transitions

    def _answers(self, robot: int, old: int, waiting: _Pending) -> bool:
        """Whether a robot may send something, or do what a property names, as these messages arrive.

        They arrive in any order of their channels.
        """
        key = (robot, old, waiting)
        answering = self._answering.get(key)
        if answering is None:
            answering = False
            for place, (topic, messages) in enumerate(waiting):
                left = ((topic, messages[1:]),) if len(messages) > 1 else ()
                rest = (*waiting[:place], *left, *waiting[place + 1 :])
                moves = self.product.receive(robot, old, topic, messages[0])
                answers = (move.sending or move.successor.events for move in moves)
                if any(answers) or any(self._answers(robot, move.state, rest) for move in moves):
                    answering = True
                    break
            self._answering[key] = answering
        return answering

    # ---- steps gone through at once ------------------------------------------------------------------

    def settled(self, transition: Transition) -> Sequence[int]:
        """Return the states to which a transition leads once the robots have taken all steps that
        no other one notices."""
        new, robot, move, reactions = transition
        if not reactions and move.stimulus[0] != "hear":
            if move.sending and new >> self.product.top and self._fast:
                return (new,)
            ends = self._differences(robot, move)
            return [new + difference for difference in ends] if ends else (new,)
        if new >> self.product.top and self._fast:  # messages arrive before anybody goes on
            return (new,)
        states, rest = [new], new
        for place, table in enumerate(self._ends):
            old = rest & MASK
            rest >>= BITS
            known = table.get(old)
            if known is None:
                known = self.ends(place, old)
            if known:
                states = [state + ((end - old) << (place * BITS)) for state in states for end in known]
        return states

    def _differences(self, robot: int, move: Move) -> tuple[int, ...]:
        if move.ends is None:
            old = move.state
            move.ends = tuple((end - old) << (robot * BITS) for end in self.ends(robot, old))
        return move.ends

    def between(self, state: int, end: int) -> Iterator[Transition]:
        """Yield the transitions from a state to one to which the robots have gone on from there, see `settled`."""
        for robot in range(self.product.count):
            old, new = (one >> (robot * BITS) & MASK for one in (state, end))
            for move in self._path(robot, old, new) if old != new else ():
                state += move.difference
                yield state, robot, move, ()

    def ends(self, robot: int, state: int) -> tuple[int, ...]:
        """Return the local states in which a robot is once it has gone all steps that may be
        explored alone; () if none may.

        Every way from each state between leads to one of them; else () as well, since somebody must come between.
        """
        ends = self._ends[robot].get(state)
        if ends is None:
            ends = self._ends[robot][state] = self._new_ends(robot, state)
        return ends

    def _new_ends(self, robot: int, state: int) -> tuple[int, ...]:
        after, pending, ends = dict[int, set[int]](), [state], list[int]()
        while pending:
            at = pending.pop()
            if at not in after and at not in ends:
                moves = self.moves(robot, at)
                if moves:
                    after[at] = {move.state for move in moves}
                    pending += sorted(after[at])
                else:
                    ends.append(at)
                if len(after) > MOST_BETWEEN:
                    return ()
        if not after:
            return ()
        leading = set(ends)
        while grown := {at for at in after.keys() - leading if after[at] & leading}:
            leading |= grown
        return tuple(sorted(ends)) if after.keys() <= leading else ()

    def _path(self, robot: int, state: int, end: int) -> list[Move]:
        """The steps from a state to one of its `ends`."""
        way = shortest([state], {end}, lambda at: (move.state for move in self.moves(robot, at)))
        return [next(move for move in self.moves(robot, at) if move.state == new) for at, new in pairwise(way)]

    # ---- of one robot ----------------------------------------------------------------------------------

    def moves(self, robot: int, state: int) -> tuple[Move, ...]:
        """Return the moves that may be explored alone in a local state."""
        moves = self.product.own(robot, state)
        silent = [move for move in moves if self._is_silent(robot, state, move)]
        if not silent:
            return ()
        single = self._of_one_token(robot, state, moves, silent)
        if single or len(silent) < len(moves):
            return single
        views = self.product.locals[robot].views
        foreign = self._foreign(robot)
        return () if any(views[at].hears & foreign for at in (state, *(move.state for move in moves))) else moves

    def _is_silent(self, robot: int, state: int, move: Move) -> bool:
        """Whether nobody notices the move."""
        did = move.successor
        if move.sending or did.flags or did.begins or did.events or move.state >= CUT:
            return False
        before, after = (self.product.locals[robot].views[at] for at in (state, move.state))
        return before.instances == after.instances

    def _of_one_token(self, robot: int, state: int, moves: tuple[Move, ...], silent: list[Move]) -> tuple[Move, ...]:
        """All moves of one token that commute with whatever the others may do."""
        structure, views = self._structures[robot], self.product.locals[robot].views
        view = views[state]
        if structure is None:
            return ()
        elements = dict(zip(view.own, view.elements, strict=True))
        candidates = dict.fromkeys(move.stimulus[:2] for move in silent if move.stimulus[0] in ("end", "person"))
        for kind, key in candidates:
            own = tuple(move for move in moves if move.stimulus[:2] == (kind, key))
            element = elements[own[0].stimulus]
            if any(move not in silent or not move.successor.quiet for move in own):
                continue
            if any(
                (views[move.state].hears, views[move.state].listeners) != (view.hears, view.listeners) for move in own
            ):
                continue
            reached = {one for move in own for one, _ in views[move.state].waiting}
            others = [one for one, _ in view.waiting]
            others.remove(element)
            if structure.commutes(element, reached - set(others), others):
                return own
        return ()

    def _foreign(self, robot: int) -> frozenset[str]:
        """The topics on which another robot may send to it."""
        topics = self.product.locals[robot].topics
        return frozenset(topic for topic in topics if topic[0] == "/") if self.product.count > 1 else frozenset()
