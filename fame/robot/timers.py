"""The timers of one engine: durations, dates and cycles of ISO 8601 on its scheduler."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from datetime import datetime
from functools import partial

from fame.clock import Entry, Kind, Scheduler, date_at
from fame.iso8601 import add, nanoseconds_between, parse_cycle, parse_datetime, parse_duration

AT_ONE_INSTANT = 1_000_000
"""Timers set without time going on before they are due: a loop over one of no duration would never end."""


class Timers:
    """Those that are set, by the engine's key. `fire` is called with the key, and whether it was the last time.

    `epoch` is the date of the scheduler's time 0. What follows in a cycle is due at its distance from the beginning,
    however late one came.
    """

    def __init__(self, scheduler: Scheduler, epoch: datetime, fire: Callable[[int, bool], object]) -> None:
        self._scheduler, self._epoch, self._fire = scheduler, epoch, fire
        self._set: dict[int, tuple[Entry, Iterator[int], int]] = {}
        self._endless: set[int] = set()
        self._instant, self._at_once = 0, 0

    def set(self, key: int, kind: str, text: str) -> None:
        """Set one: a ``duration``, ``date`` or ``cycle``.

        Raises ValueError for a text that is none, and when too many have been due at the instant they were set.
        """
        now = self._scheduler.now
        date = date_at(self._epoch, now)
        cycle = parse_cycle(text) if kind == "cycle" else None
        delays = _delays(kind, text, date) if cycle is None else cycle.delays(date)
        first = next(delays, None)
        if first is not None:
            if first <= 0:
                self._count(now)
            self._await(key, delays, now, first)
            if cycle is not None and cycle.endless:
                self._endless.add(key)

    def due(self, key: int) -> int | None:
        """When one is due next (ns); None if it is not set, or never due."""
        return self._set[key][0].time if key in self._set else None

    def is_endless(self, key: int) -> bool:
        """Whether it is a cycle without end."""
        return key in self._endless

    def _count(self, now: int) -> None:
        self._at_once = self._at_once + 1 if now == self._instant else 1
        self._instant = now
        if self._at_once > AT_ONE_INSTANT:
            raise ValueError(f"{AT_ONE_INSTANT} timers without time going on: a loop over one has to take some")

    def cancel(self, key: int) -> None:
        """Forget one, if it is set."""
        timer = self._set.pop(key, None)
        self._endless.discard(key)
        if timer is not None:
            timer[0].cancel()

    def close(self) -> None:
        """Forget all."""
        for entry, _, _ in self._set.values():
            entry.cancel()
        self._set.clear()
        self._endless.clear()

    def _await(self, key: int, delays: Iterator[int], base: int, delay: int) -> None:
        self._set[key] = (self._scheduler.at(base + delay, partial(self._due, key), Kind.TIMER), delays, base)

    def _due(self, key: int) -> None:
        _, delays, base = self._set.pop(key)
        following = next(delays, None)
        if following is not None:
            self._await(key, delays, base, following)
        self._fire(key, following is None)


def _delays(kind: str, text: str, date: datetime) -> Iterator[int]:
    """When a date or duration is due, ns from `date`."""
    if kind == "date":
        return iter((nanoseconds_between(date, parse_datetime(text)),))
    duration = parse_duration(text)
    return iter((nanoseconds_between(date, add(date, duration)) if duration.months else duration.nanoseconds,))
