"""What happened in a run, and how observers hear of it: event by event, or a whole trail at a time.

While an engine works off a stimulus it only notes what happens, and where. Observers hear of it
when the stimulus has been worked off (and, should that take long, in between); it all happened at one instant. On the
wall clock instants differ, so there each note is passed on at once.

An observer is a function of an `Event`. What has a method `trail` too is given the notes as they are, and need not have
an event made of each: so do logs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from fame.engine.program import Mark
from fame.engine.state import Trail

Observer = Callable[["Event"], object]
TakeTrail = Callable[[int, str, Trail], object]
"""Takes time (ns), robot, and what happened to it at that time."""

_new_tuple = tuple.__new__


class Event(NamedTuple):
    """One thing that happened. `time` in ns; `what` as in `fame.engine`, or ``log``, ``report``, ``answer``."""

    time: int
    robot: str
    instance: int
    scope: int
    element: str
    what: str
    detail: Any = None


def by_trails(observer: Observer) -> TakeTrail:
    """What takes trails for an observer: its own method, or one that makes the events."""
    own: TakeTrail | None = getattr(observer, "trail", None)
    if own is not None:
        return own

    def make_events(time: int, robot: str, trail: Trail) -> None:
        for scope, marks in trail:
            where = (time, robot, scope.instance.key, scope.key)
            for mark in marks:
                # As Event(...) does, without the detour through its keyword arguments: this is done for every move.
                observer(_new_tuple(Event, where + mark))

    return make_events


class EventLog:
    """An observer that keeps all that happened. Iterating makes the events; until then an event takes a few bytes."""

    def __init__(self) -> None:
        self._kept: list[tuple[tuple[int, str, int, int], Sequence[Mark]]] = []

    def __call__(self, event: Event) -> None:
        self._kept.append((event[:4], (event[4:],)))

    def trail(self, time: int, robot: str, trail: Trail) -> None:
        """What happened at one instant."""
        self._kept += [((time, robot, scope.instance.key, scope.key), marks) for scope, marks in trail]

    def __len__(self) -> int:
        return sum(len(marks) for _, marks in self._kept)

    def __iter__(self) -> Iterator[Event]:
        for where, marks in self._kept:
            for mark in marks:
                yield Event(*where, *mark)


def together(observers: Sequence[Observer]) -> Observer | None:
    """One observer in place of several, which hear in this order; None if there are none."""
    return _Together(observers) if len(observers) > 1 else next(iter(observers), None)


class _Together:
    def __init__(self, observers: Sequence[Observer]) -> None:
        self._observers, self._trails = observers, [by_trails(observer) for observer in observers]

    def __call__(self, event: Event) -> None:
        for observer in self._observers:
            observer(event)

    def trail(self, time: int, robot: str, trail: Trail) -> None:
        """All of them hear of all of it."""
        for take in self._trails:
            take(time, robot, trail)


__all__ = ["Event", "EventLog", "Observer", "TakeTrail", "by_trails", "together"]
