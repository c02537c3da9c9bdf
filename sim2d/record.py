"""Records a run for drawings: the appearance of robots at a fixed rate, collisions, and the weeds."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

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


@dataclass(frozen=True, slots=True)
class Record:
    """A run: the world as it was built, the times of the samples (s), a track per robot, and the weeds at its end."""

    config: WorldConfig
    times: list[float]
    tracks: list[Track]
    collisions: list[Collision]
    weeds: list[Weed]

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

    def _sample(self, world: World) -> None:
        self.record.times.append(world.now)
        for track, robot in zip(self.record.tracks, world.robots.values(), strict=True):
            appearance = robot.appearance
            track.poses.append(appearance.pose)
            track.appearances.append(appearance)
