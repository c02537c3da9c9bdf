"""Finds a short way on a grid: the straight line if that is free, else A* from cell to cell with its detours cut.

A route is searched among the free cells of a grid that is already inflated by the size of the robot: it may then
treat the robot as a point. Steps go to the eight neighbours. Of equally short ways the search takes always the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from heapq import heappop, heappush

import numpy as np

from fame.config.values import Point
from sim2d.grid import Grid

_STRAIGHT, _DIAGONAL = 985, 1393
"""Costs of steps as integers, for exact comparison: 1393 / 985 is the square root of 2 to six places."""

_UNKNOWN = 1 << 60
_TRIED = 10_000
"""Cells that are looked at from a start that is not free, at most."""


def route(grid: Grid, start: Point, goal: Point, tolerance: float, ground: Grid | None = None) -> list[Point] | None:
    """The corners of a way from `start` to `goal` (m), both included, or None if there is none.

    If the goal is not free, the way ends at the nearest free place within `tolerance` (m). A start that is not free,
    as of a robot that stands too close to a wall, is left by the shortest way; not through that wall, if `ground`, the
    grid that is not inflated, tells where it is.
    """
    first, last = nearest_free(grid, start, math.inf, ground), nearest_free(grid, goal, tolerance)
    if first is None or last is None:
        return None
    begin = [start] if _cell(grid, start) == first else [start, _centre(grid, first)]
    end = goal if _cell(grid, goal) == last else _centre(grid, last)
    if _in_sight(grid, begin[-1], end):
        return [*begin, end]
    cells = _search(grid, first, last)
    if cells is None:
        return None
    between = [_centre(grid, cell) for cell in cells[1:-1]]
    return begin[:-1] + _straightened(grid, [begin[-1], *between, end])


def _cell(grid: Grid, place: Point) -> tuple[int, int]:
    """Row and column."""
    (x, y), (x0, y0) = place, grid.origin
    return math.floor((y - y0) / grid.resolution), math.floor((x - x0) / grid.resolution)


def _centre(grid: Grid, cell: tuple[int, int]) -> Point:
    return grid.origin[0] + (cell[1] + 0.5) * grid.resolution, grid.origin[1] + (cell[0] + 0.5) * grid.resolution


def nearest_free(grid: Grid, place: Point, tolerance: float, ground: Grid | None = None) -> tuple[int, int] | None:
    """The row and column of the free cell at a place of the grid, or nearest to it within `tolerance` (m).

    With `ground` the nearest one from which a straight line to the place is free there, if one of the nearest is.
    """
    row, column = _cell(grid, place)
    rows, columns = grid.occupied.shape
    if not (0 <= row < rows and 0 <= column < columns):
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
    # The least cost of each cell so far; nothing is less than that of a blocked one.
    cost: list[int] = np.where(blocked.ravel(), -1, _UNKNOWN).tolist()
    came = [-1] * count
    done = bytearray(count)
    cost[first] = 0
    # Cost and cell are one integer: heaps of integers are much faster than those of tuples. Of ways that seem equal,
    # the one with less still to go comes first, which keeps the search from flooding open ground.
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
    """For each cell the cost of the way to the goal if nothing were in between."""
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
    """The places that remain when each is left out that can be passed in a straight line."""
    kept = [places[0]]
    for place, following in zip(places[1:], [*places[2:], None], strict=True):
        if following is None or not _in_sight(grid, kept[-1], following):
            kept.append(place)
    return kept


def _in_sight(grid: Grid, a: Point, b: Point) -> bool:
    """Whether all of a straight line between two places is free, sampled at every fourth of a cell."""
    count = max(2, math.ceil(math.dist(a, b) / grid.resolution * 4))
    part = np.linspace(0, 1, count)
    columns = ((a[0] + (b[0] - a[0]) * part - grid.origin[0]) / grid.resolution).astype(np.intp)
    rows = ((a[1] + (b[1] - a[1]) * part - grid.origin[1]) / grid.resolution).astype(np.intp)
    return not grid.occupied[rows, columns].any()
