"""The wall clock that waits in DDS: a message is taken by the thread that it is for, with no other in between.

With a plain `WallScheduler` a thread of the middleware waits for data and wakes the scheduler up, which costs about 30
microseconds per message. This one waits for data itself while nothing is due, and looks for them now and then while
there is much to do.
"""

from __future__ import annotations

import threading

from fame.clock import SECOND, Action, Entry, Kind, WallScheduler
from fame.middleware.dds.reading import Watch

_NAP = SECOND // 10
"""Longest single wait (ns): Python handles signals only between waits."""

_LOOK = SECOND // 1000
"""How long work that is due keeps data waiting (ns)."""


class DdsScheduler(WallScheduler):
    """A `WallScheduler` for one `DdsMiddleware`; without one it is a plain `WallScheduler`.

    `watch` is that of the middleware's readers, None before it was made and after it was closed.
    """

    def __init__(self) -> None:
        super().__init__()
        self.watch: Watch | None = None
        self._looked = 0
        self._runner = 0

    def at(self, time: int, action: Action, kind: Kind = Kind.TIMER) -> Entry:
        entry = super().at(time, action, kind)
        self._wake()
        return entry

    def stop(self) -> None:
        super().stop()
        self._wake()

    def run(self, until: int | None = None) -> None:
        self._runner = threading.get_ident()
        super().run(until)

    def _wait(self, until: int | None) -> Action | None:
        while (watch := self.watch) is not None:
            now = self.now
            if now - self._looked > _LOOK:
                self._rest(watch, 0)
            with self._changed:
                if self._stopping:
                    return None
                due, now = self.next_time(), self.now
                end = min((moment for moment in (due, until) if moment is not None), default=now + _NAP)
                if end <= now:
                    if end != due:
                        return None
                    if action := self._take():
                        return action
                    continue
            self._rest(watch, min(end - now, _NAP))
        return super()._wait(until)

    def _wake(self) -> None:
        if self.watch is not None and threading.get_ident() != self._runner:
            self.watch.ring()

    def _rest(self, watch: Watch, time: int) -> None:
        watch.wait(time)
        self._looked = self.now
