"""Events of a run, and how observers get them: one by one, or a whole trail at a time.

While an engine handles a stimulus it only records what happens, and where. Observers are called when the stimulus has
been handled (and in between, if that takes long); all of it has the same time. On the wall clock times differ, so there
each record is passed on at once.

An observer is a function of an `Event`. An observer with a method `trail` gets the records as they are, so that no
event need be made of each: logs do that. One with a method `watch` gets each `RobotNode` whose events it will get, and
returns a function that is called after each step of a script. One with a method `watch_world` gets a function that
records the simulated world, and `run_ends` is told whether the run was complete. Recordings use all of them
(`fame.log.recorder`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from fame.clock import SECOND
from fame.imports import require

if TYPE_CHECKING:
    import pandas

    from fame.engine.program import Mark
    from fame.engine.state import Trail
    from fame.robot.node import RobotNode

Observer = Callable[["Event"], object]
OnTrail = Callable[[int, str, "Trail"], object]
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


def trail_handler(observer: Observer) -> OnTrail:
    """The function that passes trails to an observer: its own method `trail`, or one that makes the events."""
    own: OnTrail | None = getattr(observer, "trail", None)
    if own is not None:
        return own

    def make_events(time: int, robot: str, trail: Trail) -> None:
        for scope, marks in trail:
            where = (time, robot, scope.instance.key, scope.key)
            for mark in marks:
                # As Event(...) does, without the detour through its keyword arguments: this runs for every move.
                observer(_new_tuple(Event, where + mark))

    return make_events


class EventLog:
    """An observer that keeps all events. Iterating makes them; until then an event takes a few bytes."""

    def __init__(self) -> None:
        self._kept: list[tuple[tuple[int, str, int, int], Sequence[Mark]]] = []

    def __call__(self, event: Event) -> None:
        self._kept.append((event[:4], (event[4:],)))

    def trail(self, time: int, robot: str, trail: Trail) -> None:
        """Keep what happened at one instant."""
        self._kept += [((time, robot, scope.instance.key, scope.key), marks) for scope, marks in trail]

    def __len__(self) -> int:
        return sum(len(marks) for _, marks in self._kept)

    def __iter__(self) -> Iterator[Event]:
        for where, marks in self._kept:
            for mark in marks:
                yield Event(*where, *mark)

    def to_pandas(self) -> pandas.DataFrame:
        """Return a `pandas.DataFrame` with a row for each event: the fields of `Event`, with ``time`` in seconds.

        Raises UnavailableError if pandas is not installed.
        """
        require("pandas")
        import pandas

        table = pandas.DataFrame(self, columns=Event._fields)
        table["time"] /= SECOND
        return table


def combine_observers(observers: Sequence[Observer]) -> Observer | None:
    """One observer that calls several, in this order; None for an empty sequence."""
    return _CombinedObserver(observers) if len(observers) > 1 else next(iter(observers), None)


class _CombinedObserver:
    def __init__(self, observers: Sequence[Observer]) -> None:
        self._observers, self._trails = observers, [trail_handler(observer) for observer in observers]

    def watch(self, node: RobotNode) -> Callable[[], object]:
        """Pass a robot to the observers that watch robots."""
        steps = [observer.watch(node) for observer in self._observers if hasattr(observer, "watch")]
        return steps[0] if len(steps) == 1 else lambda: [step() for step in steps]

    def watch_world(self, record: Callable[[Callable[..., object]], object]) -> None:
        """Pass a simulated world to the observers that record it."""
        for observer in self._observers:
            if hasattr(observer, "watch_world"):
                observer.watch_world(record)

    def run_ends(self, complete: bool) -> None:
        """Tell the observers that record it how the run ends, before it is stopped."""
        for observer in self._observers:
            if hasattr(observer, "run_ends"):
                observer.run_ends(complete)

    def __call__(self, event: Event) -> None:
        for observer in self._observers:
            observer(event)

    def trail(self, time: int, robot: str, trail: Trail) -> None:
        """Pass a trail to all of them."""
        for on_trail in self._trails:
            on_trail(time, robot, trail)
