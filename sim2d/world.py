"""The world: bodies that move in fixed steps, run by the scheduler.

World time is the step count times the step, never a sum. Each step is one entry of the scheduler, the last of its
instant: robots apply forces, all bodies move, then robots measure, always in the order of the file. A command that a
robot receives at an instant takes effect in the next step.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from fame.clock import SECOND, Entry, Kind, Scheduler
from fame.config.values import Point
from fame.errors import ConfigError, MissionError
from fame.imports import require
from fame.middleware import messages
from fame.middleware.interface import AnyMessage, Middleware
from fame.text import suggestion
from sim2d.config import WorldConfig, world_config
from sim2d.grid import Grid, rasterise
from sim2d.ground import Circle, Thing, Weeds
from sim2d.randomness import generator
from sim2d.robot import ROBOT, Pose, SimulatedRobot

if TYPE_CHECKING:
    import numpy as np

from sim2d.warehouse import THICKNESS, Door, Parcels

require("pymunk")
import pymunk  # noqa: E402 (a missing package is reported first)

_WALL = 0.05
"""Half the thickness of the walls, m; they are outside of the ground."""
_BREATH = 0.2
"""Minimum pause between two steps, as a share of the step, when a world on the wall clock is late: time for engines."""


class Collision(NamedTuple):
    """Robot `a` began to touch `b`, a robot, an obstacle, a target or ``wall``, at `time` (s)."""

    time: float
    a: str
    b: str


class World:
    """A world with its robots. Raises ConfigError if the mapping is wrong or a robot overlaps something.

    `robots` are by name in the order of the file, `collisions` all since the start, `faults` the injected faults by
    robot, `steps` the number of steps done. `watchers` are called with the world after each step.
    """

    def __init__(
        self, config: WorldConfig | Mapping[str, Any], *, seed: int = 0, scheduler: Scheduler, middleware: Middleware
    ) -> None:
        self.config = config if isinstance(config, WorldConfig) else world_config(config)
        self.seed, self.scheduler, self.middleware = seed, scheduler, middleware
        self.step = self.config.step
        self.space = pymunk.Space()
        self.space.collision_slop = 0.001  # m; the default suits pixels
        self.space.sleep_time_threshold = 0.5  # s; bodies at complete rest fall asleep and cost nothing
        self.grid: Grid = rasterise(
            self.config.bounds, (thing.shape for thing in self.config.obstacles), self.config.resolution
        )
        self.map: AnyMessage = messages.create("nav_msgs/msg/OccupancyGrid", self.grid.fields())
        self.weeds = Weeds(self.config.weeds, lambda: self.now)
        self.parcels = Parcels(self.config.parcels, self.config.stations)
        self.doors: list[Door] = []
        self.docks: Mapping[str, Pose] = {
            one.name: Pose(*one.at, math.radians(one.heading)) for one in self.config.chargers
        }
        self.robots: dict[str, SimulatedRobot] = {}
        self.collisions: list[Collision] = []
        self.faults: dict[str, list[str]] = {}
        self.watchers: list[Callable[[World], object]] = []
        self.steps = 0
        self._sensed = -1  # number of the step after which the robots measured last
        self._origin = 0
        self._next: Entry | None = None
        self._names: dict[pymunk.Shape, str] = {}
        try:
            self._build()
        except BaseException:
            self._clear()
            raise

    @property
    def now(self) -> float:
        """Seconds since the start."""
        return self.steps * self.step

    def random(self, robot: str, sensor: str) -> np.random.Generator:
        """Return the random generator of one sensor of one robot."""
        return generator(self.seed, robot, sensor)

    def charging(self, place: Point) -> float:
        """Return the power (W) of the chargers at a place (m)."""
        return sum(one.power for one in self.config.chargers if math.dist(one.at, place) <= one.radius)

    def start(self) -> None:
        """Publish latched topics and first measurements; then step until `stop`. Further calls have no effect."""
        if self._next is not None:
            return
        self._origin = self.scheduler.now - self._nanoseconds(self.steps)
        if self._sensed == self.steps:
            self._await_step()
            return
        for robot in self.robots.values():
            robot.start()
        self._next = self.scheduler.soon(self._sense, Kind.WORLD)

    def stop(self) -> None:
        """Stop stepping; `start` continues."""
        if self._next is not None:
            self._next.cancel()
            self._next = None

    def close(self) -> None:
        """Stop, close the nodes of all robots, and empty the physics space."""
        self.stop()
        for door in self.doors:
            door.close()
        for robot in self.robots.values():
            robot.close()
        self._clear()

    def summary(self) -> dict[str, Any]:
        """Return the state of the world, JSON-serialisable: m, rad, s, rounded to 0.1 mm.

        Each robot has its pose, number of collisions, distance from each target (centre to centre), the entries of its
        type (`SimulatedRobot.status`), and its faults; each weed has the time it was cut, and the robot that cut it;
        each parcel its place and carrier, each door how far it is open (0 to 1), if there are any.
        """
        things: dict[str, Any] = {}
        if self.parcels.all:
            things["parcels"] = {parcel.name: self.parcels.summary(parcel) for parcel in self.parcels.all}
        if self.doors:
            things["doors"] = {door.config.name: round(door.opening, 2) for door in self.doors}
        touched = Counter(name for _, a, b in self.collisions for name in (a, b))
        return {
            "time": round(self.now, 4),
            "robots": {name: self._standing(robot, touched[name]) for name, robot in self.robots.items()},
            "weeds": {weed.name: weed.summary() for weed in self.weeds.all},
            **things,
            "collisions": [{"time": round(time, 4), "a": a, "b": b} for time, a, b in self.collisions],
        }

    def _standing(self, robot: SimulatedRobot, collisions: int) -> dict[str, Any]:
        x, y, heading = robot.pose
        return {
            "x": round(x, 4),
            "y": round(y, 4),
            "heading": round(math.remainder(heading, math.tau), 4),
            **robot.status,
            "faults": self.faults.get(robot.name, []),
            "collisions": collisions,
            "distances": {
                target.name: round(math.dist((x, y), target.shape.centre), 4) for target in self.config.targets
            },
        }

    def fault(self, robot: str, kind: str) -> None:
        """Inject a fault into a robot, permanently. Raises ConfigError for an unknown robot or fault."""
        if robot not in self.robots:
            raise ConfigError(f"unknown robot {robot!r} in a fault; {suggestion(robot, self.robots)}")
        self.robots[robot].fault(kind)
        self.faults.setdefault(robot, []).append(kind)

    def _clear(self) -> None:
        """Empty the physics space.

        The garbage collector may call pymunk's destructors, which are Python functions, in the middle of a script. If
        one fails there because of a deep recursion, a body is freed that the space still refers to, and the process
        crashes. An empty space refers to no body.
        """
        self.space.remove(*self.space.shapes, *self.space.bodies)

    def _do_step(self) -> None:
        begin = self._origin + self._nanoseconds(self.steps)
        for robot in self.robots.values():
            robot.move(begin, self.step)
        self.space.step(self.step)
        for robot in self.robots.values():
            if not math.isfinite(sum(robot.pose)):
                raise MissionError(f"its simulation has failed: it is at {robot.pose}", robot=robot.name)
        self.steps += 1
        self._sense()

    def _sense(self) -> None:
        now = self._origin + self._nanoseconds(self.steps)
        self._sensed = self.steps
        self._await_step()
        for robot in self.robots.values():
            robot.sense(now, self.steps)
        for watch in self.watchers:
            watch(self)

    def _await_step(self) -> None:
        due = self._origin + self._nanoseconds(self.steps + 1)
        breath = self.scheduler.now + self._nanoseconds(_BREATH)
        self._next = self.scheduler.at(max(due, breath), self._do_step, Kind.WORLD)

    def _nanoseconds(self, steps: float) -> int:
        return round(steps * self.step * SECOND)

    def _build(self) -> None:
        for thing in (*self.config.obstacles, *self.config.targets):
            self._add(_static(self.space, thing), thing.name)
        for weed in self.weeds.all:
            weed.covered = bool(self.space.point_query(weed.at, 0.0, pymunk.ShapeFilter()))
        if self.config.walls:
            for wall in _walls(self.space, self.config.bounds):
                self._add(wall, "wall")
        for door in self.config.doors:
            leaf = pymunk.Segment(self.space.static_body, door.start, door.end, THICKNESS / 2)
            self._add(leaf, door.name)
            self.doors.append(Door(door, self.space, leaf, self.scheduler, self.middleware))
        for config in self.config.robots:
            robot = config.make(config, self)
            self.robots[config.name] = robot
            for shape in robot.body.shapes:
                touched = sorted(self._names[hit.shape] for hit in self.space.shape_query(shape) if hit.shape)
                if touched:
                    text = f"expected a free place; {config.name} overlaps {touched[0]}"
                    raise self.config.source.error(config.path, text)
                self._names[shape] = config.name
        self.space.on_collision(ROBOT, None, begin=self._on_touch)

    def _add(self, shape: pymunk.Shape, name: str) -> None:
        shape.friction = 0.5
        self.space.add(shape)
        self._names[shape] = name

    def _on_touch(self, arbiter: pymunk.Arbiter, space: pymunk.Space, data: object) -> None:
        a, b = (self._names[shape] for shape in arbiter.shapes)
        time = (self.steps + 1) * self.step
        if self.collisions[-1:] != [Collision(time, b, a)]:  # two robots: pymunk reports the pair twice
            self.collisions.append(Collision(time, a, b))


def _static(space: pymunk.Space, thing: Thing) -> pymunk.Shape:
    shape = thing.shape
    if isinstance(shape, Circle):
        return pymunk.Circle(space.static_body, shape.radius, shape.centre)
    return pymunk.Poly(space.static_body, shape.corners)


def _walls(space: pymunk.Space, bounds: tuple[float, float, float, float]) -> list[pymunk.Shape]:
    low_x, low_y, high_x, high_y = bounds[0] - _WALL, bounds[1] - _WALL, bounds[2] + _WALL, bounds[3] + _WALL
    corners = [(low_x, low_y), (high_x, low_y), (high_x, high_y), (low_x, high_y)]
    ends = corners[1:] + corners[:1]
    return [pymunk.Segment(space.static_body, a, b, _WALL) for a, b in zip(corners, ends, strict=True)]
