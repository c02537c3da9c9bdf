"""The graph of explored states: how each was found, and what can be reached from where."""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from dataclasses import dataclass, field


@dataclass(slots=True)
class Explored:
    """The states that were found, by number in breadth-first order; `parents` lead back to the first one."""

    states: list[int] = field(default_factory=list)
    parents: array[int] = field(default_factory=lambda: array("l"))
    offsets: array[int] = field(default_factory=lambda: array("l", [0]))
    targets: array[int] = field(default_factory=lambda: array("l"))
    _before: tuple[list[int], list[int]] | None = None
    final: list[int] = field(default_factory=list)
    stuck: list[int] = field(default_factory=list)
    loops: list[int] = field(default_factory=list)
    """States in which a robot did something by itself that changed nothing."""
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
        """The states that are reached from one, itself among them."""
        seen, pending = {at}, [at]
        while pending:
            one = pending.pop()
            if one + 1 < len(self.offsets):
                for target in self.targets[self.offsets[one] : self.offsets[one + 1]]:
                    if target not in seen:
                        seen.add(target)
                        pending.append(target)
        return sorted(seen)

    def completable(self) -> bytearray:
        """For each state, whether a final one can be reached from it; those not explored count as if it could."""
        return self.leading_to([*self.final, *range(len(self.offsets) - 1, len(self.states))])
