"""Draws a run as a moving picture, GIF or MP4: robots with their names, range cones and ways, and what each is at.

Pillow draws each frame at twice its size, over a background that holds all that never moves and the ways so far, and
shrinks it: that smooths the edges and is many times faster than a plotting library.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.errors import ConfigError, UnavailableError
from robots.robot import Pose
from sim2d import style
from sim2d.canvas import EDGE, HEAD, LINE, SMOOTH, View, background, faint, fitting, font, view_of, write
from sim2d.film import WRITERS
from sim2d.reading import Point
from sim2d.record import Record, Track
from sim2d.shapes import placed

if TYPE_CHECKING:
    from PIL.Image import Image

Label = tuple[float, str, str]
"""From this time (s) on, what the process of this robot is at."""

_LONGEST = 15.0
"""Seconds that a film lasts if nobody asks for a speed."""
_MOST_CAPTIONS = 12


def animate(
    record: Record,
    path: str | PathLike[str],
    *,
    labels: Iterable[Label] = (),
    fps: float = 10.0,
    speed: float | None = None,
    title: str = "",
) -> None:
    """Write a run as `.gif`, or as `.mp4` with ffmpeg; `fps` frames and `speed` seconds of the run per second of film.

    Without a `speed` the film is as fast as the run, but lasts 15 s at most.

    Raises ConfigError for another kind of file or nothing recorded, UnavailableError if Pillow or ffmpeg is missing.
    """
    kind = Path(path).suffix.lower()
    if kind not in WRITERS:
        raise ConfigError(f"found the ending {kind!r}, {' or '.join(WRITERS)} would be right", file=str(path))
    if not record.times:
        raise ConfigError("nothing was recorded, a run of at least one step would be right", file=str(path))
    try:
        import PIL  # noqa: F401 (is it there?)
    except ImportError:
        raise UnavailableError("animations need Pillow: pip install 'fame-robots[sim]'") from None
    if speed is None:
        speed = max(1.0, record.times[-1] / _LONGEST)
    if fps <= 0 or speed <= 0:
        raise ConfigError(f"found fps {fps:g} and speed {speed:g}, both above 0 would be right", file=str(path))
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    WRITERS[kind](_frames(record, _Captions(record, labels), speed / fps, title), str(path), fps)


class _Captions:
    """What each robot is at, by time."""

    def __init__(self, record: Record, labels: Iterable[Label]) -> None:
        self._times: dict[str, list[float]] = {track.name: [] for track in record.tracks}
        self._texts: dict[str, list[str]] = {track.name: [] for track in record.tracks}
        for time, robot, text in sorted(labels, key=lambda label: label[0]):
            if robot in self._times:
                self._times[robot].append(time)
                self._texts[robot].append(text)

    def at(self, robot: str, time: float) -> str:
        index = bisect_right(self._times[robot], time + 1e-9) - 1
        return self._texts[robot][index] if index >= 0 else ""


def _frames(record: Record, captions: _Captions, step: float, title: str) -> Iterator[Image]:
    view = view_of(record, _caption_table(len(record.tracks))[1])
    still = background(record, view, title)
    drawn, end = 0, record.times[-1]
    count = max(1, math.ceil(end / step - 1e-9) + 1)
    for number in range(count):
        time = min(number * step, end)
        sample = max(bisect_right(record.times, time + 1e-9) - 1, 0)
        _extend_ways(still, record, view, drawn, sample)
        drawn = sample
        frame = still.copy()
        _draw_robots(frame, record, view, sample)
        _draw_captions(frame, record, view, captions, sample)
        yield frame.reduce(SMOOTH)


def _extend_ways(still: Image, record: Record, view: View, drawn: int, sample: int) -> None:
    from PIL import ImageDraw

    draw = ImageDraw.Draw(still)
    for index, track in enumerate(record.tracks):
        colour = style.robot_colour(index)
        if sample == 0:
            x, y = view.at(track.poses[0])
            draw.ellipse((x - 9, y - 9, x + 9, y + 9), outline=colour, width=4)
        elif sample > drawn:
            draw.line(view.all(track.poses[drawn : sample + 1]), fill=colour, width=4, joint="curve")


def _draw_robots(frame: Image, record: Record, view: View, sample: int) -> None:
    from PIL import ImageDraw

    draw = ImageDraw.Draw(frame, "RGBA")
    for index, track in enumerate(record.tracks):
        cone = track.cones[sample]
        if cone is not None:
            (x, y), radius = view.at(cone.pose), cone.length * view.scale
            middle, half = -math.degrees(cone.pose.heading), math.degrees(cone.field_of_view) / 2
            around = (x - radius, y - radius, x + radius, y + radius)
            draw.pieslice(around, middle - half, middle + half, fill=faint(style.robot_colour(index), style.CONE))
    for index, track in enumerate(record.tracks):
        _draw_robot(draw, track, style.robot_colour(index), view, sample)
    for index, track in enumerate(record.tracks):
        others = [other.poses[sample] for other in record.tracks if other is not track]
        others += [Pose(*thing.shape.centre, 0.0) for thing in record.config.targets]
        above = style.name_goes_above(track.poses[sample], others, near=0.6, top=record.config.bounds[3])
        _name_robot(draw, view, view.all(placed(track.outline, track.poses[sample])), track.name, index, above)


def _name_robot(draw: Any, view: View, corners: list[Point], name: str, index: int, above: bool) -> None:
    half = font(14, True).getlength(name) / 2
    x = min(max(sum(x for x, _ in corners) / len(corners), half + 4), view.size[0] - half - 4)
    y, anchor = (min(y for _, y in corners) - 8, "ms") if above else (max(y for _, y in corners) + 8, "ma")
    write(draw, (x, y), name, style.robot_colour(index), anchor=anchor, size=14, bold=True, halo=True)


def _draw_robot(draw: Any, track: Track, colour: str, view: View, sample: int) -> None:
    pose, led = track.poses[sample], track.leds[sample]
    ahead = max(x for x, _ in track.outline)
    corners = view.all(placed(track.outline, pose))
    x, y = view.at(placed(((-ahead * 0.4, 0),), pose)[0])
    size = ahead * view.scale
    if led in style.LEDS:
        for radius, alpha in ((2.2, style.GLOW), (1.4, style.LAMP)):
            glow = size * radius
            draw.ellipse((x - glow, y - glow, x + glow, y + glow), fill=faint(style.LEDS[led], alpha))
    draw.polygon(corners, fill=colour, outline=style.INK, width=3)
    nose = placed(((ahead * 0.85, 0), (ahead * 0.25, ahead * 0.42), (ahead * 0.25, -ahead * 0.42)), pose)
    draw.polygon(view.all(nose), fill=style.PAPER)
    if led in style.LEDS:
        lamp = size * 0.4
        draw.ellipse((x - lamp, y - lamp, x + lamp, y + lamp), fill=style.LEDS[led], outline=style.PAPER, width=2)


def _draw_captions(frame: Image, record: Record, view: View, captions: _Captions, sample: int) -> None:
    from PIL import ImageDraw

    draw = ImageDraw.Draw(frame)
    time, edge = record.times[sample], EDGE * SMOOTH
    write(draw, (view.size[0] - edge, HEAD * SMOOTH - 14), f"{time:.1f} s", style.INK, anchor="rs", size=15)
    shown = record.tracks[:_MOST_CAPTIONS]
    widest = max((font(13, True).getlength(track.name) for track in shown), default=0)
    columns, lines = _caption_table(len(shown))
    width = (view.size[0] - 2 * edge) // columns
    for index, track in enumerate(shown):
        x = edge + index // lines * width
        y = view.captions_top + (index % lines + 0.5) * LINE * SMOOTH
        colour, led = style.robot_colour(index), track.leds[sample]
        draw.rounded_rectangle((x, y - 12, x + 24, y + 12), 6, fill=colour)
        if led in style.LEDS:
            draw.ellipse((x + 5, y - 7, x + 19, y + 7), fill=style.LEDS[led], outline=style.PAPER, width=2)
        write(draw, (x + 36, y), track.name, colour, anchor="lm", size=13, bold=True)
        text = fitting(captions.at(track.name, time), width - widest - 80, 13)
        write(draw, (x + 60 + widest, y), text, style.INK, anchor="lm", size=13)


def _caption_table(robots: int) -> tuple[int, int]:
    """Columns and lines of the captions."""
    shown = min(robots, _MOST_CAPTIONS)
    columns = 1 if shown <= _MOST_CAPTIONS // 3 else 2
    return columns, math.ceil(shown / columns)
