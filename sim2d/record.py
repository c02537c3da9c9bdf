"""Records a run for drawings: the appearance of robots at a fixed rate, collisions, and the weeds."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from fame.config.values import Point
from sim2d.config import WorldConfig
from sim2d.robot import Appearance, Pose

if TYPE_CHECKING:
    from sim2d.ground import Weed
    from sim2d.world import Collision, World


@dataclass(frozen=True, slots=True)
class Track:
    """One robot during a run, with one entry per sample. `outline` has its corners in its own frame, m."""

    name: str
    type: str
    outline: tuple[Point, ...]
    poses: list[Pose] = field(default_factory=list)
    appearances: list[Appearance] = field(default_factory=list)


class Things(NamedTuple):
    """At a sample: how far each door is open (0 to 1), and where each parcel lies (None: a robot carries it)."""

    doors: tuple[float, ...]
    parcels: tuple[Point | None, ...]


@dataclass(frozen=True, slots=True)
class Record:
    """A run: the world as it was built, the times of the samples (s), a track per robot, and the weeds at its end."""

    config: WorldConfig
    times: list[float]
    tracks: list[Track]
    collisions: list[Collision]
    weeds: list[Weed]
    things: list[Things] = field(default_factory=list)

    def cutter(self, weed: Weed) -> int | None:
        """The index of the robot that cut a weed, or None."""
        names = [track.name for track in self.tracks]
        return names.index(weed.cut_by) if weed.cut_by in names else None


class Recorder:
    """Samples a world at `rate` (Hz, as near as its step allows) from its start to its stop."""

    def __init__(self, world: World, rate: float = 10.0) -> None:
        self._every = max(1, math.floor(1 / (rate * world.step) + 0.5))
        tracks = [Track(name, robot.type, robot.outline) for name, robot in world.robots.items()]
        self.record = Record(world.config, [], tracks, world.collisions, world.weeds.all)
        world.watchers.append(self._watch)

    def _watch(self, world: World) -> None:
        if world.steps % self._every == 0:
            self._sample(world)

    def finish(self, world: World) -> None:
        """Record the final state."""
        if not self.record.times or world.now > self.record.times[-1]:
            self._sample(world)
        else:
            for track, robot in zip(self.record.tracks, world.robots.values(), strict=True):
                track.appearances[-1] = robot.appearance
            self.record.things[-1] = _things(world)

    def _sample(self, world: World) -> None:
        self.record.times.append(world.now)
        self.record.things.append(_things(world))
        for track, robot in zip(self.record.tracks, world.robots.values(), strict=True):
            appearance = robot.appearance
            track.poses.append(appearance.pose)
            track.appearances.append(appearance)


def _things(world: World) -> Things:
    doors = tuple(door.opening for door in world.doors)
    return Things(doors, tuple(None if parcel.carrier else parcel.at for parcel in world.parcels.all))
