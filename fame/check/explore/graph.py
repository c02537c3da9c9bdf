"""The graph of explored states: how each was found, and what can be reached from where."""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections.abc import Callable, Container, Iterable
from typing import TypeVar

from fame.dataclasses import dataclass, field

_T = TypeVar("_T")


def shortest(starts: Iterable[int], goals: Container[int], after: Callable[[int], Iterable[int]]) -> list[int]:
    """Return a shortest way through a graph from a start to a goal, both included; empty if no goal can be reached."""
    before: dict[int, int | None] = dict.fromkeys(starts)
    pending = list(before)
    for at in pending:
        if at in goals:
            way, last = [at], before[at]
            while last is not None:
                way.append(last)
                last = before[last]
            return way[::-1]
        for target in after(at):
            if target not in before:
                before[target] = at
                pending.append(target)
    return []


def reachable(starts: Iterable[_T], after: Callable[[_T], Iterable[_T]]) -> set[_T]:
    """Return what can be reached from some starts, themselves included."""
    reached = set(starts)
    pending = list(reached)
    while pending:
        new = set(after(pending.pop())) - reached
        reached |= new
        pending += new
    return reached


Errors = tuple[tuple[int, str], ...]
"""What fails in a step, and nothing catches it: (robot, element)."""


@dataclass(slots=True)
class Explored:
    """The states that were found, by number in breadth-first order; `parents` lead back to the first one.

    States that need fewer uncaught errors come first.
    """

    states: list[int] = field(default_factory=list)
    parents: array[int] = field(default_factory=lambda: array("l"))
    offsets: array[int] = field(default_factory=lambda: array("l", [0]))
    targets: array[int] = field(default_factory=lambda: array("l"))
    _before: tuple[list[int], list[int]] | None = None
    begun: int = 0
    """Number of states that the start itself leads to: the first ones."""
    final: list[int] = field(default_factory=list)
    stuck: list[int] = field(default_factory=list)
    failures: list[tuple[int, Errors, tuple[int, ...]]] = field(default_factory=list)
    """(state, errors that nothing catches, states after them): not among the targets."""
    layers: list[int] = field(default_factory=list)
    """The number of the first state that is only reached after one error, after two, ..., and of all states."""
    fatal: set[int] = field(default_factory=set)
    """States from which every way on is such an error; -1 is the beginning."""
    open: list[int] = field(default_factory=list)
    """States of which some successors are not explored."""
    transitions: int = 0
    cut: str = ""

    def leading_to(self, goals: Iterable[int]) -> bytearray:
        """For each state, whether one of some states can be reached from it."""
        if self._before is None:
            self._before = self._predecessors()
        starts, before = self._before
        leads = bytearray(len(self.states))
        pending = list(goals)
        for at in pending:
            leads[at] = 1
        while pending:
            at = pending.pop()
            for other in before[starts[at] : starts[at + 1]]:
                if not leads[other]:
                    leads[other] = 1
                    pending.append(other)
        return leads

    def _predecessors(self) -> tuple[list[int], list[int]]:
        """The edges by their targets: where those of each state begin, and their sources."""
        import numpy as np

        offsets, targets = np.asarray(self.offsets), np.asarray(self.targets)
        sources = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
        order = np.argsort(targets, kind="stable")
        starts = np.searchsorted(targets[order], np.arange(len(self.states) + 1))
        return starts.tolist(), sources[order].tolist()

    def reached_from(self, at: int) -> list[int]:
        """Return the states that are reached from one, itself among them."""
        return sorted(reachable([at], self._after))

    def completable(self) -> bytearray:
        """For each state, whether a final one can be reached from it, without a further error that nothing catches.

        Those not explored count as if it could.
        """
        return self.leading_to([*self.final, *self.unexplored()])

    def unexplored(self) -> list[int]:
        """Return the states of which not all successors are known."""
        return [*self.open, *range(len(self.offsets) - 1, len(self.states))]

    def layer(self, at: int) -> int:
        """Return how many uncaught errors a state needs."""
        return bisect_right(self.layers, at)

    def shortest(self, starts: Iterable[int], goals: Container[int]) -> list[int]:
        """Return a shortest way from a start to a goal, both included; empty if no goal can be reached."""
        return shortest(starts, goals, self._after)

    def bottoms(self, inside: Iterable[int]) -> list[list[int]]:
        """Return the sets of states that are never left again and in which each reaches all (path-based, Gabow 2000).

        All edges of the states `inside` lead to such.
        """
        bottoms, order, done = list[list[int]](), dict[int, int](), set[int]()
        for start in inside:
            if start in order:
                continue
            order[start] = len(order)
            stack, roots, work = [start], [start], [(start, iter(self._after(start)))]
            left = set[int]()  # states whose edges leave their component
            while work:
                at, targets = work[-1]
                for target in targets:
                    if target not in order:
                        order[target] = len(order)
                        stack.append(target)
                        roots.append(target)
                        work.append((target, iter(self._after(target))))
                        break
                    if target in done:
                        left.add(at)
                    else:
                        while order[roots[-1]] > order[target]:
                            roots.pop()
                else:
                    work.pop()
                    if roots[-1] == at:
                        roots.pop()
                        component = [stack.pop()]
                        while component[-1] != at:
                            component.append(stack.pop())
                        done.update(component)
                        if not left.intersection(component):
                            bottoms.append(component)
                        if work:
                            left.add(work[-1][0])
        return bottoms

    def _after(self, at: int) -> array[int] | tuple[()]:
        return self.targets[self.offsets[at] : self.offsets[at + 1]] if at + 1 < len(self.offsets) else ()
