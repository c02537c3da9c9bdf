"""Films and pictures of recorded runs: the simulated world, with captions that say what each robot does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fame.errors import ConfigError
from fame.imports import require
from fame.log.conversion import models_of
from fame.log.recording import Recording
from fame.scenario.film_captions import Captions

if TYPE_CHECKING:
    from sim2d.animation import Caption
    from sim2d.record import WorldRecord

FILMS, PICTURE = (".gif", ".mp4"), ".png"


def check_film(path: Path, endings: Sequence[str] = (*FILMS, PICTURE)) -> None:
    """Raise ConfigError for a name with another end, UnavailableError if what is needed to write it is missing."""
    if path.suffix.lower() not in endings:
        text = f"expected a file with the ending {' or '.join(endings)}, got {path.suffix!r}"
        raise ConfigError(text, file=str(path))
    for package in ("matplotlib", "PIL"):
        require(package)
    if path.suffix.lower() == ".mp4":
        from sim2d.animation import ffmpeg

        ffmpeg()


def read_film(source: str | Path) -> tuple[WorldRecord, Sequence[Caption]]:
    """Return what a recording shows of its simulated world, and the captions of its robots.

    Raises ConfigError for a recording without such a world, and for one that cannot be read.
    """
    from sim2d.record import read_record

    with Recording(source) as recording:
        try:
            record = read_record(recording.scenes(), recording.end)
        except (LookupError, TypeError, ValueError, AttributeError) as error:
            raise ConfigError(f"has scenes of another form: {error!r}", file=str(source)) from None
        if not record.times:
            raise ConfigError("has no simulated world to draw", file=str(source))
        models, last = models_of(recording), recording.state(recording.end)
        known = {process.id: process for file in models for process in file.processes}
        cast = {name: known[robot.process] for name, robot in last.robots.items() if robot.process in known}
        captions = Captions(models, cast)
        for event in recording.events():
            captions.add(event)
        return record, captions.labels


def draw_film(
    source: str | Path, *targets: Path, title: str = "", progress: Callable[[int, int], object] | None = None
) -> None:
    """Draw a recording as films (.gif, .mp4), or its last frame (.png); `title`: by default the name of the file.

    `progress` gets the number of frames drawn, and their total. Raises ConfigError as `read_film`, and for what cannot
    be written, UnavailableError if what is needed is missing.
    """
    from sim2d.animation import animate, picture

    for target in targets:
        check_film(target)
    record, labels = read_film(source)
    title = title or Path(source).stem.replace("_", " ").capitalize()
    for target in targets:
        if target.suffix.lower() == PICTURE:
            picture(record, target, labels=labels, title=title)
        else:
            animate(record, target, labels=labels, title=title, progress=progress)
