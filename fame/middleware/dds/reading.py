"""Waiting for data, and for nothing else: in a thread of its own, or in that of the scheduler.

A watch never takes a sample: it says that there are some, by the action that was added with the reader. Who takes them
does so when it is his turn, so that what waits stays in Cyclone, bounded by the quality of service of the reader.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable
from itertools import count
from typing import Any

from cyclonedds.core import DDSException, DDSStatus, Entity, GuardCondition, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.internal import dds_infinity

_AT_ONCE = 64
"""How many readers one waiting reports at most; the others are reported by the next."""


class Watch:
    """Readers, and what to do when there is something in them. `rung` is what `ring` makes it do."""

    def __init__(self, participant: DomainParticipant, rung: Callable[[], object] = lambda: None) -> None:
        self._waitset = WaitSet(participant)
        self._bell = GuardCondition(participant)
        self._rung = rung
        self._count = count(1)
        self._watched: dict[int, tuple[Entity, Callable[[], object]]] = {}
        self._keys: Any = (ctypes.c_void_p * _AT_ONCE)()
        self._attach(self._bell, 0)
        self._thread: threading.Thread | None = None
        self._stopping = False

    def start(self) -> None:
        """Wait in a thread, until `close`."""
        self._thread = threading.Thread(target=self._work, name="dds", daemon=True)
        self._thread.start()

    def add(self, reader: Entity, action: Callable[[], object]) -> None:
        """Call `action`, in the thread that waits, when data come for `reader`. It must be quick."""
        key = next(self._count)
        self._watched[key] = reader, action
        reader.set_status_mask(DDSStatus.DataAvailable)
        self._attach(reader, key)

    def remove(self, reader: Entity) -> None:
        """Forget a reader, if it is here."""
        for key, (watched, _) in list(self._watched.items()):
            if watched is reader:
                del self._watched[key]
                self._waitset._waitset_detach(self._waitset._ref, reader._ref)

    def ring(self) -> None:
        """Wake up whoever waits, from any thread. Rings that come while nobody waits count as one."""
        self._bell.set(True)

    def wait(self, timeout: int = dds_infinity) -> None:
        """Wait until there are data or it rings, at most `timeout` ns, and call the actions. One thread at a time."""
        number = self._waitset._waitset_wait(self._waitset._ref, self._keys, _AT_ONCE, timeout)
        for key in self._keys[: min(number, _AT_ONCE)]:
            self._see(key or 0)  # 0 comes as None

    def close(self) -> None:
        """Stop waiting, and give everything back."""
        self._stopping = True
        self.ring()
        if self._thread is not None:
            self._thread.join()
        for entity in (self._waitset, self._bell):
            delete(entity)

    def _attach(self, entity: Entity, key: int) -> None:
        # `WaitSet.attach` and `wait` of cyclonedds would not tell which of the entities it is.
        self._waitset._waitset_attach(self._waitset._ref, entity._ref, key)

    def _work(self) -> None:
        while not self._stopping:
            self.wait()

    def _see(self, key: int) -> None:
        if key == 0:
            self._bell.take()
            self._rung()
            return
        reader, action = self._watched.get(key, (None, None))
        try:
            if reader is not None and action is not None and reader.take_status(DDSStatus.DataAvailable):
                action()
        except DDSException:
            if key in self._watched:  # else it was removed meanwhile
                raise


def delete(entity: Entity) -> None:
    """Delete an entity of DDS now."""
    entity.__del__()  # the only way that cyclonedds offers
