"""Routes links at right angles around shapes: shortest paths in a grid (Wybrow, Marriott and Stuckey 2009).

The lines of the grid run through the middle of shapes and beside them. A path costs its length, each bend, each
crossing with another link, and much for each stretch on which it would cover one; links with a common source or target
may share their way. A path is found by A* (Hart, Nilsson and Raphael 1968). All lengths are in px.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Collection, Hashable, Iterable, Iterator, Sequence
from heapq import heappop, heappush
from itertools import pairwise
from typing import NamedTuple

from fame.bpmn.draw.svg import Point
from fame.bpmn.model import Bounds

MARGIN = 8.0
"""The least distance between a line and a shape that it passes."""
_BESIDE = (20.0, 32.0, 44.0)
"""How far from a shape the lines of the grid run beside it."""
_APART, _NEAR = 10.0, 5.0
"""Lines of the grid beside shapes are no closer to others; a link covers the lines that are nearer."""
_BEND, _CROSSING, _COVERING = 60.0, 45.0, 600.0
_STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))
"""Directions: right, down, left, up."""


class Obstacle(NamedTuple):
    """What lines do not go through: a shape or label, with the least distance to it. `owner` has its own links end at
    it; those of what is inside of it may cross it."""

    owner: Hashable
    bounds: Bounds
    margin: float = MARGIN


class Docking(NamedTuple):
    """Where a link can begin or end, the direction in which it leaves the shape there, and what that costs."""

    point: Point
    direction: int
    cost: float = 0.0


class Ends(NamedTuple):
    """The ends of a link that is routed."""

    source: Hashable
    target: Hashable


class RoutingGrid:
    """The grid of one scope. `room`: its lines stay inside."""

    def __init__(self, obstacles: Sequence[Obstacle], room: Bounds, points: Collection[Point]) -> None:
        boxes = [one.bounds for one in obstacles]
        self.xs: list[float] = _lines([(box.x, box.width) for box in boxes], [x for x, _ in points], room.x, room.width)
        heights = [(box.y, box.height) for box in boxes]
        self.ys: list[float] = _lines(heights, [y for _, y in points], room.y, room.height)
        self._blocked: tuple[_Cells, _Cells] = defaultdict(list), defaultdict(list)
        self._covered: tuple[_Routes, _Routes] = defaultdict(list), defaultdict(list)
        self._crossed: tuple[_Routes, _Routes] = defaultdict(list), defaultdict(list)
        for obstacle in obstacles:
            self._block(obstacle, obstacle.margin, obstacle.margin, exact=False)
            self._block(obstacle, -0.5, 2.0, exact=True)

    def _block(self, obstacle: Obstacle, along: float, beside: float, *, exact: bool) -> None:
        """Block the cells of lines that reach into an obstacle, widened in the direction of the line and across."""
        box, entry = obstacle.bounds, (obstacle.owner, exact)
        right, bottom = box.x + box.width, box.y + box.height
        for row in range(bisect_right(self.ys, box.y - beside), bisect_left(self.ys, bottom + beside)):
            for column in _cells(self.xs, box.x - along, right + along):
                self._blocked[0][row, column].append(entry)
        for column in range(bisect_right(self.xs, box.x - beside), bisect_left(self.xs, right + beside)):
            for row in _cells(self.ys, box.y - along, bottom + along):
                self._blocked[1][row, column].append(entry)

    def add(self, points: Sequence[Point], ends: Ends) -> None:
        """Enter a link, so that others do not cover it."""
        for (x, y), (to_x, to_y) in pairwise(points):
            if abs(y - to_y) < 0.5:
                self._enter(0, y, min(x, to_x), max(x, to_x), ends)
            elif abs(x - to_x) < 0.5:
                self._enter(1, x, min(y, to_y), max(y, to_y), ends)

    def _enter(self, kind: int, at: float, low: float, high: float, ends: Ends) -> None:
        along, across = (self.xs, self.ys) if kind == 0 else (self.ys, self.xs)
        near = range(bisect_left(across, at - _NEAR), bisect_right(across, at + _NEAR))
        for line in near:
            for cell in _cells(along, low + 0.5, high - 0.5):
                self._covered[kind][(line, cell) if kind == 0 else (cell, line)].append(ends)
        between = bisect_left(across, at) - 1
        for line in range(bisect_right(along, low + 0.5), bisect_left(along, high - 0.5)):
            self._crossed[1 - kind][(between, line) if kind == 0 else (line, between)].append(ends)

    def route(
        self, sources: Sequence[Docking], targets: Sequence[Docking], ends: Ends, through: Collection[Hashable]
    ) -> list[Point] | None:
        """Return the corners of the best path, or None. `through`: what it may run inside of."""
        goals = {(*found, port.direction): port for port in targets if (found := self._at(port.point)) is not None}
        if not goals:
            return None
        spots = [(self.xs[column], self.ys[row]) for row, column, _ in goals]
        low_x, high_x = min(x for x, _ in spots), max(x for x, _ in spots)
        low_y, high_y = min(y for _, y in spots), max(y for _, y in spots)

        def ahead(row: int, column: int) -> float:
            x, y = self.xs[column], self.ys[row]
            return max(low_x - x, 0, x - high_x) + max(low_y - y, 0, y - high_y)

        heap: list[tuple[float, int, float, int, int, int]] = []
        best: dict[tuple[int, int, int], float] = {}
        came: dict[tuple[int, int, int], tuple[int, int, int]] = {}
        begun = 0
        for port in sources:
            if (found := self._at(port.point)) is not None:
                best[*found, port.direction] = port.cost
                heappush(heap, (port.cost + ahead(*found), begun, port.cost, *found, port.direction))
                begun += 1
        final, least = None, float("inf")
        while heap:
            total, _, cost, row, column, direction = heappop(heap)
            if total >= least:
                break
            state = row, column, direction
            if cost > best[state]:
                continue
            goal = goals.get((row, column, (direction + 2) % 4))
            if goal is not None and cost + goal.cost < least:
                final, least = state, cost + goal.cost
            for way in (direction, (direction + 1) % 4, (direction + 3) % 4):
                across, down = _STEPS[way]
                to = row + down, column + across
                if not (0 <= to[0] < len(self.ys) and 0 <= to[1] < len(self.xs)):
                    continue
                if way != direction and state not in came:  # it leaves a shape straight on
                    continue
                step = self._cost(min(row, to[0]), min(column, to[1]), way % 2, ends, through)
                if step is None:
                    continue
                length = abs(self.xs[to[1]] - self.xs[column]) + abs(self.ys[to[0]] - self.ys[row])
                new = cost + length + step + (_BEND if way != direction else 0.0)
                if new < best.get((*to, way), least):
                    best[*to, way] = new
                    came[*to, way] = state
                    begun += 1
                    heappush(heap, (new + ahead(*to), begun, new, *to, way))
        return self._path(final, came) if final is not None else None

    def _cost(self, row: int, column: int, kind: int, ends: Ends, through: Collection[Hashable]) -> float | None:
        """What a cell costs besides its length; None if it is blocked."""
        for owner, exact in self._blocked[kind].get((row, column), ()):
            if owner not in through and (exact or owner not in ends):
                return None
        cost = sum(_COVERING for other in self._covered[kind].get((row, column), ()) if not _share(other, ends))
        return cost + sum(_CROSSING for other in self._crossed[kind].get((row, column), ()) if not _share(other, ends))

    def _at(self, point: Point) -> tuple[int, int] | None:
        """The row and column of a point of the grid."""
        column, row = bisect_left(self.xs, point[0] - 0.01), bisect_left(self.ys, point[1] - 0.01)
        inside = column < len(self.xs) and row < len(self.ys)
        on = inside and abs(self.xs[column] - point[0]) < 0.02 and abs(self.ys[row] - point[1]) < 0.02
        return (row, column) if on else None

    def _path(
        self, state: tuple[int, int, int] | None, came: dict[tuple[int, int, int], tuple[int, int, int]]
    ) -> list[Point]:
        points = list[Point]()
        while state is not None:
            points.append((self.xs[state[1]], self.ys[state[0]]))
            state = came.get(state)
        return straightened(points[::-1])


_Cells = defaultdict[tuple[int, int], list[tuple[Hashable, bool]]]
_Routes = defaultdict[tuple[int, int], list[Ends]]


def _share(one: Ends, other: Ends) -> bool:
    return one.source == other.source or one.target == other.target


def _lines(spans: Collection[tuple[float, float]], fixed: Iterable[float], start: float, extent: float) -> list[float]:
    """The lines of a grid in one direction: the fixed ones, and lines beside everything where no other is too close."""
    found = sorted({round(at, 2) for at in fixed})
    for far in _BESIDE:
        for at in sorted({round(at, 2) for low, size in spans for at in (low - far, low + size + far)}):
            place = bisect_left(found, at)
            if all(abs(at - other) >= _APART for other in found[max(place - 1, 0) : place + 1]):
                found.insert(place, at)
    return [at for at in found if start <= at <= start + extent]


def _cells(lines: Sequence[float], low: float, high: float) -> range:
    """The cells between lines that have something in common with an interval; cell n is between lines n and n + 1."""
    return range(max(bisect_right(lines, low) - 1, 0), min(bisect_left(lines, high), len(lines) - 1))


def straightened(points: Sequence[Point]) -> list[Point]:
    """Return a line without the points that are not corners."""
    found = list[Point]()
    for point in points:
        while len(found) > 1 and (found[-2][0] == found[-1][0] == point[0] or found[-2][1] == found[-1][1] == point[1]):
            found.pop()
        if not found or found[-1] != point:
            found.append(point)
    return found


def dockings(bounds: Bounds, costs: Sequence[float]) -> Iterator[Docking]:
    """Return a port in the middle of each side; costs are for right, down, left, up; infinite ones are no port."""
    x, y = round(bounds.x + bounds.width / 2, 2), round(bounds.y + bounds.height / 2, 2)
    right, bottom = round(bounds.x + bounds.width, 2), round(bounds.y + bounds.height, 2)
    points = ((right, y), (x, bottom), (round(bounds.x, 2), y), (x, round(bounds.y, 2)))
    for direction, (point, cost) in enumerate(zip(points, costs, strict=True)):
        if cost < float("inf"):
            yield Docking(point, direction, cost)
