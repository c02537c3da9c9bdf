"""Machines with clocks and disks of their own, and processes on them that are killed, stopped and continued.

A process is a scheduler: all that it does are entries of the team's scheduler, which run only while it lives. A stopped
process keeps the entries that became due, in their order, and its steady clock goes on, as after SIGSTOP.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any
from unittest.mock import patch
from uuid import UUID

from fame.clock import SECOND, Action, Entry, Kind, Scheduler
from fame.deploy import engine_node
from fame.middleware import actions
from fame.robot import journal
from fame.scripting import runner
from fame.worker import Done, Worker, outcome

from .disks import Disk, PowerLoss

START = 1_700_000_000.0
"""The date at which a run begins (s since 1970)."""


@contextmanager
def ids_of(seed: int) -> Iterator[None]:
    """What processes draw to tell goals, journals and signals apart is that of a seed meanwhile."""
    chance = random.Random(f"{seed} ids")

    def draw() -> UUID:
        return UUID(int=chance.getrandbits(128), version=4)

    with ExitStack() as patches:
        for module in (actions, engine_node, journal, runner):
            patches.enter_context(patch.object(module, "uuid4", draw))
        yield


class Machine:
    """A computer: its wall clock may be wrong (`ahead`, s) and too fast (`drift`, s per s)."""

    def __init__(self, name: str, scheduler: Scheduler, seed: int) -> None:
        self.name, self.ahead, self.drift = name, 0.0, 0.0
        self._scheduler = scheduler
        self.disk = Disk(f"{seed} disk {name}", self.wall_time)
        self.busy = random.Random(f"{seed} busy {name}")

    def wall_time(self) -> float:
        """Seconds since 1970, as its clock says."""
        return START + self._scheduler.now / SECOND * (1 + self.drift) + self.ahead

    def change_drift(self, drift: float) -> None:
        """Its clock runs faster or slower from now on, without a jump."""
        self.ahead -= self._scheduler.now / SECOND * (drift - self.drift)
        self.drift = drift


class Process(Scheduler):
    """A process on a machine. `on_error` gets what leaves one of its entries: an error, or a loss of power."""

    is_simulated = False

    def __init__(
        self, name: str, machine: Machine, team: Scheduler, on_error: Callable[[Process, Exception | PowerLoss], object]
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
        team, origin = self._team, self._origin
        now = team.now - origin
        entry = Entry(time if time > now else now, action, self)
        team.at(entry.time + origin, partial(self._run, entry), kind)
        return entry

    def worker(self, name: str) -> Worker:
        return _Worker(self, 1.5 if "load" in name else 0.05)

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
            except (Exception, PowerLoss) as error:
                self._on_error(self, error)


class _Worker(Worker):
    """A worker whose functions take some time, at most `longest` s, and have their effect at its end."""

    def __init__(self, process: Process, longest: float) -> None:
        self._process, self._longest = process, longest
        self._queue: deque[tuple[Callable[[], Any], Done]] = deque()

    def call(self, function: Callable[[], Any], done: Done) -> None:
        self._queue.append((function, done))
        if len(self._queue) == 1:
            self._begin()

    def interrupt(self) -> None:
        self._queue.clear()

    def close(self) -> None:
        queue, self._queue = self._queue, deque()
        for function, done in queue:
            self._process.soon(partial(done, *outcome(function)))

    def _begin(self) -> None:
        delay = self._process.machine.busy.uniform(0, self._longest)
        self._process.after(round(delay * SECOND), self._end, Kind.RESUMPTION)

    def _end(self) -> None:
        if self._queue:
            function, done = self._queue[0]
            found = outcome(function)
            if self._queue:
                self._queue.popleft()
            if self._queue:
                self._begin()
            done(*found)
