"""Time: one queue of actions, ordered by (time, kind, sequence), and two ways to wait for the next.

Time is integer nanoseconds. `Scheduler` is simulated time: it jumps to the next due entry and never reads the wall
clock. `WallScheduler` is the same queue waiting on the wall clock, and takes calls from other threads.

Invariants. Every entry runs to completion before the next. At one instant messages come first, then resumptions of
scripts, then timers, then the step of the world; among equals, the one entered first. The order is total, so a
simulated run is repeatable. Nothing is ever entered in the past: a late entry is due now, behind what was due before,
so that no entry can starve another by entering itself again. Periodic actions count from the time that was due
(`entry.time`), not from `now`, and do not drift. Cancelled entries are swept out before they outnumber the others.

In simulated time messages for the present instant, most of all entries, wait in a FIFO and not in the heap: nothing
can come before them but messages that were entered for this instant when it was still in the future.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from enum import IntEnum
from heapq import heapify, heappop, heappush
from itertools import count

from fame.iso8601 import parse_datetime
from fame.worker import ThreadWorker, Worker

__all__ = ["EPOCH", "SECOND", "Entry", "Kind", "Scheduler", "WallScheduler"]

SECOND = 1_000_000_000
"""Nanoseconds in a second."""

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
"""The date of simulated second 0 unless a mission has another, as in ROS."""

_SWEEP = 64
"""A queue with fewer cancelled entries than this is not worth sweeping."""

_MAX_WAIT = 3600.0
"""Longest single wait (s). Below the limit of `threading`, which a timer for the year 9999 would exceed."""

Action = Callable[[], object]


def date_at(epoch: datetime, time: int) -> datetime:
    """Return the date (UTC) at `time` (ns) of a clock whose time 0 is `epoch`. Raises
    OverflowError beyond the year 9999."""
    return epoch.astimezone(UTC) + timedelta(microseconds=time // 1000)


def date_text(date: datetime) -> str:
    """Return a date as text: ``2026-03-01T12:00:00Z``."""
    return date.astimezone(UTC).isoformat().replace("+00:00", "Z")


def parse_epoch(text: str) -> datetime:
    """Return the date of time 0 in a text: ISO 8601, or ``now``. Raises ValueError."""
    if text.strip() == "now":
        return datetime.now(UTC).replace(microsecond=0)
    date = parse_datetime(text)
    if not 1000 <= date.year <= 9000:
        raise ValueError(f"{text!r} is a date before the year 1000 or after 9000")
    return date


class Kind(IntEnum):
    """The kinds of entries, in their order at one instant."""

    MESSAGE = 0
    RESUMPTION = 1
    TIMER = 2
    WORLD = 3


_MESSAGE = Kind.MESSAGE  # looking up the member of an enumeration takes five times as long


class Entry:
    """An action, due at `time` (ns). `action` is None once it ran or was cancelled."""

    __slots__ = ("_queue", "action", "time")

    def __init__(self, time: int, action: Action, queue: Scheduler) -> None:
        self.time: int = time
        self.action: Action | None = action
        self._queue = queue

    def cancel(self) -> None:
        """Cancel the action: cheap and safe at any time, from any thread. Does nothing if it ran already."""
        if self.action is not None:
            self.action = None
            self._queue._cancelled += 1


class Scheduler:
    """Simulated time. `now` is nanoseconds since the start."""

    is_simulated = True
    """Whether time stands still while an entry runs."""

    def __init__(self) -> None:
        self.now: int = 0
        self._heap: list[tuple[int, int, int, Entry]] = []
        self._fifo: deque[Entry] = deque()  # messages for the present instant
        self._sequence = count(1)
        self._cancelled = 0
        self._running = False
        self._stopping = False
        self.on_no_memory: Callable[[], object] | None = None

    def __len__(self) -> int:
        """The number of waiting entries, including cancelled ones that have not been removed yet."""
        return len(self._heap) + len(self._fifo)

    def at(self, time: int, action: Action, kind: Kind = Kind.TIMER) -> Entry:
        """Do `action` at `time` (ns), or now if that is past. Returns the entry, for `cancel`."""
        now = self.now
        if time > now or kind is not _MESSAGE:
            return self._enter(time if time > now else now, action, kind)
        entry = Entry(now, action, self)
        self._fifo.append(entry)
        return entry

    def _enter(self, time: int, action: Action, kind: Kind) -> Entry:
        """Into the heap."""
        entry = Entry(time, action, self)
        heappush(self._heap, (time, kind, next(self._sequence), entry))
        if self._cancelled > _SWEEP and 2 * self._cancelled > len(self._heap):
            self._sweep()
        return entry

    def after(self, delay: int, action: Action, kind: Kind = Kind.TIMER) -> Entry:
        """Do `action` in `delay` ns."""
        return self.at(self.now + delay, action, kind)

    def soon(self, action: Action, kind: Kind = Kind.MESSAGE) -> Entry:
        """Do `action` now, after what was entered before it."""
        return self.at(self.now, action, kind)

    def worker(self, name: str) -> Worker:
        """Return a worker for what would stop the scheduler for too long. `name` is shown for its
        thread, if it has one."""
        return Worker()

    def next_time(self) -> int | None:
        """When the next entry is due (ns), or None if the queue is empty."""
        heap, fifo = self._heap, self._fifo
        while fifo and fifo[0].action is None:
            fifo.popleft()
            self._cancelled -= 1
        while heap and heap[0][3].action is None:
            heappop(heap)
            self._cancelled -= 1
        if fifo:
            return self.now
        return heap[0][0] if heap else None

    def run(self, until: int | None = None) -> None:
        """Run actions until `until` (ns, inclusive; then `now` is `until`), until none is left, or until `stop`.

        An exception of an action ends the run and goes to the caller; the queue stays intact, and `run` may be called
        again. After a MemoryError `on_no_memory` is called, if it is set, and the run goes on.
        """
        if self._running:
            raise RuntimeError("the scheduler runs already: an entry has to end before the next begins")
        self._running = True
        try:
            while self._runs_out_of_memory(until):
                pass
        finally:
            # Cleared here and not at the beginning: a `stop` by another thread just before `run` must count.
            self._running = self._stopping = False

    def _runs_out_of_memory(self, until: int | None) -> bool:
        try:
            self._work(until)
        except MemoryError:
            if self.on_no_memory is None:
                raise
        else:
            return False
        self.on_no_memory()  # when the frames of the error, and what they hold, are gone
        return True

    def _work(self, until: int | None) -> None:
        heap, fifo = self._heap, self._fifo
        if until is not None and until < self.now:
            return
        while (heap or fifo) and not self._stopping:
            if fifo and not (heap and heap[0][0] == self.now and heap[0][1] is _MESSAGE):
                entry = fifo.popleft()
            else:
                due, _, _, entry = heap[0]
                if until is not None and due > until and entry.action is not None:
                    break
                heappop(heap)
            action = entry.action
            if action is None:
                self._cancelled -= 1
                continue
            self.now, entry.action = entry.time, None
            action()
        if until is not None and until > self.now and not self._stopping:
            self.now = until

    def stop(self) -> None:
        """Make `run` return after the current action. If none is running, the next `run` returns at once."""
        self._stopping = True

    def _sweep(self) -> None:
        self._heap[:] = [item for item in self._heap if item[3].action is not None]  # in place: `run` holds this list
        heapify(self._heap)
        self._cancelled = sum(entry.action is None for entry in self._fifo)


class WallScheduler(Scheduler):
    """The same queue on the wall clock (steady). `now` is nanoseconds since it was made.

    `at`, `after`, `soon`, `stop` and `Entry.cancel` may be called from any thread and from signal handlers; all actions
    run in the thread that called `run`. `run()` without `until` waits for work from other threads until `stop`.
    """

    is_simulated = False

    def __init__(self) -> None:
        self._changed = threading.Condition()  # on a reentrant lock: a signal handler may interrupt its own thread
        self._origin = time.monotonic_ns()
        super().__init__()

    @property
    def now(self) -> int:
        """Nanoseconds since this scheduler was made."""
        return time.monotonic_ns() - self._origin

    @now.setter
    def now(self, value: int) -> None:
        pass  # the wall clock goes by itself

    def at(self, time: int, action: Action, kind: Kind = Kind.TIMER) -> Entry:
        with self._changed:
            entry = self._enter(max(time, self.now), action, kind)
            self._changed.notify()
            return entry

    def worker(self, name: str) -> Worker:
        return ThreadWorker(name, self.soon)

    def next_time(self) -> int | None:
        with self._changed:
            return super().next_time()

    def _work(self, until: int | None) -> None:
        while (action := self._wait(until)) is not None:
            action()

    def stop(self) -> None:
        with self._changed:
            super().stop()
            self._changed.notify()

    def _wait(self, until: int | None) -> Action | None:
        """Wait for the next entry, take it off the queue and return its action; None if it is time to end."""
        with self._changed:
            while not self._stopping:
                due, now = self.next_time(), self.now
                end = min((moment for moment in (due, until) if moment is not None), default=None)
                if end is None or end > now:
                    self._changed.wait(_MAX_WAIT if end is None else min((end - now) / SECOND, _MAX_WAIT))
                elif end != due:
                    return None
                elif action := self._take():
                    return action
        return None

    def _take(self) -> Action | None:
        entry = heappop(self._heap)[3]
        action, entry.action = entry.action, None
        return action  # None: another thread cancelled it since it was found due


class Turns(Scheduler):
    """A queue of one mission on the wall clock: however many of its entries are due, `wall` gets one of them at a time.

    So what others enter meanwhile, as the messages of a deployment, waits for one entry of the mission at most.
    """

    is_simulated = False

    def __init__(self, wall: Scheduler) -> None:
        self._wall = wall
        self._lock = threading.RLock()
        self._turn: Entry | None = None
        super().__init__()

    @property
    def now(self) -> int:
        """The time of `wall`."""
        return self._wall.now

    @now.setter
    def now(self, value: int) -> None:
        pass

    def at(self, time: int, action: Action, kind: Kind = Kind.TIMER) -> Entry:
        with self._lock:
            entry = self._enter(max(time, self.now), action, kind)
            self._plan()
            return entry

    def worker(self, name: str) -> Worker:
        return self._wall.worker(name)

    def _plan(self) -> None:
        """Enter the next turn, behind what is due in `wall` already."""
        due, turn = self.next_time(), self._turn
        if due is None or (turn is not None and turn.time <= due):
            return
        if turn is not None:
            turn.cancel()
        self._turn = self._wall.at(due, self._take_turn)

    def _take_turn(self) -> None:
        with self._lock:
            self._turn, due = None, self.next_time()
            action: Action | None = None
            if due is not None and due <= self.now:
                entry = heappop(self._heap)[3]
                action, entry.action = entry.action, None
        try:
            if action is not None:
                action()
        finally:
            with self._lock:
                self._plan()
