"""Colours and sizes, and how the outcomes of a run are shown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, get_args

from fame.bpmn.draw.icons import Ink
from fame.bpmn.draw.labels import Label
from fame.bpmn.draw.svg import tag, text_lines, text_width, translated
from fame.bpmn.model import Edge, Element, Shape

Outcome = Literal["failed", "waiting", "completed", "cancelled"]
Tally = Mapping[Outcome, int]
"""Number of executions with each outcome."""

OUTCOMES: tuple[Outcome, ...] = get_args(Outcome)
"""An element has the colour of the first of them that occurred."""


class Style(NamedTuple):
    """The colours of an outcome, and the path of its symbol (8 px wide, centred at (0, 0))."""

    stroke: str
    paper: str
    symbol: str


STYLES: Mapping[Outcome, Style] = {
    "failed": Style("#cf222e", "#ffebe9", "M-2.7 -2.7L2.7 2.7M-2.7 2.7L2.7 -2.7"),
    "waiting": Style("#9a6700", "#fff8c5", "M-1.7 -3V3M1.7 -3V3"),
    "completed": Style("#1a7f37", "#e3f4e6", "M-3.2 0.2L-0.9 2.6L3.2 -2.6"),
    "cancelled": Style("#57606a", "#eaeef2", "M-2.1 2.1L2.1 -2.1M3 0A3 3 0 1 1 -3 0A3 3 0 1 1 3 0"),
}
_LIGHT = "#ffffff"
_PILL, _SYMBOL = 16.0, 9.0


def style_of(tally: Tally) -> Style | None:
    """The style of a visited element, None for one that was not visited."""
    return next((STYLES[outcome] for outcome in OUTCOMES if tally.get(outcome)), None)


def badge(content: str, x: float, y: float, outcome: Outcome = "completed", *, symbol: bool = False) -> str:
    """A number on a pill around a point, after the symbol of its outcome if `symbol`."""
    left = _SYMBOL if symbol else 0.0
    width = _width(content, symbol=symbol)
    pill = tag(
        "rect", x=x - width / 2, y=y - 8, width=width, height=_PILL, rx=8, fill=STYLES[outcome].stroke, stroke=_LIGHT
    )
    sign = translated(x - width / 2 + 4 + left / 2, y, _sign(outcome, _LIGHT)) if symbol else ""
    return pill + sign + text_lines([content], x + left / 2, y - 6, size=10, fill=_LIGHT)


def badges(tally: Tally, right: float, y: float) -> str:
    """A badge for each outcome that occurred, side by side, ending at `right`."""
    drawn = ""
    for outcome in reversed(OUTCOMES):
        if count := tally.get(outcome, 0):
            width = _width(str(count), symbol=True)
            drawn += tag("g", tag("title", outcome), badge(str(count), right - width / 2, y, outcome, symbol=True))
            right -= width + 1
    return drawn


def legend(present: Iterable[Outcome], x: float, y: float) -> str:
    """The symbols of the given outcomes with their names, starting at (x, y)."""
    drawn = ""
    for outcome in present:
        drawn += translated(x + 8, y, tag("circle", r=8, fill=STYLES[outcome].stroke) + _sign(outcome, _LIGHT))
        drawn += text_lines([outcome], x + 20, y - 7, size=11, fill=STYLES[outcome].stroke, anchor="start")
        x += 40 + text_width(outcome, 11)
    return drawn


def _width(content: str, *, symbol: bool) -> float:
    return max(_PILL, text_width(content, 10) + 9 + (_SYMBOL if symbol else 0.0))


def _sign(outcome: Outcome, ink: str) -> str:
    return tag("path", d=STYLES[outcome].symbol, fill="none", stroke=ink, stroke_width=1.5, stroke_linecap="round")


INK, BACKGROUND = "#22242a", "#ffffff"
BAND_FILL = "#d9d9dd"
"""Fill of the participant in a choreography task that does not initiate it."""
SIZE, SMALL = 12.0, 11.0
"""Font sizes inside boxes and beside shapes (px)."""
_VISITED = frozenset(style.stroke for style in STYLES.values())


@dataclass(slots=True)
class Picture:
    """The tables of a drawing, by id: elements, outcomes, labels."""

    elements: Mapping[str, Element] = field(default_factory=dict)
    visits: Mapping[str, Tally] = field(default_factory=dict)
    labels: Mapping[str, Label] = field(default_factory=dict)

    def ink(self, shape: Shape | Edge) -> Ink:
        """The colours of a shape or edge: those of its outcome if it was visited, else its own."""
        style = style_of(self.visits.get(shape.element, {}))
        if style is not None:
            return style.stroke, style.paper
        return shape.stroke or INK, (shape.fill if isinstance(shape, Shape) else "") or BACKGROUND

    def label(self, id: str, colour: str = INK) -> str:
        """The name beside a shape or flow, or empty."""
        label = self.labels.get(id)
        if label is None:
            return ""
        middle = label.box.x + label.box.width / 2
        return text_lines(label.lines, middle, label.box.y, size=SMALL, fill=colour, halo=True)


def is_visited(ink: Ink) -> bool:
    """Whether these are the colours of a visited element."""
    return ink[0] in _VISITED


def text_colour(ink: Ink) -> str:
    """The colour of text on these colours."""
    return INK if is_visited(ink) else ink[0]
