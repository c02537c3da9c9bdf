"""Time: one queue of things to do, ordered by (time, kind, sequence), and two ways to wait for the next.

Time is integer nanoseconds. `Scheduler` is simulated time: it jumps to the next due entry and never reads the wall clock.
`WallScheduler` is the same queue waiting on the wall clock, and takes calls from other threads. Every entry runs to completion
before the next. At one instant messages come first, then resumptions of scripts, then timers, then the step of the world;
among equals, whoever was entered first. The order is total, so a simulated run is repeatable.
"""

from __future__ import annotations

import heapq
import threading
import time
from collections.abc import Callable
from enum import IntEnum

SECOND = 1_000_000_000
"""Nanoseconds in a second."""


class Kind(IntEnum):
    """What an entry is; the order at one instant (DESIGN section 7)."""

    MESSAGE = 0
    RESUMPTION = 1
    TIMER = 2
    WORLD = 3


class Entry:
    """One thing to do. `cancel` is cheap and safe at any time; a cancelled entry is skipped when it comes up."""

    __slots__ = ("action", "time")

    def __init__(self, time: int, action: Callable[[], object] | None) -> None:
        self.time, self.action = time, action

    def cancel(self) -> None:
        """Forget it. Does nothing if it ran already."""
        self.action = None


class Scheduler:
    """Simulated time. `now` is nanoseconds since the start."""

    def __init__(self) -> None:
        self.now = 0
        self._heap: list[tuple[int, int, int, Entry]] = []
        self._sequence = 0
        self._stopping = False

    def at(self, time: int, action: Callable[[], object], kind: Kind = Kind.TIMER) -> Entry:
        """Do `action` at `time` (ns), or at once if that is past. Returns the entry, for `cancel`."""
        entry = Entry(max(time, self.now), action)
        self._sequence += 1
        heapq.heappush(self._heap, (entry.time, kind, self._sequence, entry))
        return entry

    def after(self, delay: int, action: Callable[[], object], kind: Kind = Kind.TIMER) -> Entry:
        """Do `action` in `delay` ns."""
        return self.at(self.now + delay, action, kind)

    def soon(self, action: Callable[[], object], kind: Kind = Kind.MESSAGE) -> Entry:
        """Do `action` now, after what was entered before it."""
        return self.at(self.now, action, kind)

    def next_time(self) -> int | None:
        """When the next entry is due (ns), or None if there is nothing left to do."""
        heap = self._heap
        while heap and heap[0][3].action is None:
            heapq.heappop(heap)
        return heap[0][0] if heap else None

    def run(self, until: int | None = None) -> None:
        """Work until `until` (ns, inclusive; then `now` is `until`), until nothing is left, or until `stop`."""
        self._stopping = False
        while not self._stopping:
            due = self.next_time()
            if due is None or (until is not None and due > until):
                break
            self._wait(due)
            self._do_next()
        if until is not None and not self._stopping:
            self.now = max(self.now, until)

    def stop(self) -> None:
        """Make `run` return after the entry that is at work now."""
        self._stopping = True

    def _wait(self, due: int) -> None:
        self.now = max(self.now, due)

    def _do_next(self) -> None:
        entry = heapq.heappop(self._heap)[3]
        action, entry.action = entry.action, None
        if action is not None:
            action()


class WallScheduler(Scheduler):
    """The same queue on the wall clock (steady). `now` is nanoseconds since it was made.

    `at`, `after`, `soon` and `stop` may be called from any thread; all actions run in the thread that called `run`.
    `run()` without `until` waits for work from other threads until `stop`.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._origin = time.monotonic_ns()
        super().__init__()

    @property
    def now(self) -> int:
        """Nanoseconds since this scheduler was made."""
        return time.monotonic_ns() - self._origin

    @now.setter
    def now(self, value: int) -> None:
        pass  # the wall clock goes by itself

    def at(self, time: int, action: Callable[[], object], kind: Kind = Kind.TIMER) -> Entry:
        with self._changed:
            entry = super().at(time, action, kind)
            self._changed.notify_all()
            return entry

    def stop(self) -> None:
        with self._changed:
            super().stop()
            self._changed.notify_all()

    def run(self, until: int | None = None) -> None:
        self._stopping = False
        while True:
            with self._changed:
                if self._stopping:
                    return
                due = self.next_time()
                now = self.now
                if until is not None and now >= until and (due is None or due > until):
                    return
                if due is None or due > now:
                    ends = [moment for moment in (due, until) if moment is not None]
                    self._changed.wait((min(ends) - now) / SECOND if ends else None)
                    continue
            self._do_next()

    def _do_next(self) -> None:
        with self._changed:
            entry = heapq.heappop(self._heap)[3]
            action, entry.action = entry.action, None
        if action is not None:
            action()
