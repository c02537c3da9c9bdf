"""Drive a pure state machine: feed it events, carry its actions out; keep out what messages could do to it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

from fame.errors import FameError

_State = TypeVar("_State")
_Event = TypeVar("_Event")
_Action = TypeVar("_Action")


def boundary(handle: Callable[[Any], object], refuse: Callable[[str], object]) -> Callable[[Any], None]:
    """Return a handler of messages from outside for which no message ends this process: `refuse` gets what went wrong.

    Only a FameError passes. For the signals of a mission there is no such boundary: their errors belong to its engine.
    """

    def receive(message: Any) -> None:
        try:
            handle(message)
        except FameError:
            raise
        except Exception as error:  # whatever somebody sent
            refuse(unexpected(error))

    return receive


def unexpected(error: Exception) -> str:
    """Return the reason of a refusal for an error that nobody foresaw. A MemoryError is raised again: what the message
    has begun may be half done (`fame.clock.Scheduler.on_no_memory`)."""
    if isinstance(error, MemoryError):
        raise error
    return f"it could not be handled: {type(error).__name__}: {error}"


class ProtocolMachine(Generic[_State, _Event, _Action]):
    """The `state` of a ``step(state, event) -> (state, actions)``; `perform` carries one action out.

    An event that arises while actions are carried out is handled after them: steps never nest.
    """

    def __init__(
        self,
        state: _State,
        step: Callable[[_State, _Event], tuple[_State, Sequence[_Action]]],
        perform: Callable[[_Action], object],
    ) -> None:
        self.state: _State = state
        self._step, self._perform = step, perform
        self._events: deque[_Event] = deque()

    def handle(self, event: _Event) -> None:
        """Handle an event, now or after the current one."""
        self._events.append(event)
        if len(self._events) > 1:
            return
        try:
            while self._events:
                self.state, actions = self._step(self.state, self._events[0])
                for action in actions:
                    self._perform(action)
                self._events.popleft()
        finally:
            self._events.clear()
