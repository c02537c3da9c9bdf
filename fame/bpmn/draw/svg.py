"""SVG as text: tags, lines with round corners, arrow heads, and names.

A name inside a box is set in its middle, clear of the pictogram, in a smaller size if that avoids breaking a word. A
name beside a shape or flow is placed where the diagram says, else where it covers least.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple
from xml.sax.saxutils import escape, quoteattr

from fame.bpmn.model import Bounds, Edge, Shape
from fame.dataclasses import dataclass, field
from fame.text import NOT_XML

Point = tuple[float, float]

FONT = "Arial, Helvetica, 'Liberation Sans', sans-serif"
LINE_HEIGHT = 1.2
"""Relative to the font size."""

_SEAMS = re.compile(r"(?<=[_\-/.])(?=[^_\-/.])|(?<=[a-z])(?=[A-Z])")
_NARROW, _WIDE = frozenset("iIjl.,:;'|!()[]{}ftr /-\"`"), frozenset("mwMW@%")


def tag(name: str, *content: str, **attributes: object) -> str:
    """Return an SVG element with content. ``_`` in attribute names becomes ``-``; None and empty
    values are left out."""
    written = "".join(
        f" {key.rstrip('_').replace('_', '-')}={quoteattr(_text(value))}"
        for key, value in attributes.items()
        if value is not None and value != ""
    )
    return f"<{name}{written}>{''.join(content)}</{name}>" if content else f"<{name}{written}/>"


def _text(value: object) -> str:
    return number(value) if isinstance(value, float) else NOT_XML.sub("", str(value))


def number(value: float) -> str:
    """Return a number, rounded to a hundredth, in its shortest form."""
    return f"{value:.2f}".rstrip("0").rstrip(".")


def text(content: str) -> str:
    return escape(NOT_XML.sub("", content))


def translated(x: float, y: float, *content: str, scale: float = 1.0) -> str:
    """Content moved by (x, y), and scaled."""
    scaled = f" scale({number(scale)})" if scale != 1 else ""
    return tag("g", *content, transform=f"translate({number(x)} {number(y)}){scaled}")


# ---- lines -----------------------------------------------------------------------------------------------------------


_RADIUS = 5.0
"""Of the corners of a line."""


def polyline(points: Sequence[Point]) -> str:
    """Path data of a line through `points` with round corners."""
    data = [f"M{number(points[0][0])} {number(points[0][1])}"]
    for before, corner, after in zip(points, points[1:], points[2:], strict=False):
        near = point_towards(corner, before, min(_RADIUS, math.dist(corner, before) / 2))
        far = point_towards(corner, after, min(_RADIUS, math.dist(corner, after) / 2))
        data.append(f"L{number(near[0])} {number(near[1])}")
        data.append(f"Q{number(corner[0])} {number(corner[1])} {number(far[0])} {number(far[1])}")
    data.append(f"L{number(points[-1][0])} {number(points[-1][1])}")
    return "".join(data)


def point_towards(start: Point, end: Point, distance: float) -> Point:
    """Return the point at `distance` from `start` towards `end`."""
    length = math.dist(start, end) or 1
    return start[0] + (end[0] - start[0]) * distance / length, start[1] + (end[1] - start[1]) * distance / length


def arrow(points: Sequence[Point], length: float = 10, width: float = 8) -> list[Point]:
    """Return the corners of the arrow head at the end of a line: side, tip, side."""
    tip = points[-1]
    tail = next((point for point in reversed(points[:-1]) if math.dist(point, tip) > 0.1), points[0])
    base = point_towards(tip, tail, length)
    x, y = (base[0] - tip[0]) / length * width / 2, (base[1] - tip[1]) / length * width / 2
    return [(base[0] - y, base[1] + x), tip, (base[0] + y, base[1] - x)]


def corners(points: Iterable[Point]) -> str:
    """Return the value of the attribute ``points`` of a polygon."""
    return " ".join(f"{number(x)},{number(y)}" for x, y in points)


def middle(points: Sequence[Point]) -> Point:
    """Return the point half way along a line."""
    return along(points, 0.5)


def along(points: Sequence[Point], part: float) -> Point:
    """Return the point at a part (0 to 1) of the length of a line."""
    left = sum(math.dist(start, end) for start, end in pairwise(points)) * part
    for start, end in pairwise(points):
        length = math.dist(start, end)
        if length >= left:
            return point_towards(start, end, left)
        left -= length
    return points[-1]


# ---- lettering -------------------------------------------------------------------------------------------------------


def text_width(content: str, size: float) -> float:
    """Return the approximate width of a text in Arial (px)."""
    return size * sum(
        0.31 if letter in _NARROW else 0.85 if letter in _WIDE else 0.68 if letter.isupper() else 0.55
        for letter in content
    )


def wrap(content: str, width: float, size: float, *, anywhere: bool = False) -> list[str]:
    """Break text into lines no wider than `width` if possible. Words break after ``_-/.``, or `anywhere`."""
    lines: list[str] = []
    for paragraph in content.splitlines():
        line = ""
        for word in paragraph.split():
            joined = f"{line} {word}" if line else word
            if text_width(joined, size) <= width:
                line = joined
                continue
            if line:
                lines.append(line)
            *full, line = _broken(word, width, size, anywhere)
            lines += full
        lines.append(line)
    return lines


def _broken(word: str, width: float, size: float, anywhere: bool) -> list[str]:
    parts, line = [], ""
    pieces = [piece for piece in _SEAMS.split(word) if piece]
    for piece in pieces:
        for letters in piece if anywhere and text_width(piece, size) > width else [piece]:
            if line and text_width(line + letters, size) > width:
                parts.append(line)
                line = ""
            line += letters
    return [*parts, line]


def fitted(content: str, bounds: Bounds, size: float) -> list[str]:
    """Break text into the number of lines that fit the height of a label box, even if they are wider than it."""
    room = max(1, round(bounds.height / (size * LINE_HEIGHT)))
    lines = wrap(content, max(bounds.width, 20) * 1.05, size)
    for factor in (1.2, 1.4, 1.7):
        if len(lines) <= room:
            break
        lines = wrap(content, max(bounds.width, 20) * factor, size)
    return lines


def text_lines(
    lines: Sequence[str], x: float, top: float, *, size: float, fill: str, anchor: str = "middle", halo: bool = False
) -> str:
    """Lines of text. `x` is their middle (or start), `top` the top of the first. `halo`: white outline."""
    spans = [
        tag("tspan", text(line), x=x, y=top + size * (LINE_HEIGHT * number_of + 0.95))
        for number_of, line in enumerate(lines)
    ]
    white = {"stroke": "white", "stroke_width": 3, "paint_order": "stroke"} if halo else {}
    return tag("text", *spans, font_size=size, text_anchor=anchor, fill=fill, **white) if spans else ""


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
        """Return the number of boxes and lines that a box would cover."""
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
    across = min(a.x + a.width, b.x + b.width) - max(a.x, b.x)
    return across > 0 and min(a.y + a.height, b.y + b.height) - max(a.y, b.y) > 0


def crosses(box: Bounds, start: Point, end: Point) -> bool:
    """Return whether a line from `start` to `end` goes through a box (Liang and Barsky 1984)."""
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
