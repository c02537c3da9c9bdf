"""Waiting for data: in a thread of its own, or in that of a `DataScheduler`.

A `DataWaiter` never takes a sample: it calls the action that was added with the reader. Samples stay in Cyclone,
bounded by the quality of service of the reader, until their subscription takes them.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from itertools import count

from cyclonedds.core import DDSException, DDSStatus, Entity, GuardCondition
from cyclonedds.domain import DomainParticipant
from cyclonedds.internal import dds_infinity

from fame.middleware.dds.cyclone import KeyedWaitSet, delete


class DataWaiter:
    """Readers, and the actions to call when data come for them. `on_wake` is called after `wake`."""

    def __init__(self, participant: DomainParticipant, on_wake: Callable[[], object] = lambda: None) -> None:
        self._waitset = KeyedWaitSet(participant)
        self._guard = GuardCondition(participant)
        self._on_wake = on_wake
        self._count = count(1)
        self._readers: dict[int, tuple[Entity, Callable[[], object]]] = {}
        self._waitset.attach(self._guard, 0)
        self._thread: threading.Thread | None = None
        self._stopping = False
        self._closed, self._waking = False, threading.RLock()  # a signal handler may interrupt its own thread

    def start(self) -> None:
        """Wait in a thread, until `close`."""
        self._thread = threading.Thread(target=self._work, name="dds", daemon=True)
        self._thread.start()

    def add(self, reader: Entity, action: Callable[[], object]) -> None:
        """Call `action`, in the thread that waits, when data come for `reader`. It must be quick."""
        key = next(self._count)
        self._readers[key] = reader, action
        reader.set_status_mask(DDSStatus.DataAvailable)
        self._waitset.attach(reader, key)

    def remove(self, reader: Entity) -> None:
        """Forget a reader, if it is here."""
        for key, (known, _) in list(self._readers.items()):
            if known is reader:
                del self._readers[key]
                self._waitset.detach(reader)

    def wake(self) -> None:
        """Wake up the thread that waits, from any thread, also after `close`. Calls while none waits count as one."""
        with self._waking:
            if not self._closed:  # else the guard has been deleted
                self._guard.set(True)

    def wait(self, timeout: int = dds_infinity) -> None:
        """Wait for data or `wake`, at most `timeout` ns, and call the actions. One thread at a time."""
        for key in self._waitset.wait(timeout):
            self._handle(key)

    def close(self) -> None:
        """Stop waiting, and delete the entities."""
        self._stopping = True
        self.wake()
        if self._thread is not None:
            self._thread.join()
        with self._waking:
            self._closed = True
        self._waitset.close()
        delete(self._guard)

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
