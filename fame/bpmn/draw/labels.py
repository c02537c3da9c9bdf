"""Places names: inside a shape, or beside a shape or flow where they cover least.

A name inside a box is set in its middle, clear of the pictogram. A smaller size is used if it avoids breaking a word.
The diagram may give the place of a name that stands beside its shape.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

from fame.bpmn.draw.svg import LINE_HEIGHT, Point, fitted, middle, text_width, wrap
from fame.bpmn.model import Bounds, Edge, Shape

_ROOM = 12.0
"""Horizontal space around a name, left and right together (px)."""
_SMALLEST = 9


class FittedText(NamedTuple):
    """Lines, their font size, and the top of the first one (px)."""

    lines: list[str]
    size: float
    top: float


def fit_in_box(name: str, box: Bounds, size: float, corner: float = 0) -> FittedText:
    """Fit a name into the middle of a box, in `size` or smaller, clear of a square at the upper left `corner`."""
    width = max(box.width - _ROOM, 10)
    for smaller in range(round(size), _SMALLEST - 1, -1):
        setting = _fit(wrap(name, width, smaller), smaller, box, corner)
        if setting is not None and all(text_width(line, smaller) <= width for line in setting.lines):
            return setting
    lines = wrap(name, width, _SMALLEST, anywhere=True)
    return _fit(lines, _SMALLEST, box, corner) or FittedText(lines, _SMALLEST, box.y)


def _fit(lines: list[str], size: float, box: Bounds, corner: float) -> FittedText | None:
    """Lines in the middle, or lower to avoid the corner; None if they do not fit."""
    height = len(lines) * size * LINE_HEIGHT
    top = box.y + (box.height - height) / 2
    if _in_corner(lines, size, top, box, corner):
        top = box.y + corner
    return FittedText(lines, size, top) if box.y <= top and top + height <= box.y + box.height else None


def _in_corner(lines: list[str], size: float, top: float, box: Bounds, corner: float) -> bool:
    """Whether a line overlaps the square at the corner."""
    beside = [text_width(line, size) > box.width - 2 * corner for line in lines]
    return any(wide and top + place * size * LINE_HEIGHT < box.y + corner for place, wide in enumerate(beside))


_GAP = 4.0
"""Distance between a name and its shape or flow (px)."""
_WIDTH = 90.0
"""Width of a name after which it is wrapped (px)."""


class Label(NamedTuple):
    """The lines of a name, centred in their box."""

    lines: tuple[str, ...]
    box: Bounds


@dataclass(slots=True)
class Obstacles:
    """What names should not cover: boxes of shapes and of other names, and lines."""

    boxes: list[Bounds] = field(default_factory=list)
    lines: list[tuple[Point, Point]] = field(default_factory=list)

    def count(self, box: Bounds) -> int:
        """The number of boxes and lines that a box would cover."""
        boxes = sum(overlap(box, other) for other in self.boxes)
        return boxes + sum(crosses(box, *line) for line in self.lines)


def place_labels(
    shapes: Sequence[Shape], edges: Sequence[Edge], names: Mapping[str, str], frames: Iterable[str], size: float
) -> dict[str, Label]:
    """Place the `names` (by id) of shapes and edges. `frames` may be covered. Returns labels by id."""
    inside = set(frames)
    taken = Obstacles(
        [shape.bounds for shape in shapes if shape.element not in inside],
        [line for edge in edges for line in pairwise(edge.waypoints)],
    )
    things: list[Shape | Edge] = [*shapes, *edges]
    named = [thing for thing in things if names.get(thing.element)]
    found: dict[str, Label] = {}
    for thing in sorted(named, key=lambda thing: _given_place(thing) is None):  # fixed places first
        name, own = names[thing.element], _given_place(thing)
        lines = fitted(name, own, size) if own is not None else wrap(name, _WIDTH, size)
        extent = max(text_width(line, size) for line in lines), len(lines) * size * LINE_HEIGHT
        spots = [(own.x + (own.width - extent[0]) / 2, own.y)] if own is not None else _places_around(thing, *extent)
        box = min((Bounds(*spot, *extent) for spot in spots), key=taken.count)
        taken.boxes.append(box)
        found[thing.element] = Label(tuple(lines), box)
    return found


def overlap(a: Bounds, b: Bounds) -> bool:
    """Whether two boxes overlap."""
    across = min(a.x + a.width, b.x + b.width) - max(a.x, b.x)
    return across > 0 and min(a.y + a.height, b.y + b.height) - max(a.y, b.y) > 0


def crosses(box: Bounds, start: Point, end: Point) -> bool:
    """Whether a line from `start` to `end` goes through a box (Liang and Barsky 1984)."""
    first, last = 0.0, 1.0
    sides = ((start[0], end[0], box.x, box.x + box.width), (start[1], end[1], box.y, box.y + box.height))
    for begin, stop, low, high in sides:
        if begin == stop:
            if not low < begin < high:
                return False
            continue
        enter, leave = sorted(((low - begin) / (stop - begin), (high - begin) / (stop - begin)))
        first, last = max(first, enter), min(last, leave)
    return first < last


def _given_place(thing: Shape | Edge) -> Bounds | None:
    """The place given by the diagram, or None."""
    return thing.label if thing.label is not None and thing.label.width > 0 else None


def _places_around(thing: Shape | Edge, width: float, height: float) -> list[Point]:
    """Places around a shape or the middle of a line, in order of preference."""
    if isinstance(thing, Shape):
        box = thing.bounds
    else:
        x, y = middle(thing.waypoints)
        box = Bounds(x, y, 0, 0)
    x, y = box.x + (box.width - width) / 2, box.y + (box.height - height) / 2
    over, under = box.y - height - _GAP, box.y + box.height + _GAP
    right, left = box.x + box.width + _GAP, box.x - width - _GAP
    around = [(x, under), (x, over), (right, y), (left, y), (right, under), (left, under), (right, over), (left, over)]
    if isinstance(thing, Edge):
        around[:2] = [(x, over), (x, under)]
    return around
