"""What everything on a drawing shares: its colours, its sizes, and where to look things up."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from fame.bpmn.drawing.icons import Ink
from fame.bpmn.drawing.svg import lettering, tag, text_width
from fame.bpmn.model import Edge, Element, Shape

INK, PAPER = "#22242a", "#ffffff"
VISITED, VISITED_PAPER = "#1a7f37", "#e3f4e6"
SIZE, SMALL = 12.0, 11.0
"""Of lettering, in pixels: in boxes, beside things."""


@dataclass(slots=True)
class Picture:
    """What the drawing functions look things up in: elements, and how often each was visited, by id."""

    elements: Mapping[str, Element] = field(default_factory=dict)
    visits: Mapping[str, int] = field(default_factory=dict)

    def ink(self, shape: Shape | Edge) -> Ink:
        """The colours of a shape or edge: its own, but for one that was visited."""
        fill = shape.fill if isinstance(shape, Shape) else ""
        if self.visits.get(shape.element):
            return VISITED, VISITED_PAPER
        return shape.stroke or INK, fill or PAPER


def badge(content: str, x: float, y: float) -> str:
    """A number on a pill, around a point."""
    width = max(16.0, text_width(content, 10) + 9)
    pill = tag("rect", x=x - width / 2, y=y - 8, width=width, height=16.0, rx=8, fill=VISITED, stroke=PAPER)
    return pill + lettering([content], x, y - 6, size=10, fill=PAPER)
