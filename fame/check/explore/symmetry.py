"""Symmetry reduction: of the states that differ only in the order of equal robots, one is explored."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise

from fame.check.explore.network import NetworkContents
from fame.check.explore.transitions import BITS, MASK


class Symmetry:
    """Sorts the robots of each group of equal ones. `top`: the place of the network in a state of the team.

    exchanged  the difference of a state in what belongs to properties when robots change places
    """

    groups: Sequence[tuple[int, ...]]
    network: NetworkContents
    top: int

    def __init__(self, groups: Sequence[tuple[int, ...]], network: NetworkContents, top: int,
                 exchanged: Callable[[int, Mapping[int, int]], int] | None = None) -> None:  # fmt: skip
        self.groups, self.network, self.top, self._exchanged = groups, network, top, exchanged

    def canonical(self, state: int) -> int:
        """Return the same state with robots that nothing tells apart in the order of their local states."""
        for group in self.groups:
            order = self.order(state, group)
            if order is not None:
                state = self.permuted(state, group, order)
        return state

    def order(self, state: int, group: tuple[int, ...]) -> tuple[int, ...] | None:
        """Return the places of a group in the order of what they are at; None if they are in order."""
        locals_of_group = [state >> (robot * BITS) & MASK for robot in group]
        if not state >> self.top:
            if all(first <= second for first, second in pairwise(locals_of_group)):
                return None
            return tuple(sorted(range(len(group)), key=locals_of_group.__getitem__))
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
            return locals_of_group[place], repr(sorted(parts))

        order = tuple(sorted(range(len(group)), key=signature))
        return None if order == tuple(range(len(group))) else order

    def permuted(self, state: int, group: tuple[int, ...], order: tuple[int, ...]) -> int:
        """Return the state in which the robot at `order[k]` of the group has taken place k."""
        locals_of_group = [state >> (robot * BITS) & MASK for robot in group]
        network = state >> self.top
        places = {group[old]: group[new] for new, old in enumerate(order)}
        if self._exchanged is not None:
            state += self._exchanged(state, places)
        for place, robot in enumerate(group):
            state += (locals_of_group[order[place]] - locals_of_group[place]) << (robot * BITS)
        if network:
            state += (self.network.renamed(network, places) - network) << self.top
        return state
