"""Benign changes of a run as a whole: another speed, pauses, another start pose, an offset of the path.

A `PathDetector` subtracts what they explain, up to the bounds of `PathParameters`, before it compares scores to limits.
"""

from __future__ import annotations

import math
from bisect import insort
from dataclasses import dataclass
from typing import NamedTuple

from fame.errors import ConfigError
from fame.monitor.kinematics import Vector

SMOOTH = 3
"""Points over which deviations and tilts are averaged."""
WINDOW = 40
"""Samples over which the change of lateness is taken."""
_SETTLED = 50
"""Points on the way before the speed of a run is estimated."""
_PRIOR = 220
"""Points of no offset that the estimate of a constant offset begins with: an attack must not pass for an offset."""


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
    drift       constant offset of the path that is tolerated, m
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

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            tolerance = name in ("speed", "pause", "start", "drift")
            if type(value) not in (int, float) or not (value >= 0 if tolerance else value > 0) or not value < math.inf:
                raise ConfigError(f"expected a {name} {'of 0 or more' if tolerance else 'above 0'}, got {value!r}")

    @property
    def floors(self) -> tuple[float, float, float, float]:
        """The smallest limits, in their order."""
        return self.floor, self.floor_late, self.floor_late, self.floor_tilt


class Reading(NamedTuple):
    """Scores of a point: the deviation (m), change of lateness and lateness (samples), where along the nominal run
    (samples), whether it is off the path, and whether it is anomalous for that or another reason; the tilt (rad), and
    what is anomalous: ``path``, ``orientation``, ``speed``, or nothing."""

    deviation: float
    change: float
    lateness: float
    phase: float
    off_path: bool
    anomalous: bool
    tilt: float = 0.0
    kind: str = ""


NO_READING = Reading(0.0, 0.0, 0.0, 0.0, False, False)


class Change(NamedTuple):
    """A benign change of a run: ``speed`` (relative), ``pause`` (samples), ``start pose`` (m), ``drift`` (m) or
    ``stamps`` that were made up (number), and whether it is within the bound that is tolerated."""

    kind: str
    size: float
    tolerated: bool

    @property
    def text(self) -> str:
        """In a few words."""
        shown = {
            "speed": f"{100 * self.size:+.1f} %", "pause": f"{self.size:.0f} samples",
            "start pose": f"{1000 * self.size:.2g} mm off", "drift": f"{1000 * self.size:.2g} mm",
            "stamps": f"{self.size:.0f} made up",
        }[self.kind]  # fmt: skip
        return f"{self.kind}: {shown}" + ("" if self.tolerated else ", beyond what is tolerated")


class BenignChanges:
    """Estimates of what differs in a run as a whole, point by point: speed, pauses, start pose, offset of the path."""

    def __init__(self, parameters: PathParameters) -> None:
        self._parameters = parameters
        self.offset: Vector = (0.0, 0.0, 0.0)
        self._rates: list[float] = []  # sorted
        self._rest = self._late = self._clock = 0.0
        self._sum, self._count = (0.0, 0.0, 0.0), 0
        self._starting, self._began, self._points = True, 0.0, 0

    def add(self, deviation: Vector, clock: float, lateness: float, *, resting: bool, moving: bool) -> None:
        """Take the mean deviation of a point, its clock and lateness (samples)."""
        if resting:
            self._rest += max(0.0, clock - self._clock)
        self._clock = clock
        if not moving or not lateness:
            return
        self._late = lateness
        if clock > WINDOW:
            insort(self._rates, (lateness - self._rest) / clock)
        if not self._starting:
            self._sum = tuple(total + part for total, part in zip(self._sum, deviation, strict=True))  # type: ignore[assignment]
            self._count += 1
            self.offset = self._bounded()

    def _bounded(self) -> Vector:
        """The mean deviation, as far as it is tolerated."""
        x, y, z = (total / max(self._count, _PRIOR) for total in self._sum)
        length = math.sqrt(x * x + y * y + z * z)
        share = min(1.0, self._parameters.drift / length) if length else 0.0
        return x * share, y * share, z * share

    @property
    def rate(self) -> float:
        """Lateness per sample of the whole run: the median over its points, which a part of the run does not move."""
        return self._rates[len(self._rates) // 2] if len(self._rates) >= _SETTLED else 0.0

    def explained(self, clock: float) -> float:
        """Give the lateness (samples) that tolerated pauses and speed explain."""
        bound = self._parameters.speed
        rest = self._rest if self._rest <= self._parameters.pause else 0.0
        return rest + clock * min(max(self.rate, -bound), bound)

    def excuse(self, reading: Reading) -> Reading:
        """Give a reading that is not anomalous if it is of a start from another pose."""
        self._points += 1
        if not self._starting:
            return reading
        if reading.kind in ("path", "orientation") and reading.deviation <= self._parameters.start:
            self._began = max(self._began, reading.deviation)
            return reading._replace(anomalous=False, off_path=False, kind="")
        if self._points > SMOOTH:  # it has come to the path, or is too far away
            self._starting = False
        return reading

    def found(self) -> list[Change]:
        """Give the changes that can be told from noise."""
        p, found = self._parameters, []
        if abs(self.rate) > 0.005:
            found.append(Change("speed", 1 / (1 + self.rate) - 1, abs(self.rate) <= p.speed))
        if self._rest > 2:
            found.append(Change("pause", self._rest, self._rest <= p.pause))
        if self._began > p.floor:
            found.append(Change("start pose", self._began, self._began <= p.start))
        x, y, z = (total / max(self._count, 1) for total in self._sum)
        length = math.sqrt(x * x + y * y + z * z)
        if length > 0.4 * p.floor:
            found.append(Change("drift", length, length <= p.drift))
        return found
