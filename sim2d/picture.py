"""Draws a run as one picture: the ground, the things on it, and the trail of each robot."""

from __future__ import annotations

import math
import warnings
from os import PathLike
from typing import TYPE_CHECKING, Any

from fame.imports import require
from sim2d import style
from sim2d.ground import Circle, Shape, Thing, Weed, bounding_box, disc, placed
from sim2d.record import Record, Track
from sim2d.robot import Cone
from sim2d.style import (
    CHARGER,
    FAINT,
    GROUND,
    INK,
    LEDS,
    LINES,
    MOST_NAMES,
    OBSTACLE,
    OBSTACLE_EDGE,
    PAPER,
    STUBBLE,
    TARGET,
    TARGET_EDGE,
    WEED,
    WEED_EDGE,
    name_goes_above,
    paint,
    robot_colour,
    writing,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PARCEL = {"facecolor": style.PARCEL, "edgecolor": style.PARCEL_EDGE, "linewidth": 1.0}
_LONGEST = 9.0
"""Length of the longer side of the ground in the picture, inches."""


def picture(record: Record, path: str | PathLike[str], *, title: str = "") -> None:
    """Write a PNG of a run. Raises UnavailableError without matplotlib, ConfigError if it cannot be written."""
    require("matplotlib")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    xmin, ymin, xmax, ymax = record.config.bounds
    scale = _LONGEST / max(xmax - xmin, ymax - ymin)
    size = max((xmax - xmin) * scale, 3.0) + 2.6, max((ymax - ymin) * scale, 2.5) + 1.2
    figure = Figure(figsize=size, facecolor=PAPER)
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    _ground(axes, record, title)
    for thing in record.config.obstacles:
        axes.add_patch(_patch(thing.shape, facecolor=OBSTACLE, edgecolor=OBSTACLE_EDGE, linewidth=1.2, zorder=2))
    for thing in record.config.targets:
        _target(axes, thing, record)
    for charger in record.config.chargers:
        ring = Circle(charger.at, charger.radius)
        axes.add_patch(_patch(ring, fill=False, edgecolor=CHARGER, linewidth=1.6, zorder=2))
        _label(axes, (charger.at[0], charger.at[1] - charger.radius), charger.name, CHARGER, above=False, size=8)
    _warehouse(axes, record)
    for weed in record.weeds:
        _weed(axes, weed, record)
    for index, track in enumerate(record.tracks):
        if track.poses:
            _track(axes, track, robot_colour(index), record)
            if len(record.tracks) <= MOST_NAMES:
                _name(axes, track, record, robot_colour(index))
    _legend(axes, record)
    with writing(path), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing")  # matplotlib draws a box instead
        figure.savefig(path, dpi=130, bbox_inches="tight", pad_inches=0.15)


def _warehouse(axes: Axes, record: Record) -> None:
    """Draw stations, doors, and the parcels that lie on the ground."""
    for station in record.config.stations:
        (x, y), r = station.at, station.radius
        corners = ((x - r, y - r), (x + r, y - r), (x + r, y + r), (x - r, y + r))
        axes.add_patch(_polygon(corners, fill=False, edgecolor=style.STATION, linewidth=1.6, zorder=2))
        _label(axes, (x, y + r), station.name, style.STATION, above=True, size=8)
    if not record.things:
        return
    doors, parcels = record.things[-1]
    for door, opening in zip(record.config.doors, doors, strict=True):
        for start, end in style.door_leaves(door.start, door.end, opening):
            axes.plot(*zip(start, end, strict=True), color=style.DOOR, linewidth=4.0, zorder=3)
    for parcel in parcels:
        if parcel is not None:
            box = style.parcel(parcel)
            axes.add_patch(
                _polygon(box, facecolor=style.PARCEL, edgecolor=style.PARCEL_EDGE, linewidth=1.0, zorder=4.6)
            )


def _ground(axes: Axes, record: Record, title: str) -> None:
    xmin, ymin, xmax, ymax = record.config.bounds
    rim = 0.015 * max(xmax - xmin, ymax - ymin)
    axes.set(
        xlim=(xmin - rim, xmax + rim), ylim=(ymin - rim, ymax + rim), aspect="equal", xlabel="x  [m]", ylabel="y  [m]"
    )
    outline = ((xmin, ymin), (xmax, ymin), (xmax, ymax), (xmin, ymax))
    axes.add_patch(_polygon(outline, facecolor=GROUND, linewidth=0, zorder=0))
    edge = {"edgecolor": INK, "linewidth": 2.0} if record.config.walls else {"edgecolor": LINES, "linewidth": 1.0}
    axes.add_patch(_polygon(outline, fill=False, joinstyle="miter", zorder=3.5, **edge))
    axes.hlines([y for y in axes.get_yticks() if ymin < y < ymax], xmin, xmax, color=LINES, linewidth=0.8, zorder=0.5)
    axes.vlines([x for x in axes.get_xticks() if xmin < x < xmax], ymin, ymax, color=LINES, linewidth=0.8, zorder=0.5)
    axes.tick_params(colors=FAINT, labelsize=8, length=0)
    axes.xaxis.label.set_color(FAINT)
    axes.yaxis.label.set_color(FAINT)
    for spine in axes.spines.values():
        spine.set_visible(False)
    time = f"{record.times[-1]:.1f} s of simulated time" if record.times else ""
    axes.set_title(title, loc="left", color=INK, fontsize=13, fontweight="bold", pad=10, parse_math=False)
    axes.set_title(time, loc="right", color=FAINT, fontsize=10, pad=10)


def _target(axes: Axes, target: Thing, record: Record) -> None:
    shape = target.shape
    axes.add_patch(_patch(shape, facecolor=TARGET, edgecolor=TARGET_EDGE, linewidth=1.4, zorder=3))
    axes.plot(*shape.centre, marker="+", color=TARGET_EDGE, markersize=7, markeredgewidth=1.4, zorder=3.1)
    last = [track.poses[-1] for track in record.tracks if track.poses]
    above = name_goes_above(shape.centre, last, near=1.0, top=-math.inf)
    _label(axes, (shape.centre[0], bounding_box(shape)[3 if above else 1]), target.name, TARGET_EDGE, above=above)


def _weed(axes: Axes, weed: Weed, record: Record) -> None:
    """Draw a weed: green, or, if it was cut, pale with the time and the colour of the robot."""
    cutter = record.cutter(weed)
    grown, edge = weed.cut_at is None, WEED_EDGE if cutter is None else robot_colour(cutter)
    radius = max(weed.radius, 0.012 * _longer(record))
    corners = style.weed(weed.at, radius)
    axes.add_patch(_polygon(corners, facecolor=WEED if grown else STUBBLE, edgecolor=edge, linewidth=1.2, zorder=4.5))
    if len(record.weeds) <= MOST_NAMES:
        text = weed.name if grown else f"{weed.name}, {weed.cut_at:.0f} s"
        _label(axes, (weed.at[0], weed.at[1] - radius), text, edge, above=False, size=8)


def _track(axes: Axes, track: Track, colour: str, record: Record) -> None:
    xs, ys = [pose.x for pose in track.poses], [pose.y for pose in track.poses]
    axes.plot(xs, ys, color=colour, linewidth=1.8, alpha=0.75, solid_capstyle="round", zorder=4)
    axes.plot(
        xs[0], ys[0], "o", markersize=9, markerfacecolor=PAPER, markeredgecolor=colour, markeredgewidth=2, zorder=5
    )
    appearance = track.appearances[-1]
    pose, growth = appearance.pose, _growth(track, record)
    if appearance.cone is not None:
        _cone(axes, appearance.cone, colour)
    if appearance.footprint:
        axes.add_patch(_polygon(disc(pose[:2], appearance.footprint), facecolor=colour, alpha=0.10, zorder=1.5))
    if appearance.blade:
        ring = disc(pose[:2], appearance.blade * growth * 1.25)
        axes.add_patch(_polygon(ring, facecolor=FAINT, edgecolor=INK, alpha=0.6, zorder=5.8))
    for part in style.symbol(track.type, track.outline, appearance):
        fill, edge = paint(part.colour, colour)
        corners = placed(style.larger(part.corners, growth), pose)
        if part.closed:
            lines = {"edgecolor": edge, "linewidth": 1.0} if edge is not None else {"linewidth": 0}
            axes.add_patch(_polygon(corners, facecolor=fill, joinstyle="round", zorder=6, **lines))
        else:
            axes.plot(*zip(*corners, strict=True), color=fill, linewidth=2.0, zorder=6)
    if appearance.cargo:
        box = placed(style.larger(style.parcel((0.0, 0.0)), growth), pose)
        axes.add_patch(_polygon(box, **_PARCEL, zorder=6.5))
    ahead = max(x for x, _ in track.outline) * growth
    if appearance.led in LEDS:
        _light(axes, placed(((-ahead * 0.4, 0),), pose)[0], ahead, LEDS[appearance.led])


def _longer(record: Record) -> float:
    """The longer side of the ground, m."""
    xmin, ymin, xmax, ymax = record.config.bounds
    return max(xmax - xmin, ymax - ymin)


def _growth(track: Track, record: Record) -> float:
    """The factor by which a robot is enlarged to be visible on a large ground."""
    return max(1.0, 0.033 * _longer(record) / (2 * max(x for x, _ in track.outline)))


def _cone(axes: Axes, cone: Cone, colour: str) -> None:
    from matplotlib.patches import Wedge

    middle, half = math.degrees(cone.pose.heading), math.degrees(cone.field_of_view) / 2
    place = (cone.pose.x, cone.pose.y)
    wedge = Wedge(place, cone.length, middle - half, middle + half, facecolor=colour, alpha=0.10, linewidth=0)
    wedge.set_zorder(1.5)
    axes.add_patch(wedge)


def _name(axes: Axes, track: Track, record: Record, colour: str) -> None:
    """Write the name of a robot on the side without another robot or target."""
    pose, altitude = track.poses[-1], track.appearances[-1].altitude
    others = [other.poses[-1][:2] for other in record.tracks if other is not track]
    others += [target.shape.centre for target in record.config.targets]
    above = name_goes_above(pose, others, near=0.08 * _longer(record), top=record.config.bounds[3])
    heights = [y for _, y in placed(style.larger(track.outline, _growth(track, record)), pose)]
    text = f"{track.name}  {altitude:.1f} m" if altitude >= 0.05 else track.name
    text += "" if track.appearances[-1].charge else "  (battery empty)"
    _label(axes, (pose.x, max(heights) if above else min(heights)), text, colour, above=above)


def _light(axes: Axes, place: tuple[float, float], size: float, colour: str) -> None:
    from matplotlib.patches import Circle as Disc

    for radius, alpha in ((1.5, 0.18), (0.9, 0.3)):
        axes.add_patch(Disc(place, size * radius, facecolor=colour, alpha=alpha, linewidth=0, zorder=5.5))
    axes.add_patch(Disc(place, size * 0.38, facecolor=colour, edgecolor=PAPER, linewidth=1.0, zorder=6.2))


def _label(axes: Axes, place: tuple[float, float], text: str, colour: str, *, above: bool, size: int = 10) -> None:
    from matplotlib.patheffects import withStroke

    axes.annotate(
        text, place, xytext=(0, 6 if above else -6), textcoords="offset points", ha="center",
        va="bottom" if above else "top", color=colour, fontsize=size, fontweight="bold", zorder=7,
        path_effects=[withStroke(linewidth=3, foreground=PAPER)], annotation_clip=False, parse_math=False,
    )  # fmt: skip


def _legend(axes: Axes, record: Record) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = []
    for index, track in enumerate(record.tracks[:20]):
        led = f", LED {track.appearances[-1].led}" if track.appearances and track.appearances[-1].led in LEDS else ""
        handles.append(
            Line2D([], [], color=robot_colour(index), linewidth=2.5, label=f"{track.name} ({track.type}{led})")
        )
    if record.tracks:
        ring: dict[str, Any] = {
            "marker": "o",
            "markersize": 8,
            "markerfacecolor": PAPER,
            "markeredgecolor": FAINT,
            "markeredgewidth": 2,
        }
        handles.append(Line2D([], [], linewidth=0, label="start", **ring))
    if record.config.parcels:
        handles.append(Patch(facecolor=style.PARCEL, edgecolor=style.PARCEL_EDGE, label="parcel"))
    if record.config.doors:
        handles.append(Line2D([], [], color=style.DOOR, linewidth=4.0, label="door"))
    if any(weed.cut_at is None for weed in record.weeds):
        handles.append(Patch(facecolor=WEED, edgecolor=WEED_EDGE, label="weed"))
    if any(weed.cut_at is not None for weed in record.weeds):
        handles.append(Patch(facecolor=STUBBLE, edgecolor=FAINT, label="weed, cut"))
    if record.config.targets:
        handles.append(Patch(facecolor=TARGET, edgecolor=TARGET_EDGE, label="target (not in the map)"))
    if record.config.obstacles:
        handles.append(Patch(facecolor=OBSTACLE, edgecolor=OBSTACLE_EDGE, label="obstacle (in the map)"))
    if handles:
        axes.legend(
            handles=handles, loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, labelcolor=INK, fontsize=9
        )


def _patch(shape: Shape, **style: Any) -> Any:
    from matplotlib.patches import Circle as Disc

    return Disc(shape.centre, shape.radius, **style) if isinstance(shape, Circle) else _polygon(shape.corners, **style)


def _polygon(corners: Any, **style: Any) -> Any:
    from matplotlib.patches import Polygon

    return Polygon(corners, closed=True, **style)
