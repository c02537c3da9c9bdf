"""Waiting for data: in a thread of its own, or in that of a `DataScheduler`.

A `DataWaiter` never takes a sample: it calls the action that was added with the reader. Samples stay in Cyclone,
bounded by the quality of service of the reader, until their subscription takes them.
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

_MAX_REPORTED = 64
"""How many readers one wait reports at most; the next reports the others."""


class DataWaiter:
    """Readers, and the actions to call when data come for them. `on_wake` is called after `wake`."""

    def __init__(self, participant: DomainParticipant, on_wake: Callable[[], object] = lambda: None) -> None:
        self._waitset = WaitSet(participant)
        self._guard = GuardCondition(participant)
        self._on_wake = on_wake
        self._count = count(1)
        self._readers: dict[int, tuple[Entity, Callable[[], object]]] = {}
        self._keys: Any = (ctypes.c_void_p * _MAX_REPORTED)()
        self._attach(self._guard, 0)
        self._thread: threading.Thread | None = None
        self._stopping = False

    def start(self) -> None:
        """Wait in a thread, until `close`."""
        self._thread = threading.Thread(target=self._work, name="dds", daemon=True)
        self._thread.start()

    def add(self, reader: Entity, action: Callable[[], object]) -> None:
        """Call `action`, in the thread that waits, when data come for `reader`. It must be quick."""
        key = next(self._count)
        self._readers[key] = reader, action
        reader.set_status_mask(DDSStatus.DataAvailable)
        self._attach(reader, key)

    def remove(self, reader: Entity) -> None:
        """Forget a reader, if it is here."""
        for key, (known, _) in list(self._readers.items()):
            if known is reader:
                del self._readers[key]
                self._waitset._waitset_detach(self._waitset._ref, reader._ref)

    def wake(self) -> None:
        """Wake up the thread that waits, from any thread. Calls while none waits count as one."""
        self._guard.set(True)

    def wait(self, timeout: int = dds_infinity) -> None:
        """Wait for data or `wake`, at most `timeout` ns, and call the actions. One thread at a time."""
        number = self._waitset._waitset_wait(self._waitset._ref, self._keys, _MAX_REPORTED, timeout)
        for key in self._keys[: min(number, _MAX_REPORTED)]:
            self._handle(key or 0)  # 0 comes as None

    def close(self) -> None:
        """Stop waiting, and delete the entities."""
        self._stopping = True
        self.wake()
        if self._thread is not None:
            self._thread.join()
        for entity in (self._waitset, self._guard):
            delete(entity)

    def _attach(self, entity: Entity, key: int) -> None:
        # `WaitSet.attach` and `wait` of cyclonedds do not return which of the entities it is.
        self._waitset._waitset_attach(self._waitset._ref, entity._ref, key)

    def _work(self) -> None:
        while not self._stopping:
            self.wait()

    def _handle(self, key: int) -> None:
        if key == 0:
            self._guard.take()
            self._on_wake()
            return
        reader, action = self._readers.get(key, (None, None))
        try:
            if reader is not None and action is not None and reader.take_status(DDSStatus.DataAvailable):
                action()
        except DDSException:
            if key in self._readers:  # else it was removed meanwhile
                raise


def delete(entity: Entity) -> None:
    """Delete a DDS entity now."""
    entity.__del__()  # the only way that cyclonedds offers
