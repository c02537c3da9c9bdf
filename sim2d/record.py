"""Watches a world and keeps what a drawing of its run needs: poses, LEDs and range cones at a fixed rate."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from robots.robot import Cone, Pose
from sim2d.config import WorldConfig
from sim2d.reading import Point

if TYPE_CHECKING:
    from sim2d.world import Collision, World


@dataclass(frozen=True, slots=True)
class Track:
    """One robot through a run, an entry per sample. `outline` is its corners in its own frame, m."""

    name: str
    outline: tuple[Point, ...]
    poses: list[Pose] = field(default_factory=list)
    leds: list[str] = field(default_factory=list)
    cones: list[Cone | None] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Record:
    """A run: the world as it was built, the times of the samples (s), and a track per robot."""

    config: WorldConfig
    times: list[float]
    tracks: list[Track]
    collisions: list[Collision]


class Recorder:
    """Samples a world at `rate` (Hz, as near as its step allows) from its start to its stop."""

    def __init__(self, world: World, rate: float = 10.0) -> None:
        self._every = max(1, math.floor(1 / (rate * world.step) + 0.5))
        tracks = [Track(name, robot.outline) for name, robot in world.robots.items()]
        self.record = Record(world.config, [], tracks, world.collisions)
        world.watchers.append(self._watch)

    def _watch(self, world: World) -> None:
        if world.steps % self._every:
            return
        self.record.times.append(world.now)
        for track, robot in zip(self.record.tracks, world.robots.values(), strict=True):
            track.poses.append(robot.pose)
            track.leds.append(robot.led)
            track.cones.append(robot.cone)
