"""Navigation of a simulated ground robot, as maneuvers: plan, follow the path, recover, dock.

A *maneuver* is a generator that is resumed at every odometry message: it yields the next velocity and returns an error
code of Nav2, 0 for success. Navigation replans every `_REPLAN` s on the map and on the obstacles that the range sensor
has recently seen where the map has none. Without a path, or without progress, recoveries run in turn: wait, back up,
spin. After `_RECOVERIES` of them the maneuver ends with the error code.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from fame.clock import SECOND, Scheduler
from fame.config.values import Point
from fame.middleware.interface import AnyMessage
from robots.planner import PlannerParameters, route
from sim2d.grid import Grid, inflate
from sim2d.robot import Pose

NO_PATH, GOAL_OCCUPIED, GOAL_OUTSIDE, NO_PROGRESS, NO_POSES = 208, 206, 204, 105, 309
SPIN_TIMEOUT, BACKUP_TIMEOUT, COLLISION, INVALID_INPUT = 701, 711, 714, 713
UNKNOWN_DOCK, NOT_DOCKED, NO_STAGING, NO_CONTROL, NO_CHARGE, WAYPOINT_FAILED = 901, 902, 903, 905, 906, 600
NO_WAYPOINTS = 602
_REPLAN = 1.0
"""s between two plans."""
_MEMORY = 6.0
"""s for which an obstacle that is not on the map is remembered after it was seen."""
_OBSTACLE = 0.25
"""Assumed radius of an obstacle that is not on the map, m."""
_LOOKAHEAD = 0.5
"""Distance of the point on the path that the robot steers to, m."""
_STOP = 0.3
"""The robot does not drive towards an obstacle that is nearer than this to its front, m."""
_PLACE, _ANGLE = 0.08, 0.08
"""Tolerances of a reached pose: m, rad."""
_PATIENCE, _PROGRESS = 8.0, 0.3
"""No progress: less than this distance (m) within this time (s)."""
_RECOVERIES = 6
_DOCKING = 20.0
"""Maximum time from the staging pose into the dock, s."""
_STAGING = 0.7
"""Distance of the staging pose from the dock, m."""

Maneuver = Generator["Velocity", None, int]


class Velocity(NamedTuple):
    """Forward speed (m/s) and turn rate (rad/s)."""

    ahead: float = 0.0
    turn_rate: float = 0.0


STILL = Velocity()


class Dock(NamedTuple):
    """A dock: where a docked robot stands, m. Robots approach it in the direction `heading` (rad)."""

    x: float
    y: float
    heading: float


class Limits(NamedTuple):
    """Limits of a vehicle: m/s, rad/s, m/s²; radius of its circumscribed circle and distance of its front, m."""

    speed: float
    turn_rate: float
    acceleration: float
    radius: float
    front: float


class Navigator:
    """The state of a robot that navigates, and its maneuvers. `docks` is its dock database.

    Update `ground` (the map), `pose`, `charging` (True without a battery) and `on_range` from topics. `path` and
    `recoveries` are those of the current maneuver.
    """

    def __init__(
        self, scheduler: Scheduler, parameters: PlannerParameters, limits: Limits, docks: Mapping[str, Dock]
    ) -> None:
        self.scheduler, self.limits, self.docks = scheduler, limits, docks
        self._margin, self._tolerance = parameters.margin, parameters.tolerance
        self.ground: Grid | None = None
        self._free: Grid | None = None  # inflated; made for the first plan on a map
        self._inflated: Grid | None = None
        self.pose: Pose | None = None
        self.range = math.inf
        self.charging = True
        self.path: Sequence[Point] = ()
        self.recoveries = 0
        self.unreached: Point | None = None  # the goal of the last navigation that failed
        self._docked: Dock | None = None
        self._obstacles: dict[tuple[int, int], tuple[Point, int]] = {}  # cell -> place, until when (ns)

    def on_range(self, distance: float) -> None:
        """Take a measurement (m), and remember an obstacle in front of the robot that is not on the map."""
        self.range = max(distance, 0.0)
        if self.pose is None or self.ground is None or not self.range < 1.5:
            return
        place = self.pose.ahead(self.limits.front + self.range + _OBSTACLE)
        grid, reach = self.ground, 2
        row, column = grid.cell(place)
        rows, columns = slice(max(0, row - reach), row + reach + 1), slice(max(0, column - reach), column + reach + 1)
        if not grid.occupied[rows, columns].any():
            self._obstacles[row // 2, column // 2] = place, self.scheduler.now + round(_MEMORY * SECOND)

    def go_through(self, remaining: list[Pose]) -> Maneuver:
        """Go to each pose in turn; only the last one has to be reached with its heading."""
        if not remaining:
            return NO_POSES
        while remaining:
            code = yield from self._go_to(remaining[0], turn=len(remaining) == 1)
            if code:
                return code
            del remaining[0]
        return 0

    def follow(self, goal: AnyMessage, missed: list[dict[str, Any]], at: list[int]) -> Maneuver:
        """Go to each waypoint in turn, and continue after one that cannot be reached. A further loop begins with the
        first."""
        first, count = goal.goal_index, len(goal.poses)
        if first >= count:
            return NO_WAYPOINTS
        for index in (number % count for number in range(first, count * (goal.number_of_loops + 1))):
            at[0], self.recoveries = index, 0
            code = yield from self._go_to(goal_pose(goal.poses[index]))
            if code:
                missed.append({"index": index, "goal": goal.poses[index], "error_code": code})
        return WAYPOINT_FAILED if len(missed) == count * (goal.number_of_loops + 1) - first else 0

    def _go_to(self, goal: Pose, *, turn: bool = True) -> Maneuver:
        """Plan and follow paths to a pose, with recoveries."""
        while True:
            code = yield from self._approach(goal)
            if code == 0:
                break
            if self.recoveries >= _RECOVERIES or code in (GOAL_OUTSIDE, GOAL_OCCUPIED):
                self.unreached = goal.x, goal.y
                return code
            yield from self._recover()
        if turn:
            yield from self._face(goal.heading)
        return 0

    def _recover(self) -> Maneuver:
        self.recoveries += 1
        match self.recoveries % 3:
            case 1:
                self._obstacles.clear()
                return (yield from self.wait(2.0))
            case 2:
                return (yield from self.back_up(0.3, 0.2, 4.0, [0.0]))
            case _:
                return (yield from self.spin(math.pi / 2, 5.0, [0.0]))

    def _approach(self, goal: Pose) -> Maneuver:
        """Follow paths to a place until it is reached, or there is no path or no progress."""
        planned, mark, since = -1, self.here, self.scheduler.now
        while True:
            now, here = self.scheduler.now, self.here
            if planned < 0 or now - planned >= _REPLAN * SECOND:
                path, planned = self._plan(here, (goal.x, goal.y)), now
                if isinstance(path, int):
                    self.path = ()
                    return path
                self.path = path
            if math.dist(here, self.path[-1]) < _PLACE:
                return 0
            if math.dist(here, mark) > _PROGRESS:
                mark, since = here, now
            elif now - since > _PATIENCE * SECOND:
                return NO_PROGRESS
            yield self._steer(here)

    def _steer(self, here: Point) -> Velocity:
        """The velocity towards the point of the path that is `_LOOKAHEAD` m ahead."""
        assert self.pose is not None
        limits = self.limits
        self.path = path = _passed(self.path, here)
        x, y = _ahead(path, here, _LOOKAHEAD)
        error = math.remainder(math.atan2(y - here[1], x - here[0]) - self.pose.heading, math.tau)
        turn = min(max(2.5 * error, -limits.turn_rate), limits.turn_rate)
        if abs(error) > 0.5 or self.range < _STOP:
            return Velocity(0.0, turn)
        left = sum(math.dist(a, b) for a, b in zip([here, *path], path, strict=False))
        free = max(0.0, self.range - _STOP)
        speed = min(limits.speed, math.sqrt(limits.acceleration * min(left, free)) + 0.05)
        return Velocity(speed * math.cos(error) ** 2, turn)

    def _face(self, heading: float) -> Maneuver:
        for _ in range(200):
            assert self.pose is not None
            error = math.remainder(heading - self.pose.heading, math.tau)
            if abs(error) < _ANGLE:
                break
            yield self._turn(error)
        return 0

    def _turn(self, error: float) -> Velocity:
        rate = min(self.limits.turn_rate, 2.0 * abs(error) + 0.1)
        return Velocity(0.0, math.copysign(rate, error))

    def spin(self, angle: float, allowance: float, turned: list[float]) -> Maneuver:
        """Turn on the spot by an angle (rad) within `allowance` s; `turned` is updated."""
        assert self.pose is not None
        until, before = self._until(allowance), self.pose.heading
        while abs(turned[0]) < abs(angle) - _ANGLE:
            if self.scheduler.now > until:
                return SPIN_TIMEOUT
            yield self._turn(angle - turned[0])
            turned[0] += math.remainder(self.pose.heading - before, math.tau)
            before = self.pose.heading
        return 0

    def back_up(self, distance: float, speed: float, allowance: float, gone: list[float]) -> Maneuver:
        """Drive backwards by a distance (m) within `allowance` s; `gone` is updated. It stops before mapped
        obstacles."""
        if not speed:
            return INVALID_INPUT
        start, until, stalled = self.here, self._until(allowance), 0
        while gone[0] < distance:
            if self.scheduler.now > until:
                return BACKUP_TIMEOUT
            assert self.pose is not None
            behind = self.pose.ahead(-self.limits.radius - 0.1)
            if stalled > 20 or not (self.ground is None or self.ground.is_free(behind)):
                return COLLISION
            yield Velocity(-min(speed, self.limits.speed))
            stalled = stalled + 1 if math.dist(start, self.here) <= gone[0] + 1e-3 else 0
            gone[0] = max(gone[0], math.dist(start, self.here))
        return 0

    def wait(self, seconds: float) -> Maneuver:
        until = self.scheduler.now + round(seconds * SECOND)
        while self.scheduler.now < until:
            yield STILL
        return 0

    def go_to_dock(self, dock: Dock | None, goal: AnyMessage, state: list[int]) -> Maneuver:
        """Go to the staging pose, drive into the dock, and wait until the battery is charging."""
        if dock is None:
            return UNKNOWN_DOCK
        heading = dock.heading
        staging = Pose(dock.x - _STAGING * math.cos(heading), dock.y - _STAGING * math.sin(heading), heading)
        if goal.navigate_to_staging_pose and (yield from self._go_to(staging)):
            return NO_STAGING
        state[0] = 3
        until = self._until(_DOCKING)
        while math.dist(self.here, dock[:2]) > _PLACE:
            if self.scheduler.now > until:
                return NO_CONTROL
            self.path = [(dock.x, dock.y)]
            yield self._steer(self.here)._replace(ahead=0.25)
        state[0] = 4
        for _ in range(200):
            if self.charging:
                self._docked = dock
                return 0
            yield STILL
        return NO_CHARGE

    def leave_dock(self) -> Maneuver:
        if self._docked is None:
            return NOT_DOCKED
        code = yield from self.back_up(_STAGING, 0.25, 10.0, [0.0])
        if not code:
            self._docked = None
        return NO_CONTROL if code else 0

    @property
    def here(self) -> Point:
        assert self.pose is not None  # maneuvers run on odometry
        return self.pose.x, self.pose.y

    def _until(self, allowance: float) -> int:
        """The end (ns) of a time allowance (s); 0 is unlimited."""
        return self.scheduler.now + round(allowance * SECOND) if allowance else 1 << 62

    def _plan(self, here: Point, goal: Point) -> Sequence[Point] | int:
        """The path to a place, without the start, or an error code."""
        if self.ground is None:
            return NO_PATH
        if self._free is None or self._inflated is not self.ground:
            self._inflated = self.ground
            self._free = inflate(self.ground, self.limits.radius + max(self._margin, self.ground.resolution))
        row, column = self.ground.cell(goal)
        if not self.ground.has(row, column):
            return GOAL_OUTSIDE
        grid = self._with_obstacles(self._free, here)
        path = route(grid, here, goal, self._tolerance, self.ground)
        if path is None:
            return GOAL_OCCUPIED if self._free.occupied[row, column] else NO_PATH
        return path[1:] or [goal]

    def _with_obstacles(self, free: Grid, here: Point) -> Grid:
        """The grid with the obstacles that were seen recently, except where the robot is."""
        now = self.scheduler.now
        self._obstacles = {cell: one for cell, one in self._obstacles.items() if one[1] > now}
        if not self._obstacles:
            return free
        places = np.array([place for place, _ in self._obstacles.values()])
        occupied, reach = free.occupied.copy(), _OBSTACLE + self.limits.radius
        for x, y in places:
            _occupy(occupied, free, (x, y), min(reach, math.dist((x, y), here) - free.resolution))
        return replace(free, occupied=occupied)


def _occupy(occupied: Any, grid: Grid, place: Point, radius: float) -> None:
    if radius <= 0:
        return
    row, column = grid.cell(place)
    reach = math.ceil(radius / grid.resolution)
    rows = slice(max(0, row - reach), row + reach + 1)
    columns = slice(max(0, column - reach), column + reach + 1)
    part = occupied[rows, columns]
    down = np.arange(rows.start, rows.start + part.shape[0])[:, np.newaxis] - row
    across = np.arange(columns.start, columns.start + part.shape[1])[np.newaxis, :] - column
    part |= np.hypot(down, across) * grid.resolution <= radius


def _passed(path: Sequence[Point], here: Point) -> Sequence[Point]:
    """The path without the corners that the robot has passed or is close to; the last one stays."""
    while len(path) > 1 and math.dist(here, path[0]) < _LOOKAHEAD / 2:
        path = path[1:]
    return path


def _ahead(path: Sequence[Point], here: Point, distance: float) -> Point:
    """The point at a distance (m) along the path."""
    for corner in path:
        step = math.dist(here, corner)
        if step >= distance:
            part = distance / step
            return here[0] + part * (corner[0] - here[0]), here[1] + part * (corner[1] - here[1])
        here, distance = corner, distance - step
    return path[-1]


def goal_pose(stamped: AnyMessage) -> Pose:
    """Return the pose of a geometry_msgs/msg/PoseStamped."""
    position, orientation = stamped.pose.position, stamped.pose.orientation
    return Pose(position.x, position.y, 2 * math.atan2(orientation.z, orientation.w))
