"""Phases by the element of the mission that is active: a time axis on which the elements follow each other.

A mission says itself where a run is: a robot that waits longer for a part is in the same element, only later. On the
axis each element of the training has a place, and a time in it is that since the element began last. An element lasts
as long as half of its visits do; what lies behind, or was visited in fewer than half of the runs, is in no known phase.
Which element is active is told by changes, each with the stamp (s) from which one, or several at once, are active.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fame.iso8601 import parse_datetime
from fame.middleware.interface import MAX_MESSAGE_SIZE
from fame.monitor.arrays import Floats
from fame.monitor.pipeline.processor import ActiveElements, Samples
from fame.robot.robot_state import RobotState
from fame.text import read_json

_KEPT = 1000
"""Changes of the active element that are kept."""

Axis = Mapping[str, tuple[float, ...]]
"""Element -> its begin on the axis and how long it is known, both s; empty: the axis is the time since the start."""


def axis_of(runs: Sequence[Samples], step: float) -> dict[str, tuple[float, ...]]:
    """Return the axis of training runs, on which elements are at least a `step` (s) apart; empty if a run has none."""
    if not all(run.elements for run in runs):
        return {}
    visits: dict[str, list[float]] = {}
    for run in runs:
        ends = [*(begin for begin, _ in run.elements[1:]), float(run.stamps[-1])]
        for (begin, name), end in zip(run.elements, ends, strict=True):
            if name:
                visits.setdefault(name, []).append(end - begin)
    axis: dict[str, tuple[float, ...]] = {}
    offset = 0.0
    for name, lengths in visits.items():
        length = float(np.median(lengths)) if 2 * len(lengths) >= len(runs) else 0.0
        axis[name] = offset, length
        offset += step * (np.ceil(length / step) + 2)
    return axis


def active(stamps: Floats, changes: ActiveElements) -> tuple[NDArray[np.str_], Floats]:
    """Return the active element at each stamp (n,), empty before the first one, and the stamp at which it began."""
    begins, names = zip(*((-np.inf, ""), *changes), strict=True)
    place = np.searchsorted(begins[1:], stamps, side="right")
    return np.array(names)[place], np.array(begins)[place]


def phase_times(stamps: Floats, changes: ActiveElements, axis: Axis) -> Floats:
    """Return the place of each stamp (n,) on the axis; NaN in no known phase."""
    names, begins = active(stamps, changes)
    places = np.array([axis.get(name, (0.0, -1.0)) for name in names]).reshape(-1, 2)
    since = np.where(np.isfinite(begins), stamps - begins, np.inf)
    return np.asarray(np.where(since <= places[:, 1], places[:, 0] + since, np.nan))


def run_times(run: Samples, stamps: Floats, axis: Axis) -> Floats:
    return phase_times(stamps, run.elements, axis) if axis else stamps - run.stamps[0]


def foreign(stamps: Floats, changes: ActiveElements, axis: Axis) -> NDArray[np.bool_]:
    """Return whether the element at each stamp (n,) is one that no training run had."""
    names, _ = active(stamps, changes)
    return np.isin(names, ["", *axis], invert=True) if axis else np.zeros(len(stamps), dtype=bool)


class ElementFollower:
    """Follows a robot's mission by its ``bpmn_events``; `changes` are those of the active element, the last ones.

    The element is that of the mission itself, not one inside what it calls; those active at once are joined by a plus.
    It is unknown (empty) before the first batch, and after a lost one until a robot gives its whole state again: up to
    the stamp `lost`.
    """

    def __init__(self) -> None:
        self.changes: ActiveElements = ()
        self.lost: float = -np.inf
        self._state: RobotState | None = None
        self._batch = 0

    def on_message(self, message: Any) -> None:
        """Take a batch; any other message is ignored."""
        try:
            self._take(read_json(message.data, MAX_MESSAGE_SIZE))
        except (ValueError, TypeError, LookupError, AttributeError):
            self._state, self._batch = None, -1  # what it had taken is half of a batch

    def element_at(self, stamp: float) -> str:
        """Return the active element at a stamp (s), empty if that is not known."""
        place = bisect_right(self.changes, stamp, key=itemgetter(0))
        return self.changes[place - 1][1] if place else ""

    def _take(self, batch: Mapping[str, Any]) -> None:
        begin = parse_datetime(str(batch["epoch"])).timestamp()
        following, self._batch = batch["batch"] == self._batch + 1, batch["batch"]
        if "begins" in batch:
            self._state = RobotState(str(batch["begins"]))
        elif not following:
            self._state = None
        if self._state is None:
            self.lost = begin + 1e-9 * batch["time"]
            self._state = RobotState.from_key(batch["key"]) if "key" in batch else None
        else:
            for kind, time, data in batch["changes"]:
                self._state.apply(f"/fame/{kind}", data, time)
                self._note(begin + 1e-9 * time)
        self._note(begin + 1e-9 * batch["time"])

    def _note(self, stamp: float) -> None:
        state = self._state if self._state is not None else RobotState()
        name = "+".join(sorted({(*state.path(token["scope"]), token["element"])[0] for token in state.tokens.values()}))
        last, before = self.changes[-1] if self.changes else (-np.inf, "")
        if stamp < last:  # the robot's clock began anew
            self.changes = ()
        if name != before:
            self.changes = (*self.changes[-_KEPT:], (stamp, name))
