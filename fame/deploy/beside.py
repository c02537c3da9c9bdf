"""Long work beside the thread of the scheduler, which goes on with the mission meanwhile.

A task is a generator. What it does between two ``yield``s is done in the scheduler's thread; what it yields is a
function, called in a thread beside it, whose result (or error) comes back to the ``yield``. Under simulated time all of
it is done at once, so a simulated run stays repeatable.

Python runs one thread at a time and changes between them every few milliseconds, so the mission hardly notices.
Collecting garbage would stop all threads, the longer the more is being made: it waits until the work is done.
"""

from __future__ import annotations

import ctypes
import gc
import threading
from collections.abc import Callable, Generator
from functools import partial
from typing import Any, Generic, TypeVar

from fame.clock import SECOND, Kind, Scheduler, WallScheduler
from fame.errors import FameError, ModelError

Result = TypeVar("Result")
Task = Generator[Callable[[], Any], Any, Result]

LIMIT = 60.0
"""How long the work of a task may take (s)."""


class TooLong(BaseException):
    """Ends a thread whose task has been given up."""


class Work(Generic[Result]):
    """A task under way. `done` is called once, in the scheduler's thread, with its result or its FameError."""

    def __init__(self, scheduler: Scheduler, task: Task[Result], done: Callable[[Result | FameError], object]) -> None:
        self._scheduler, self._task, self._done = scheduler, task, done
        self._beside = isinstance(scheduler, WallScheduler)
        self._thread: threading.Thread | None = None
        self._limit = scheduler.after(round(LIMIT * SECOND), self._give_up, Kind.TIMER) if self._beside else None
        self._go_on(task.send, None)

    def _go_on(self, step: Callable[[Any], Callable[[], Any]], value: Any) -> None:
        """Do the task up to its next function."""
        if self._limit is not None and self._limit.action is None:
            return  # given up
        try:
            function = step(value)
        except StopIteration as end:
            self._end(end.value)
        except FameError as error:
            self._end(error)
        else:
            self._call(function)

    def _call(self, function: Callable[[], Any]) -> None:
        if not self._beside:
            self._go_on(*self._outcome(function))
            return
        self._thread = threading.Thread(target=self._call_beside, args=(function,), name="fame load", daemon=True)
        self._thread.start()

    def _call_beside(self, function: Callable[[], Any]) -> None:
        gc.disable()
        try:
            outcome = self._outcome(function)
        except TooLong:
            return
        finally:
            gc.enable()
        self._scheduler.soon(partial(self._go_on, *outcome), Kind.RESUMPTION)

    def _outcome(self, function: Callable[[], Any]) -> tuple[Callable[[Any], Callable[[], Any]], Any]:
        """How the task goes on after a function."""
        try:
            return self._task.send, function()
        except Exception as error:
            return self._task.throw, error

    def _give_up(self) -> None:
        if self._thread is not None:  # it ends at its next step of Python
            ctypes.pythonapi.PyThreadState_SetAsyncExc(
                ctypes.c_ulong(self._thread.ident or 0), ctypes.py_object(TooLong)
            )
        self._task.close()
        self._done(ModelError(f"takes more than {LIMIT:g} s to be read and checked"))

    def _end(self, outcome: Result | FameError) -> None:
        if self._limit is not None:
            self._limit.cancel()
        self._done(outcome)
