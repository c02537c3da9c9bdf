"""Work beside a scheduler, one function after the other: at once in simulated time, in a thread on the wall clock."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from queue import SimpleQueue
from typing import Any

Done = Callable[[Any, Exception | None], object]
"""Gets the result of a function, or its error, in the scheduler's thread."""


class Interrupted(BaseException):
    """Ends the function that an interrupted worker is at."""


class Worker:
    """Does each function at once, and tells `done` at once: in simulated time work takes no time."""

    def call(self, function: Callable[[], Any], done: Done) -> None:
        """Do a function after those before it, then call `done`."""
        done(*outcome(function))

    def interrupt(self) -> None:
        """Raise `Interrupted` in the function that is under way. What has been interrupted does no more work."""

    def close(self) -> None:
        """Wait for the work that was given, and end."""


class ThreadWorker(Worker):
    """Does the work in a thread of its own; `soon` has a function called in the scheduler's thread."""

    def __init__(self, name: str, soon: Callable[[Callable[[], object]], object]) -> None:
        self._name, self._soon = name, soon
        self._queue: SimpleQueue[tuple[Callable[[], Any], Done] | None] = SimpleQueue()
        self._thread: threading.Thread | None = None

    def call(self, function: Callable[[], Any], done: Done) -> None:
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name=self._name, daemon=True)
            self._thread.start()
        self._queue.put((function, done))

    def interrupt(self) -> None:
        if self._thread is not None:
            from fame.cpython import raise_in

            raise_in(self._thread, Interrupted)

    def close(self) -> None:
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join()

    def _work(self) -> None:
        try:
            for function, done in iter(self._queue.get, None):
                self._soon(partial(done, *outcome(function)))
        except Interrupted:
            return


def outcome(function: Callable[[], Any]) -> tuple[Any, Exception | None]:
    """Return the result of a function and no error, or its error."""
    try:
        return function(), None
    except Exception as error:
        return None, error
