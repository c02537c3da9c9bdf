"""Nav2 for simulated ground robots: the action servers of Nav2 on a node that uses only topics.

`navigate_to_pose`, `navigate_through_poses`, `follow_waypoints`, `dock_robot`, `undock_robot`, `spin`, `backup` and
`wait` have the interfaces of ROS 2 Jazzy, and the error codes of Nav2's planner, controller, behavior and docking
servers. The node subscribes to `map`, `odom`, `range` and `battery_state`, and publishes `cmd_vel`. One goal runs at a
time: a new goal replaces the current one, which is aborted.

Each goal is a generator (a *maneuver*) that is resumed at every odometry message: it yields the next velocity and
returns an error code, 0 for success. Navigation replans every `_REPLAN` s on the map and on the obstacles that the
range sensor has recently seen where the map has none. Without a path, or without progress, recoveries run in turn:
wait, spin, back up. After `_RECOVERIES` of them the goal is aborted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from fame.clock import SECOND, Scheduler
from fame.config.values import Point
from fame.middleware import messages
from fame.middleware.actions import ActionServer, ServerGoal
from fame.middleware.interface import LATCHED, Message, Node
from robots.planner import PlannerParameters, route
from sim2d.grid import Grid, from_message, inflate
from sim2d.robot import MEASUREMENT, Pose

NO_PATH, GOAL_OCCUPIED, GOAL_OUTSIDE, NO_PROGRESS, NO_POSES = 208, 206, 204, 105, 309
SPIN_TIMEOUT, BACKUP_TIMEOUT, COLLISION, INVALID_INPUT = 701, 711, 714, 713
UNKNOWN_DOCK, NO_STAGING, NO_CHARGE, NOT_DOCKED, WAYPOINT_FAILED = 901, 903, 906, 902, 600
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
_FEEDBACK = 0.5
"""s between two feedback messages."""
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
    """Of a vehicle: m/s, rad/s, m/s²; radius of its circumscribed circle and distance of its front, m."""

    speed: float
    turn_rate: float
    acceleration: float
    radius: float
    front: float


class Nav2:
    """Nav2 of one robot. `docks` is its dock database; with a battery, docking waits until that is charged."""

    def __init__(
        self,
        node: Node,
        scheduler: Scheduler,
        parameters: PlannerParameters,
        limits: Limits,
        docks: Mapping[str, Dock],
        *,
        battery: bool = False,
    ) -> None:
        self._scheduler, self._limits, self._docks = scheduler, limits, docks
        self._margin, self._tolerance = parameters.margin, parameters.tolerance
        self._ground: Grid | None = None
        self._free: Grid | None = None  # inflated; made for the first plan
        self._pose: Pose | None = None
        self._range = math.inf
        self._charging: bool | None = None if battery else True
        self._obstacles: dict[tuple[int, int], tuple[Point, int]] = {}  # cell -> place, until when (ns)
        self._goal: ServerGoal | None = None
        self._maneuver: Maneuver | None = None
        self._begun = self._told = 0
        self._result: Callable[[int], Mapping[str, Any]] = lambda code: {}
        self._feedback: Callable[[], Mapping[str, Any]] = lambda: {}
        self._path: Sequence[Point] = ()
        self._recoveries = 0
        self._docked: Dock | None = None
        self._publisher = node.publisher("cmd_vel", "geometry_msgs/msg/Twist")
        node.subscription("map", "nav_msgs/msg/OccupancyGrid", self._on_map, LATCHED)
        node.subscription("odom", "nav_msgs/msg/Odometry", self._on_odometry, MEASUREMENT)
        node.subscription("range", "sensor_msgs/msg/Range", self._on_range, MEASUREMENT)
        if battery:
            node.subscription("battery_state", "sensor_msgs/msg/BatteryState", self._on_battery, MEASUREMENT)
        self._servers = [
            ActionServer(node, name, f"nav2_msgs/action/{type}", begin, self._cancel, accept)
            for name, type, begin, accept in (
                ("navigate_to_pose", "NavigateToPose", self._to_pose, lambda goal: _in_map([goal.pose])),
                ("navigate_through_poses", "NavigateThroughPoses", self._through, lambda goal: _in_map(goal.poses)),
                ("follow_waypoints", "FollowWaypoints", self._waypoints, lambda goal: _in_map(goal.poses)),
                ("dock_robot", "DockRobot", self._dock, lambda goal: goal.use_dock_id or _in_map([goal.dock_pose])),
                ("undock_robot", "UndockRobot", self._undock, lambda goal: True),
                ("spin", "Spin", self._spin_goal, lambda goal: math.isfinite(goal.target_yaw)),
                ("backup", "BackUp", self._back_up_goal, lambda goal: True),
                ("wait", "Wait", self._wait_goal, lambda goal: True),
            )
        ]

    # ---- topics ----------------------------------------------------------------------------------------------------

    def _on_map(self, message: Message) -> None:
        self._ground, self._free = from_message(message), None

    def _on_battery(self, message: Message) -> None:
        self._charging = message.power_supply_status in (1, 4)  # charging, full

    def _on_range(self, message: Message) -> None:
        """Remember an obstacle in front of the robot that is not on the map."""
        self._range = message.range if message.range > -math.inf else 0.0
        if self._pose is None or self._ground is None or not self._range < 1.5:
            return
        x, y = place = self._pose.ahead(self._limits.front + self._range + _OBSTACLE)
        grid, reach = self._ground, 2
        row, column = _cell(grid, (x, y))
        rows, columns = slice(max(0, row - reach), row + reach + 1), slice(max(0, column - reach), column + reach + 1)
        if not grid.occupied[rows, columns].any():
            self._obstacles[row // 2, column // 2] = place, self._scheduler.now + round(_MEMORY * SECOND)

    def _on_odometry(self, message: Message) -> None:
        position, orientation = message.pose.pose.position, message.pose.pose.orientation
        self._pose = Pose(position.x, position.y, 2 * math.atan2(orientation.z, orientation.w))
        if self._maneuver is None or self._goal is None:
            return
        try:
            velocity = next(self._maneuver)
        except StopIteration as end:
            self._end("aborted" if end.value else "succeeded", end.value)
            return
        self._drive(velocity)
        if self._scheduler.now - self._told >= _FEEDBACK * SECOND:
            self._told = self._scheduler.now
            self._goal.feedback(self._feedback())

    def _drive(self, velocity: Velocity) -> None:
        fields = {"linear": {"x": velocity.ahead}, "angular": {"z": velocity.turn_rate}}
        self._publisher.publish(messages.create("geometry_msgs/msg/Twist", fields))

    # ---- goals -----------------------------------------------------------------------------------------------------

    def _begin(
        self,
        goal: ServerGoal,
        maneuver: Maneuver,
        feedback: Callable[[], Mapping[str, Any]],
        result: Callable[[int], Mapping[str, Any]] | None = None,
    ) -> None:
        """Run a maneuver for a goal; a goal that runs already is aborted."""
        self._end("aborted", 0, "replaced by a new goal")
        self._goal, self._maneuver, self._feedback = goal, maneuver, feedback
        self._result = result or (lambda code: {})
        self._begun = self._told = self._scheduler.now
        self._recoveries = 0

    def _end(self, outcome: Any, code: int, text: str = "") -> None:
        goal, self._goal, self._maneuver, self._path = self._goal, None, None, ()
        if goal is not None:
            self._drive(STILL)
            goal.end(outcome, {**self._result(code), "error_code": code, "error_msg": text or _TEXTS.get(code, "")})

    def _cancel(self, goal: ServerGoal) -> None:
        if goal is self._goal:
            self._end("canceled", 0)

    def _elapsed(self) -> dict[str, int]:
        return _duration(self._scheduler.now - self._begun)

    def _to_pose(self, goal: ServerGoal) -> None:
        self._begin(goal, self._go_through([_pose(goal.message.pose)]), self._progress)

    def _through(self, goal: ServerGoal) -> None:
        remaining = list(map(_pose, goal.message.poses))
        feedback = lambda: {**self._progress(), "number_of_poses_remaining": len(remaining)}  # noqa: E731
        self._begin(goal, self._go_through(remaining), feedback)

    def _waypoints(self, goal: ServerGoal) -> None:
        missed: list[dict[str, Any]] = []
        at = [0]
        maneuver = self._follow(goal.message, missed, at)
        self._begin(goal, maneuver, lambda: {"current_waypoint": at[0]}, lambda code: {"missed_waypoints": missed})

    def _dock(self, goal: ServerGoal) -> None:
        message = goal.message
        dock = self._docks.get(message.dock_id) if message.use_dock_id else Dock(*_pose(message.dock_pose))
        state = [1]
        feedback = lambda: {"state": state[0], "docking_time": self._elapsed()}  # noqa: E731
        maneuver = self._go_to_dock(dock, message, state)
        self._begin(goal, maneuver, feedback, lambda code: {"success": code == 0, "num_retries": 0})

    def _undock(self, goal: ServerGoal) -> None:
        self._begin(goal, self._leave_dock(), dict, lambda code: {"success": code == 0})

    def _spin_goal(self, goal: ServerGoal) -> None:
        turned = [0.0]
        maneuver = self._spin(goal.message.target_yaw, _seconds(goal.message.time_allowance), turned)
        elapsed = lambda code: {"total_elapsed_time": self._elapsed()}  # noqa: E731
        self._begin(goal, maneuver, lambda: {"angular_distance_traveled": turned[0]}, elapsed)

    def _back_up_goal(self, goal: ServerGoal) -> None:
        gone, message = [0.0], goal.message
        maneuver = self._back_up(abs(message.target.x), abs(message.speed), _seconds(message.time_allowance), gone)
        elapsed = lambda code: {"total_elapsed_time": self._elapsed()}  # noqa: E731
        self._begin(goal, maneuver, lambda: {"distance_traveled": gone[0]}, elapsed)

    def _wait_goal(self, goal: ServerGoal) -> None:
        until = self._scheduler.now + round(_seconds(goal.message.time) * SECOND)
        elapsed = lambda code: {"total_elapsed_time": self._elapsed()}  # noqa: E731
        left = lambda: {"time_left": _duration(max(0, until - self._scheduler.now))}  # noqa: E731
        self._begin(goal, self._wait(_seconds(goal.message.time)), left, elapsed)

    def _progress(self) -> dict[str, Any]:
        """Feedback of navigation."""
        assert self._pose is not None
        x, y, heading = self._pose
        places = [(x, y), *self._path]
        distance = sum(math.dist(a, b) for a, b in pairwise(places))
        turn = {"z": math.sin(heading / 2), "w": math.cos(heading / 2)}
        return {
            "current_pose": {
                "header": {"frame_id": "map"},
                "pose": {"position": {"x": x, "y": y}, "orientation": turn},
            },
            "navigation_time": self._elapsed(),
            "estimated_time_remaining": _duration(round(distance / self._limits.speed * SECOND)),
            "number_of_recoveries": self._recoveries,
            "distance_remaining": distance,
        }

    # ---- maneuvers -------------------------------------------------------------------------------------------------

    def _go_through(self, remaining: list[Pose]) -> Maneuver:
        """Go to each pose in turn; only the last one has to be reached with its heading."""
        if not remaining:
            return NO_POSES
        while remaining:
            code = yield from self._go_to(remaining[0], turn=len(remaining) == 1)
            if code:
                return code
            del remaining[0]
        return 0

    def _follow(self, goal: Message, missed: list[dict[str, Any]], at: list[int]) -> Maneuver:
        """Go to each waypoint in turn, and continue after one that cannot be reached."""
        for _ in range(goal.number_of_loops + 1):
            for index in range(goal.goal_index, len(goal.poses)):
                at[0], self._recoveries = index, 0
                code = yield from self._go_to(_pose(goal.poses[index]))
                if code:
                    missed.append({"index": index, "goal": goal.poses[index], "error_code": code})
        return WAYPOINT_FAILED if missed and len(missed) == len(goal.poses) else 0

    def _go_to(self, goal: Pose, *, turn: bool = True) -> Maneuver:
        """Plan and follow paths to a pose, with recoveries."""
        while True:
            code = yield from self._approach(goal)
            if code == 0:
                break
            if self._recoveries >= _RECOVERIES or code in (GOAL_OUTSIDE, GOAL_OCCUPIED):
                return code
            yield from self._recover()
        if turn:
            yield from self._face(goal.heading)
        return 0

    def _recover(self) -> Maneuver:
        self._recoveries += 1
        match self._recoveries % 3:
            case 1:
                self._obstacles.clear()
                return (yield from self._wait(2.0))
            case 2:
                return (yield from self._back_up(0.3, 0.2, 4.0, [0.0]))
            case _:
                return (yield from self._spin(math.pi / 2, 5.0, [0.0]))

    def _approach(self, goal: Pose) -> Maneuver:
        """Follow paths to a place until it is reached, or there is no path or no progress."""
        planned, mark, since = -1, self._here, self._scheduler.now
        while True:
            now, here = self._scheduler.now, self._here
            if planned < 0 or now - planned >= _REPLAN * SECOND:
                path, planned = self._plan(here, (goal.x, goal.y)), now
                if isinstance(path, int):
                    self._path = ()
                    return path
                self._path = path
            if math.dist(here, self._path[-1]) < _PLACE:
                return 0
            if math.dist(here, mark) > _PROGRESS:
                mark, since = here, now
            elif now - since > _PATIENCE * SECOND:
                return NO_PROGRESS
            yield self._steer(here)

    def _steer(self, here: Point) -> Velocity:
        """The velocity towards the point of the path that is `_LOOKAHEAD` m ahead."""
        assert self._pose is not None
        limits = self._limits
        self._path = path = _passed(self._path, here)
        x, y = _ahead(path, here, _LOOKAHEAD)
        error = math.remainder(math.atan2(y - here[1], x - here[0]) - self._pose.heading, math.tau)
        turn = min(max(2.5 * error, -limits.turn_rate), limits.turn_rate)
        if abs(error) > 0.5 or self._range < _STOP:
            return Velocity(0.0, turn)
        left = sum(math.dist(a, b) for a, b in zip([here, *path], path, strict=False))
        free = max(0.0, self._range - _STOP)
        speed = min(limits.speed, math.sqrt(limits.acceleration * min(left, free)) + 0.05)
        return Velocity(speed * math.cos(error) ** 2, turn)

    def _face(self, heading: float) -> Maneuver:
        for _ in range(200):
            assert self._pose is not None
            error = math.remainder(heading - self._pose.heading, math.tau)
            if abs(error) < _ANGLE:
                break
            yield self._turn(error)
        return 0

    def _turn(self, error: float) -> Velocity:
        rate = min(self._limits.turn_rate, 2.0 * abs(error) + 0.1)
        return Velocity(0.0, math.copysign(rate, error))

    def _spin(self, angle: float, allowance: float, turned: list[float]) -> Maneuver:
        """Turn on the spot by an angle (rad) within `allowance` s; `turned` is updated."""
        assert self._pose is not None
        until, before = self._until(allowance), self._pose.heading
        while abs(turned[0]) < abs(angle) - _ANGLE:
            if self._scheduler.now > until:
                return SPIN_TIMEOUT
            yield self._turn(angle - turned[0])
            turned[0] += math.remainder(self._pose.heading - before, math.tau)
            before = self._pose.heading
        return 0

    def _back_up(self, distance: float, speed: float, allowance: float, gone: list[float]) -> Maneuver:
        """Drive backwards by a distance (m) within `allowance` s; `gone` is updated. It stops before mapped
        obstacles."""
        if not speed:
            return INVALID_INPUT
        start, until, stalled = self._here, self._until(allowance), 0
        while gone[0] < distance:
            if self._scheduler.now > until:
                return BACKUP_TIMEOUT
            assert self._pose is not None
            behind = self._pose.ahead(-self._limits.radius - 0.1)
            if stalled > 20 or (self._ground is not None and self._ground.occupied[_cell(self._ground, behind)]):
                return COLLISION
            yield Velocity(-min(speed, self._limits.speed))
            stalled = stalled + 1 if math.dist(start, self._here) <= gone[0] + 1e-3 else 0
            gone[0] = max(gone[0], math.dist(start, self._here))
        return 0

    def _wait(self, seconds: float) -> Maneuver:
        until = self._scheduler.now + round(seconds * SECOND)
        while self._scheduler.now < until:
            yield STILL
        return 0

    def _go_to_dock(self, dock: Dock | None, goal: Message, state: list[int]) -> Maneuver:
        """Go to the staging pose, drive into the dock, and wait until the battery is charging."""
        if dock is None:
            return UNKNOWN_DOCK
        heading = dock.heading
        staging = Pose(dock.x - _STAGING * math.cos(heading), dock.y - _STAGING * math.sin(heading), heading)
        if goal.navigate_to_staging_pose and (yield from self._go_to(staging)):
            return NO_STAGING
        state[0] = 3
        while math.dist(self._here, dock[:2]) > _PLACE:
            self._path = [(dock.x, dock.y)]
            yield self._steer(self._here)._replace(ahead=0.25)
        state[0] = 4
        for _ in range(200):
            if self._charging:
                self._docked = dock
                return 0
            yield STILL
        return NO_CHARGE

    def _leave_dock(self) -> Maneuver:
        if self._docked is None:
            return NOT_DOCKED
        code = yield from self._back_up(_STAGING, 0.25, 10.0, [0.0])
        if not code:
            self._docked = None
        return 905 if code else 0

    # ---- planning --------------------------------------------------------------------------------------------------

    @property
    def _here(self) -> Point:
        assert self._pose is not None  # maneuvers run on odometry
        return self._pose.x, self._pose.y

    def _until(self, allowance: float) -> int:
        """The end (ns) of a time allowance (s); 0 is unlimited."""
        return self._scheduler.now + round(allowance * SECOND) if allowance else 1 << 62

    def _plan(self, here: Point, goal: Point) -> Sequence[Point] | int:
        """The path to a place, without the start, or an error code."""
        if self._ground is None:
            return NO_PATH
        if self._free is None:
            self._free = inflate(self._ground, self._limits.radius + max(self._margin, self._ground.resolution))
        row, column = _cell(self._ground, goal)
        rows, columns = self._ground.occupied.shape
        if not (0 <= row < rows and 0 <= column < columns):
            return GOAL_OUTSIDE
        grid = self._with_obstacles(self._free, here)
        path = route(grid, here, goal, self._tolerance, self._ground)
        if path is None:
            return GOAL_OCCUPIED if self._free.occupied[row, column] else NO_PATH
        return path[1:] or [goal]

    def _with_obstacles(self, free: Grid, here: Point) -> Grid:
        """The grid with the obstacles that were seen recently, except where the robot is."""
        now = self._scheduler.now
        self._obstacles = {cell: one for cell, one in self._obstacles.items() if one[1] > now}
        if not self._obstacles:
            return free
        places = np.array([place for place, _ in self._obstacles.values()])
        occupied, reach = free.occupied.copy(), _OBSTACLE + self._limits.radius
        for x, y in places:
            _occupy(occupied, free, (x, y), min(reach, math.dist((x, y), here) - free.resolution))
        return replace(free, occupied=occupied)


def _occupy(occupied: Any, grid: Grid, place: Point, radius: float) -> None:
    if radius <= 0:
        return
    row, column = _cell(grid, place)
    reach = math.ceil(radius / grid.resolution)
    rows = slice(max(0, row - reach), row + reach + 1)
    columns = slice(max(0, column - reach), column + reach + 1)
    part = occupied[rows, columns]
    down = np.arange(rows.start, rows.start + part.shape[0])[:, np.newaxis] - row
    across = np.arange(columns.start, columns.start + part.shape[1])[np.newaxis, :] - column
    part |= np.hypot(down, across) * grid.resolution <= radius


def _cell(grid: Grid, place: Point) -> tuple[int, int]:
    (x, y), (x0, y0) = place, grid.origin
    return math.floor((y - y0) / grid.resolution), math.floor((x - x0) / grid.resolution)


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


def _in_map(poses: Iterable[Message]) -> bool:
    """Whether poses are finite and in the frame `map`, the only one known here."""
    return all(pose.header.frame_id.lstrip("/") == "map" and all(map(math.isfinite, (*_pose(pose),))) for pose in poses)


def _pose(stamped: Message) -> Pose:
    position, orientation = stamped.pose.position, stamped.pose.orientation
    return Pose(position.x, position.y, 2 * math.atan2(orientation.z, orientation.w))


def _seconds(duration: Message) -> float:
    return float(duration.sec + duration.nanosec / SECOND)


def _duration(nanoseconds: int) -> dict[str, int]:
    return {"sec": nanoseconds // SECOND, "nanosec": nanoseconds % SECOND}


_TEXTS = {
    NO_PATH: "no valid path",
    GOAL_OCCUPIED: "the goal is occupied",
    GOAL_OUTSIDE: "the goal is outside of the map",
    NO_PROGRESS: "failed to make progress",
    NO_POSES: "no poses given",
    SPIN_TIMEOUT: "the time allowance is over",
    BACKUP_TIMEOUT: "the time allowance is over",
    COLLISION: "collision ahead",
    INVALID_INPUT: "expected a speed other than 0",
    UNKNOWN_DOCK: "the dock is not in the database",
    NO_STAGING: "failed to reach the staging pose",
    NO_CHARGE: "the battery is not charging",
    NOT_DOCKED: "the robot is not docked",
    WAYPOINT_FAILED: "no waypoint was reached",
}
