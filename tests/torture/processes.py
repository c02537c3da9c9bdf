"""Machines with clocks of their own, and processes on them that are killed, stopped and continued.

A process is a scheduler: all that it does are entries of the team's scheduler, which run only while it lives. A stopped
process keeps the entries that became due, in their order, and its steady clock goes on, as after SIGSTOP.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from fame.clock import SECOND, Action, Entry, Kind, Scheduler

START = 1_700_000_000.0
"""The date at which a run begins (s since 1970)."""


class Machine:
    """A computer: its wall clock may be wrong (`ahead`, s) and too fast (`drift`, s per s)."""

    def __init__(self, name: str, scheduler: Scheduler) -> None:
        self.name, self.ahead, self.drift = name, 0.0, 0.0
        self._scheduler = scheduler

    def wall_time(self) -> float:
        """Seconds since 1970, as its clock says."""
        return START + self._scheduler.now / SECOND * (1 + self.drift) + self.ahead


class Process(Scheduler):
    """A process on a machine. `on_error` is called with an exception that leaves one of its entries."""

    def __init__(
        self, name: str, machine: Machine, team: Scheduler, on_error: Callable[[Process, Exception], object]
    ) -> None:
        self._team, self._origin = team, team.now
        super().__init__()
        self.name, self.machine = name, machine
        self.alive, self.stopped = True, False
        self._on_error = on_error
        self._held: list[Entry] = []

    @property
    def now(self) -> int:
        """Nanoseconds since the process began, by the steady clock of its machine."""
        return self._team.now - self._origin

    @now.setter
    def now(self, value: int) -> None:
        pass

    def at(self, time: int, action: Action, kind: Kind = Kind.TIMER) -> Entry:
        entry = Entry(max(time, self.now), action, self)
        self._team.at(entry.time + self._origin, partial(self._run, entry), kind)
        return entry

    def stop(self) -> None:
        """SIGSTOP."""
        self.stopped = True

    def go_on(self) -> None:
        """SIGCONT."""
        self.stopped = False
        held, self._held = self._held, []
        for entry in held:
            self._run(entry)

    def kill(self) -> None:
        """SIGKILL."""
        self.alive = False
        self._held.clear()

    def _run(self, entry: Entry) -> None:
        if self.stopped:
            self._held.append(entry)
        elif self.alive and entry.action is not None:
            action, entry.action = entry.action, None
            try:
                action()
            except Exception as error:
                self._on_error(self, error)
