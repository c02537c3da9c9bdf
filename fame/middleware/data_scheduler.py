"""A wall-clock scheduler that waits for the data of a middleware itself.

With a plain `WallScheduler` a thread of the middleware waits for data and wakes the scheduler up, which costs 30 to 100
microseconds per message. A `DataScheduler` waits for data itself while nothing is due, and polls for data while it is
busy.
"""

from __future__ import annotations

import threading
from collections import deque
from typing import Protocol

from fame.clock import SECOND, Action, Entry, Kind, WallScheduler

_MAX_WAIT = SECOND // 10
"""Longest single wait (ns): Python handles signals only between waits."""
_POLL = SECOND // 1000
"""Interval of polling for data while work is due (ns)."""


class Waiter(Protocol):
    """Waits for the data of a middleware."""

    def wait(self, timeout: int) -> None:
        """Wait for data or `wake`, at most `timeout` ns, and handle received data. One thread at a time."""

    def wake(self) -> None:
        """Wake up the thread that waits, from any thread."""


class DataScheduler(WallScheduler):
    """A `WallScheduler` for one middleware; without one it is a plain `WallScheduler`.

    `waiter` is that of the middleware, None before it is made and after it is closed.
    """

    def __init__(self) -> None:
        super().__init__()
        self.waiter: Waiter | None = None
        self._polled = 0
        self._runner = 0
        self._arrived: deque[tuple[int, Action]] = deque()  # time, and what to do with a message

    def at(self, time: int, action: Action, kind: Kind = Kind.TIMER) -> Entry:
        entry = super().at(time, action, kind)
        self._wake()
        return entry

    def arrived(self, action: Action) -> None:
        """Do `action`, with a message that the waiter has handled, as `soon` does; in this thread far cheaper."""
        if self.waiter is not None and threading.get_ident() == self._runner:
            self._arrived.append((self.now, action))
        else:
            self.soon(action)

    def stop(self) -> None:
        super().stop()
        self._wake()

    def run(self, until: int | None = None) -> None:
        self._runner = threading.get_ident()
        super().run(until)

    def _wait(self, until: int | None) -> Action | None:
        while (waiter := self.waiter) is not None:
            now = self.now
            if now - self._polled > _POLL:
                self._wait_for_data(waiter, 0)
            if self._arrived and not self._stopping and (action := self._take_arrived(until)):
                return action
            with self._changed:
                if self._stopping:
                    return None
                due, now = self.next_time(), self.now
                end = min((moment for moment in (due, until) if moment is not None), default=now + _MAX_WAIT)
                if end <= now:
                    if end != due:
                        return None
                    if action := self._take():
                        return action
                    continue
            self._wait_for_data(waiter, 0 if self._arrived else min(end - now, _MAX_WAIT))
        return super()._wait(until)

    def _take_arrived(self, until: int | None) -> Action | None:
        """Take the first message, if nothing was due before it."""
        time, action = self._arrived[0]
        heap = self._heap
        if (heap and heap[0][0] < time) or (until is not None and time > until):
            return None
        self._arrived.popleft()
        return action

    def _wake(self) -> None:
        if self.waiter is not None and threading.get_ident() != self._runner:
            self.waiter.wake()

    def _wait_for_data(self, waiter: Waiter, time: int) -> None:
        waiter.wait(time)
        self._polled = self.now
