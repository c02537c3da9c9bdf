"""PathDetector: how far the tool is from the paths of benign runs, and how late it is on them.

In joint space a detector has to learn the shape of the task from points; in task space it is known. Every benign run is
a path of the tool. For each point of another run the nearest points of those paths are looked up; near means in place,
in direction of travel and, weakly, in time, which distinguishes the way there from the way back. The vector from them
to the point, less its part along their direction of travel, is the deviation: it does not depend on when exactly the
samples were taken. The mean of the last three deviation vectors removes the noise of encoders.

The time at which benign runs pass the same place is the second score: the lateness, and how it changed over the last
`WINDOW` samples. A rest shows as lateness that grows by one sample per sample, a speed 20 % lower as 0.25. The clock of
a run starts when the tool has left (`LEFT`) its first place, and stops when it has come to the last one: how long it
waits there, and where the runs were divided, does not count.

Threshold rule. The benign runs are put into `BLOCKS` contiguous blocks, and each run is scored against the other
blocks: single runs would resemble their neighbours more than they resemble what comes later, since arms drift. The
limit of a score is `MARGIN` times the largest value that any of them reached within the neighbourhood (`BIN` samples
on either side at least) of the same time along the path, but never below `FLOOR`. A row of zeros only is a dropout
and not evaluated.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from fame.errors import ConfigError
from fame.imports import require
from fame.monitor.anomaly.recording import Recording
from fame.monitor.arrays import Floats
from fame.monitor.kinematics import Chain

NEIGHBOURS = 8
TURN = 0.02
"""What a unit of difference in direction counts (m): 11 degrees count as 4 mm."""

LAG = 5e-5
"""What one sample of difference in time counts (m)."""

LEFT = 2e-3
"""So far (m) from its first place the tool has left it; so near its last place it has come to it."""

SLOW = 5e-5
"""A step of the tool (m) too short to have a direction."""

SMOOTH = 3
WINDOW = 40
MARGIN = 1.5
FLOOR = (5e-5, 4.0, 4.0)
"""Smallest limits of deviation (m), change of lateness and lateness (samples)."""

BIN = 15
BLOCKS = 3


class Reading(NamedTuple):
    """Scores of a point: the deviation (m), change of lateness and lateness (samples), where along the nominal run
    (samples), whether it is off the path, and whether it is anomalous for that or another reason."""

    deviation: float
    change: float
    lateness: float
    phase: float
    off_path: bool
    anomalous: bool


NO_READING = Reading(0.0, 0.0, 0.0, 0.0, False, False)


@dataclass(frozen=True, slots=True)
class Paths:
    """Points of benign paths: places (points, 3) m, directions of travel (points, 3), time since the tool left in
    samples (points,), run (points,); `arrival` is the earliest time at which one comes to its last place."""

    places: Floats
    directions: Floats
    times: Floats
    runs: Floats
    arrival: float

    def without(self, runs: Sequence[int]) -> Paths:
        """All runs but these."""
        kept = ~np.isin(self.runs, runs)
        return Paths(self.places[kept], self.directions[kept], self.times[kept], self.runs[kept], self.arrival)


class PathDetector:
    """Learns from benign runs alone. `limits` is (bins, 3): of deviation, change of lateness, lateness."""

    chain: Chain
    margin: float
    period: float

    def __init__(self, chain: Chain, margin: float = MARGIN) -> None:
        self.chain, self.margin = chain, margin
        self.period = 0.0
        self.paths: Paths | None = None
        self.limits: Floats = np.zeros((0, 3))

    def fit(self, benign: Recording) -> PathDetector:
        """Learn the paths of the benign runs, and the limits by the rule above. Raises ConfigError for too few."""
        runs = list(benign)
        if len(runs) < BLOCKS:
            raise ConfigError(f"has {len(runs)} benign runs; at least {BLOCKS} are needed", file=benign.source)
        self.period = _period(runs)
        self.paths = join_paths([self._path(run, number) for number, run in enumerate(runs)])
        length = int(self.paths.times.max()) // BIN + 1
        largest = np.zeros((length, 3))
        self.limits = np.full((length, 3), np.inf)
        for block in np.array_split(np.arange(len(runs)), BLOCKS):
            others = self.paths.without(block.tolist())
            for number in block:
                for reading in self._follow(runs[number], others):
                    scores = (reading.deviation, abs(reading.change), abs(reading.lateness))
                    bin = bin_of(reading.phase, length)
                    largest[bin] = np.maximum(largest[bin], scores)
        padded = np.pad(largest, ((1, 1), (0, 0)), mode="edge")
        around = np.max([padded[:-2], padded[1:-1], padded[2:]], axis=0)
        self.limits = np.maximum(self.margin * around, FLOOR)
        return self

    def follow(self, run: Recording) -> list[Reading]:
        """Every point of one run."""
        assert self.paths is not None
        return self._follow(run, self.paths)

    def predict(self, recording: Recording) -> Any:
        """Labels (points,): +1 benign, -1 anomalous."""
        readings = [reading for run in recording for reading in self.follow(run)]
        return np.where([reading.anomalous for reading in readings], -1, 1)

    def tracker(self) -> Tracker:
        """What follows one run after the other, point by point."""
        assert self.paths is not None
        return Tracker(self.chain, self.paths, self.limits, self.period)

    def _follow(self, run: Recording, paths: Paths) -> list[Reading]:
        tracker = Tracker(self.chain, paths, self.limits, self.period)
        stamps = [None] * len(run) if run.stamps is None else run.stamps.tolist()
        return [tracker.step(values, stamp) for values, stamp in zip(run.values.tolist(), stamps, strict=True)]

    def _path(self, run: Recording, number: int) -> Paths:
        values = run.values
        times = np.arange(len(values), dtype=np.float64)
        if run.stamps is not None and self.period:
            times = (run.stamps - run.stamps[0]) / self.period
        read = values.any(axis=1)
        places, times = self.chain.places(values[read]), times[read]
        left = np.linalg.norm(places - places[:1], axis=1) > LEFT
        away = np.flatnonzero(np.linalg.norm(places - places[-1:], axis=1) > LEFT)
        times = times - times[int(np.argmax(left))]
        arrival = float(times[away[-1]] if len(away) else times[-1])
        return Paths(places, directions(places), times, np.full(len(places), float(number)), arrival)

    def limits_text(self) -> str:
        """What the detector does not see, in a sentence."""
        return "It sees the position of the tool, not its orientation."

    # ---- storing ---------------------------------------------------------------------------------------------------

    def to_plain(self) -> dict[str, Any]:
        """All of it as plain data and arrays."""
        assert self.paths is not None
        chain, paths = self.chain, self.paths
        return {
            "kind": "paths",
            "joints": list(chain.joints),
            "origins": np.array(chain.origins),
            "axes": np.array(chain.axes),
            "steps": list(chain.steps),
            "tool": list(chain.tool),
            "margin": self.margin,
            "period": self.period,
            "places": paths.places,
            "directions": paths.directions,
            "times": paths.times,
            "runs": paths.runs,
            "arrival": paths.arrival,
            "limits": self.limits,
        }

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> PathDetector:
        """Give the detector that `to_plain` described. Raises KeyError, TypeError or ValueError for anything else."""
        vectors = [tuple(tuple(map(float, row)) for row in plain[name]) for name in ("origins", "axes")]
        chain = Chain(tuple(plain["joints"]), vectors[0], vectors[1], tuple(plain["steps"]), tuple(plain["tool"]))  # type: ignore[arg-type]
        detector = cls(chain, float(plain["margin"]))
        detector.period = float(plain["period"])
        detector.paths = Paths(
            plain["places"], plain["directions"], plain["times"], plain["runs"], float(plain["arrival"])
        )
        detector.limits = plain["limits"]
        return detector


class Tracker:
    """Follows a run point by point. `reset` begins the next."""

    def __init__(self, chain: Chain, paths: Paths, limits: Floats, period: float) -> None:
        self._chain, self._period = chain, period
        require("scipy")
        from scipy.spatial import cKDTree

        self._tree = cKDTree(np.hstack([paths.places, TURN * paths.directions, LAG * paths.times[:, None]]))
        self._places, self._directions, self._times = paths.places, paths.directions, paths.times
        self._limits, self._arrival = limits.tolist(), paths.arrival
        self.reset()

    def reset(self) -> None:
        """A new run begins."""
        self._before: tuple[float, float, float] | None = None
        self._first: tuple[float, float, float] | None = None
        self._offset: float | None = None  # what to add to the time for the clock; None until the tool has left
        self._count = -1
        self._deviations: deque[tuple[float, float, float]] = deque(maxlen=SMOOTH)
        self._lateness: deque[tuple[float, float]] = deque()

    def step(self, values: Sequence[float], stamp: float | None = None) -> Reading:
        """One more point: angles (rad), and its time (s) if there is one."""
        self._count += 1
        if not any(values):
            return NO_READING
        place = self._chain.place(values)
        time = stamp / self._period if stamp is not None and self._period else float(self._count)
        clock = 0.0 if self._offset is None else time + self._offset
        direction = self._direction(place)
        query = (*place, *(TURN * part for part in direction), LAG * clock)
        _, near = self._tree.query(query, k=NEIGHBOURS)
        self._deviations.append(self._across(place, near))
        x, y, z = (sum(parts) / len(self._deviations) for parts in zip(*self._deviations, strict=True))
        phase = float(self._times[near].mean())
        if self._offset is None:
            self._leave(place, phase - time)
            clock = phase
        lateness = clock - phase if phase < self._arrival else 0.0
        return self._judge((x * x + y * y + z * z) ** 0.5, self._change(clock, lateness), lateness, phase)

    def _leave(self, place: tuple[float, float, float], offset: float) -> None:
        """Start the clock if the tool has left its first place."""
        self._first = self._first or place
        if sum((a - b) ** 2 for a, b in zip(place, self._first, strict=True)) > LEFT * LEFT:
            self._offset = offset

    def _judge(self, deviation: float, change: float, lateness: float, phase: float) -> Reading:
        limit = self._limits[bin_of(phase, len(self._limits))]
        off_path = deviation > limit[0]
        anomalous = off_path or abs(change) > limit[1] or abs(lateness) > limit[2]
        return Reading(deviation, change, lateness, phase, off_path, anomalous)

    def _direction(self, place: tuple[float, float, float]) -> tuple[float, float, float]:
        """The direction of travel since the point before; all zero if that is too near."""
        before, self._before = self._before or place, place
        x, y, z = place[0] - before[0], place[1] - before[1], place[2] - before[2]
        length = (x * x + y * y + z * z) ** 0.5
        return (x / length, y / length, z / length) if length > SLOW else (0.0, 0.0, 0.0)

    def _across(self, place: tuple[float, float, float], near: Any) -> tuple[float, float, float]:
        """The mean vector from the neighbours to the place, without its parts along their directions."""
        away = np.subtract(place, self._places[near])
        along = self._directions[near]
        away -= (away * along).sum(axis=1, keepdims=True) * along
        x, y, z = (away.sum(axis=0) / NEIGHBOURS).tolist()
        return x, y, z

    def _change(self, clock: float, lateness: float) -> float:
        """How the lateness changed over the window."""
        history = self._lateness
        if not lateness:  # the clock is stopped
            return 0.0
        history.append((clock, lateness))
        while history[0][0] < clock - WINDOW:
            history.popleft()
        return lateness - history[0][1]


def bin_of(phase: float, count: int) -> int:
    """Which of the `count` pieces along the path holds the phase (samples)."""
    return max(0, min(int(phase) // BIN, count - 1))


def directions(places: Floats) -> Floats:
    """The direction of travel at each place (points, 3): unit vectors, or zero where the tool rests."""
    step = np.gradient(places, axis=0) if len(places) > 1 else np.zeros_like(places)
    length = np.linalg.norm(step, axis=1, keepdims=True)
    return np.asarray(np.where(length > SLOW, step / np.maximum(length, SLOW), 0.0))


def join_paths(paths: Sequence[Paths]) -> Paths:
    """All points of several paths."""
    return Paths(
        np.vstack([path.places for path in paths]),
        np.vstack([path.directions for path in paths]),
        np.concatenate([path.times for path in paths]),
        np.concatenate([path.runs for path in paths]),
        min(path.arrival for path in paths),
    )


def _period(runs: Sequence[Recording]) -> float:
    """The usual time (s) between two samples; 0 without stamps."""
    steps = [np.diff(run.stamps) for run in runs if run.stamps is not None]
    return float(np.median(np.concatenate(steps))) if len(steps) == len(runs) else 0.0
