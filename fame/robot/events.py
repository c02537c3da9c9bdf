"""Events of a run, and how observers get them: one by one, or a whole trail at a time.

While an engine handles a stimulus it only records what happens, and where. Observers are called when the stimulus has
been handled (and in between, if that takes long); all of it has the same time. On the wall clock times differ, so there
each record is passed on at once.

An observer is a function of an `Event`, or an `Observer`, which may get more: the records as they are, so that no event
need be made of each (logs do that), the robots, and the simulated world (recordings do that: `fame.log.recorder`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

from fame.clock import SECOND
from fame.imports import require

if TYPE_CHECKING:
    import pandas

    from fame.engine.program import Mark
    from fame.engine.state import Trail
    from fame.robot.node import RobotNode

OnEvent = Callable[["Event"], object]
ENDED = "ended"
"""The last event of a run, of no robot: its detail is ``complete`` if nothing could come any more, else ``cut``."""


class Event(NamedTuple):
    """One thing that happened. `time` in ns; `what` as in `fame.engine`, or ``log``, ``report``, ``answer``.

    At the end of a run there is a ``verdict`` of no robot for each property; `detail` is its judgement as dict. The
    last event is `ENDED`.
    """

    time: int
    robot: str
    instance: int
    scope: int
    element: str
    what: str
    detail: Any = None


@runtime_checkable
class Observer(Protocol):
    """Follows a run. Classes that inherit from it override what they need."""

    def __call__(self, event: Event) -> object:
        """Take an event."""

    def trail(self, time: int, robot: str, trail: Trail) -> None:
        """Take what happened to a robot at a time (ns): by default, event by event."""
        for scope, marks in trail:
            where = (time, robot, scope.instance.key, scope.key)
            for mark in marks:
                self(Event._make(where + mark))

    def watch(self, node: RobotNode) -> Callable[[], object] | None:
        """Follow a robot from its first step on. What this returns is called after each step of a script."""
        return None

    def add_channels(self, record: Callable[[Callable[..., object]], object]) -> None:
        """Record other channels, as of a world: `record` is called with a function that takes their messages."""
        return None


def observer_of(observer: OnEvent) -> Observer:
    """Return the observer that a function of events is, or makes."""
    return observer if isinstance(observer, Observer) else _Function(observer)


class EventLog(Observer):
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


def combine_observers(observers: Sequence[OnEvent]) -> Observer | None:
    """Return one observer that calls several, in this order; None for an empty sequence."""
    made = [observer_of(observer) for observer in observers]
    return _CombinedObserver(made) if len(made) > 1 else next(iter(made), None)


class _Function(Observer):
    def __init__(self, function: OnEvent) -> None:
        self._function = function

    def __call__(self, event: Event) -> None:
        self._function(event)


class _CombinedObserver(Observer):
    def __init__(self, observers: Sequence[Observer]) -> None:
        self._observers = observers

    def watch(self, node: RobotNode) -> Callable[[], object] | None:
        steps = [step for observer in self._observers if (step := observer.watch(node)) is not None]
        return steps[0] if len(steps) == 1 else lambda: [step() for step in steps]

    def add_channels(self, record: Callable[[Callable[..., object]], object]) -> None:
        for observer in self._observers:
            observer.add_channels(record)

    def __call__(self, event: Event) -> None:
        for observer in self._observers:
            observer(event)

    def trail(self, time: int, robot: str, trail: Trail) -> None:
        for observer in self._observers:
            observer.trail(time, robot, trail)
