"""The map: what is known of the ground, as a grid of cells that are free or occupied.

Obstacles and the edge of the ground are in it, targets and robots are not. A cell that an obstacle touches is
occupied, so the map never shows less than there is.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fame.config.values import Point
from fame.middleware.interface import Message
from sim2d.ground import Circle, Shape

Array = NDArray[np.floating[Any]]

OCCUPIED = 100
"""The value of an occupied cell in a nav_msgs/msg/OccupancyGrid; 0 is free, -1 unknown."""


@dataclass(frozen=True, slots=True)
class Grid:
    """`occupied[row, column]`: rows go with y, columns with x; `origin` is the outer corner of cell [0, 0], m."""

    occupied: NDArray[np.bool_]
    resolution: float
    origin: Point

    def fields(self) -> dict[str, Any]:
        """The fields of a nav_msgs/msg/OccupancyGrid in the frame `map`."""
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


def from_message(message: Message) -> Grid:
    """The grid of a nav_msgs/msg/OccupancyGrid. Cells unknown, or more likely occupied than not, are occupied."""
    info = message.info
    cells = np.asarray(message.data, dtype=np.int8).reshape(info.height, info.width)
    position = info.origin.position
    return Grid((cells < 0) | (cells >= OCCUPIED // 2), float(info.resolution), (position.x, position.y))


def rasterise(bounds: tuple[float, float, float, float], shapes: Iterable[Shape], resolution: float) -> Grid:
    """The map of the ground within `bounds` with solid `shapes`, and a rim one cell wide around it that is occupied.

    A cell of which only a part is on the ground belongs to the rim.
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


def _distance(shape: Shape, x: Array, y: Array) -> Array:
    """How far (m) points are outside of a shape; inside it is negative. At a polygon's corners less than in truth."""
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
    """The grid with every cell occupied whose centre is within `distance` (m) of the centre of an occupied one."""
    cells = distance / grid.resolution
    rows, columns = grid.occupied.shape
    result = grid.occupied.copy()
    for up in range(min(math.floor(cells), rows - 1) + 1):
        wide = _widen(grid.occupied, min(math.floor(math.sqrt(cells**2 - up**2)), columns))
        result[up:] |= wide[: len(wide) - up]
        result[: len(wide) - up] |= wide[up:]
    return Grid(result, grid.resolution, grid.origin)


def _widen(cells: NDArray[np.bool_], by: int) -> NDArray[np.bool_]:
    """Every cell that has an occupied one at most `by` to its left or right: a running count, compared with itself."""
    count = np.cumsum(np.pad(cells, ((0, 0), (by + 1, by))), axis=1, dtype=np.int32)
    wide: NDArray[np.bool_] = count[:, 2 * by + 1 :] > count[:, : -2 * by - 1]
    return wide
