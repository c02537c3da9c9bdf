"""PathDetector: how far the tool is from the paths of benign runs, how it is turned, and how late it is on them.

In joint space a detector has to learn the shape of the task from points; in task space it is known. Every benign run is
a path of the tool. For each point of another run the nearest points of those paths are looked up; near means in place,
in direction of travel and, weakly, in time, which distinguishes the way there from the way back. The vector from them
to the point, less its part along their direction of travel, is the deviation: it does not depend on when exactly the
samples were taken. The mean of the last three deviation vectors removes the noise of encoders. The rotation from their
orientations to that of the point, as a rotation vector and averaged likewise, is the tilt (distance on SO(3)), less
what benign paths turn themselves along that part. After missing samples the direction of travel is not known: the
neighbours of deviation and tilt are then near in place and time alone.

The time at which benign runs pass the same place is the third score: the lateness, and how it changed over the last
`WINDOW` samples. A rest shows as lateness that grows by one sample per sample, a speed 20 % lower as 0.25. The clock of
a run starts when the tool has left its first place, and stops when it has come to the last one: how long it waits
there, and where the runs were divided, does not count.

Benign changes are not anomalies up to a stated bound (`PathParameters`): another speed of the whole run, a pause, lost
samples, a start from another pose, sag, noise. What they explain is subtracted before scores are compared to their
limits, and reported as what it is at the end of the run (`Change`).

Threshold rule. The benign runs are put into `BLOCKS` contiguous blocks, and each run is scored against the other
blocks: single runs would resemble their neighbours more than they resemble what comes later, since arms drift. The
limit of a score is `margin` times the largest value that any of them reached within the neighbourhood (`bin` samples
on either side at least) of the same time along the path, but never below its floor. A row of zeros only is a dropout
and not evaluated. Stamps that do not grow are made up: the usual time after the one before.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Sequence
from itertools import accumulate
from typing import Any, ClassVar

import numpy as np

from fame.dataclasses import dataclass, field, replace
from fame.errors import ConfigError
from fame.imports import require
from fame.monitor.anomaly.benign_changes import (
    NO_READING,
    SMOOTH,
    BenignChanges,
    Change,
    PathParameters,
    PointScores,
)
from fame.monitor.anomaly.recording import Recording
from fame.monitor.arrays import Floats
from fame.monitor.kinematics import Chain, Vector

NEIGHBOURS = 8
TURN = 0.02
"""What a unit of difference in direction counts (m): 11 degrees count as 4 mm."""
_JUMP = 1.5
"""Samples from one point to the next, from which on some are missing between them."""
BLOCKS = 3
MARGIN = 1.5


@dataclass(frozen=True, slots=True)
class Paths:
    """Points of benign paths: places (points, 3) m, directions of travel (points, 3), time since the tool left in
    samples (points,), run (points,); `arrival` is the earliest time at which one comes to its last place, without runs
    that were cut off;
    `turns` (points, 4) are the orientations as quaternions, none in a model of an earlier version."""

    places: Floats
    directions: Floats
    times: Floats
    runs: Floats
    arrival: float
    turns: Floats

    def without(self, runs: Sequence[int]) -> Paths:
        """Return all runs but these."""
        kept = ~np.isin(self.runs, runs)
        return replace(self, **{name: getattr(self, name)[kept] for name in _ARRAYS})


_ARRAYS = ("places", "directions", "times", "runs", "turns")


@dataclass(slots=True)
class PathDetector:
    """Learns from benign runs alone: `paths`, and `limits` (bins, 4) of deviation, change of lateness, lateness, tilt.

    `period` is the usual time between two samples (s, 0 without stamps), `noise` the largest of benign runs (m).
    """

    kind: ClassVar[str] = "paths"
    supervised: ClassVar[bool] = False
    chain: Chain
    margin: float = MARGIN
    parameters: PathParameters = field(default_factory=PathParameters)
    period: float = 0.0
    noise: float = math.inf
    paths: Paths | None = None
    limits: Floats = field(default_factory=lambda: np.zeros((0, 4)))

    def fit(self, benign: Recording) -> PathDetector:
        """Learn the paths of the benign runs, and the limits by the rule above.

        Raises ConfigError for too few runs or points, and for a gap on the way that is longer than the task.
        """
        runs, expected = list(benign), len(self.chain.joints)
        if expected != len(benign.joints):
            text = f"expected {expected} joints, as the chain of the PathDetector has, got {len(benign.joints)}"
            raise ConfigError(text, file=benign.source)
        if len(runs) < BLOCKS:
            raise ConfigError(f"has {len(runs)} benign runs; at least {BLOCKS} are needed", file=benign.source)
        for number, run in enumerate(runs):
            if (points := int(run.values.any(axis=1).sum())) < NEIGHBOURS:
                text = f"benign run {number} has {points} points that are not all 0; at least {NEIGHBOURS} are needed"
                raise ConfigError(text, file=benign.source)
        self.period = _period(runs)
        paths = [self._path(run, number) for number, run in enumerate(runs)]
        self.paths = join_paths(paths, self.parameters.left)
        for number, path in enumerate(paths):
            way = path.times[(path.times >= 0) & (path.times <= path.arrival)]
            if (gap := float(np.diff(way).max(initial=0.0))) > self.paths.arrival:
                text = f"benign run {number} has a gap of {gap:.0f} samples; the task takes {self.paths.arrival:.0f}"
                raise ConfigError(text, file=benign.source)
        size = self.parameters.bin
        length = int(min(self.paths.times.max(), 2 * self.paths.arrival)) // size + 1  # a wait afterwards may be long
        largest = np.zeros((length, 4))
        self.limits, self.noise = np.full((length, 4), np.inf), math.inf
        noise = 0.0
        for block in np.array_split(np.arange(len(runs)), BLOCKS):
            others = self.paths.without(block.tolist())
            for number in block:
                tracker = Tracker(self, others)
                for reading in tracker.follow(runs[number]):
                    scores = (reading.deviation, abs(reading.change), abs(reading.lateness), reading.tilt)
                    bin = bin_of(reading.phase, length, size)
                    largest[bin] = np.maximum(largest[bin], scores)
                noise = max(noise, tracker.noise)
        self.noise = self.margin * noise
        padded = np.pad(largest, ((1, 1), (0, 0)), mode="edge")
        around = np.max([padded[:-2], padded[1:-1], padded[2:]], axis=0)
        self.limits = np.maximum(self.margin * around, self.parameters.floors)
        return self

    def follow(self, run: Recording) -> list[PointScores]:
        """Return the scores of every point of one run."""
        return self.tracker().follow(run)

    def predict(self, recording: Recording) -> Any:
        """Return labels (points,): +1 benign, -1 anomalous."""
        readings = [reading for run in recording for reading in self.follow(run)]
        return np.where([reading.anomalous for reading in readings], -1, 1)

    def tracker(self) -> Tracker:
        """Return a tracker, which follows one run after the other, point by point."""
        assert self.paths is not None
        return Tracker(self, self.paths)

    def _path(self, run: Recording, number: int) -> Paths:
        values = run.values
        times = np.arange(len(values), dtype=np.float64)
        if run.stamps is not None and self.period:
            times = np.fromiter(accumulate((run.stamps / self.period).tolist(), _next_time), np.float64)
        read = values.any(axis=1)
        places, times = self.chain.places(values[read]), times[read]
        left = np.linalg.norm(places - places[:1], axis=1) > self.parameters.left
        away = np.flatnonzero(np.linalg.norm(places - places[-1:], axis=1) > self.parameters.left)
        times = times - times[int(np.argmax(left))]
        arrival = float(times[away[-1]] if len(away) else times[-1])
        ways, turns = directions(places, self.parameters.slow), self.chain.quaternions(values[read])
        return Paths(places, ways, times, np.full(len(places), float(number)), arrival, turns)

    def limits_text(self) -> str:
        """Return what the detector does not see, in a sentence; it has learned."""
        assert self.paths is not None
        if not len(self.paths.turns):
            text = "It was learned by an earlier version and does not see the orientation of the tool"
            return f"{text}: fame monitor adm learn makes it anew."
        p = self.parameters
        return (
            f"Tolerated and reported: a speed within {100 * p.speed:g} %, pauses of {p.pause:g} samples in all, "
            f"a start {1000 * p.start:g} mm away, a constant offset of {1000 * p.drift:g} mm."
        )


class Tracker:
    """Follows a run point by point. `reset` begins the next."""

    def __init__(self, detector: PathDetector, paths: Paths) -> None:
        parameters = detector.parameters
        self._chain, self._period, self._parameters = detector.chain, detector.period, parameters
        self._usual = detector.noise
        require("scipy")
        from scipy.spatial import cKDTree

        self._lag, self._slow, self._left = parameters.lag, parameters.slow, parameters.left
        times = self._lag * paths.times[:, None]
        self._tree = cKDTree(np.hstack([paths.places, TURN * paths.directions, times]))
        self._tree_of_places = cKDTree(np.hstack([paths.places, times]))
        self._places, self._directions, self._times = paths.places, paths.directions, paths.times
        self._turns = paths.turns if len(paths.turns) else None
        self._turning = turning(paths, self._slow) if len(paths.turns) else np.zeros((0, 3))
        self._limits, self._arrival = detector.limits.tolist(), paths.arrival
        self.reset()

    def reset(self) -> None:
        """Begin a new run."""
        self._before: Vector | None = None
        self._first: Vector | None = None
        self._offset: float | None = None  # what to add to the time for the clock; None until the tool has left
        self._time: float | None = None
        self._phase = 0.0
        self._made_up = 0
        self._deviations: deque[Vector] = deque(maxlen=SMOOTH)
        self._tilts: deque[Vector] = deque(maxlen=SMOOTH)
        self._changes = BenignChanges(self._parameters, self._usual)

    def step(self, values: Sequence[float], stamp: float | None = None) -> PointScores:
        """Take one more point: angles (rad), and its time (s) if there is one."""
        before, time = self._time, self._update_time(stamp)
        if not any(values):
            return NO_READING
        place = self._chain.place(values)
        clock = 0.0 if self._offset is None else time + self._offset
        direction = self._direction(place)
        stamped = stamp is not None and self._period > 0 and before is not None
        step = time - before if stamped and before is not None else None
        _, near = self._tree.query((*place, *(TURN * part for part in direction), self._lag * clock), k=NEIGHBOURS)
        phase = float(self._times[near].sum()) / NEIGHBOURS
        beside = near
        if self._offset is not None and (phase - self._phase > _JUMP or (step or 0.0) > _JUMP):
            # The way from the point before leads across missing samples: around a corner it is no direction of the run.
            _, beside = self._tree_of_places.query((*place, self._lag * clock), k=NEIGHBOURS)
        self._phase = phase
        away, along = self._away(place, beside)
        self._deviations.append(away)
        deviation = _mean(self._deviations)
        if self._offset is None:
            self._leave(place, phase - time)
            clock = phase
        moving = self._offset is not None and phase < self._arrival
        resting = direction == (0.0, 0.0, 0.0) and moving and bool(self._directions[near].any(axis=1).all())
        changes = self._changes
        changes.add(deviation, moving=moving)
        changes.lost.step(phase, step, moving=moving)
        late = changes.late(clock, clock - phase if phase < self._arrival else 0.0, resting=resting)
        return changes.excuse(self._judge(changes.above(deviation), late, phase, self._tilt(values, beside, along)))

    def follow(self, run: Recording) -> list[PointScores]:
        """Return the scores of every point of one run."""
        stamps = [None] * len(run) if run.stamps is None else run.stamps.tolist()
        return [self.step(values, stamp) for values, stamp in zip(run.values.tolist(), stamps, strict=True)]

    @property
    def noise(self) -> float:
        """The noise of the run so far, m."""
        return self._changes.noise.level

    def changes(self) -> list[Change]:
        """Return the benign changes of the run so far that can be told from noise."""
        return [*self._changes.found(), *([Change("stamps", self._made_up, True)] if self._made_up else [])]

    def _update_time(self, stamp: float | None) -> float:
        """Return the time in samples; one that does not grow is made up, and counted if there is a period."""
        before = self._time
        time = stamp / self._period if stamp is not None and self._period else None
        if before is None:
            self._time = 0.0 if time is None else time
        else:
            self._time = _next_time(before, time)
            self._made_up += time not in (None, self._time)
        return self._time

    def _leave(self, place: Vector, offset: float) -> None:
        """Start the clock if the tool has left its first place."""
        self._first = self._first or place
        if math.dist(place, self._first) > self._left:
            self._offset = offset

    def _judge(self, deviation: float, late: list[tuple[float, float]], phase: float, tilt: float) -> PointScores:
        limit = self._limits[bin_of(phase, len(self._limits), self._parameters.bin)]
        most = limit[0] + self._changes.widening
        off_path, tilted = deviation > most, tilt > limit[3]
        lateness, change = late[0]
        slow = all(abs(change) > limit[1] or abs(lateness) > limit[2] for lateness, change in late)
        kind = "path" if off_path else "orientation" if tilted else "speed" if slow else ""
        kind = self._changes.kind(kind, deviation, most, early=lateness < 0) if kind else ""
        return PointScores(deviation, change, lateness, phase, off_path, bool(kind), tilt, kind)

    def _direction(self, place: Vector) -> Vector:
        """Return the direction of travel since the point before; all zero if that is too near."""
        before, self._before = self._before or place, place
        x, y, z = place[0] - before[0], place[1] - before[1], place[2] - before[2]
        length = (x * x + y * y + z * z) ** 0.5
        return (x / length, y / length, z / length) if length > self._slow else (0.0, 0.0, 0.0)

    def _away(self, place: Vector, near: Any) -> tuple[Vector, Any]:
        """Return the mean vector (m) from the neighbours to the place, without the parts along their directions; the
        neighbours."""
        away, directions = np.subtract(place, self._places[near]), self._directions[near]
        along = (away * directions).sum(axis=1)
        x, y, z = ((away.sum(axis=0) - along @ directions) / NEIGHBOURS).tolist()
        return (x, y, z), along

    def _tilt(self, values: Sequence[float], near: Any, along: Any) -> float:
        """Return the angle (rad) from the neighbours' orientations: the mean rotation vector, to first order, without
        what they turn themselves on the way `along` to the point."""
        if self._turns is None:
            return 0.0
        turned = _turned(self._turns[near], self._chain.quaternion(values)) - along @ self._turning[near]
        self._tilts.append(tuple((turned / NEIGHBOURS).tolist()))
        x, y, z = _mean(self._tilts)
        return math.sqrt(x * x + y * y + z * z)


def _product(turn: Any) -> Any:
    """Return the matrix that turns a quaternion into the product of its conjugate and `turn`."""
    w, x, y, z = turn
    return (w, -x, -y, -z), (x, w, z, -y), (y, -z, w, x), (z, y, -x, w)


def _turned(turns: Floats, turn: Any) -> Any:
    """Return the sum of the rotation vectors from orientations (n, 4) to one, to first order; angles are at most pi."""
    product = turns @ _product(turn)
    return np.where(product[:, 0] < 0, -2.0, 2.0) @ product[:, 1:]


def turning(paths: Paths, slow: float) -> Floats:
    """Return how the benign paths turn, per metre of their way: rotation vectors (points, 3) by the points before and
    after, zero where the tool rests."""
    found = np.zeros((len(paths.places), 3))
    ways = np.linalg.norm(paths.places[2:] - paths.places[:-2], axis=1)
    moving = (paths.runs[2:] == paths.runs[:-2]) & (ways > 2 * slow)
    product = np.einsum("ni,ijn->nj", paths.turns[:-2], np.array(_product(paths.turns[2:].T)))
    vectors = np.where(product[:, :1] < 0, -2.0, 2.0) * product[:, 1:]
    found[1:-1][moving] = vectors[moving] / ways[moving, None]
    return found


def _next_time(before: float, time: float | None) -> float:
    """Return the time of a point (samples), made up if it does not grow."""
    return time if time is not None and time > before else before + 1


def _mean(vectors: Collection[Vector]) -> Vector:
    (x, y, z), count = map(sum, zip(*vectors, strict=True)), len(vectors)
    return x / count, y / count, z / count


def bin_of(phase: float, count: int, size: int) -> int:
    """Return which of the `count` pieces of `size` samples along the path holds the phase (samples)."""
    return max(0, min(int(phase) // size, count - 1))


def directions(places: Floats, slow: float = PathParameters().slow) -> Floats:
    """Return the direction of travel at each place (points, 3): unit vectors, or zero where the tool rests."""
    step = np.gradient(places, axis=0) if len(places) > 1 else np.zeros_like(places)
    length = np.linalg.norm(step, axis=1, keepdims=True)
    return np.asarray(np.where(length > slow, step / np.maximum(length, slow), 0.0))


def join_paths(paths: Sequence[Paths], near: float) -> Paths:
    """Join the paths of single runs. One that ends farther than `near` (m) from where they usually end was cut off."""
    arrays = {name: np.concatenate([getattr(path, name) for path in paths]) for name in _ARRAYS}
    ends = np.array([path.places[-1] for path in paths])
    cut_off = np.linalg.norm(ends - np.median(ends, axis=0), axis=1) > near
    arrivals = np.array([path.arrival for path in paths])
    return Paths(**arrays, arrival=float(arrivals[~cut_off if not cut_off.all() else cut_off].min()))


def _period(runs: Sequence[Recording]) -> float:
    """Return the usual time (s) between two samples; 0 without stamps, or if most do not grow."""
    steps = [np.diff(run.stamps) for run in runs if run.stamps is not None]
    return max(0.0, float(np.median(np.concatenate(steps)))) if len(steps) == len(runs) else 0.0
