"""How a name is set in a box: in its middle, no word broken if a smaller size avoids it, clear of a pictogram."""

from __future__ import annotations

from typing import NamedTuple

from fame.bpmn.draw.svg import LINE_HEIGHT, text_width, wrap
from fame.bpmn.model import Bounds

_ROOM = 12.0
"""Pixels that a name keeps from the left and right edges, together."""
_SMALLEST = 9


class Setting(NamedTuple):
    """Lines of a size, and where the first one begins."""

    lines: list[str]
    size: float
    top: float


def set_inside(name: str, box: Bounds, size: float, corner: float = 0) -> Setting:
    """A name in the middle of a box, of `size` or smaller; a square at the upper left `corner` stays free."""
    width = max(box.width - _ROOM, 10)
    for smaller in range(round(size), _SMALLEST - 1, -1):
        setting = _fit(wrap(name, width, smaller), smaller, box, corner)
        if setting is not None and all(text_width(line, smaller) <= width for line in setting.lines):
            return setting
    lines = wrap(name, width, _SMALLEST, anywhere=True)
    return _fit(lines, _SMALLEST, box, corner) or Setting(lines, _SMALLEST, box.y)


def _fit(lines: list[str], size: float, box: Bounds, corner: float) -> Setting | None:
    """In the middle, or lower to be clear of the corner; None if that is not possible."""
    height = len(lines) * size * LINE_HEIGHT
    top = box.y + (box.height - height) / 2
    if _in_corner(lines, size, top, box, corner):
        top = box.y + corner
    return Setting(lines, size, top) if box.y <= top and top + height <= box.y + box.height else None


def _in_corner(lines: list[str], size: float, top: float, box: Bounds, corner: float) -> bool:
    """Whether a line begins in the square at the corner."""
    beside = [text_width(line, size) > box.width - 2 * corner for line in lines]
    return any(wide and top + place * size * LINE_HEIGHT < box.y + corner for place, wide in enumerate(beside))
