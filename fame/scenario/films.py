"""Films and pictures of recorded runs: the diagram with its tokens, and the simulated world with its captions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from fame.bpmn.draw.diagram import is_drawable, with_diagram
from fame.bpmn.model import Definitions
from fame.clock import SECOND
from fame.dataclasses import dataclass
from fame.errors import ConfigError
from fame.imports import require
from fame.log.recording import Recording, models_of, team_order
from fame.robot import Event
from fame.scenario.film_captions import Captions

if TYPE_CHECKING:
    from PIL.Image import Image

    from sim2d.animation import Caption
    from sim2d.record import WorldRecord

FILMS, PICTURE = (".gif", ".mp4", ".webp"), ".png"
Shown = Literal["both", "diagram", "world"]

WIDTH, HEIGHT = 800, 400
"""The size of a film that shows both, pixels: its width, and the height of each half at most."""
FPS = 10.0


def check_film(path: Path, endings: Sequence[str] = (*FILMS, PICTURE), show: Shown = "both") -> None:
    """Raise ConfigError for a name with another end, UnavailableError if what is needed to write it is missing."""
    if path.suffix.lower() not in endings:
        text = f"expected a file with the ending {' or '.join(endings)}, got {path.suffix!r}"
        raise ConfigError(text, file=str(path))
    with_diagram = show != "world" and path.suffix.lower() != PICTURE
    require("matplotlib", "PIL", *["resvg_py"] * with_diagram)
    if path.suffix.lower() == ".mp4":
        from sim2d.animation import ffmpeg

        ffmpeg()


@dataclass(frozen=True, slots=True)
class FilmedRun:
    """What a recording shows of a run: its world (None: it has none), captions, events, and the model of the team."""

    world: WorldRecord | None
    labels: Sequence[Caption]
    events: Sequence[Event]
    model: Definitions | None
    end: float


def read_run(source: str | Path) -> FilmedRun:
    """Read a recording for its film. Raises ConfigError for one that cannot be read."""
    from sim2d.record import read_record

    with Recording(source) as recording:
        try:
            record = read_record(recording.scenes(), recording.end)
        except (LookupError, TypeError, ValueError, AttributeError) as error:
            raise ConfigError(f"has scenes of another form: {error!r}", file=str(source)) from None
        models, last = models_of(recording), recording.state(recording.end)
        known = {process.id: process for file in models for process in file.processes}
        team = ((name, last.robots[name]) for name in team_order(last.robots))
        cast = {name: known[robot.process] for name, robot in team if robot.process in known}
        captions = Captions(models, cast)
        events = list(recording.events())
        for event in events:
            captions.add(event)
        model = next((file for file in models if any(one in cast.values() for one in file.processes)), None)
        model = with_diagram(model) if model is not None and is_drawable(model) else None
        labels = [*((0.0, robot, "") for robot in cast), *captions.labels]  # the order of a team gives it its colours
        return FilmedRun(record if record.times else None, labels, events, model, recording.end / SECOND)


def draw_film(
    source: str | Path,
    *targets: Path,
    title: str = "",
    show: Shown = "both",
    progress: Callable[[int, int], object] | None = None,
) -> None:
    """Draw a recording as films (.gif, .mp4, .webp), or its world at the end (.png).

    `title`: by default the name of the file. `show`: the diagram with its tokens, the world, or both, as far as the
    recording has them. `progress` gets the number of frames drawn, and their total.

    Raises ConfigError for a recording without what is to be shown, and for what cannot be read or written,
    UnavailableError if what is needed is missing.
    """
    from sim2d.animation import animate, picture

    for target in targets:
        check_film(target, show=show)
    run = read_run(source)
    title = title or Path(source).stem.replace("_", " ").capitalize()
    for target in targets:
        is_picture = target.suffix.lower() == PICTURE
        if show == "diagram" and not is_picture and run.model is None:
            raise ConfigError("has no diagram to draw", file=str(source))
        if run.world is None and (is_picture or show == "world" or run.model is None):
            neither = "neither a drawn diagram nor a simulated world to show"
            only = is_picture or show == "world"
            raise ConfigError(f"has {'no simulated world to draw' if only else neither}", file=str(source))
        if run.model is not None and not is_picture and show != "world":
            _draw_diagram(run, run.model, target, title, run.world if show == "both" else None, progress)
        elif run.world is not None and is_picture:
            picture(run.world, target, labels=run.labels, title=title)
        elif run.world is not None:
            animate(run.world, target, labels=run.labels, title=title, progress=progress, fps=FPS)


def _draw_diagram(
    run: FilmedRun,
    model: Definitions,
    target: Path,
    title: str,
    world: WorldRecord | None,
    progress: Callable[[int, int], object] | None,
) -> None:
    """Write the film of a diagram, above or beside the world if there is one."""
    from fame.scenario.film_diagram import DiagramFilm
    from sim2d.animation import frame_times, usual_speed, world_frames, write_film

    times = frame_times(max(run.end, 1.0), usual_speed(run.end) / FPS)  # a run that is stuck at once is seen, too
    colours = _colours(run)
    if world is None:
        diagram = DiagramFilm(model, colours, WIDTH, 2 * HEIGHT)
        frames = diagram.frames(run.events, times)
    else:
        beside = _is_tall(model)
        diagram = DiagramFilm(model, colours, *((WIDTH // 2, 2 * HEIGHT) if beside else (WIDTH, HEIGHT)))
        room = (WIDTH // 2 - 32, 2 * HEIGHT) if beside else (WIDTH - 32, HEIGHT)
        shown = world_frames(world, times, labels=run.labels, title=title, room=room)
        frames = _joined(diagram.frames(run.events, times), shown, beside=beside)
    write_film(frames, target, len(times), FPS, progress)


def _colours(run: FilmedRun) -> Mapping[str, str]:
    """The colour of each robot, as the world and its captions have them: bodies first, then computers."""
    from sim2d.style import robot_colour

    bodies = [track.name for track in run.world.tracks] if run.world is not None else []
    names = dict.fromkeys([*bodies, *(robot for _, robot, _ in run.labels), *(event.robot for event in run.events)])
    return {name: robot_colour(index) for index, name in enumerate(names)}


def _is_tall(model: Definitions) -> bool:
    """Whether a diagram is higher than wide: then the world is beside it."""
    boxes = [shape.bounds for shape in model.shapes]
    width = max(box.x + box.width for box in boxes) - min(box.x for box in boxes)
    return max(box.y + box.height for box in boxes) - min(box.y for box in boxes) > 1.1 * width


def _joined(first: Iterator[Image], second: Iterator[Image], *, beside: bool) -> Iterator[Image]:
    """Images in pairs, beside or above each other, each in the middle; sides are even, as video codecs want them."""
    from PIL import Image

    for one, other in zip(first, second, strict=True):
        width, height = (
            (one.width + other.width, max(one.height, other.height))
            if beside
            else (max(one.width, other.width), one.height + other.height)
        )
        frame = Image.new("RGB", (width + width % 2, height + height % 2), "#ffffff")
        frame.paste(one, (0, (height - one.height) // 2) if beside else ((width - one.width) // 2, 0))
        place = (one.width, (height - other.height) // 2) if beside else ((width - other.width) // 2, one.height)
        frame.paste(other, place)
        yield frame
