"""The trigger of a run: a value on a topic, such as a digital input, or in a column of a file, and when runs begin.

::

    Run: {Topic: cell/input_3, Field: data, Starts: 1, Ends: 0}
    Run: {Service: cell/run, Ends: 0}
    Run: {Column: force, Starts: "> 0.5"}

A run begins when `Starts` becomes true. It ends when `Ends` becomes true, and with the begin of the next one. What the
value was before the first one is not known: the first one begins no run. Each call of a service counts, whatever the
one before it said. Live, from bags and from tables, the same `RunTracker` tells when runs last.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from fame.config.values import ConfigValue
from fame.monitor.arrays import Floats

KEYS = {
    "Topic": "of the trigger; without a leading slash in the robot's namespace",
    "Service": "instead of it: a service (std_srvs/srv/SetBool) that the node offers; the value is `data` of each call",
    "Field": "path to one number or boolean in its messages (`data`)",
    "MessageType": "of the topic (that of the Inputs of the same topic, otherwise `std_msgs/msg/Bool`)",
    "QoS": "policies of this topic",
    "Column": "name of the value in CSV files (`trigger`)",
    "Starts": "what the value becomes when a run begins: a number (true is 1), or a comparison such as `> 0.5` (1)",
    "Ends": "what it becomes when the run ends; without this key it lasts until the next one",
}
COLUMN = "trigger"
_SIGNS: dict[str, Callable[[float, float], bool]] = {
    ">=": operator.ge, "<=": operator.le, "!=": operator.ne, "==": operator.eq, ">": operator.gt, "<": operator.lt,
}  # fmt: skip
_COMPARISON = re.compile(r"\s*(>=|<=|!=|==|>|<)\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*")
_KEPT = 100
"""Runs that are remembered."""


class RunTrigger(NamedTuple):
    """The column of the value, and the conditions that it meets when a run begins, and ends (empty: with the next). Of
    `calls` each one counts, also if the value stays the same."""

    column: str = COLUMN
    starts: str = "== 1"
    ends: str = ""
    calls: bool = False

    @property
    def text(self) -> str:
        """When a run begins and ends, in words."""
        ends = f", and ends when it becomes {self.ends}" if self.ends else ""
        return f"a run begins when {self.column} becomes {self.starts}{ends}"


def trigger_of(parts: Mapping[str, ConfigValue]) -> RunTrigger:
    """Read the keys `Column`, `Starts`, `Ends`, and whether there is a `Service`. Raises ConfigError."""
    column = parts["Column"].text() if "Column" in parts else COLUMN
    starts, ends = (
        _condition(parts[key]) if key in parts else text for key, text in (("Starts", "== 1"), ("Ends", ""))
    )
    if starts == ends:
        raise parts["Ends"].error(f"is the condition of Starts, too ({starts}): expected another one, or no Ends")
    return RunTrigger(column, starts, ends, "Service" in parts)


def _condition(value: ConfigValue) -> str:
    """Return a condition as sign and number. Raises ConfigError."""
    if isinstance(value.data, bool | int | float):
        return f"== {float(value.data):g}"
    found = _COMPARISON.fullmatch(str(value.data))
    if found is None:
        raise value.expected("a number, true, false, or a comparison such as '> 0.5'")
    return f"{found[1]} {float(found[2]):g}"


def _holds(condition: str, value: float) -> bool:
    sign, _, number = condition.partition(" ")
    return _SIGNS[sign](value, float(number))


class RunTracker:
    """Follows the value of a trigger; `spans` says from when to when (s) runs lasted, the last one until inf if its end
    is not known."""

    def __init__(self, trigger: RunTrigger) -> None:
        self.trigger = trigger
        self.spans: list[tuple[float, float]] = []
        self._before: tuple[bool, bool] | None = None  # whether the last value met Starts, and Ends

    def feed(self, stamp: float, value: float) -> None:
        """Take the next value. Values that are not finite are ignored."""
        if not np.isfinite(value):
            return
        starts, ends = (bool(each) and _holds(each, value) for each in (self.trigger.starts, self.trigger.ends))
        before, self._before = self._before or (True, True), (starts, ends)
        if self.trigger.calls:
            before = False, False
        if ends and not before[1]:
            self._end(stamp)
        if starts and not before[0]:
            self._end(stamp)
            self.spans = [*self.spans[-_KEPT:], (stamp, np.inf)]

    def _end(self, stamp: float) -> None:
        if self.spans and self.spans[-1][1] == np.inf:
            self.spans[-1] = (self.spans[-1][0], stamp)


def spans_of(trigger: RunTrigger, stamps: Floats, values: Floats) -> list[tuple[float, float]]:
    """Return when runs last (s), by the values of a file."""
    tracker, found = RunTracker(trigger), list[tuple[float, float]]()
    for stamp, value in zip(stamps.tolist(), values.tolist(), strict=True):
        tracker.feed(stamp, value)
        if len(tracker.spans) > 1:
            found += tracker.spans[:-1]
            tracker.spans = tracker.spans[-1:]
    return found + tracker.spans


def begins_within(trigger: RunTrigger, values: Floats) -> bool:
    """Return whether a run may be under way with the first value of a file, of which the begin is not known."""
    first = values[np.isfinite(values)][:1].tolist()
    return not trigger.calls and any(_holds(trigger.starts, value) for value in first)


def no_run(trigger: RunTrigger, values: Floats) -> str:
    """Say that no run begins in a file."""
    known = values[np.isfinite(values)]
    range_ = f"its values are {known.min():g} to {known.max():g}" if len(known) else "it has no value"
    return f"no run begins: column {trigger.column!r} never becomes {trigger.starts} (Run: Starts); {range_}"
