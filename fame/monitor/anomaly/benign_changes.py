"""Benign changes of a run as a whole: speed, pauses, lost samples, start pose, sag, noise.

A `PathDetector` subtracts what they explain, up to the bounds of `PathParameters`, before it compares scores to limits.
"""

from __future__ import annotations

import math
from bisect import insort
from collections import deque
from typing import NamedTuple

from fame.dataclasses import dataclass
from fame.errors import ConfigError
from fame.monitor.kinematics import Vector

SMOOTH = 3
"""Points over which deviations and tilts are averaged."""
WINDOW = 40
"""Samples over which the change of lateness is taken."""
_COMING = 40
"""Points within which a tool that started elsewhere has to come nearer to the benign paths."""
_SETTLED = 50
"""Points on the way before the speed of a run is estimated."""
_HEARD = 12
"""Points before the noise of a run is estimated."""
_WIDEN = 2.0
"""What one unit of noise beyond the usual adds to the limit of deviation: the largest of 500 points keeps below it."""
_NOISY = 2.5e-5
"""Widening of the limit (m) from which on anomalies of a run are called noise."""
_GAP, _AFTER = 1.5e-5, 5
"""What is added to the limit of deviation (m), and for how many points after a missing sample: the mean of the last
points cuts corners there."""
_UNSURE = 3.0
"""What is added to the limits of lateness (samples) where lost samples were made up."""
_SOME, _FEW = 3, 5
"""Lost samples that may be seen in a run that lost none: from the first number on, being early is called sampling, from
the second on, lost samples are made up."""

TOLERATED = ("speed", "pause", "start", "drift", "noise", "lost")
"""The parameters that are bounds of what is tolerated; 0 tolerates nothing."""


@dataclass(frozen=True, slots=True)
class PathParameters:
    """Parameters of a PathDetector; in a learning file keys of `parameters`.

    floor       smallest limit of the deviation, m
    floor_tilt  smallest limit of the tilt, rad
    floor_late  smallest limits of lateness and its change, samples
    lag         what one sample of difference in time counts in the search of neighbours, m
    slow        a step of the tool too short to have a direction, m
    left        so far from its first place the tool has left it; so near its last place it has come to it, m
    bin         length of a piece of the path that has limits of its own, samples
    speed       change of speed of the whole run that is tolerated, relative
    pause       sum of pauses that is tolerated, samples; beyond it, none of them is
    start       distance from the benign paths at which a run may start, m
    drift       how far the tool may be below the benign paths, m: an arm sags as it warms up and wears
    noise       what noise beyond the usual may add to the limit of the deviation, m
    lost        share of the samples that may be lost without stamps
    """

    floor: float = 5e-5
    floor_tilt: float = 2e-3
    floor_late: float = 4.0
    lag: float = 5e-5
    slow: float = 5e-5
    left: float = 2e-3
    bin: int = 15
    speed: float = 0.03
    pause: float = 12.0
    start: float = 0.01
    drift: float = 6e-5
    noise: float = 8e-5
    lost: float = 0.05

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            tolerance = name in TOLERATED
            if type(value) not in (int, float) or not (value >= 0 if tolerance else value > 0) or not value < math.inf:
                raise ConfigError(f"expected a {name} {'of 0 or more' if tolerance else 'above 0'}, got {value!r}")
        if type(self.bin) is not int:
            raise ConfigError(f"expected a bin of whole samples, got {self.bin!r}")

    @property
    def floors(self) -> tuple[float, float, float, float]:
        """The smallest limits, in their order."""
        return self.floor, self.floor_late, self.floor_late, self.floor_tilt


class PointScores(NamedTuple):
    """Scores of a point: the deviation (m), change of lateness and lateness (samples), where along the nominal run
    (samples), whether it is off the path, and whether it is anomalous for that or another reason; the tilt (rad), and
    what is anomalous: ``path``, ``orientation``, ``speed``, nothing; or that all of it may come from ``noise`` or
    ``sampling``, beyond what is tolerated of them."""

    deviation: float
    change: float
    lateness: float
    phase: float
    off_path: bool
    anomalous: bool
    tilt: float = 0.0
    kind: str = ""


NO_READING = PointScores(0.0, 0.0, 0.0, 0.0, False, False)


class Change(NamedTuple):
    """A benign change of a run: ``speed`` (relative), ``pause`` (samples), ``start pose`` (m), ``drift`` (m),
    ``noise`` (m, what it adds to the limit), ``sampling`` (share of the samples that are missing) or ``stamps`` that
    were made up (number), and whether it is within the bound that is tolerated."""

    kind: str
    size: float
    tolerated: bool

    @property
    def text(self) -> str:
        """In a few words."""
        shown = {
            "speed": f"{100 * self.size:+.1f} %", "pause": f"{self.size:.0f} samples",
            "start pose": f"{1000 * self.size:.2g} mm off", "drift": f"{1000 * self.size:.2g} mm",
            "noise": f"{1000 * self.size:.2g} mm", "sampling": f"{100 * self.size:.2g} % of the samples are missing",
            "stamps": f"{self.size:.0f} made up",
        }[self.kind]  # fmt: skip
        return f"{self.kind}: {shown}" + ("" if self.tolerated else ", beyond what is tolerated")


class Lateness:
    """The lateness of a run, less what tolerated pauses and another speed of the whole run explain."""

    def __init__(self, parameters: PathParameters) -> None:
        self._parameters = parameters
        self._rates: list[float] = []  # sorted
        self._clock = 0.0
        self._history: deque[tuple[float, float]] = deque()
        self.rest: float = 0.0

    def step(self, clock: float, lateness: float, *, resting: bool) -> tuple[float, float]:
        """Take the clock and the lateness (samples) of a point; return what remains, and its change over the window."""
        if resting:
            self.rest += max(0.0, clock - self._clock)
        self._clock = clock
        if not lateness:  # the clock is stopped
            return 0.0, 0.0
        if clock > WINDOW:
            insort(self._rates, (lateness - self.rest) / clock)
        lateness -= self._explained(clock)
        self._history.append((clock, lateness))
        while self._history[0][0] < clock - WINDOW:
            self._history.popleft()
        return lateness, lateness - self._history[0][1]

    @property
    def rate(self) -> float:
        """Lateness per sample of the whole run: the median over its points, which a part of the run does not move."""
        return self._rates[len(self._rates) // 2] if len(self._rates) >= _SETTLED else 0.0

    def _explained(self, clock: float) -> float:
        bound = self._parameters.speed
        rest = self.rest if self.rest <= self._parameters.pause else 0.0
        return rest + clock * min(max(self.rate, -bound), bound)


class LostSamples:
    """Samples that are missing: by stamps that are far apart, without stamps by the way that the tool has gone.

    Without stamps, a point is two samples ahead of the one before, and the next one does not make up for it, as it
    does after a sample that came late.
    """

    def __init__(self, parameters: PathParameters) -> None:
        self._parameters = parameters
        self._phases: deque[float] = deque(maxlen=3)
        self.count: int = 0
        self.points: int = 0
        self.known: bool = False
        self._since = _AFTER + 1

    def step(self, phase: float, step: float | None, *, moving: bool) -> None:
        """Take the place along the run, and the time since the point before if there are stamps (samples)."""
        self.points += 1
        self._since += 1
        if step is not None:
            self.known = True
            self._miss(round(step) - 1)
            return
        if not moving:
            self._phases.clear()
            return
        self._phases.append(phase)
        if len(self._phases) == 3:
            first, middle, last = self._phases
            if middle - first > 1.75 and last - first > 2.7:
                self._miss(max(1, round(last - first - 2)))

    def _miss(self, count: int) -> None:
        if count > 0:
            self.count += count
            self._since = 0

    @property
    def recent(self) -> bool:
        """Whether a sample is missing shortly before the last point."""
        return self._since <= _AFTER

    @property
    def share(self) -> float:
        """The share of the samples that are missing; 0 for a few, which are no evidence."""
        return self.count / (self.points + self.count) if self.count >= _FEW else 0.0

    @property
    def tolerated(self) -> bool:
        """Whether they are within the bound: with stamps always, because these give the time."""
        return self.known or self.count <= 2 + self._parameters.lost * self.points


class NoiseEstimate:
    """The noise of a run: the median of the second differences of its deviations, each of means of three points."""

    def __init__(self) -> None:
        self._recent: deque[Vector] = deque(maxlen=2 * SMOOTH + 1)
        self._sizes: list[float] = []  # sorted

    def step(self, deviation: Vector) -> None:
        """Take the mean deviation of a point, m."""
        recent = self._recent
        recent.append(deviation)
        if len(recent) > 2 * SMOOTH:
            (a, b, c), (d, e, f), (g, h, i) = recent[-1], recent[SMOOTH], recent[0]
            x, y, z = a - 2 * d + g, b - 2 * e + h, c - 2 * f + i
            insort(self._sizes, math.sqrt(x * x + y * y + z * z))

    @property
    def level(self) -> float:
        """The noise so far, m."""
        return self._sizes[len(self._sizes) // 2] if len(self._sizes) >= _HEARD else 0.0


class BenignChanges:
    """Estimates of what differs in a run as a whole, point by point. `usual` is the noise (m) of benign runs."""

    def __init__(self, parameters: PathParameters, usual: float = math.inf) -> None:
        self._parameters, self._usual = parameters, usual
        self.lateness: Lateness = Lateness(parameters)
        self._without_lost = Lateness(parameters)
        self.lost: LostSamples = LostSamples(parameters)
        self.noise: NoiseEstimate = NoiseEstimate()
        self._height, self._count = 0.0, 0
        self._starting, self._began, self._points = True, 0.0, 0
        self._nearest, self._nearer = math.inf, 0  # the smallest deviation of the start, and the point of it

    def add(self, deviation: Vector, *, moving: bool) -> None:
        """Take the mean deviation of a point, m."""
        self.noise.step(deviation)
        if moving and not self._starting:
            self._height += deviation[2]
            self._count += 1

    def late(self, clock: float, lateness: float, *, resting: bool) -> list[tuple[float, float]]:
        """Return lateness and its change as they are and, if samples were lost, as they are at least with these."""
        found = [self.lateness.step(clock, lateness, resting=resting)]
        lost = 0 if self.lost.known else self.lost.count
        other = self._without_lost.step(clock + lost, lateness + lost if lateness else 0.0, resting=resting)
        if self._made_up:
            late, change = (math.copysign(max(0.0, abs(part) - _UNSURE), part) for part in other)
            found.append((late, change))
        return found

    @property
    def _made_up(self) -> bool:
        """Whether samples were lost without stamps, and are tolerated."""
        return self.lost.share > 0 and not self.lost.known and self.lost.tolerated

    def above(self, deviation: Vector) -> float:
        """Return the size of a deviation (m) without the sag that is tolerated."""
        x, y, z = deviation
        z = min(0.0, z + self._parameters.drift) if z < 0 else z
        return math.sqrt(x * x + y * y + z * z)

    @property
    def excess(self) -> float:
        """What the noise beyond the usual would add to the limit of deviation, m."""
        return _WIDEN * max(0.0, self.noise.level - self._usual)

    @property
    def widening(self) -> float:
        """What is added to the limit of deviation, m: noise as far as it is tolerated, and for missing samples."""
        return min(self.excess, self._parameters.noise) + (_GAP if self.lost.recent else 0.0)

    def kind(self, kind: str, deviation: float, limit: float, *, early: bool) -> str:
        """Return what an anomaly may come from instead: ``noise``, ``sampling``; else its kind. `early`: it is of a run
        that is ahead of time."""
        if self.lost.share and not self.lost.tolerated:
            return "sampling"
        if kind == "speed" and early and not self.lost.known and self.lost.count >= _SOME:
            return "sampling"
        return "noise" if self.excess >= _NOISY and deviation <= 2 * limit else kind

    def excuse(self, reading: PointScores) -> PointScores:
        """Return a reading that is not anomalous if it is of a start from another pose, while the tool comes nearer."""
        self._points += 1
        if not self._starting:
            return reading
        if reading.deviation < 0.9 * self._nearest:
            self._nearest, self._nearer = reading.deviation, self._points
        coming = self._points - self._nearer <= _COMING
        if coming and reading.anomalous and reading.kind != "speed" and reading.deviation <= self._parameters.start:
            self._began = max(self._began, reading.deviation)
            return reading._replace(anomalous=False, off_path=False, kind="")
        if self._points > SMOOTH:  # it has come to the path, is too far away, or stays away
            self._starting = False
        return reading

    def found(self) -> list[Change]:
        """Return the changes that can be told from noise."""
        late = self._without_lost if self._made_up else self.lateness
        p, found, rate, rest = self._parameters, [], late.rate, late.rest
        if abs(rate) > 0.005:
            found.append(Change("speed", 1 / max(0.1, 1 + rate) - 1, abs(rate) <= p.speed))
        if rest > 2:
            found.append(Change("pause", rest, rest <= p.pause))
        if self.lost.share:
            found.append(Change("sampling", self.lost.share, self.lost.tolerated))
        if self._began > p.floor:
            found.append(Change("start pose", self._began, self._began <= p.start))
        if self.excess > 0.2 * p.floor:
            found.append(Change("noise", self.excess, self.excess <= p.noise))
        sag = -self._height / max(self._count, 1)
        if sag > 0.4 * p.floor:
            found.append(Change("drift", sag, sag <= p.drift))
        return found
