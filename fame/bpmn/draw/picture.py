"""What everything on a drawing shares: its colours, its sizes, and where to look things up."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from fame.bpmn.draw.icons import Ink
from fame.bpmn.draw.labels import Label
from fame.bpmn.draw.outcome import STYLES, Tally, style_of
from fame.bpmn.draw.svg import lettering
from fame.bpmn.model import Edge, Element, Shape

INK, PAPER = "#22242a", "#ffffff"
BAND = "#d9d9dd"
"""Of the participant in a choreography task that did not begin it."""
SIZE, SMALL = 12.0, 11.0
"""Of lettering, in pixels: in boxes, beside things."""
_VISITED = frozenset(style.stroke for style in STYLES.values())


@dataclass(slots=True)
class Picture:
    """What the drawing functions look things up in, by id: elements, what became of each, where its name stands."""

    elements: Mapping[str, Element] = field(default_factory=dict)
    visits: Mapping[str, Tally] = field(default_factory=dict)
    labels: Mapping[str, Label] = field(default_factory=dict)

    def ink(self, shape: Shape | Edge) -> Ink:
        """The colours of a shape or edge: its own, but for one that was visited."""
        style = style_of(self.visits.get(shape.element, {}))
        if style is not None:
            return style.stroke, style.paper
        return shape.stroke or INK, (shape.fill if isinstance(shape, Shape) else "") or PAPER

    def label(self, id: str, colour: str = INK) -> str:
        """The name that stands beside a shape or flow, if there is one."""
        label = self.labels.get(id)
        if label is None:
            return ""
        middle = label.box.x + label.box.width / 2
        return lettering(label.lines, middle, label.box.y, size=SMALL, fill=colour, halo=True)


def visited(ink: Ink) -> bool:
    """Whether these are the colours of something that was visited."""
    return ink[0] in _VISITED


def letters(ink: Ink) -> str:
    """The colour of lettering on these colours."""
    return INK if visited(ink) else ink[0]
