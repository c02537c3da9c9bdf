"""Where one run of the task ends and the next begins: in recorded data, and point by point.

Two rules of motion cover what is recorded of a repetitive task. *Home*: the arm leaves a home posture and comes back;
the boundary is the point nearest to home between approaching and leaving it. *Dwell*: the arm follows a loop and rests
at its corner; the boundary is the middle of the rest. A block of points follows the first rule if it is ever at home.

Live, three rules delimit a run. *signal*: messages tell begin and end. *home*: as above; the boundary is known as soon
as the arm is on its way again, so the points since then move over to the new run. *count*: a fixed number of points.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fame.monitor.arrays import Floats, Whole

NEAR = 0.5
"""Distance from home (rad, over all joints) that counts as being there."""

JUMP = 0.1
"""A step of a joint (rad) that no motion explains: ten times the largest between two samples of the MH5."""

STILL = 2e-4
"""A joint that moves less between two points (rad) rests: ten steps of the MH5's coarsest encoder."""

CORNER = 3e-3
"""How near (rad) a rest is to where the loop began to count as the same corner."""

_SHORTEST_REST = 3
_SHORTEST_LOOP = 20


def separators(values: Floats) -> NDArray[np.bool_]:
    """Rows that only separate: all zero, while the arm is elsewhere in the row after (in the last row: before)."""
    zero: NDArray[np.bool_] = (values == 0).all(axis=1)
    if len(values) < 2:
        return zero
    following = np.vstack([values[1:], values[-2:-1]])
    return np.asarray(zero & (np.abs(following).max(axis=1) > JUMP))


def blocks(values: Floats, labels: Whole, apart: NDArray[np.bool_]) -> list[slice]:
    """Stretches that nothing interrupts: neither a separator (`apart`), nor another label, nor a jump."""
    jump = np.abs(np.diff(values, axis=0)).max(axis=1) > JUMP
    cut = jump | (np.diff(labels) != 0) | apart[1:] | apart[:-1]
    bounds = [0, *(np.flatnonzero(cut) + 1).tolist(), len(values)]
    stretches = (slice(first, last) for first, last in pairwise(bounds))
    return [stretch for stretch in stretches if not apart[stretch].any()]


def number_runs(values: Floats, labels: Whole) -> tuple[NDArray[np.bool_], Whole]:
    """Which rows are points of a run, and the number of the run of each of those."""
    apart = separators(values)
    numbers: list[Whole] = []
    count = 0
    for block in blocks(values, labels, apart):
        bounds = boundaries(values[block])
        lengths = np.diff([*bounds, block.stop - block.start])
        numbers.append(np.repeat(np.arange(count, count + len(bounds), dtype=np.int64), lengths))
        count += len(bounds)
    return ~apart, np.concatenate(numbers) if numbers else np.zeros(0, dtype=np.int64)


def boundaries(values: Floats) -> list[int]:
    """The first row of each run in one block, by the rule that fits it."""
    at_home = (np.linalg.norm(values, axis=1) < NEAR).any()
    return home_boundaries(values) if at_home else dwell_boundaries(values)


def home_boundaries(values: Floats, home: Floats | None = None) -> list[int]:
    """The first row of each run that leaves `home` (rad, default all zero) and comes back."""
    distance = np.linalg.norm(values if home is None else values - home, axis=1)
    near = distance < NEAR
    comes = np.flatnonzero(near[1:] & ~near[:-1]) + 1
    leaves = np.flatnonzero(~near[1:] & near[:-1]) + 1
    found = [0]
    for first in comes:
        later = leaves[leaves > first]
        if len(later):  # without, the arm stays at home: what follows belongs to the last run
            found.append(int(first + np.argmin(distance[first : later[0]])))
    return found


def dwell_boundaries(values: Floats) -> list[int]:
    """The first row of each loop that begins and ends at rest on the same corner."""
    step = np.abs(np.diff(values, axis=0, prepend=values[:1])).max(axis=1)
    resting = np.flatnonzero((step < STILL) & (np.abs(values - values[0]).max(axis=1) < CORNER))
    rests = np.split(resting, np.flatnonzero(np.diff(resting) > 1) + 1)
    rests = [rest for rest in rests if len(rest) >= _SHORTEST_REST and rest[0] >= _SHORTEST_LOOP]
    if rests and rests[-1][-1] >= len(values) - _SHORTEST_LOOP:
        rests.pop()  # the rest that ends the last loop
    return [0, *(int(rest[0] + rest[-1]) // 2 for rest in rests)]


Rule = Literal["signal", "home", "count"]

RISE = 5e-4
"""How much farther from home (rad) than at its nearest the arm is on its way again: ten steps of
the MH5's coarsest encoder."""

WHOLE = 0.8
"""A run with less than this part of the nominal points was cut off."""


class RunSegmenter:
    """Finds with each point whether a run has begun, and how many points ago."""

    rule: Rule
    cycle: int

    def __init__(self, rule: Rule, cycle: int = 0) -> None:
        self.rule, self.cycle = rule, cycle
        self._count = 0
        self._left = False
        self._nearest, self._since = math.inf, 0

    def feed(self, values: Sequence[float]) -> int | None:
        """Take a point. None: the run goes on. A number: a run began that many points ago, this one included."""
        self._count += 1
        if self.rule == "count" and self._count > self.cycle > 0:
            self._count = 1
            return 1
        return self._home(math.sqrt(sum(value * value for value in values))) if self.rule == "home" else None

    @property
    def undecided(self) -> bool:
        """Whether the last points may turn out to belong to a new run."""
        return self._left and self._since > 1

    def _home(self, distance: float) -> int | None:
        if distance >= NEAR:
            self._left, self._nearest, self._since = True, math.inf, 0
        elif self._left:
            self._since += 1
            if distance < self._nearest:
                self._nearest, self._since = distance, 1
            elif distance > self._nearest + RISE:
                self._left = False
                return self._since
        return None
