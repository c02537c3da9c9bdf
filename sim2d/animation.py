"""Draws a run as a film (GIF, MP4 or WebP), or its end as a picture: robots with names, sensors and trails, captions.

Pillow draws each frame at twice its size, over a background with everything static and the trails so far, and shrinks
it. This smooths the edges and is many times faster than a plotting library.

All frames of a GIF share one palette, made of the colours of the style: a thing has the same colour in all frames, and
only changes are stored. MP4 is written with ffmpeg.
"""

from __future__ import annotations

import math
import shutil
import subprocess
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.errors import ConfigError, UnavailableError
from fame.imports import require
from fame.text import writing
from sim2d import style
from sim2d.canvas import EDGE, HEAD, LINE, SMOOTH, Viewport, background, draw_weed, faint, fitting, font, view_of, write
from sim2d.ground import disc, placed
from sim2d.record import Track, WorldRecord
from sim2d.robot import Appearance, Pose
from sim2d.style import larger, symbol

if TYPE_CHECKING:
    from PIL.Image import Image


Caption = tuple[float, str, str]
"""From this time (s) on, the caption of this robot."""

_LONGEST = 15.0
"""Maximum duration of an animation without a given speed, s."""
_MOST_CAPTIONS = 12
_NEAR, _SMALLEST = 45.0, 30.0
"""Pixels: distance below which names of robots avoid each other, and minimum length of a drawn robot."""


def animate(
    record: WorldRecord,
    path: str | PathLike[str],
    *,
    labels: Iterable[Caption] = (),
    fps: float = 10.0,
    speed: float | None = None,
    title: str = "",
    progress: Callable[[int, int], object] | None = None,
) -> None:
    """Write a run as `.gif`, `.webp` or (with ffmpeg) `.mp4`: `fps` frames per second, `speed` times simulated time.

    Without `speed` the animation has the speed of the run, but lasts at most 15 s. `progress` is called after each
    frame with the number of frames drawn and their total.

    Raises ConfigError for another kind of file, one that cannot be written, or an empty record, UnavailableError if
    Pillow or ffmpeg is missing.
    """
    kind = Path(path).suffix.lower()
    if kind not in WRITERS:
        raise ConfigError(f"expected a file {' or '.join(WRITERS)}, got {kind!r}", file=str(path))
    _check(record, path)
    if speed is None:
        speed = usual_speed(record.times[-1])
    if fps <= 0 or speed <= 0:
        raise ConfigError(f"expected fps and speed above 0, got fps {fps:g} and speed {speed:g}", file=str(path))
    times = frame_times(record.times[-1], speed / fps)
    write_film(world_frames(record, times, labels=labels, title=title), path, len(times), fps, progress)


def usual_speed(end: float) -> float:
    """Return the speed of a film of a run of `end` s: that of the run, or what makes it last 15 s."""
    return max(1.0, end / _LONGEST)


def frame_times(end: float, step: float) -> Sequence[float]:
    """Return the times of the frames of a run of `end` s, `step` s apart: the last is its end."""
    return [min(number * step, end) for number in range(max(1, math.ceil(end / step - 1e-9) + 1))]


def world_frames(
    record: WorldRecord,
    times: Sequence[float],
    *,
    labels: Iterable[Caption] = (),
    title: str = "",
    room: tuple[int, int] | None = None,
) -> Iterator[Image]:
    """Yield the world at each time (s); its ground fills at most `room` (width, height in pixels)."""
    for frame in _frames(record, _Captions(record, labels), times, title, room):
        yield frame.reduce(SMOOTH)


def write_film(
    frames: Iterator[Image],
    path: str | PathLike[str],
    count: int,
    fps: float,
    progress: Callable[[int, int], object] | None = None,
) -> None:
    """Write `count` images of one size as a film. `progress` is called as by `animate`."""
    with writing(path) as part:
        WRITERS[part.suffix.lower()](_counted(frames, count, progress), str(part), fps)


def picture(record: WorldRecord, path: str | PathLike[str], *, labels: Iterable[Caption] = (), title: str = "") -> None:
    """Write the last frame of a film of a run as `.png`, twice as large. Raises as `animate`."""
    _check(record, path)
    times = frame_times(record.times[-1], record.times[-1] or 1.0)
    *_, last = _frames(record, _Captions(record, labels), times, title)
    with writing(path) as part:
        last.save(part)


def _check(record: WorldRecord, path: str | PathLike[str]) -> None:
    """Raise ConfigError if nothing was recorded, UnavailableError if a package is missing."""
    if not record.times:
        raise ConfigError("expected a run of at least one step, got nothing recorded", file=str(path))
    require("PIL", "matplotlib")


def _counted(frames: Iterator[Image], count: int, progress: Callable[[int, int], object] | None) -> Iterator[Image]:
    """Yield the frames and report each to `progress`."""
    for number, frame in enumerate(frames, 1):
        yield frame
        if progress is not None:
            progress(number, count)


class _Captions:
    """The captions of robots by time: robots of the world first, then computers, which have no body."""

    def __init__(self, record: WorldRecord, labels: Iterable[Caption]) -> None:
        self._times: dict[str, list[float]] = {track.name: [] for track in record.tracks}
        self._texts: dict[str, list[str]] = {track.name: [] for track in record.tracks}
        for time, robot, text in sorted(labels, key=lambda label: label[0]):
            self._times.setdefault(robot, []).append(time)
            self._texts.setdefault(robot, []).append(text)

    @property
    def names(self) -> Sequence[str]:
        """The robots whose captions are shown."""
        return list(self._times)[:_MOST_CAPTIONS]

    def at(self, robot: str, time: float, until: float) -> str:
        """Return the caption with the largest share of the time between `time` and `until` (s);
        shorter ones would flicker."""
        times, texts = self._times[robot], self._texts[robot]
        begin, end = max(bisect_right(times, time + 1e-9) - 1, 0), bisect_left(times, until)
        held: dict[str, float] = {}
        for index in range(begin, end):
            over = times[index + 1] if index + 1 < end else until
            held[texts[index]] = held.get(texts[index], 0.0) + over - max(times[index], time)
        return max(held, key=lambda text: held[text], default="")


def _frames(
    record: WorldRecord,
    captions: _Captions,
    times: Sequence[float],
    title: str,
    room: tuple[int, int] | None = None,
) -> Iterator[Image]:
    lines = _caption_table(len(captions.names))[1]
    view = view_of(record, lines, room) if room else view_of(record, lines)
    still = background(record, view, title)
    step = times[1] - times[0] if len(times) > 1 else 1.0
    drawn = 0
    for time in times:
        sample = max(bisect_right(record.times, time + 1e-9) - 1, 0)
        _extend_ways(still, record, view, drawn, sample)
        _cut_weeds(still, record, view, record.times[drawn], record.times[sample])
        drawn = sample
        frame = still.copy()
        _draw_things(frame, record, view, sample)
        _draw_robots(frame, record, view, sample)
        _draw_captions(frame, record, view, captions, sample, step)
        yield frame


def _extend_ways(still: Image, record: WorldRecord, view: Viewport, drawn: int, sample: int) -> None:
    from PIL import ImageDraw

    draw = ImageDraw.Draw(still)
    for index, track in enumerate(record.tracks):
        colour = style.robot_colour(index)
        if sample == 0:
            x, y = view.at(track.poses[0])
            draw.ellipse((x - 9, y - 9, x + 9, y + 9), outline=colour, width=4)
        elif sample > drawn:
            draw.line(view.all(track.poses[drawn : sample + 1]), fill=colour, width=4, joint="curve")


def _cut_weeds(still: Image, record: WorldRecord, view: Viewport, since: float, until: float) -> None:
    """Draw the weeds that were cut between two times (s) as stubble."""
    from PIL import ImageDraw

    draw = ImageDraw.Draw(still)
    for weed in record.weeds:
        if weed.cut_at is not None and since < weed.cut_at <= until:
            cutter = record.cutter(weed)
            edge = style.robot_colour(cutter) if cutter is not None else style.FAINT
            draw_weed(draw, view, weed, style.STUBBLE, edge)


def _draw_things(frame: Image, record: WorldRecord, view: Viewport, sample: int) -> None:
    """Draw doors, and the parcels that lie on the ground."""
    from PIL import ImageDraw

    if not record.things:
        return
    draw = ImageDraw.Draw(frame)
    doors, parcels = record.things[sample]
    for door, opening in zip(record.config.doors, doors, strict=True):
        for leaf in style.door_leaves(door.start, door.end, opening):
            draw.line(view.all(leaf), fill=style.DOOR, width=10)
    for parcel in parcels:
        if parcel is not None:
            draw.polygon(view.all(style.parcel(parcel)), fill=style.PARCEL, outline=style.PARCEL_EDGE, width=3)


def _draw_robots(frame: Image, record: WorldRecord, view: Viewport, sample: int) -> None:
    from PIL import ImageDraw

    draw = ImageDraw.Draw(frame, "RGBA")
    for index, track in enumerate(record.tracks):
        _draw_senses(draw, track.appearances[sample], style.robot_colour(index), view)
    inked = sorted(
        enumerate(record.tracks), key=lambda item: item[1].appearances[sample].altitude
    )  # flying robots are on top
    for index, track in inked:
        _draw_robot(draw, track, style.robot_colour(index), view, sample)
        if track.appearances[sample].charge < style.LOW:
            _draw_battery(draw, view.at(track.poses[sample]), track.appearances[sample].charge)
    if len(record.tracks) > style.MOST_NAMES:
        return
    for index, track in enumerate(record.tracks):
        others = [other.poses[sample] for other in record.tracks if other is not track]
        others += [Pose(*thing.shape.centre, 0.0) for thing in record.config.targets]
        near = _NEAR * SMOOTH / view.scale
        above = style.name_goes_above(track.poses[sample], others, near=near, top=record.config.bounds[3])
        _name_robot(draw, view, track, sample, index, above)


def _draw_senses(draw: Any, appearance: Appearance, colour: str, view: Viewport) -> None:
    """Draw the ground that a range sensor saw free, and that a camera sees."""
    cone = appearance.cone
    if cone is not None:
        (x, y), radius = view.at(cone.pose), cone.length * view.scale
        middle, half = -math.degrees(cone.pose.heading), math.degrees(cone.field_of_view) / 2
        around = (x - radius, y - radius, x + radius, y + radius)
        draw.pieslice(around, middle - half, middle + half, fill=faint(colour, style.CONE))
    if appearance.footprint:
        (x, y), radius = view.at(appearance.pose), appearance.footprint * view.scale
        around = (x - radius, y - radius, x + radius, y + radius)
        draw.ellipse(around, fill=faint(colour, style.CONE), outline=faint(colour, style.LAMP), width=3)


def _name_robot(draw: Any, view: Viewport, track: Track, sample: int, index: int, above: bool) -> None:
    appearance = track.appearances[sample]
    text = f"{track.name}  {appearance.altitude:.1f} m" if appearance.altitude >= 0.05 else track.name
    half = font(14, True).getlength(text) / 2
    corners = view.all(placed(larger(track.outline, _growth(track, view)), appearance.pose))
    x = min(max(view.at(appearance.pose)[0], half + 4), view.size[0] - half - 4)
    y, anchor = (min(y for _, y in corners) - 8, "ms") if above else (max(y for _, y in corners) + 8, "ma")
    write(draw, (x, y), text, style.robot_colour(index), anchor=anchor, size=14, bold=True, halo=True)


def _growth(track: Track, view: Viewport) -> float:
    """The factor by which a robot is enlarged to be visible on a large ground."""
    return max(1.0, _SMALLEST * SMOOTH / (2 * max(x for x, _ in track.outline) * view.scale))


def _draw_robot(draw: Any, track: Track, colour: str, view: Viewport, sample: int) -> None:
    appearance, growth = track.appearances[sample], _growth(track, view)
    pose, led = appearance.pose, appearance.led
    ahead = max(x for x, _ in track.outline) * growth
    x, y = view.at(placed(((-ahead * 0.4, 0),), pose)[0])
    size = ahead * view.scale
    if led in style.LEDS:
        for radius, alpha in ((2.2, style.GLOW), (1.4, style.LAMP)):
            glow = size * radius
            draw.ellipse((x - glow, y - glow, x + glow, y + glow), fill=faint(style.LEDS[led], alpha))
    if appearance.blade:
        round_ = view.all(disc(appearance.pose[:2], appearance.blade * growth * 1.25))
        draw.polygon(round_, fill=faint(style.INK, style.GLOW), outline=style.INK, width=3)
    for part in symbol(track.type, track.outline, appearance):
        fill, edge = style.paint(part.colour, colour)
        corners = view.all(placed(larger(part.corners, growth), pose))
        if part.closed:
            draw.polygon(corners, fill=fill, outline=edge, width=3)
        else:
            draw.line(corners, fill=fill, width=6, joint="curve")
    if appearance.cargo:
        corners = view.all(placed(larger(style.parcel((0.0, 0.0)), growth), pose))
        draw.polygon(corners, fill=style.PARCEL, outline=style.PARCEL_EDGE, width=3)
    if led in style.LEDS:
        lamp = size * 0.4
        draw.ellipse((x - lamp, y - lamp, x + lamp, y + lamp), fill=style.LEDS[led], outline=style.PAPER, width=2)


def _draw_battery(draw: Any, place: tuple[float, float], charge: float) -> None:
    """Draw a low battery with its charge in red, crossed out if it is empty."""
    (x, y), red = place, style.LEDS["red"]
    draw.rectangle((x + 20, y - 9, x + 24, y + 9), fill=style.INK)
    draw.rectangle((x - 24, y - 14, x + 20, y + 14), fill=style.PAPER, outline=style.INK, width=4)
    if charge > 0:
        draw.rectangle((x - 18, y - 8, x - 18 + 32 * charge, y + 8), fill=red)
    else:
        draw.line((x - 30, y + 20, x + 28, y - 20), fill=red, width=6)


def _draw_captions(
    frame: Image, record: WorldRecord, view: Viewport, captions: _Captions, sample: int, step: float
) -> None:
    from PIL import ImageDraw

    draw = ImageDraw.Draw(frame)
    time, edge = record.times[sample], EDGE * SMOOTH
    write(draw, (view.size[0] - edge, HEAD * SMOOTH - 14), f"{time:.1f} s", style.INK, anchor="rs", size=15)
    appearances = {track.name: track.appearances[sample] for track in record.tracks}
    widest = max((font(13, True).getlength(name) for name in captions.names), default=0)
    columns, lines = _caption_table(len(captions.names))
    width = (view.size[0] - 2 * edge) // columns
    for index, name in enumerate(captions.names):
        x = edge + index // lines * width
        y = view.captions_top + (index % lines + 0.5) * LINE * SMOOTH
        colour, appearance = style.robot_colour(index), appearances.get(name, Appearance(Pose(0.0, 0.0, 0.0)))
        draw.rounded_rectangle((x, y - 12, x + 24, y + 12), 6, fill=colour)
        if appearance.led in style.LEDS:
            draw.ellipse((x + 5, y - 7, x + 19, y + 7), fill=style.LEDS[appearance.led], outline=style.PAPER, width=2)
        write(draw, (x + 36, y), name, colour, anchor="lm", size=13, bold=True)
        activity = style.activity_text(captions.at(name, time, time + step), appearance.note, appearance.charge)
        text = fitting(activity, width - widest - 80, 13)
        write(draw, (x + 60 + widest, y), text, style.INK, anchor="lm", size=13)


def _caption_table(robots: int) -> tuple[int, int]:
    """Columns and lines of the captions."""
    shown = min(robots, _MOST_CAPTIONS)
    columns = 1 if shown <= _MOST_CAPTIONS // 3 else 2
    return columns, math.ceil(shown / columns)


_PARTS = (1.0, 0.8, 0.6, 0.4, *(part / 255 for part in (style.LAMP, style.GLOW, style.CONE)))
"""Shares of a colour in its mixtures with the ground: at smooth edges and in faint areas."""
_PAUSE = 3000
"""Time of the last frame before a GIF begins again, ms."""


def write_gif(frames: Iterator[Image], path: str, fps: float) -> None:
    """Write a GIF that repeats forever."""
    from PIL import Image

    colours = Image.new("P", (1, 1))
    colours.putpalette([part for colour in _gif_colours() for part in colour])
    flat = [frame.quantize(palette=colours, dither=Image.Dither.NONE) for frame in frames]
    durations = [round(100 / fps) * 10] * (len(flat) - 1) + [_PAUSE]
    flat[0].save(path, save_all=True, append_images=flat[1:], duration=durations, loop=0, optimize=True)


def _gif_colours() -> list[tuple[int, int, int]]:
    """At most 256 colours: those of the style, and mixtures with ground and paper for smooth edges and faint areas."""
    from PIL.ImageColor import getrgb

    def mixed(colour: str, other: str, part: float) -> tuple[int, int, int]:
        r, g, b = (round(a * part + b * (1 - part)) for a, b in zip(getrgb(colour)[:3], getrgb(other)[:3], strict=True))
        return r, g, b

    things = (
        style.INK,
        style.OBSTACLE,
        style.OBSTACLE_EDGE,
        style.TARGET,
        style.TARGET_EDGE,
        style.WEED,
        style.WEED_EDGE,
        style.STUBBLE,
        style.MATERIALS["fixture"][0],
    )
    plain = [mixed(colour, colour, 1.0) for colour in (style.PARCEL, style.PARCEL_EDGE, style.DOOR, style.STATION)]
    lights = (colour for colour in style.LEDS.values() if colour != style.PAPER)
    on_ground = [mixed(colour, style.GROUND, part) for colour in (*things, *style.ROBOTS, *lights) for part in _PARTS]
    on_paper = [mixed(colour, style.PAPER, part / 3) for colour in (style.INK, *style.ROBOTS) for part in (0, 1, 2)]
    lines = [mixed(style.LINES, style.GROUND, part / 2) for part in (0, 1, 2)]
    return list(dict.fromkeys([*on_ground, *on_paper, *lines, *plain]))


def ffmpeg() -> str:
    """Return the path of the program ffmpeg. Raises UnavailableError if it is not installed."""
    found = shutil.which("ffmpeg")
    if found is None:
        raise UnavailableError("an .mp4 needs ffmpeg: apt install ffmpeg (a .gif needs nothing more)")
    return found


def write_mp4(frames: Iterator[Image], path: str, fps: float) -> None:
    """Write an MP4. Raises UnavailableError without ffmpeg."""
    program = ffmpeg()
    first = next(frames)
    size = f"{first.width}x{first.height}"
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", str(fps), "-i", "-"]
    target = ["-pix_fmt", "yuv420p", "-movflags", "+faststart", path]
    with subprocess.Popen([program, "-y", "-loglevel", "error", *source, *target], stdin=subprocess.PIPE) as process:
        assert process.stdin is not None
        with suppress(BrokenPipeError):  # ffmpeg ended early: its exit code and messages say why
            for frame in chain([first], frames):
                process.stdin.write(frame.tobytes())
            process.stdin.close()
    if process.returncode:
        raise UnavailableError(f"ffmpeg could not write {path}: it ended with code {process.returncode}")


def write_webp(frames: Iterator[Image], path: str, fps: float) -> None:
    """Write an animated WebP that repeats forever."""
    first, *others = frames
    durations = [round(1000 / fps)] * len(others) + [_PAUSE]
    first.save(path, save_all=True, append_images=others, duration=durations, loop=0, quality=80, minimize_size=False)


WRITERS: Mapping[str, Callable[[Iterator[Image], str, float], None]] = {
    ".gif": write_gif,
    ".mp4": write_mp4,
    ".webp": write_webp,
}
"""By file extension; each takes frames, path, frames per second."""
