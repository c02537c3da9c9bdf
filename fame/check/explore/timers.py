"""Pending timers: which of them may fire next, and their form in a state."""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import Any

from fame.check.explore.canonical import Keys
from fame.dataclasses import dataclass


@dataclass(slots=True)
class Timer:
    """A pending timer. `group` and `offset` order those whose order is known; a cycle has its `period` (s)."""

    group: Any
    offset: float
    period: float | None


Timers = tuple[tuple[int, int, float, float | None], ...]
"""Pending timers in a state: (key, group, offset, period)."""


def canonical_timers(timers: Mapping[int, Timer], keys: Keys) -> Timers:
    """Pending timers by key; only the order within a group counts, so each begins at 0."""
    pending = sorted(((keys[key], timer) for key, timer in timers.items() if key in keys), key=_first)
    groups: dict[Any, int] = {}
    earliest: dict[Any, float] = {}
    for _, timer in pending:
        groups.setdefault(timer.group, len(groups))
        earliest[timer.group] = min(earliest.get(timer.group, timer.offset), timer.offset)
    return tuple(
        (number, groups[timer.group], round(timer.offset - earliest[timer.group], 9), timer.period)
        for number, timer in pending
    )


def next_timers(timers: Mapping[int, Timer], alive: Container[int]) -> list[int]:
    """Return the timers that may fire now: of each group the earliest."""
    first: dict[Any, int] = {}
    for key, timer in timers.items():
        if key in alive:
            other = first.get(timer.group)
            if other is None or timer.offset < timers[other].offset:
                first[timer.group] = key
    return list(first.values())


def _first(item: tuple[int, Timer]) -> int:
    return item[0]
