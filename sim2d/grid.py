"""Occupancy grids: the map of the ground, inflation by a robot's size, and random placement of robots on free ground.

The map contains obstacles and the edge of the ground, but neither targets nor robots. A cell that an obstacle touches
is occupied, so the map never underestimates obstacles.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fame.config.values import Point
from fame.dataclasses import dataclass, replace
from fame.middleware.interface import AnyMessage
from sim2d.config import WorldConfig
from sim2d.ground import Circle, Outline
from sim2d.randomness import generator
from sim2d.robot import RobotConfig

Array = NDArray[np.floating[Any]]

OCCUPIED = 100
"""The value of an occupied cell in a nav_msgs/msg/OccupancyGrid; 0 is free, -1 unknown."""


@dataclass(frozen=True, slots=True)
class Grid:
    """`occupied[row, column]` with rows along y and columns along x; `origin` is the outer corner of cell [0, 0], m."""

    occupied: NDArray[np.bool_]
    resolution: float
    origin: Point

    @property
    def extent(self) -> str:
        """From where to where it reaches, for people; that of a world includes its rim of one cell."""
        (rows, columns), (x, y) = self.occupied.shape, self.origin
        return f"x {x:g} to {x + columns * self.resolution:g} m, y {y:g} to {y + rows * self.resolution:g} m"

    def cell(self, place: Point) -> tuple[int, int]:
        """Return row and column of the cell at a place, which may be outside."""
        (x, y), (x0, y0) = place, self.origin
        return math.floor((y - y0) / self.resolution), math.floor((x - x0) / self.resolution)

    def has(self, row: int, column: int) -> bool:
        """Return whether there is such a cell."""
        rows, columns = self.occupied.shape
        return row in range(rows) and column in range(columns)

    def is_free(self, place: Point) -> bool:
        """Return whether a place is inside of the grid, in a cell that is not occupied."""
        cell = self.cell(place)
        return self.has(*cell) and not self.occupied[cell]

    def fields(self) -> dict[str, Any]:
        """Return the fields of a nav_msgs/msg/OccupancyGrid in the frame `map`."""
        height, width = self.occupied.shape
        x, y = self.origin
        return {
            "header": {"frame_id": "map"},
            "info": {
                "resolution": self.resolution,
                "width": width,
                "height": height,
                "origin": {"position": {"x": x, "y": y}, "orientation": {"w": 1.0}},
            },
            "data": np.where(self.occupied, OCCUPIED, 0).astype(np.int8).ravel(),
        }


def from_message(message: AnyMessage) -> Grid:
    """Return the grid of a nav_msgs/msg/OccupancyGrid. Unknown cells, and those with a value of 50 or more, are
    occupied. A map whose origin is turned (`yaw` in ROS's ``map.yaml``) is drawn anew along the axes of its frame."""
    info = message.info
    cells = np.asarray(message.data, dtype=np.int8).reshape(info.height, info.width)
    position, turn = info.origin.position, info.origin.orientation
    grid = Grid((cells < 0) | (cells >= OCCUPIED // 2), float(info.resolution), (position.x, position.y))
    yaw = 2 * math.atan2(turn.z, turn.w)
    return _turned(grid, yaw) if abs(math.sin(yaw / 2)) > 1e-6 else grid


def _turned(grid: Grid, yaw: float) -> Grid:
    """The smallest grid along the axes around one that is turned by `yaw` (rad) about its origin.

    What is outside of it is occupied, and so is each cell that touches an occupied one.
    """
    near = inflate(grid, 1.5 * grid.resolution).occupied  # all neighbours: a turned cell touches that of its centre
    (rows, columns), cos, sin = near.shape, math.cos(yaw), math.sin(yaw)
    corners = [(x * cos - y * sin, x * sin + y * cos) for x in (0, columns) for y in (0, rows)]
    (left, right), (low, high) = ((math.floor(min(side)), math.ceil(max(side))) for side in zip(*corners, strict=True))
    x, y = np.meshgrid(np.arange(left, right) + 0.5, np.arange(low, high) + 0.5)
    column, row = (np.floor(part).astype(int) for part in (x * cos + y * sin, y * cos - x * sin))
    within = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    occupied = np.ones(x.shape, dtype=np.bool_)
    occupied[within] = near[row[within], column[within]]
    x0, y0 = grid.origin
    return Grid(occupied, grid.resolution, (x0 + left * grid.resolution, y0 + low * grid.resolution))


def rasterise(bounds: tuple[float, float, float, float], shapes: Iterable[Outline], resolution: float) -> Grid:
    """Return the map of the ground within `bounds` (m) with solid `shapes`, and an occupied rim one cell wide.

    A cell that is only partly on the ground belongs to the rim.
    """
    xmin, ymin, xmax, ymax = bounds
    columns, rows = (math.floor((high - low) / resolution + 1e-9) for low, high in ((xmin, xmax), (ymin, ymax)))
    origin = xmin - resolution, ymin - resolution
    x = (origin[0] + (np.arange(columns + 2) + 0.5) * resolution)[np.newaxis, :]
    y = (origin[1] + (np.arange(rows + 2) + 0.5) * resolution)[:, np.newaxis]
    occupied = np.ones((rows + 2, columns + 2), dtype=np.bool_)
    occupied[1:-1, 1:-1] = False
    half_diagonal = resolution * math.sqrt(0.5)
    for shape in shapes:
        occupied |= _distance(shape, x, y) <= half_diagonal
    return Grid(occupied, resolution, origin)


def _distance(shape: Outline, x: Array, y: Array) -> Array:
    """Distance (m) of points from a shape, negative inside. Near a polygon's corners it is underestimated."""
    if isinstance(shape, Circle):
        outside: Array = np.hypot(x - shape.centre[0], y - shape.centre[1]) - shape.radius
        return outside
    far = np.full(np.broadcast_shapes(x.shape, y.shape), -np.inf)
    ends = (*shape.corners[1:], shape.corners[0])
    for (ax, ay), (bx, by) in zip(shape.corners, ends, strict=True):
        length = math.hypot(bx - ax, by - ay)
        if length:
            np.maximum(far, ((x - ax) * (by - ay) - (y - ay) * (bx - ax)) / length, out=far)
    return far


def inflate(grid: Grid, distance: float) -> Grid:
    """Return the grid with every cell occupied whose centre is within `distance` (m) of the centre of an occupied
    one."""
    cells = distance / grid.resolution
    rows, columns = grid.occupied.shape
    result = grid.occupied.copy()
    for up in range(min(math.floor(cells), rows - 1) + 1):
        wide = _widen(grid.occupied, min(math.floor(math.sqrt(cells**2 - up**2)), columns))
        result[up:] |= wide[: len(wide) - up]
        result[: len(wide) - up] |= wide[up:]
    return Grid(result, grid.resolution, grid.origin)


def _widen(cells: NDArray[np.bool_], by: int) -> NDArray[np.bool_]:
    """Cells with an occupied one at most `by` cells to the left or right, by differences of cumulative counts."""
    count = np.cumsum(np.pad(cells, ((0, 0), (by + 1, by))), axis=1, dtype=np.int32)
    wide: NDArray[np.bool_] = count[:, 2 * by + 1 :] > count[:, : -2 * by - 1]
    return wide


_APART = 0.3
"""Minimum distance between the circumscribed circles of two robots, m."""


def place(config: WorldConfig, name: str, count: int, seed: int) -> tuple[RobotConfig, ...]:
    """Return all robots of a world with `count` robots ``<name>_1``, ``<name>_2``, ...

    Robots of the file keep their places; further ones are copies of the last of them on free ground, drawn by the
    `seed`. A robot ``<name>_<n>`` with n above `count` is left out. Raises ConfigError if the file has no such robot to
    copy, and if the ground is full.
    """
    group = re.compile(re.escape(name) + r"_[0-9]+")
    models = [robot for robot in config.robots if group.fullmatch(robot.name)]
    if not models:
        text = f"expected a robot {name}_1 to copy for {name}={count}; robots are: "
        raise config.source.error("robots", text + (", ".join(robot.name for robot in config.robots) or "none"))
    names = [f"{name}_{number}" for number in range(1, count + 1)]
    kept = [robot for robot in config.robots if robot not in models or robot.name in names]
    missing = [other for other in names if all(robot.name != other for robot in kept)]
    return (*kept, *_placed(config, kept, models[-1], missing, seed))


def _placed(
    config: WorldConfig, kept: list[RobotConfig], model: RobotConfig, names: list[str], seed: int
) -> list[RobotConfig]:
    """Copies of `model` with these names, at a distance from obstacles and each other."""
    solid = [thing.shape for thing in (*config.obstacles, *config.targets)]
    radius = _radius(model)
    grid = inflate(rasterise(config.bounds, solid, config.resolution), radius + _APART / 2 + config.resolution / 2)
    for robot in kept:
        _occupy(grid, robot, _radius(robot) + radius + _APART)
    random = generator(seed, "placement", model.name.rpartition("_")[0])
    placed = []
    for number, name in enumerate(names):
        free = np.flatnonzero(~grid.occupied)
        if not len(free):
            raise config.source.error(
                "robots", f"expected room for {len(names)} more robots like {model.name}, got room for {number}"
            )
        row, column = divmod(int(random.choice(free)), grid.occupied.shape[1])
        at = tuple(
            round(start + (cell + 0.5) * grid.resolution, 4)
            for start, cell in zip(grid.origin, (column, row), strict=True)
        )
        robot = replace(model, name=name, at=at, heading=round(float(random.uniform(-math.pi, math.pi)), 4))
        _occupy(grid, robot, 2 * radius + _APART)
        placed.append(robot)
    return placed


def _radius(robot: RobotConfig) -> float:
    p = robot.parameters
    sides = (p.length, p.width) if hasattr(p, "length") else (p.base, p.base)  # the square base of an arm
    return math.hypot(*sides) / 2


def _occupy(grid: Grid, robot: RobotConfig, radius: float) -> None:
    """Mark the cells as occupied whose centre is within `radius` (m) of a robot."""
    reach = math.ceil(radius / grid.resolution) + 1
    rows, columns = (slice(max(0, middle - reach), middle + reach + 1) for middle in grid.cell(robot.at))
    around: NDArray[np.bool_] = grid.occupied[rows, columns]
    y = grid.origin[1] + (np.arange(rows.start, rows.start + around.shape[0]) + 0.5) * grid.resolution
    x = grid.origin[0] + (np.arange(columns.start, columns.start + around.shape[1]) + 0.5) * grid.resolution
    around |= np.hypot(x[np.newaxis, :] - robot.at[0], y[:, np.newaxis] - robot.at[1]) <= radius
