"""The static part of an animation: the scale, the ground and the things on it, text.

Everything is drawn `SMOOTH` times larger than shown.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.config.values import Point
from fame.dataclasses import dataclass
from sim2d import style
from sim2d.ground import Circle, Outline, Thing, Weed, bounding_box
from sim2d.record import WorldRecord

if TYPE_CHECKING:
    from PIL.Image import Image

SMOOTH = 2
EDGE, LINE, HEAD = 16, 22, 30
"""Pixels around the ground, per caption line, and above the ground."""
_WIDTH, _HEIGHT = 840, 640
"""Maximum size of the ground, pixels."""


@dataclass(frozen=True, slots=True)
class Viewport:
    """The transformation from metres on the ground to pixels of the large image, and the `size` of that image."""

    scale: float
    left: float
    bottom: float
    size: tuple[int, int]
    captions_top: int

    def at(self, place: Sequence[float]) -> Point:
        """Return the pixel of a place on the ground."""
        return self.left + place[0] * self.scale, self.bottom - place[1] * self.scale

    def all(self, places: Iterable[Sequence[float]]) -> list[Point]:
        """Return the pixels of several places."""
        return [self.at(place) for place in places]


def view_of(record: WorldRecord, lines: int, room: tuple[int, int] = (_WIDTH, _HEIGHT)) -> Viewport:
    """Return the view of a record's ground, in at most that room (pixels), with `lines` of captions below it."""
    xmin, ymin, xmax, ymax = record.config.bounds
    scale = min(room[0] / (xmax - xmin), room[1] / (ymax - ymin))
    ground = round((xmax - xmin) * scale), round((ymax - ymin) * scale)
    width = max(ground[0], 420) + 2 * EDGE
    captions_top = HEAD + ground[1] + EDGE // 2
    height = captions_top + lines * LINE + EDGE // 2
    left = (width - ground[0]) / 2 - xmin * scale
    bottom = HEAD + ground[1] + ymin * scale
    even = width + width % 2, height + height % 2  # video codecs want even sizes
    s = SMOOTH
    return Viewport(scale * s, left * s, bottom * s, (even[0] * s, even[1] * s), captions_top * s)


def background(record: WorldRecord, view: Viewport, title: str) -> Image:
    """Draw a large image of the world without its robots."""
    from PIL import Image, ImageDraw

    image = Image.new("RGB", view.size, style.PAPER)
    draw = ImageDraw.Draw(image)
    xmin, ymin, xmax, ymax = record.config.bounds
    (left, bottom), (right, top) = view.at((xmin, ymin)), view.at((xmax, ymax))
    draw.rectangle((left, top, right, bottom), fill=style.GROUND)
    apart = _round_length(max(xmax - xmin, ymax - ymin) / 20)
    for x in _multiples(apart, xmin, xmax):
        across = _whole_pixel(view.at((x, 0))[0])
        draw.rectangle((across, top, across + SMOOTH - 1, bottom), fill=style.LINES)
    for y in _multiples(apart, ymin, ymax):
        down = _whole_pixel(view.at((0, y))[1])
        draw.rectangle((left, down, right, down + SMOOTH - 1), fill=style.LINES)
    draw.rectangle((left, top, right, bottom), outline=style.INK if record.config.walls else style.LINES, width=4)
    for thing in record.config.obstacles:
        _solid(draw, view, thing.shape, style.OBSTACLE, style.OBSTACLE_EDGE)
    for thing in record.config.targets:
        _solid(draw, view, thing.shape, style.TARGET, style.TARGET_EDGE)
        _name_target(draw, view, thing, record)
    for charger in record.config.chargers:
        (x, y), radius = view.at(charger.at), charger.radius * view.scale
        draw.ellipse((x - radius, y - radius, x + radius, y + radius), outline=style.CHARGER, width=4)
        write(draw, (x, y + radius + 4), charger.name, style.CHARGER, anchor="ma", size=11)
    for station in record.config.stations:
        (x, y), radius = view.at(station.at), station.radius * view.scale
        draw.rounded_rectangle((x - radius, y - radius, x + radius, y + radius), 10, outline=style.STATION, width=4)
        write(draw, (x, y - radius - 4), station.name, style.STATION, anchor="ms", size=11)
    for weed in record.weeds:
        draw_weed(draw, view, weed, style.WEED, style.WEED_EDGE)
    if len(record.weeds) <= style.MOST_NAMES:
        for weed in record.weeds:
            x, y = view.at(weed.at)
            write(draw, (x, y + _weed_radius(view, weed) + 4), weed.name, style.WEED_EDGE, anchor="ma", size=11)
    write(draw, (left, top - 14), title, style.INK, anchor="ls", size=15, bold=True)
    _scale_bar(draw, view, record)
    return image


def draw_weed(draw: Any, view: Viewport, weed: Weed, fill: str, edge: str) -> None:
    """Draw a weed, large enough to be seen."""
    corners = view.all(style.weed(weed.at, _weed_radius(view, weed) / view.scale))
    draw.polygon(corners, fill=fill, outline=edge, width=3)


def _weed_radius(view: Viewport, weed: Weed) -> float:
    """Pixels of the large image."""
    return max(weed.radius * view.scale, 9.0 * SMOOTH)


def _round_length(least: float) -> float:
    """The smallest power of ten, or five times one, that is at least `least` (m)."""
    power: float = 10.0 ** math.floor(math.log10(least))
    return next(length for length in (power, 5 * power, 10 * power) if length >= least * (1 - 1e-9))


def _multiples(of: float, low: float, high: float) -> list[float]:
    return [number * of for number in range(math.ceil(low / of), math.floor(high / of) + 1)]


def _whole_pixel(large: float) -> int:
    """Round to the edge of a pixel of the small image, which keeps thin lines sharp."""
    return round(large / SMOOTH) * SMOOTH


def _name_target(draw: Any, view: Viewport, target: Thing, record: WorldRecord) -> None:
    """Write the name of a target on the side without a robot."""
    (x, y), (_, low, _, high) = target.shape.centre, bounding_box(target.shape)
    last = [track.poses[-1] for track in record.tracks]
    if style.name_goes_above((x, y), last, near=1.0, top=-math.inf):
        across, down = view.at((x, high))
        write(draw, (across, down - 6), target.name, style.TARGET_EDGE, anchor="ms", size=13)
    else:
        across, down = view.at((x, low))
        write(draw, (across, down + 6), target.name, style.TARGET_EDGE, anchor="ma", size=13)


def _scale_bar(draw: Any, view: Viewport, record: WorldRecord) -> None:
    xmin, _, xmax, _ = record.config.bounds
    length = _round_length((xmax - xmin) / 10)
    x, y = view.at((xmax, record.config.bounds[1]))
    x, y = x - 12 * SMOOTH, y - 10 * SMOOTH
    draw.line((x - length * view.scale, y, x, y), fill=style.INK, width=2 * SMOOTH)
    write(draw, (x - length * view.scale / 2, y - 6), f"{length:g} m", style.INK, anchor="ms", size=11)


def _solid(draw: Any, view: Viewport, shape: Outline, fill: str, edge: str) -> None:
    if isinstance(shape, Circle):
        x, y = view.at(shape.centre)
        radius = shape.radius * view.scale
        draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=fill, outline=edge, width=3)
    else:
        draw.polygon(view.all(shape.corners), fill=fill, outline=edge, width=3)


def write(
    draw: Any, place: Point, text: str, colour: str, *, anchor: str, size: int, bold: bool = False, halo: bool = False
) -> None:
    """Write text; `size` in pixels of the final image, `anchor` as in Pillow."""
    outline = {"stroke_width": 4, "stroke_fill": style.PAPER} if halo else {}
    draw.text(place, text, fill=colour, font=font(size, bold), anchor=anchor, **outline)


def faint(colour: str, alpha: int) -> str:
    """Return a colour with opacity `alpha` (of 255)."""
    return f"{colour}{alpha:02x}"


def font_file(bold: bool) -> Path:
    """Return the file of the font of films and pictures: the one shipped with matplotlib."""
    import matplotlib as mpl

    return Path(mpl.get_data_path(), "fonts", "ttf", "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf")


@cache
def font(size: int, bold: bool) -> Any:
    """Return a font of the large image; `size` in pixels of the final one."""
    return plain_font(size * SMOOTH, bold)


@cache
def plain_font(size: int, bold: bool = False) -> Any:
    """Return a font; `size` in pixels."""
    from PIL import ImageFont

    return ImageFont.truetype(str(font_file(bold)), size)


def fitting(text: str, width: float, size: int) -> str:
    """Shorten text to at most `width` pixels of the large image."""
    letters = font(size, False)
    if letters.getlength(text) <= width:
        return text
    while text and letters.getlength(text + "…") > width:
        text = text[:-1]
    return text + "…"
