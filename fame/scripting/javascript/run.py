"""One run of a script, from its first step to the last of its callbacks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fame.scripting.javascript.environment import Environment
from fame.scripting.javascript.source import Script
from fame.scripting.requests import MessageQueue, Next

if TYPE_CHECKING:
    from fame.scripting.javascript.realm import Realm


class Run:
    """`suspended` is what the engine waits for, if it does; `callbacks` are the numbers of those that may come.

    `entrusted`: it has put functions into variables, so that others may call next(). `rejection` is why a promise of it
    was rejected, if one was.
    """

    __slots__ = ("callbacks", "entrusted", "environment", "number", "rejection", "script", "suspended")

    def __init__(self, number: int, script: Script, environment: Environment) -> None:
        self.number, self.script, self.environment = number, script, environment
        self.callbacks: dict[int, None] = {}
        self.suspended: Suspended | None = None
        self.entrusted, self.rejection = False, ""


class _Answer(MessageQueue):
    """The queue that takes the one word that a script is over."""

    __slots__ = ()

    def __str__(self) -> str:
        return "a callback to call next()"


class Suspended:
    """A script that has returned without next(): what `fame.scripting.runner` drives instead of a coroutine.

    It asks for one thing, which comes when next() is called. Cancelled, it is out at once, with all its callbacks.
    """

    __slots__ = ("_answer", "_asked", "_realm", "_run")

    def __init__(self, realm: Realm, run: Run) -> None:
        self._realm, self._run, self._asked = realm, run, False
        self._answer = _Answer("next", 1)

    def end(self, error: BaseException | None) -> None:
        """next() was called, or something failed."""
        self._answer.put((error,))

    def send(self, value: Any) -> Next:
        """A step, as of a coroutine."""
        if not self._asked:
            self._asked = True
            return Next(self._answer)
        (error,) = value
        if error is not None:
            raise error
        raise StopIteration

    def throw(self, error: BaseException) -> Next:
        """The runner ends it."""
        self._realm.cancel(self._run)
        raise error

    def close(self) -> None:
        """It is not wanted any more."""
        self._realm.cancel(self._run)
