"""A cache of steps by the variables that they read: where these have the same values, a step does the same.

What a step does depends on the control state, the timers, the stimulus, and the values of the variables that it reads.
In all states that agree on these it goes the same ways and writes the same values; every other variable keeps its own.
So an engine runs a step once for each footprint, not once for each state.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import Any, NamedTuple

from fame.check.explore.contents import Changes
from fame.check.explore.remembering import Memory, Outcomes

Names = tuple[str, ...]
Codes = tuple[Hashable, ...]


class Watched(Outcomes):
    """Variables that note which of them are read and written.

    reads   names that were read or looked for, whether they are set or not
    writes  names that were set or deleted
    whole   whether they were used in another way, as when all are listed
    """

    __slots__ = ("reads", "whole", "writes")

    def __init__(self, values: dict[str, Any], memory: Memory | None = None) -> None:
        super().__init__(values, memory or Memory({}))
        self.reads: set[str] = set()
        self.writes: set[str] = set()
        self.whole: bool = False

    def __getitem__(self, name: str) -> Any:
        self.reads.add(name)
        return super().__getitem__(name)

    def __contains__(self, name: object) -> bool:
        self.reads.add(str(name))
        return super().__contains__(name)

    def get(self, name: str, default: Any = None) -> Any:
        self.reads.add(name)
        return super().get(name, default)

    def __setitem__(self, name: str, value: Any) -> None:
        self.writes.add(name)
        super().__setitem__(name, value)

    def remember(self, key: str, decisions: tuple[int, ...]) -> None:
        self.writes.add(key)
        super().remember(key, decisions)

    def __delitem__(self, name: str) -> None:
        self.reads.add(name)
        self.writes.add(name)
        super().__delitem__(name)


def _as_a_whole(method: str) -> Callable[..., Any]:
    def use(self: Watched, *arguments: Any, **named: Any) -> Any:
        self.whole = True
        return getattr(Outcomes, method)(self, *arguments, **named)

    return use


for _method in ("__iter__", "__reversed__", "__len__", "__eq__", "__ne__", "__or__", "__ror__", "__ior__", "keys",
                "values", "items", "copy", "pop", "popitem", "setdefault", "update", "clear"):  # fmt: skip
    setattr(Watched, _method, _as_a_whole(_method))


class Effect(NamedTuple):
    """One way that a step goes, in whatever state.

    control, timers       of the new state
    changes               the variables that it has written; None if their instance has ended
    sent ... events       as of `fame.check.explore.local.Successor`
    """

    control: int
    timers: tuple[Any, ...]
    changes: Changes | None
    sent: tuple[Any, ...]
    flags: tuple[Any, ...]
    quiet: bool
    events: tuple[Any, ...]


class Footprints:
    """The effects of steps, by what they have read.

    `codes` gives the codes of variables of a content by name, None for those that are not set.
    """

    def __init__(self, codes: Callable[[int, Names], Codes]) -> None:
        self._codes = codes
        self._tables: dict[Hashable, dict[Names, dict[Codes, tuple[Effect, ...]]]] = {}

    def find(self, step: Hashable, content: int) -> tuple[Effect, ...] | None:
        """Return the effects of a step on variables with that content; None if they are not known."""
        for names, known in self._tables.get(step, {}).items():
            effects = known.get(self._codes(content, names))
            if effects is not None:
                return effects
        return None

    def add(self, step: Hashable, content: int, reads: set[str], effects: Sequence[Effect]) -> None:
        """Note the effects of a step that has read these variables."""
        names = tuple(sorted(reads))
        known = self._tables.setdefault(step, {}).setdefault(names, {})
        known[self._codes(content, names)] = tuple(effects)
