"""Phases by the element of the mission that is active: a time axis on which the elements follow each other.

A mission says itself where a run is: a robot that waits longer for a part is in the same element, only later. On the
axis each element of the training has a place, and a time in it is that since the element began last. An element lasts
as long as half of its visits do; what lies behind, or was visited in fewer than half of the runs, is in no known phase.
Which element is active is told by changes, each with the stamp (s) from which one, or several at once, are active.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from fame.monitor.arrays import Floats
from fame.monitor.pipeline.processor import Changes, Samples

Axis = Mapping[str, tuple[float, ...]]
"""Element -> its begin on the axis and how long it is known, both s; empty: the axis is the time since the start."""


def axis_of(runs: Sequence[Samples], step: float) -> dict[str, tuple[float, ...]]:
    """Give the axis of training runs, on which elements are at least a `step` (s) apart; empty if a run has none."""
    if not all(run.elements for run in runs):
        return {}
    visits: dict[str, list[float]] = {}
    for run in runs:
        ends = [*(begin for begin, _ in run.elements[1:]), float(run.stamps[-1])]
        for (begin, name), end in zip(run.elements, ends, strict=True):
            visits.setdefault(name, []).append(end - begin)
    axis: dict[str, tuple[float, ...]] = {}
    offset = 0.0
    for name, lengths in visits.items():
        length = float(np.median(lengths)) if 2 * len(lengths) >= len(runs) else 0.0
        axis[name] = offset, length
        offset += step * (np.ceil(length / step) + 2)
    return axis


def active(stamps: Floats, changes: Changes) -> tuple[NDArray[np.str_], Floats]:
    """Give the active element at each stamp (n,), empty before the first one, and the stamp at which it began."""
    begins, names = zip(*((-np.inf, ""), *changes), strict=True)
    place = np.searchsorted(begins[1:], stamps, side="right")
    return np.array(names)[place], np.array(begins)[place]


def phase_times(stamps: Floats, changes: Changes, axis: Axis) -> Floats:
    """Give the place of each stamp (n,) on the axis; NaN in no known phase."""
    names, begins = active(stamps, changes)
    places = np.array([axis.get(name, (0.0, -1.0)) for name in names]).reshape(-1, 2)
    since = np.where(np.isfinite(begins), stamps - begins, np.inf)
    return np.asarray(np.where(since <= places[:, 1], places[:, 0] + since, np.nan))


def run_times(run: Samples, stamps: Floats, axis: Axis) -> Floats:
    """Give the place of stamps of a run on the axis."""
    return phase_times(stamps, run.elements, axis) if axis else stamps - run.stamps[0]


def foreign(stamps: Floats, changes: Changes, axis: Axis) -> NDArray[np.bool_]:
    """Whether the element at each stamp (n,) is one that no training run had."""
    names, _ = active(stamps, changes)
    return np.isin(names, ["", *axis], invert=True) if axis else np.zeros(len(stamps), dtype=bool)
