"""Drive a pure state machine: feed it events, carry its actions out."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

State = TypeVar("State")
Event = TypeVar("Event")
Action = TypeVar("Action")


class Machine(Generic[State, Event, Action]):
    """The `state` of a ``step(state, event) -> (state, actions)``; `perform` carries one action out.

    An event that arises while actions are carried out is handled after them: steps never nest.
    """

    state: State

    def __init__(
        self,
        state: State,
        step: Callable[[State, Event], tuple[State, Sequence[Action]]],
        perform: Callable[[Action], object],
    ) -> None:
        self.state: State = state
        self._step, self._perform = step, perform
        self._events: deque[Event] = deque()

    def handle(self, event: Event) -> None:
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
