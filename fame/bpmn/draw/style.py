"""Colours, sizes and pictograms of BPMN 2.0, and how the outcomes of a run are shown.

The pictograms are those in events, gateways and tasks, and the markers of activities. Events are drawn in a box of
36 x 36, task types in one of 18 x 18, markers in one of 14 x 14.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple, get_args

from fame.bpmn.draw.svg import Label, number, tag, text_lines, text_width, translated
from fame.bpmn.model import Edge, Element, ElementOutcome, Shape
from fame.dataclasses import dataclass, field

Ink = tuple[str, str]
"""(stroke, fill)"""


def _line(data: str, ink: Ink, width: float = 1.3, fill: str = "none") -> str:
    return tag(
        "path", d=data, fill=fill, stroke=ink[0], stroke_width=width, stroke_linejoin="round", stroke_linecap="round"
    )


def _solid(data: str, ink: Ink, filled: bool) -> str:
    """An outline for a caught trigger, filled for a thrown one."""
    return _line(data, ink, fill=ink[0] if filled else ink[1])


# ---- events ----------------------------------------------------------------------------------------------------------


def _message(ink: Ink, filled: bool) -> str:
    return envelope(ink, filled, 9.5, 12, 17, 12)


def envelope(ink: Ink, filled: bool, x: float, y: float, width: float, height: float) -> str:
    """Return a closed envelope; the flap is white if it is filled."""
    box = tag("rect", x=x, y=y, width=width, height=height, fill=ink[0] if filled else ink[1], stroke=ink[0])
    half, fall = number(width / 2), height * 0.55
    flap = f"M{number(x)} {number(y)}l{half} {number(fall)}l{half} {number(-fall)}"
    return box + _line(flap, (ink[1] if filled else ink[0], ""), 1.2)


def _timer(ink: Ink, filled: bool) -> str:
    ticks = "".join(
        f"M{number(18 + 8.5 * math.sin(hour * math.pi / 6))} {number(18 - 8.5 * math.cos(hour * math.pi / 6))}"
        f"L{number(18 + 10.5 * math.sin(hour * math.pi / 6))} {number(18 - 10.5 * math.cos(hour * math.pi / 6))}"
        for hour in range(12)
    )
    dial = tag("circle", cx=18, cy=18, r=10.5, fill=ink[1], stroke=ink[0], stroke_width=1.5)
    return dial + _line(ticks, ink, 0.8) + _line("M20 10.5L18 18L23 18.5", ink, 1.5)


def _conditional(ink: Ink, filled: bool) -> str:
    lines = "".join(f"M13 {y}H23" for y in (12.5, 16, 20, 23.5))
    return tag("rect", x=11, y=9, width=14, height=18, fill=ink[1], stroke=ink[0], stroke_width=1.3) + _line(
        lines, ink, 1
    )


def _terminate(ink: Ink, filled: bool) -> str:
    return tag("circle", cx=18, cy=18, r=10, fill=ink[0], stroke=ink[0])


def pentagon(ink: Ink, filled: bool, radius: float = 9.5) -> str:
    """Return a pentagon around the middle of an event."""
    angles = [2 * math.pi * corner / 5 for corner in range(5)]
    points = [f"{number(18 + radius * math.sin(angle))} {number(18 - radius * math.cos(angle))}" for angle in angles]
    return _solid(f"M{'L'.join(points)}Z", ink, filled)


_OUTLINES: Mapping[str, str] = {
    "signal": "M18 9.5L26.5 24H9.5Z",
    "error": "M9.5 26.5L14.6 10.5L20 18.6L26.5 9L22 25.8L16 18.2Z",
    "escalation": "M18 8.5L25 26L18 19.2L11 26Z",
    "link": "M9 14.8H19V10.2L27.5 18L19 25.8V21.2H9Z",
    "compensate": "M17.6 11.5V24.5L9 18ZM26.6 11.5V24.5L18 18Z",
    "cancel": "M10.4 13.4l3-3 4.6 4.6 4.6-4.6 3 3-4.6 4.6 4.6 4.6-3 3-4.6-4.6-4.6 4.6-3-3 4.6-4.6Z",
    "parallel_multiple": "M16 9.5H20V16H26.5V20H20V26.5H16V20H9.5V16H16Z",
}
_DRAWN: Mapping[str, Callable[[Ink, bool], str]] = {
    "message": _message,
    "timer": _timer,
    "conditional": _conditional,
    "terminate": _terminate,
    "multiple": pentagon,
}


def trigger(kind: str, ink: Ink, filled: bool) -> str:
    """Return the pictogram of an event definition, empty for a none event."""
    if kind in _OUTLINES:
        return _solid(_OUTLINES[kind], ink, filled)
    return _DRAWN[kind](ink, filled) if kind in _DRAWN else ""


# ---- gateways: around (0, 0), 50 across ------------------------------------------------------------------------------


def gateway(kind: str, ink: Ink, marked: bool) -> str:
    """Return the sign inside the diamond. An exclusive gateway has one only if `marked`."""
    thick = "M-9 0H9M0 -9V9"
    crossed = "M-6.5 -6.5L6.5 6.5M-6.5 6.5L6.5 -6.5"
    if kind == "parallel":
        return _line(thick, ink, 4)
    if kind == "complex":
        return _line(thick + crossed, ink, 3.5)
    if kind == "exclusive":
        return _line("M-5 -7.5L5 7.5M-5 7.5L5 -7.5", ink, 4) if marked else ""
    if kind == "inclusive":
        return tag("circle", r=9.5, fill="none", stroke=ink[0], stroke_width=2.5)
    rings = "".join(tag("circle", r=radius, fill="none", stroke=ink[0]) for radius in (13.5, 10.5))
    return rings + tag("g", pentagon(ink, False, 7), transform="translate(-18 -18)")


# ---- tasks -----------------------------------------------------------------------------------------------------------


def _user(ink: Ink) -> str:
    shoulders = _line("M2.5 17V13.5C2.5 10.8 5.2 9.6 9 9.6C12.8 9.6 15.5 10.8 15.5 13.5V17Z", ink, 1.1, ink[1])
    head = tag("circle", cx=9, cy=5.5, r=4.3, fill=ink[1], stroke=ink[0], stroke_width=1.1)
    return shoulders + head + _line("M5 17V14.2M13 17V14.2", ink, 1) + _line("M4.9 4.6C7 5.6 10.4 2.6 13 4.6", ink, 1)


def _manual(ink: Ink) -> str:
    thumb = "M1.2 14.2V7.2C3.6 4.4 5.6 2.8 7.4 2.4C9.6 2 9.4 4.4 7.6 6.2"
    fingers = "H16.2C17.6 6.2 17.6 8.6 16.2 8.6H16.6C18 8.6 18 11.2 16.6 11.2H15.9C17.2 11.2 17.2 13.5 15.9 13.5H14.6"
    palm = "C15.7 13.5 15.7 15.6 14.6 15.6H5.4C3.6 15.6 2.4 15 1.2 14.2Z"
    between = "M10 8.6H16.2M10 11.2H16.2M10 13.5H14.8"
    return _line(thumb + fingers + palm, ink, 1.1, ink[1]) + _line(between, ink, 1)


def _script(ink: Ink) -> str:
    page = "M6 1.5H16.5C12 5.5 12.5 7.5 14 10C15.5 12.5 15 14.5 12 17H1.8C5.4 14 5.4 12 3.8 9.4C2.4 7 2.6 4.4 6 1.5Z"
    lines = "M6.6 4.5H12M5.6 7.5H11M6.4 10.5H12M7.2 13.5H12.4"
    return _line(page, ink, 1.1, ink[1]) + _line(lines, ink, 1)


def _service(ink: Ink) -> str:
    return _gear(7.2, 7, 6.2, ink) + _gear(11, 11, 6.2, ink)


def _gear(x: float, y: float, radius: float, ink: Ink) -> str:
    points = []
    for corner in range(32):
        angle = 2 * math.pi * (corner + 0.5) / 32
        reach = radius if corner % 4 < 2 else radius * 0.76
        points.append(f"{number(x + reach * math.cos(angle))} {number(y + reach * math.sin(angle))}")
    hub = tag("circle", cx=x, cy=y, r=radius * 0.36, fill=ink[1], stroke=ink[0])
    return _line(f"M{'L'.join(points)}Z", ink, 1, ink[1]) + hub


def _rules(ink: Ink) -> str:
    frame = tag("rect", x=1, y=3, width=16, height=12, fill=ink[1], stroke=ink[0])
    head = tag("rect", x=1, y=3, width=16, height=3.6, fill=ink[0], fill_opacity=0.35, stroke=ink[0])
    return frame + head + _line("M1 10.8H17M6 6.6V15", ink, 1)


_TASKS: Mapping[str, Callable[[Ink], str]] = {
    "user": _user,
    "manual": _manual,
    "script": _script,
    "service": _service,
    "business_rule": _rules,
    "send": lambda ink: envelope(ink, True, 1, 3, 16, 11.5),
    "receive": lambda ink: envelope(ink, False, 1, 3, 16, 11.5),
}


def task(kind: str, ink: Ink) -> str:
    """Return the pictogram of a task type, empty for a plain task."""
    return _TASKS[kind](ink) if kind in _TASKS else ""


# ---- markers ---------------------------------------------------------------------------------------------------------

_MARKERS: Mapping[str, tuple[str, float]] = {
    "parallel": ("M3 1V13M7 1V13M11 1V13", 2.2),
    "sequential": ("M1 3H13M1 7H13M1 11H13", 2.2),
    "loop": ("M5 12.4A5.6 5.6 0 1 1 9.4 12.3M5.2 12.6L1.6 12.6M5.2 12.6L4.6 8.8", 1.4),
    "compensation": ("M6.8 2.5V11.5L0.8 7ZM13 2.5V11.5L7 7Z", 1.2),
    "adhoc": ("M1 9C2.5 4.5 5 4.5 7 7C9 9.5 11.5 9.5 13 5", 2),
    "collapsed": ("M0.5 0.5H13.5V13.5H0.5ZM7 3.2V10.8M3.2 7H10.8", 1.2),
}


def marker(kind: str, ink: Ink) -> str:
    """Return a marker at the bottom of an activity or pool."""
    data, width = _MARKERS[kind]
    return _line(data, ink, width)


Tally = Mapping[ElementOutcome, int]
"""Number of executions with each outcome."""

OUTCOMES: tuple[ElementOutcome, ...] = get_args(ElementOutcome)
"""An element has the colour of the first of them that occurred."""


class Style(NamedTuple):
    """The colours of an outcome, and the path of its symbol (8 px wide, centred at (0, 0))."""

    stroke: str
    paper: str
    symbol: str


STYLES: Mapping[ElementOutcome, Style] = {
    "failed": Style("#cf222e", "#ffebe9", "M-2.7 -2.7L2.7 2.7M-2.7 2.7L2.7 -2.7"),
    "waiting": Style("#9a6700", "#fff8c5", "M-1.7 -3V3M1.7 -3V3"),
    "completed": Style("#1a7f37", "#e3f4e6", "M-3.2 0.2L-0.9 2.6L3.2 -2.6"),
    "violated": Style("#c21f2c", "#ffebe9", "M0 -2V0.3L1.6 1.4M3.4 0A3.4 3.4 0 1 1 -3.4 0A3.4 3.4 0 1 1 3.4 0"),
    "cancelled": Style("#57606a", "#eaeef2", "M-2.1 2.1L2.1 -2.1M3 0A3 3 0 1 1 -3 0A3 3 0 1 1 3 0"),
}
_LIGHT = "#ffffff"
_PILL, _SYMBOL = 16.0, 9.0


def style_of(tally: Tally) -> Style | None:
    """Return the style of a visited element, None for one that was not visited."""
    return next((STYLES[outcome] for outcome in OUTCOMES if tally.get(outcome)), None)


def badge(content: str, x: float, y: float, outcome: ElementOutcome = "completed", *, symbol: bool = False) -> str:
    """Return a number on a pill around a point, after the symbol of its outcome if `symbol`."""
    left = _SYMBOL if symbol else 0.0
    width = _width(content, symbol=symbol)
    pill = tag(
        "rect", x=x - width / 2, y=y - 8, width=width, height=_PILL, rx=8, fill=STYLES[outcome].stroke, stroke=_LIGHT
    )
    sign = translated(x - width / 2 + 4 + left / 2, y, _sign(outcome, _LIGHT)) if symbol else ""
    return pill + sign + text_lines([content], x + left / 2, y - 6, size=10, fill=_LIGHT)


def badges(tally: Tally, right: float, y: float) -> str:
    """Return a badge for each outcome that occurred, side by side, ending at `right`."""
    drawn = ""
    for outcome in reversed(OUTCOMES):
        if count := tally.get(outcome, 0):
            width = _width(str(count), symbol=True)
            drawn += tag("g", tag("title", outcome), badge(str(count), right - width / 2, y, outcome, symbol=True))
            right -= width + 1
    return drawn


def badges_width(tally: Tally) -> float:
    """Return how wide the badges of these outcomes are, side by side (px)."""
    return sum(_width(str(count), symbol=True) + 1 for count in tally.values() if count)


def legend(present: Mapping[ElementOutcome, str], x: float, y: float) -> tuple[str, float]:
    """Return the symbols of the given outcomes with their names, starting at (x, y), and their width (px)."""
    drawn, left = "", x
    for outcome, name in present.items():
        drawn += translated(x + 8, y, tag("circle", r=8, fill=STYLES[outcome].stroke) + _sign(outcome, _LIGHT))
        drawn += text_lines([name], x + 20, y - 7, size=11, fill=STYLES[outcome].stroke, anchor="start")
        x += 40 + text_width(name, 11)
    return drawn, x - 20 - left


def _width(content: str, *, symbol: bool) -> float:
    return max(_PILL, text_width(content, 10) + 9 + (_SYMBOL if symbol else 0.0))


def _sign(outcome: ElementOutcome, ink: str) -> str:
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
        """Return the colours of a shape or edge: those of its outcome if it was visited, else its own."""
        style = style_of(self.visits.get(shape.element, {}))
        if style is not None:
            return style.stroke, style.paper
        return shape.stroke or INK, (shape.fill if isinstance(shape, Shape) else "") or BACKGROUND

    def label(self, id: str, colour: str = INK) -> str:
        """Return the name beside a shape or flow, or empty."""
        label = self.labels.get(id)
        if label is None:
            return ""
        middle = label.box.x + label.box.width / 2
        return text_lines(label.lines, middle, label.box.y, size=SMALL, fill=colour, halo=True)


def is_visited(ink: Ink) -> bool:
    """Return whether these are the colours of a visited element."""
    return ink[0] in _VISITED


def text_colour(ink: Ink) -> str:
    return INK if is_visited(ink) else ink[0]
