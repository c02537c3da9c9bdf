"""One run of a script, from its first step to the last of its callbacks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from fame.scripting.javascript.environment import Environment
from fame.scripting.javascript.source import Script
from fame.scripting.requests import MessageQueue, Next


class Run:
    """The state of one run.

    suspended  what the engine waits for, None if it does not wait
    callbacks  the numbers of callbacks that may come
    entrusted  whether it has put functions into variables, so that other scripts may call next()
    rejection  why one of its promises was rejected, empty if none was
    """

    __slots__ = ("callbacks", "entrusted", "environment", "number", "rejection", "script", "suspended")

    number: int
    script: Script
    environment: Environment

    def __init__(self, number: int, script: Script, environment: Environment) -> None:
        self.number, self.script, self.environment = number, script, environment
        self.callbacks: dict[int, None] = {}
        self.suspended: Suspended | None = None
        self.entrusted: bool = False
        self.rejection: str = ""


class _EndOfScript(MessageQueue):
    """A queue for the one message that the script is over."""

    __slots__ = ()

    def __str__(self) -> str:
        return "a callback to call next()"


class Suspended:
    """A script that has returned without calling next(): `fame.scripting.runner` drives it like a coroutine.

    It awaits a single message, which comes when next() is called. `cancel` ends the run with all its callbacks.
    """

    __slots__ = ("_asked", "_cancel", "_queue")

    def __init__(self, cancel: Callable[[], object]) -> None:
        self._cancel, self._asked = cancel, False
        self._queue = _EndOfScript("next", 1)

    def end(self, error: BaseException | None) -> None:
        """Resume the script: next() was called, or something failed."""
        self._queue.put((error,))

    def send(self, value: Any) -> Next:
        """Run one step, like the method of a coroutine."""
        if not self._asked:
            self._asked = True
            return Next(self._queue)
        (error,) = value
        if error is not None:
            raise error
        raise StopIteration

    def throw(self, error: BaseException) -> Next:
        """Cancel the run and raise the error, like the method of a coroutine."""
        self._cancel()
        raise error

    def close(self) -> None:
        """Cancel the run."""
        self._cancel()
