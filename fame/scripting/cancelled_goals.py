"""Goals that a robot has cancelled and that may still run: their server refuses, is slow, or is away.

A cancelled goal counts as running until its server says that it has ended. One that the server refuses to cancel, or
that has not ended `BOUND` later, is reported, once, and again when it has ended.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from fame.clock import SECOND, Entry, Kind, Scheduler
from fame.dataclasses import dataclass, field
from fame.errors import MessageError
from fame.middleware.actions import ActionClient, Goal, GoalEnd

BOUND = 5.0
"""Time in which a cancelled goal is expected to end (s): Nav2 brings a robot to a stop first."""
_AGAIN = (SECOND, 3 * SECOND)
"""Delays (ns) after which an earlier goal, unknown to its server, is cancelled again: the request to accept it may
arrive after the one to cancel it."""
_KEPT = 100
"""Number of goals that have ended whose outcome is known."""


@dataclass(slots=True)
class _Cancelled:
    """A goal of `client` that was cancelled, and when this is reported if it has not ended. `told`: it was reported.
    `again` are delays of further cancellations, should its server not know it (ns).
    """

    client: ActionClient
    goal: Goal
    told: bool
    again: Sequence[int] = ()
    late: Entry = field(init=False)

    @property
    def text(self) -> str:
        """What is known of it; empty while there is nothing to report."""
        if self.goal.refused:
            return f"{self.client.name}: a cancelled goal still runs: its server refuses to cancel it"
        if not self.told:
            return ""
        if not self.client.available:
            return f"{self.client.name}: a cancelled goal may still run: its server has left"
        return f"{self.client.name}: a cancelled goal still runs: it has not ended within {BOUND:g} s"


class CancelledGoals:
    """Those of one robot. `report` takes what a person should know.

    `on_still_running` is called with the full name of the action when a goal is reported first.
    """

    on_still_running: Callable[[str], object]

    def __init__(self, scheduler: Scheduler, report: Callable[[str], object]) -> None:
        self._scheduler, self._report = scheduler, report
        self.on_still_running = lambda action: None
        self._goals: dict[bytes, _Cancelled] = {}
        self._outcomes: dict[bytes, GoalEnd | None] = {}

    def cancel(self, client: ActionClient, goal: Goal) -> None:
        """Cancel a goal, unless it has ended."""
        goal.cancel()
        if client.cancelled.get(goal.id) is goal:
            self._add(client, goal, told=False)

    def table(self) -> dict[str, list[Any]]:
        """Return them as plain data: hex id -> name and type of the action, and whether it was reported."""
        return {id.hex(): [one.client.name, one.client.type, one.told] for id, one in self._goals.items()}

    def take_up(self, table: Mapping[str, Sequence[Any]], client_of: Callable[[str, str], ActionClient]) -> None:
        """Cancel the goals of a `table`, of a process that has ended, once more, and follow them.

        `client_of` gives the client of an action by name and type; it may raise MessageError.
        """
        for id, (name, type, told) in table.items():
            try:
                client = client_of(name, type)
            except MessageError as error:
                self._report(f"{name}: a cancelled goal may still run: {error}")
                continue
            self._add(client, client.cancel(bytes.fromhex(id)), told=told, again=_AGAIN)

    def outcome(self, id: bytes) -> GoalEnd | None:
        """Return how one of the last goals has ended; None for one that may still run."""
        return self._outcomes.get(id, None if id in self._goals else "unknown")

    def actions(self) -> list[str]:
        """Return the full name of each action with such a goal, in order."""
        return sorted({one.client.name for one in self._goals.values()})

    def texts(self) -> list[str]:
        """Return what is reported now."""
        return list(dict.fromkeys(filter(None, [one.text for one in tuple(self._goals.values())])))

    def close(self) -> None:
        """Follow them no longer."""
        for goal in self._goals.values():
            goal.late.cancel()
        self._goals.clear()

    def _add(self, client: ActionClient, goal: Goal, *, told: bool, again: Sequence[int] = ()) -> None:
        cancelled = _Cancelled(client, goal, told, again)
        cancelled.late = self._scheduler.after(round(BOUND * SECOND), partial(self._tell, cancelled), Kind.TIMER)
        self._goals[goal.id], client.on_cancelled = cancelled, self._on_change

    def _on_change(self, goal: Goal) -> None:
        """A server refuses to cancel a goal, or it has ended."""
        if (cancelled := self._goals.get(goal.id)) is None:
            return
        if cancelled.client.cancelled.get(goal.id) is goal:
            self._tell(cancelled)
            return
        if goal.outcome == "unknown" and cancelled.again:
            delay, *cancelled.again = cancelled.again
            self._scheduler.after(delay, partial(self._cancel_again, cancelled), Kind.TIMER)
            return
        del self._goals[goal.id]
        self._outcomes[goal.id] = goal.outcome
        for id in list(self._outcomes)[:-_KEPT]:
            del self._outcomes[id]
        cancelled.late.cancel()
        if cancelled.told:
            self._report(f"{cancelled.client.name}: the cancelled goal has ended")

    def _cancel_again(self, cancelled: _Cancelled) -> None:
        if self._goals.get(cancelled.goal.id) is cancelled:
            cancelled.goal = cancelled.client.cancel(cancelled.goal.id)

    def _tell(self, goal: _Cancelled) -> None:
        goal.late.cancel()
        if not goal.told:
            goal.told = True
            self._report(goal.text)
            self.on_still_running(goal.client.name)
