"""The diagram of a run in a film: tokens where they rest, flows as they are taken, signals as they are thrown.

The diagram is drawn once. On each frame come the elements with a token, in the colour of their robot, and what
happened since the frame before. A diagram that does not fit at a readable size is seen through a window, which goes
where a token came last; what comes again and again, as a loop that waits for odometry, does not draw it there. It does
not stay where no token is.
"""

from __future__ import annotations

import io
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from fame.bpmn.draw.diagram import draw_planes
from fame.bpmn.model import Definitions
from fame.clock import SECOND
from fame.dataclasses import dataclass
from fame.imports import require
from fame.robot import Event

if TYPE_CHECKING:
    from PIL.Image import Image

READABLE = 0.8
"""Pixels per unit of a diagram at least: names of 12 units are read at 800 pixels."""
LARGEST = 1.25
CAPTION = 26
"""Height of the line that names the last signal, pixels."""
_AFTERGLOW = 4
"""For how many frames a flow that was taken, and for how many times as many a signal, is shown."""
_STRETCH = 1.3
"""How much higher than asked for a diagram may be if all of it is seen then."""
_HOLD, _NEWS = 12, 6
"""For how many frames the window stays at a token, and how often an element is news."""
_GLIDE = 0.25
"""The share of its way that the window makes in a frame; twice as much while no token is in it."""
_PIXELS = 2.5e7
"""Most pixels of the whole diagram: one that is larger is drawn too small to be read."""
_NARROWER = 0.86
"""The width of the diagram's font relative to that of the film's."""

Rectangle = tuple[float, float, float, float]


@dataclass(slots=True)
class _Moment:
    """What is seen at a time: where tokens rest (element -> robots), the flows that were taken since the last one, with
    their robots, the last signal in words with its robot, and the elements that are news."""

    tokens: Mapping[str, Sequence[str]]
    taken: Mapping[str, str]
    signal: tuple[str, str]
    news: Sequence[str]


class _Tokens:
    """Where the tokens of a team rest, from its events."""

    def __init__(self) -> None:
        self._resting: dict[tuple[str, int, int, str], None] = {}

    def add(self, event: Event) -> None:
        key = (event.robot, event.instance, event.scope, event.element)
        if event.what == "enter":
            self._resting[key] = None
        elif event.what in ("leave", "cancel", "fail"):
            self._resting.pop(key, None)
        elif event.what == "end":
            for other in [other for other in self._resting if other[:2] == key[:2]]:
                del self._resting[other]

    def by_element(self, elements: Mapping[str, object]) -> Mapping[str, Sequence[str]]:
        """Return the robots with a token at each of these elements, those that came last at the end."""
        found: dict[str, dict[str, None]] = {}
        for robot, _, _, element in self._resting:
            if element in elements:
                found.setdefault(element, {})[robot] = None
        return {element: list(robots) for element, robots in found.items()}


class DiagramFilm:
    """The frames of a diagram, `width` pixels wide and about `height` high at most; `colours` has one for each robot.

    Raises ModelError if the file has no diagram, UnavailableError if a package is missing.
    """

    def __init__(self, model: Definitions, colours: Mapping[str, str], width: int, height: int) -> None:
        drawing = draw_planes(model)[0]
        self._colours = colours
        self._nodes = {node.id: node for process in model.processes for node in process.body.walk()}
        most = height - CAPTION
        scale = max(READABLE, min(LARGEST, width / drawing.width, _STRETCH * most / drawing.height))
        scale = min(scale, math.sqrt(_PIXELS / (drawing.width * drawing.height)))
        self._boxes = {id: _scaled(box, scale) for id, box in drawing.boxes.items()}
        self._lines = {id: [(x * scale, y * scale) for x, y in line] for id, line in drawing.lines.items()}
        self._frames = frozenset(drawing.frames)
        self._still = raster(drawing.svg, scale)
        self._view = width, self._still.height if self._still.height <= _STRETCH * most + 1 else most
        self.size: tuple[int, int] = (width, self._view[1] + CAPTION)

    def frames(self, events: Iterable[Event], times: Sequence[float]) -> Iterator[Image]:
        """Yield the diagram at each time (s)."""
        left, top, focus, since, recent = 0.0, 0.0, "", _HOLD, list[_Moment]()
        for moment in self._moments(events, times):
            since += 1
            sees = self._sees(self._corner(focus), moment.tokens)
            news = [element for element in moment.news if element in moment.tokens]
            if (since >= _HOLD and news) or (not sees and moment.tokens):
                focus, since = (news or [*moment.tokens])[-1], 0
            goal = self._corner(focus)
            if not recent:
                left, top = goal
            share = _GLIDE if self._sees((left, top), moment.tokens) else 2 * _GLIDE
            left, top = left + (goal[0] - left) * share, top + (goal[1] - top) * share
            recent = [*recent, moment][-_AFTERGLOW:]
            yield self._frame(recent, round(left), round(top))

    def _moments(self, events: Iterable[Event], times: Sequence[float]) -> Iterator[_Moment]:
        tokens, visits, coming = _Tokens(), Counter[str](), iter(events)
        event = next(coming, None)
        signal, said = ("", ""), 0
        for number, time in enumerate(times):
            taken, news = dict[str, str](), list[str]()
            while event is not None and event.time <= time * SECOND + 1:
                tokens.add(event)
                if event.what == "take" and event.element in self._lines:
                    taken[event.element] = event.robot
                elif event.what == "enter" and event.element in self._boxes:
                    visits[event.element] += 1
                    news += [event.element] if visits[event.element] <= _NEWS else []
                elif event.what == "leave" and (topic := self._thrown(event.element)):
                    signal, said = (event.robot, f"{event.robot} throws {topic}"), number
                event = next(coming, None)
            if number - said > 4 * _AFTERGLOW:
                signal = ("", "")
            yield _Moment(tokens.by_element(self._boxes), taken, signal, news)

    def _thrown(self, element: str) -> str:
        """The topic on which an element of the diagram throws; empty if it does not."""
        node = self._nodes.get(element)
        return next((topic.name for topic, throws in node.topics() if throws), "") if node is not None else ""

    # ---- drawing -----------------------------------------------------------------------------------------------------

    def _corner(self, element: str) -> tuple[float, float]:
        """The place of the window's corner at which an element is in its middle, as far as the window stays inside."""
        x, y, width, height = self._boxes.get(element, (0.0, 0.0, 0.0, 0.0))
        (across, down), (whole, high) = self._view, self._still.size
        return _begin(x + width / 2, across, whole), _begin(y + height / 2, down, high)

    def _sees(self, corner: tuple[float, float], tokens: Iterable[str]) -> bool:
        """Whether the window with this corner has a token in it."""
        (left, top), (across, down) = corner, self._view
        boxes = (self._boxes[element] for element in tokens if element not in self._frames)
        return any(0 <= x + w / 2 - left <= across and 0 <= y + h / 2 - top <= down for x, y, w, h in boxes)

    def _frame(self, recent: Sequence[_Moment], left: int, top: int) -> Image:
        from PIL import Image, ImageDraw

        frame = Image.new("RGB", self.size, "#ffffff")
        frame.paste(self._still, (-left, -top))
        draw = ImageDraw.Draw(frame, "RGBA")
        for age, moment in enumerate(reversed(recent)):
            for flow, robot in moment.taken.items():
                line = [(x - left, y - top) for x, y in self._lines[flow]]
                alpha = 200 * (_AFTERGLOW - age) // _AFTERGLOW
                draw.line(line, fill=f"{self._colours[robot]}{alpha:02x}", width=4, joint="curve")
        for element, robots in recent[-1].tokens.items():
            self._draw_tokens(draw, element, robots, left, top)
        self._draw_caption(frame, recent[-1])
        return frame

    def _draw_tokens(self, draw: Any, element: str, robots: Sequence[str], left: int, top: int) -> None:
        x, y, w, h = self._boxes[element]
        box = (x - left, y - top, x + w - left, y + h - top)
        colour = self._colours[robots[-1]]
        fill = None if element in self._frames else f"{colour}38"
        draw.rounded_rectangle(box, min(10, w / 2, h / 2), outline=colour, width=3, fill=fill)
        if element in self._frames:
            return
        for number, robot in enumerate(robots):
            middle = box[0] + 4 + 15 * number
            disc = (middle - 8, box[1] - 9, middle + 8, box[1] + 7)
            draw.ellipse(disc, fill=self._colours[robot], outline="#ffffff", width=2)

    def _draw_caption(self, frame: Image, moment: _Moment) -> None:
        from PIL import ImageDraw

        from sim2d.canvas import plain_font

        draw, top = ImageDraw.Draw(frame), self._view[1]
        draw.rectangle((0, top, frame.width, frame.height), fill="#ffffff")
        robot, text = moment.signal
        if text:
            draw.text((16, top + CAPTION / 2), text, fill=self._colours[robot], font=plain_font(15), anchor="lm")


def _scaled(box: Rectangle, scale: float) -> Rectangle:
    x, y, width, height = box
    return x * scale, y * scale, width * scale, height * scale


def _begin(middle: float, window: int, whole: int) -> float:
    """Where a window begins that has `middle` in its middle as far as it stays inside; a small whole is centred."""
    return (whole - window) / 2 if whole <= window else min(max(middle - window / 2, 0.0), float(whole - window))


def raster(svg: str, scale: float) -> Image:
    """Draw an SVG with the font that the rest of the film has, on each machine the same."""
    require("resvg_py")
    import resvg_py
    from PIL import Image

    from sim2d.canvas import font_file

    narrow = re.sub(r'font-size="([\d.]+)"', lambda found: f'font-size="{float(found[1]) * _NARROWER:.2f}"', svg)
    files = [str(font_file(bold)) for bold in (False, True)]
    png = resvg_py.svg_to_bytes(
        svg_string=narrow,
        zoom=scale,
        background="#ffffff",
        skip_system_fonts=True,
        font_files=files,
        sans_serif_family="DejaVu Sans",
    )
    return Image.open(io.BytesIO(png)).convert("RGB")
