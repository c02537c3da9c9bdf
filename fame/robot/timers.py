"""The timers of one engine: durations, dates and cycles of ISO 8601 on its scheduler."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import datetime
from functools import partial
from itertools import chain
from typing import Any, Literal

from fame.clock import Entry, Kind, Scheduler, date_at
from fame.iso8601 import add, nanoseconds_between, parse_cycle, parse_datetime, parse_duration

AT_ONE_INSTANT = 1_000_000
"""Most timers that are due at the instant at which they are set: a loop over a timer of no duration never ends."""


Missed = Literal["fire", "skip", "fail"]
"""The policy for a timer that came due while its engine was away."""


class RobotTimers:
    """The timers that are set, by the engine's key.

    `epoch` is the date of the scheduler's time 0. `on_fire` is called with the key, and with whether it was the last
    time. The times of a cycle count from its beginning: a late one does not delay those that follow.
    """

    def __init__(self, scheduler: Scheduler, epoch: datetime, on_fire: Callable[[int, bool], object]) -> None:
        self._scheduler, self._epoch, self._on_fire = scheduler, epoch, on_fire
        self._timers: dict[int, tuple[Entry, Iterator[int], int]] = {}  # entry, further delays, what these count from
        self._texts: dict[int, list[Any]] = {}  # kind, text, what its delays count from (ns), how many are over
        self._endless: set[int] = set()
        self._instant, self._count_now = 0, 0
        self._held = False

    def set(self, key: int, kind: str, text: str) -> None:
        """Set a timer. `kind` is ``duration``, ``date`` or ``cycle``.

        Raises ValueError for a text that is not ISO 8601, and if too many timers are due as soon as they are set.
        """
        now = self._scheduler.now
        date = date_at(self._epoch, now)
        cycle = parse_cycle(text) if kind == "cycle" else None
        delays = _delays(kind, text, date) if cycle is None else cycle.delays(date)
        first = next(delays, None)
        if first is not None:
            if first <= 0:
                self._count_instant(now)
            self._texts[key] = [kind, text, now, 0]
            self._enter(key, delays, now, first)
            if cycle is not None and cycle.endless:
                self._endless.add(key)

    def hold(self) -> None:
        """Let timers fire only by `fire` from now on."""
        self._held = True

    def fire(self, key: int) -> None:
        """Fire a timer that is set."""
        self._timers[key][0].cancel()
        self._on_due(key)

    def due(self, key: int) -> int | None:
        """When a timer is due next (ns); None if it is not set, or never due."""
        return self._timers[key][0].time if key in self._timers else None

    def is_endless(self, key: int) -> bool:
        """Return whether a timer is a cycle without end."""
        return key in self._endless

    def _count_instant(self, now: int) -> None:
        self._count_now = self._count_now + 1 if now == self._instant else 1
        self._instant = now
        if self._count_now > AT_ONE_INSTANT:
            raise ValueError(
                f"{AT_ONE_INSTANT} timers were due as soon as they were set: a loop over a timer has to take time"
            )

    def cancel(self, key: int) -> None:
        """Cancel a timer, if it is set."""
        timer = self._timers.pop(key, None)
        self._texts.pop(key, None)
        self._endless.discard(key)
        if timer is not None:
            timer[0].cancel()

    def state(self) -> Mapping[int, Sequence[Any]]:
        """Return the timers that are set: kind, text, the time they count from (ns), and how often they have fired."""
        return self._texts

    def resume(self, key: int, kind: str, text: str, base: int, fired: int, missed: Missed = "fire") -> int:
        """Set a timer of an engine that was not running. Returns how many of its times have passed meanwhile.

        `base` and `fired` as of `state`, in the time of this scheduler. With `missed` = ``skip`` these times are left
        out, and a duration counts again from now; else the timer fires once for all of them, at once and in due order.
        Raises ValueError as `set` does.
        """
        date = date_at(self._epoch, base)
        cycle = parse_cycle(text) if kind == "cycle" else None
        delays = _delays(kind, text, date) if cycle is None else cycle.delays(date)
        for _ in range(fired):
            next(delays, None)
        late, last, following = 0, None, next(delays, None)
        while following is not None and base + following <= self._scheduler.now and late < AT_ONE_INSTANT:
            late, last, following = late + 1, following, next(delays, None)
        if late and missed == "skip" and kind == "duration":
            self.set(key, kind, text)
            return late
        if last is not None and missed != "skip":
            # It fires once, at the last of its missed times, which then counts for all of them.
            delays, following, fired = chain([] if following is None else [following], delays), last, fired - 1
        if following is not None:
            self._texts[key] = [kind, text, base, fired + late]
            self._enter(key, delays, base, following)
            if cycle is not None and cycle.endless:
                self._endless.add(key)
        return late

    def close(self) -> None:
        """Cancel all timers."""
        for entry, _, _ in self._timers.values():
            entry.cancel()
        self._timers.clear()
        self._texts.clear()
        self._endless.clear()

    def _enter(self, key: int, delays: Iterator[int], base: int, delay: int) -> None:
        action = partial(self._on_due, key) if not self._held else _stay
        self._timers[key] = (self._scheduler.at(base + delay, action, Kind.TIMER), delays, base)

    def _on_due(self, key: int) -> None:
        _, delays, base = self._timers.pop(key)
        following = next(delays, None)
        if following is not None:
            self._texts[key][3] += 1
            self._enter(key, delays, base, following)
        else:
            del self._texts[key]
        self._on_fire(key, following is None)


def _stay() -> None:
    """The action of a held timer."""


def _delays(kind: str, text: str, date: datetime) -> Iterator[int]:
    """When a date or duration is due, ns from `date`."""
    if kind == "date":
        return iter((nanoseconds_between(date, parse_datetime(text)),))
    duration = parse_duration(text)
    return iter((nanoseconds_between(date, add(date, duration)) if duration.months else duration.nanoseconds,))
