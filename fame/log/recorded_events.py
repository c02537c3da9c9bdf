"""The events of a run as rows, whatever file they were read from."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import datetime
from operator import itemgetter
from typing import Any

from fame.bpmn.model import Definitions
from fame.bpmn.pools import matches, pools_of
from fame.clock import EPOCH
from fame.dataclasses import dataclass
from fame.iso8601 import nanoseconds_between, parse_datetime
from fame.robot.events import ENDED

EventRow = Mapping[str, Any]
WHAT: Mapping[str, str] = {
    "start": "enter", "complete": "leave", "abort": "cancel", "ate_abort": "cancel", "pi_abort": "cancel",
    "fail": "fail",
}  # fmt: skip
"""Transition of the life cycle -> mark of the engine."""


@dataclass(frozen=True, slots=True)
class RecordedEvents:
    """The events of a run: robot, instance, element, what, detail, and time (ns).

    processes  robot -> id of its process
    complete   whether nothing could come any more, as the log says; else whether no instance was running at the end
    partly     robots of which the log does not have everything
    lacks      (element, what): what such a log does not say, as text; empty if it has such events
    reordered  the same rows in the other order where they are at one time and the log has no order of them
    has_order  whether `rows` or `reordered` have these of one time in the order of the run
    cancelled  (robot, instance) that ended cancelled, where rows do not say it
    """

    rows: Sequence[EventRow]
    processes: Mapping[str, str]
    complete: bool
    partly: frozenset[str] = frozenset()
    lacks: Callable[[str, str], str] = lambda element, what: ""
    reordered: Sequence[EventRow] = ()
    has_order: Callable[[Sequence[EventRow]], bool] = lambda rows: True
    cancelled: frozenset[tuple[str, str]] = frozenset()


def is_complete(rows: Iterable[EventRow], otherwise: bool) -> bool:
    """Return whether nothing could come any more, as the end of the run says; `otherwise` without one."""
    return next((row["detail"] == "complete" for row in rows if row["what"] == ENDED), otherwise)


def processes_of(rows: Iterable[EventRow]) -> dict[str, str]:
    """Return the processes (ids) of robots, by their starts."""
    return {str(row["robot"]): str(row["element"]) for row in rows if row["what"] == "start"}


def processes_by_pool(model: Definitions, robots: Iterable[str]) -> dict[str, str]:
    """Return the processes (ids) of robots, by the names of their pools, where a log does not say them."""
    pools = pools_of(model)
    return {robot: pool.process.id for robot in robots for pool in pools if matches(robot, pool)}


def count_instances(rows: Iterable[EventRow]) -> int:
    """Return how many instances rows are of."""
    return len({(row["robot"], row["instance"]) for row in rows})


def dated(time: str, robot: str, instance: str, element: str, what: str, detail: Any = None) -> dict[str, Any]:
    """Return a row with a date, to be `timed`. Raises ValueError for another text."""
    date = parse_datetime(time)
    return {"time": date, "robot": robot, "instance": instance, "element": element, "what": what, "detail": detail}


def timed(rows: Sequence[dict[str, Any]]) -> Sequence[EventRow]:
    """Return rows with dates, in order, with times (ns): since 1970, or since the first one if it is long after."""
    rows = sorted(rows, key=itemgetter("time"))
    first: datetime = rows[0]["time"] if rows and rows[0]["time"].year > EPOCH.year else EPOCH
    return [{**row, "time": nanoseconds_between(first, row["time"])} for row in rows]
