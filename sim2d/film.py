"""Writes frames as a film: GIF with Pillow, MP4 with ffmpeg.

All frames of a GIF share one palette, made of the colours of the style and not of the frames: so the same thing has
the same colour throughout, and only what changes is stored.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from fame.errors import ConfigError, UnavailableError
from sim2d import style

if TYPE_CHECKING:
    from PIL.Image import Image

_PARTS = (1.0, 0.8, 0.6, 0.4, *(part / 255 for part in (style.LAMP, style.GLOW, style.CONE)))
"""How much of a colour is in its mixtures with the ground: at smooth edges, and where it is faint."""
_PAUSE = 3000
"""How long the last frame stays before a GIF begins again, ms."""


@contextmanager
def writing(path: str | PathLike[str]) -> Iterator[None]:
    """Make the folder of a file that is written; raises ConfigError, with its name, if that cannot be done."""
    try:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        yield
    except OSError as error:
        raise ConfigError(f"cannot be written: {error.strerror or error}", file=str(path)) from None


def write_gif(frames: Iterator[Image], path: str, fps: float) -> None:
    """Write a GIF that runs for ever."""
    from PIL import Image

    colours = Image.new("P", (1, 1))
    colours.putpalette([part for colour in _gif_colours() for part in colour])
    flat = [frame.quantize(palette=colours, dither=Image.Dither.NONE) for frame in frames]
    durations = [round(100 / fps) * 10] * (len(flat) - 1) + [_PAUSE]
    flat[0].save(path, save_all=True, append_images=flat[1:], duration=durations, loop=0, optimize=True)


def _gif_colours() -> list[tuple[int, int, int]]:
    """At most 256: the colours of the style, and mixtures with ground and paper for smooth edges and faint areas."""
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
    lights = (colour for colour in style.LEDS.values() if colour != style.PAPER)
    on_ground = [mixed(colour, style.GROUND, part) for colour in (*things, *style.ROBOTS, *lights) for part in _PARTS]
    on_paper = [mixed(colour, style.PAPER, part / 3) for colour in (style.INK, *style.ROBOTS) for part in (0, 1, 2)]
    lines = [mixed(style.LINES, style.GROUND, part / 2) for part in (0, 1, 2)]
    return list(dict.fromkeys([*on_ground, *on_paper, *lines]))


def ffmpeg() -> str:
    """Path of the program ffmpeg. Raises UnavailableError where it is not installed."""
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
        with suppress(BrokenPipeError):  # it ended early: its code and its own words say why
            for frame in chain([first], frames):
                process.stdin.write(frame.tobytes())
            process.stdin.close()
    if process.returncode:
        raise UnavailableError(f"ffmpeg could not write {path}: it ended with code {process.returncode}")


WRITERS: Mapping[str, Callable[[Iterator[Image], str, float], None]] = {".gif": write_gif, ".mp4": write_mp4}
"""By the ending of the file: frames, path, frames per second."""
