"""The path planner of a ground robot: a node of its own that uses only topics, like Nav2's planner server.

It subscribes to `map` (nav_msgs/msg/OccupancyGrid, latched) and `odom`, and answers each `goal_pose`
(geometry_msgs/msg/PoseStamped) with a `plan` (nav_msgs/msg/Path) from the latest odometry to the goal. An empty path
means that the goal cannot be reached; `plan_failure` (std_msgs/msg/String) has said why before. A goal that arrives
before map and odometry is answered as soon as they are known; of several such goals, the latest.

`route` searches a grid that is already inflated by the robot's radius, so the robot is a point: the straight line if
that is free, else A* over cells with eight neighbours, whose detours are straightened. Ties are resolved in a fixed
order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from heapq import heappop, heappush
from itertools import pairwise
from typing import Any

import numpy as np

from fame.config.values import Point, parameter
from fame.dataclasses import dataclass
from fame.middleware import messages
from fame.middleware.interface import LATCHED, AnyMessage, Node
from sim2d.grid import Grid, from_message, inflate
from sim2d.robot import MEASUREMENT

_STRAIGHT, _DIAGONAL = 985, 1393
"""Costs of steps as integers, for exact comparison: 1393 / 985 is the square root of 2 to six digits."""

_UNKNOWN = 1 << 60
_TRIED = 10_000
"""Number of free cells that are tried at most to leave a start that is not free."""


def route(grid: Grid, start: Point, goal: Point, tolerance: float, ground: Grid | None = None) -> list[Point] | None:
    """Return the corners of a path from `start` to `goal` (m), both included, or None if there is no path.

    If the goal is not free, the path ends at the nearest free place within `tolerance` (m). A start that is not free,
    for example too close to a wall, is left by the shortest line; with `ground`, the grid before inflation, that line
    does not cross the wall.
    """
    first, last = nearest_free(grid, start, math.inf, ground), nearest_free(grid, goal, tolerance)
    if first is None or last is None:
        return None
    begin = [start] if grid.cell(start) == first else [start, _centre(grid, first)]
    end = goal if grid.cell(goal) == last else _centre(grid, last)
    if _in_sight(grid, begin[-1], end):
        return [*begin, end]
    cells = _search(grid, first, last)
    if cells is None:
        return None
    between = [_centre(grid, cell) for cell in cells[1:-1]]
    return begin[:-1] + _straightened(grid, [begin[-1], *between, end])


def _centre(grid: Grid, cell: tuple[int, int]) -> Point:
    return grid.origin[0] + (cell[1] + 0.5) * grid.resolution, grid.origin[1] + (cell[0] + 0.5) * grid.resolution


def nearest_free(grid: Grid, place: Point, tolerance: float, ground: Grid | None = None) -> tuple[int, int] | None:
    """Return row and column of the free cell at a place, or of the nearest one within `tolerance` (m), or None.

    With `ground`, cells with a line of sight to the place on that grid are preferred.
    """
    row, column = grid.cell(place)
    if not grid.has(row, column):
        return None
    if not grid.occupied[row, column]:
        return row, column
    free_rows, free_columns = np.nonzero(~grid.occupied)
    if not len(free_rows):
        return None
    x, y = _centre(grid, (0, 0))
    squared = (x + free_columns * grid.resolution - place[0]) ** 2 + (y + free_rows * grid.resolution - place[1]) ** 2
    best = int(np.argmin(squared))
    if ground is not None and not ground.occupied[row, column]:
        nearest = np.argsort(squared, kind="stable")[:_TRIED].tolist()
        cells = ((one, _centre(grid, (int(free_rows[one]), int(free_columns[one])))) for one in nearest)
        best = next((one for one, centre in cells if _in_sight(ground, place, centre)), best)
    return (int(free_rows[best]), int(free_columns[best])) if squared[best] <= tolerance**2 else None


def _search(grid: Grid, start: tuple[int, int], goal: tuple[int, int]) -> list[tuple[int, int]] | None:
    """A* over cells numbered row by row in a grid with an occupied rim, so that every cell has eight neighbours."""
    blocked = np.pad(grid.occupied, 1, constant_values=True)
    width, count = blocked.shape[1], blocked.size
    first, last = ((row + 1) * width + column + 1 for row, column in (start, goal))
    around = [(by, _STRAIGHT) for by in (1, -1, width, -width)]
    around += [(by, _DIAGONAL) for by in (width + 1, width - 1, 1 - width, -width - 1)]
    ahead = _estimates(blocked.shape, last)
    # The least cost of each cell so far; a blocked cell has -1, which no path undercuts.
    cost: list[int] = np.where(blocked.ravel(), -1, _UNKNOWN).tolist()
    came = [-1] * count
    done = bytearray(count)
    cost[first] = 0
    # Cost and cell are one integer, because heaps of integers are much faster than heaps of tuples. Of equal estimates
    # the one closer to the goal comes first, which keeps the search from flooding open ground.
    far = max(ahead) + 1
    queue = [(ahead[first] * far + ahead[first]) * count + first]
    while queue:
        here = heappop(queue) % count
        if here == last:
            return _traced(came, last, width)
        if done[here]:
            continue
        done[here] = 1
        so_far = cost[here]
        for by, step in around:
            there = here + by
            total = so_far + step
            if total < cost[there]:
                cost[there] = total
                came[there] = here
                left = ahead[there]
                heappush(queue, ((total + left) * far + left) * count + there)
    return None


def _estimates(shape: tuple[int, ...], goal: int) -> list[int]:
    """For each cell the cost of a path to the goal without obstacles."""
    row, column = divmod(goal, shape[1])
    rows = np.abs(np.arange(shape[0]) - row)[:, np.newaxis]
    columns = np.abs(np.arange(shape[1]) - column)[np.newaxis, :]
    diagonal = np.minimum(rows, columns)
    estimates: list[int] = (_STRAIGHT * (rows + columns - 2 * diagonal) + _DIAGONAL * diagonal).ravel().tolist()
    return estimates


def _traced(came: list[int], last: int, width: int) -> list[tuple[int, int]]:
    numbers = [last]
    while (before := came[numbers[-1]]) >= 0:
        numbers.append(before)
    return [(number // width - 1, number % width - 1) for number in reversed(numbers)]


def _straightened(grid: Grid, places: Sequence[Point]) -> list[Point]:
    """Remove the places that a straight line can skip."""
    kept = [places[0]]
    for place, following in zip(places[1:], [*places[2:], None], strict=True):
        if following is None or not _in_sight(grid, kept[-1], following):
            kept.append(place)
    return kept


def _in_sight(grid: Grid, a: Point, b: Point) -> bool:
    """Whether the straight line between two places is free, sampled every quarter of a cell."""
    count = max(2, math.ceil(math.dist(a, b) / grid.resolution * 4))
    part = np.linspace(0, 1, count)
    columns = ((a[0] + (b[0] - a[0]) * part - grid.origin[0]) / grid.resolution).astype(np.intp)
    rows = ((a[1] + (b[1] - a[1]) * part - grid.origin[1]) / grid.resolution).astype(np.intp)
    return not grid.occupied[rows, columns].any()


@dataclass(frozen=True, slots=True)
class PlannerParameters:
    """`margin` is the distance kept from obstacles; `tolerance` how far from an occupied goal a path may end (m)."""

    margin: float = parameter(0.08, "m from obstacles, at least one cell of the map", minimum=0)
    tolerance: float = parameter(
        0.5, "m between the end of the plan and a goal that is too close to an obstacle, at most", minimum=0
    )


class Planner:
    """Plans on the map for a robot that fits into a circle of `radius` m."""

    def __init__(self, node: Node, parameters: PlannerParameters, radius: float) -> None:
        self._radius, self._margin, self._tolerance = radius, parameters.margin, parameters.tolerance
        self._map: AnyMessage | None = None
        self._ground: Grid | None = None
        self._grid: Grid | None = None  # inflated; made for the first goal, because many robots never get one
        self._odometry: AnyMessage | None = None
        self._goal: AnyMessage | None = None
        self._plan = node.publisher("plan", "nav_msgs/msg/Path")
        self._failure = node.publisher("plan_failure", "std_msgs/msg/String")
        node.subscription("map", "nav_msgs/msg/OccupancyGrid", self._on_map, LATCHED)
        node.subscription("odom", "nav_msgs/msg/Odometry", self._on_odometry, MEASUREMENT)
        node.subscription("goal_pose", "geometry_msgs/msg/PoseStamped", self._on_goal)

    def _on_map(self, message: AnyMessage) -> None:
        self._map, self._grid = message, None
        self._answer()

    def _on_odometry(self, message: AnyMessage) -> None:
        self._odometry = message
        if self._goal is not None:
            self._answer()

    def _on_goal(self, message: AnyMessage) -> None:
        self._goal = message
        self._answer()

    def _answer(self) -> None:
        if self._map is None or self._odometry is None or self._goal is None:
            return
        if self._grid is None:
            self._ground = from_message(self._map)
            margin = max(self._margin, self._ground.resolution)  # cells are compared by their centres
            self._grid = inflate(self._ground, self._radius + margin)
        goal, self._goal = self._goal, None
        position, target = self._odometry.pose.pose.position, goal.pose.position
        places = None
        if math.isfinite(target.x) and math.isfinite(target.y):
            here, there = (position.x, position.y), (target.x, target.y)
            places = route(self._grid, here, there, self._tolerance, self._ground)
        if not places:
            text = f"x={target.x:g} y={target.y:g}: {_why(self._grid, (target.x, target.y))}"
            self._failure.publish(messages.create("std_msgs/msg/String", {"data": text}))
        self._plan.publish(messages.create("nav_msgs/msg/Path", _path(places or [], self._odometry, goal)))


def _why(grid: Grid, goal: Point) -> str:
    """Why there is no path to a goal, for people."""
    if not all(map(math.isfinite, goal)):
        return "not a place"
    row, column = grid.cell(goal)
    if not grid.has(row, column):
        return f"outside the map ({grid.extent})"
    return "too close to an obstacle" if grid.occupied[row, column] else "obstacles are all around"


class DirectPlanner:
    """The planner of a flying robot: always the straight line, without a map."""

    def __init__(self, node: Node) -> None:
        self._odometry: AnyMessage | None = None
        self._goal: AnyMessage | None = None
        self._plan = node.publisher("plan", "nav_msgs/msg/Path")
        node.subscription("odom", "nav_msgs/msg/Odometry", self._on_odometry, MEASUREMENT)
        node.subscription("goal_pose", "geometry_msgs/msg/PoseStamped", self._on_goal)

    def _on_odometry(self, message: AnyMessage) -> None:
        self._odometry = message
        if self._goal is not None:
            self._on_goal(self._goal)

    def _on_goal(self, message: AnyMessage) -> None:
        if self._odometry is None:
            self._goal = message
            return
        self._goal = None
        here, there = self._odometry.pose.pose.position, message.pose.position
        finite = math.isfinite(there.x) and math.isfinite(there.y)
        places = [(here.x, here.y), (there.x, there.y)] if finite else []
        self._plan.publish(messages.create("nav_msgs/msg/Path", _path(places, self._odometry, message)))


def _path(places: list[Point], odometry: AnyMessage, goal: AnyMessage) -> dict[str, Any]:
    """The fields of a nav_msgs/msg/Path: each pose faces the next, the last has the goal's orientation."""
    stamp, last = odometry.header.stamp, goal.pose.orientation
    header = {"frame_id": "map", "stamp": {"sec": stamp.sec, "nanosec": stamp.nanosec}}
    headings = [math.atan2(b[1] - a[1], b[0] - a[0]) for a, b in pairwise(places)]
    turns = [{"z": math.sin(heading / 2), "w": math.cos(heading / 2)} for heading in headings]
    turns.append({"x": last.x, "y": last.y, "z": last.z, "w": last.w})
    poses = [
        {"header": header, "pose": {"position": {"x": x, "y": y}, "orientation": turn}}
        for (x, y), turn in zip(places, turns, strict=False)
    ]
    return {"header": header, "poses": poses}
