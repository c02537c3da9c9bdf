"""Machines with clocks and disks of their own, and processes on them that are killed, stopped and continued.

A process is a scheduler: all that it does are entries of the team's scheduler, which run only while it lives. A stopped
process keeps the entries that became due, in their order, and its steady clock goes on, as after SIGSTOP.
"""

from __future__ import annotations

import random
import uuid
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from heapq import heappop, heappush
from typing import Any
from unittest.mock import patch
from uuid import UUID

from fame.clock import SECOND, Action, Entry, Kind, Scheduler
from fame.deploy import engine_node
from fame.robot import journal
from fame.worker import Done, Worker, outcome

from .disks import Disk, PowerLoss

START = 1_700_000_000.0
"""The date at which a run begins (s since 1970)."""


@contextmanager
def ids_of(seed: int) -> Iterator[None]:
    """What processes draw, also to tell goals, journals and signals apart, is that of a seed meanwhile."""
    chance = random.Random(f"{seed} ids")

    def draw() -> UUID:
        return UUID(int=chance.getrandbits(128), version=4)

    with ExitStack() as patches:
        for module in (uuid, engine_node, journal):  # others import it when they draw
            patches.enter_context(patch.object(module, "uuid4", draw))
        patches.enter_context(
            patch.object(engine_node, "new_seed", partial(random.Random(f"{seed} seeds").getrandbits, 32))
        )
        yield


LONGEST = 200_000
"""How many entries a run has at most: few have more than 20,000."""


class EndlessRunError(BaseException):
    """A run has no end: what is done leads to more and more. No process may catch this."""


class Timeline(Scheduler):
    """The time of a team. One queue has what is to be done and the entries of all processes, in their order.

    Raises EndlessRunError for more than `LONGEST` entries.
    """

    def at(self, time: int, action: Action, kind: Kind = Kind.TIMER) -> Entry:
        return self.enter(time, 0, Entry(time, action, self), kind)

    def enter(self, time: int, origin: int, entry: Entry, kind: Kind) -> Entry:
        """Enter what is to be done at `time` (ns); the clock of its process began at `origin`."""
        if time < self.now:
            time = self.now
        entry.time = time - origin
        number = next(self._sequence)
        if number > LONGEST:
            raise EndlessRunError(f"the run does not end: {LONGEST} entries at {self.now / SECOND:g} s")
        heappush(self._heap, (time, kind, number, entry))
        return entry

    def _work(self, until: int | None) -> None:
        heap, end = self._heap, self.now if until is None else until
        while heap and heap[0][0] <= end:
            self.now, _, _, entry = heappop(heap)
            action = entry.action
            if action is not None and isinstance(process := entry._queue, Process):
                process.do(entry, action)
            elif action is not None:
                entry.action = None
                action()
        self.now = end


WRITING = 0.05
"""How long a disk takes at most (s) to write what a worker gives it."""


class Machine:
    """A computer: its wall clock may be wrong (`ahead`, s) and too fast (`drift`, s per s), its disk `slow` (s)."""

    def __init__(self, name: str, scheduler: Scheduler, seed: int) -> None:
        self.name, self.ahead, self.drift = name, 0.0, 0.0
        self.slow = self.slowest = WRITING
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

    def slow_down(self, seconds: float) -> None:
        """Its disk takes so long from now on, which is no fault that ends."""
        self.slow, self.slowest = seconds, max(self.slowest, seconds)


class Process(Scheduler):
    """A process on a machine. `on_error` gets what leaves one of its entries: an error, or a loss of power."""

    is_simulated = False

    def __init__(
        self, name: str, machine: Machine, team: Timeline, on_error: Callable[[Process, Exception | PowerLoss], object]
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
        return self._team.enter(time + self._origin, self._origin, Entry(time, action, self), kind)

    def after(self, delay: int, action: Action, kind: Kind = Kind.TIMER) -> Entry:
        return self._team.enter(self._team.now + delay, self._origin, Entry(delay, action, self), kind)

    def soon(self, action: Action, kind: Kind = Kind.MESSAGE) -> Entry:
        return self._team.enter(self._team.now, self._origin, Entry(0, action, self), kind)

    def worker(self, name: str) -> Worker:
        return _Worker(self, 1.5 if "load" in name else 0.0)

    def stop(self) -> None:
        """SIGSTOP."""
        self.stopped = True

    def go_on(self) -> None:
        """SIGCONT."""
        self.stopped = False
        held, self._held = self._held, []
        for entry in held:
            if entry.action is not None:
                self.do(entry, entry.action)

    def kill(self) -> None:
        """SIGKILL."""
        self.alive = False
        self._held.clear()

    def do(self, entry: Entry, action: Action) -> None:
        """Do what an entry has, unless the process is dead; as soon as it goes on if it is stopped."""
        if self.stopped:
            self._held.append(entry)
        elif self.alive:
            entry.action = None
            try:
                action()
            except (Exception, PowerLoss) as error:
                self._on_error(self, error)


class _Worker(Worker):
    """A worker whose functions take some time, at most `longest` s, or what the disk takes, and have their effect then.

    What they write to the disk is what was there when they began.
    """

    def __init__(self, process: Process, longest: float) -> None:
        self._process, self._longest = process, longest
        self._queue: deque[tuple[Callable[[], Any], Done]] = deque()
        self._begun: dict[Any, int] = {}

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
        machine = self._process.machine
        self._begun = machine.disk.sizes()
        delay = machine.busy.uniform(0, self._longest or machine.slow)
        self._process.after(round(delay * SECOND), self._end, Kind.RESUMPTION)

    def _end(self) -> None:
        if self._queue:
            function, done = self._queue[0]
            disk = self._process.machine.disk
            disk.begun = self._begun
            try:
                found = outcome(function)
            finally:
                disk.begun = {}
            if self._queue:
                self._queue.popleft()
            if self._queue:
                self._begin()
            done(*found)
