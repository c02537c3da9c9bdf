"""Reads and checks world files: bounds, obstacles, flat things, robots. `docs/world.md` describes the file."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

from fame.config.loader import read_document
from fame.config.values import ConfigValue, Point, Source, fill
from fame.dataclasses import dataclass, field
from fame.errors import ConfigError
from sim2d.ground import ChargerConfig, Circle, Outline, Thing, WeedConfig, bounding_box, box, convex
from sim2d.robot import RobotConfig, robot_class, robot_types
from sim2d.warehouse import DoorConfig, ParcelConfig, StationConfig

_LEAST, _MOST = 0.01, 1000.0
"""Limits of the sides of the ground, m."""
_CELLS = 25_000_000
"""Maximum number of cells of a map: making one with a hundred million takes gigabytes."""

Extent = tuple[float, float, float, float]
"""xmin, ymin, xmax, ymax in m."""

KEYS = {
    "size": "the ground: `[width, height]` in m, from the origin",
    "bounds": "the ground, instead: `[xmin, ymin, xmax, ymax]` in m",
    "step": "one step of the physics, s: 0.0001 to 0.05 (0.01)",
    "walls": "whether solid walls surround the ground (true)",
    "resolution": "cell size of the robots' map, m: 0.01 to 1; at most 25 million cells (0.05)",
    "obstacles": "solid, and in the robots' map, each with the keys below",
    "targets": "solid, and not in the robots' map, with the keys of obstacles",
    "weeds": "flat: neither solid nor in the map; a blade cuts them",
    "chargers": "flat: charge the batteries of robots that stand on them",
    "stations": "flat: places of a warehouse",
    "parcels": "flat: what a carrier moves",
    "doors": "solid while they are closed, and not in the map",
    "robots": "the robots by name, which is also the namespace: `type`, `at`, `heading` and the parameters of the type",
}
"""Of a world file, with their meanings."""
OBSTACLE_KEYS = {
    "name": "of its own (`obstacle_1`, `target_1` ...)",
    "at": "the centre: `[x, y]` in m",
    "radius": "of a disc, m",
    "size": "of a box: `[width, height]` in m",
    "angle": "of a box, degrees (0)",
    "polygon": "instead: the corners of a convex polygon, in order around it: `[[x, y], ...]`",
}
"""Of an obstacle or a target."""
PARCEL_KEYS = {
    "name": "of its own (`parcel_1` ...)",
    "at": "a station, or `[x, y]` in m",
    "to": "the station where it is wanted: for the summary of a run, which says where it lies; without effect",
}
"""Of a parcel."""
DOOR_KEYS = {
    "name": "of its own, of ASCII letters, digits and _ (`door_1` ...)",
    "from": "one end: `[x, y]` in m",
    "to": "the other end",
    "time": "seconds in which it opens (1.5)",
    "open": "seconds after the last call until it closes, as soon as no robot stands in it (8)",
}
"""Of a door."""
WEED_KEYS = {
    "name": "of its own (`weed_1` ...)",
    "at": "`[x, y]` in m, anywhere on the ground",
    "radius": "m (0.1)",
}
"""Of a weed."""
CHARGER_KEYS = {
    "name": "of its own (`charger_1` ...)",
    "at": "`[x, y]` in m",
    "radius": "within which the centre of a robot must be, m (0.5)",
    "power": "W (500)",
    "heading": "in which robots dock with Nav2, degrees (0)",
}
"""Of a charger."""
STATION_KEYS = {
    "name": "of its own (`station_1` ...)",
    "at": "`[x, y]` in m",
    "radius": "within which a parcel lies at the station, m (0.6)",
}
"""Of a station."""
_SHAPES = {"radius": ("name", "at", "radius"), "size": ("name", "at", "size", "angle"), "polygon": ("name", "polygon")}
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


_Flat = TypeVar("_Flat", WeedConfig, ChargerConfig, StationConfig)


@dataclass(frozen=True, slots=True)
class WorldConfig:
    """The content of a world file. `step` in s; `resolution` of the robots' map in m per cell."""

    bounds: Extent
    robots: tuple[RobotConfig, ...] = ()
    obstacles: tuple[Thing, ...] = ()
    targets: tuple[Thing, ...] = ()
    weeds: tuple[WeedConfig, ...] = ()
    chargers: tuple[ChargerConfig, ...] = ()
    stations: tuple[StationConfig, ...] = ()
    parcels: tuple[ParcelConfig, ...] = ()
    doors: tuple[DoorConfig, ...] = ()
    step: float = 0.01
    walls: bool = True
    resolution: float = 0.05
    source: Source = field(default=Source(), compare=False, repr=False)


def read_world(path: str | PathLike[str]) -> WorldConfig:
    """Read a world from a YAML file. Raises ConfigError with file, line and key."""
    return world_config(read_document(path, "world"))


def world_config(world: ConfigValue | Mapping[str, Any]) -> WorldConfig:
    """Check a world given as a mapping. Raises ConfigError."""
    value = world if isinstance(world, ConfigValue) else ConfigValue(world)
    keys = value.mapping(KEYS)
    bounds = _bounds(value, keys)
    resolution = keys["resolution"].number(minimum=0.01, maximum=1) if "resolution" in keys else 0.05
    area = (bounds[2] - bounds[0]) * (bounds[3] - bounds[1])
    if area / resolution**2 > _CELLS:
        least = math.ceil(math.sqrt(area / _CELLS) * 100) / 100
        text = f"expected a resolution of at least {least:g}, got a map of {area / resolution**2:.0f} cells"
        raise keys.get("resolution", value).error(text)
    stations = tuple(_flat(keys.get("stations"), "station", StationConfig, STATION_KEYS, bounds))
    return WorldConfig(
        bounds,
        robots=_robots(keys["robots"], bounds) if "robots" in keys else (),
        obstacles=tuple(_things(keys.get("obstacles"), "obstacle", bounds)),
        targets=tuple(_things(keys.get("targets"), "target", bounds)),
        weeds=tuple(_flat(keys.get("weeds"), "weed", WeedConfig, WEED_KEYS, bounds)),
        chargers=tuple(_flat(keys.get("chargers"), "charger", ChargerConfig, CHARGER_KEYS, bounds)),
        stations=stations,
        parcels=tuple(_parcels(keys.get("parcels"), stations, bounds)),
        doors=tuple(_doors(keys.get("doors"), bounds)),
        step=keys["step"].number(minimum=0.0001, maximum=0.05) if "step" in keys else 0.01,
        walls=keys["walls"].boolean() if "walls" in keys else True,
        resolution=resolution,
        source=value.source,
    )


def _bounds(value: ConfigValue, keys: Mapping[str, ConfigValue]) -> Extent:
    if ("size" in keys) == ("bounds" in keys):
        got = "both" if "size" in keys else "neither"
        raise value.error(f"expected either size: [w, h] or bounds: [xmin, ymin, xmax, ymax], got {got}")
    if "size" in keys:
        width, height = keys["size"].numbers(2, "[width, height] in m")
        xmin, ymin, xmax, ymax = 0.0, 0.0, width, height
    else:
        xmin, ymin, xmax, ymax = keys["bounds"].numbers(4, "[xmin, ymin, xmax, ymax] in m")
    if not (_LEAST <= xmax - xmin <= _MOST and _LEAST <= ymax - ymin <= _MOST):
        raise (keys.get("size") or keys["bounds"]).expected(f"ground of {_LEAST:g} to {_MOST:g} m on each side")
    return xmin, ymin, xmax, ymax


def _named(
    listed: ConfigValue | None, kind: str, known: Iterable[str] | None = None
) -> Iterator[tuple[str, ConfigValue, Mapping[str, ConfigValue]]]:
    """Yield (name, value, its keys) of the things in a list. Each has a name of its own."""
    names: set[str] = set()
    for number, value in enumerate(listed.items() if listed else (), 1):
        keys = value.mapping(known)
        name = keys["name"].text() if "name" in keys else f"{kind}_{number}"
        if name in names:
            raise value.error(f"expected a name of its own, got a second {kind} named {name!r}")
        names.add(name)
        yield name, value, keys


def _things(listed: ConfigValue | None, kind: str, bounds: Extent) -> Iterator[Thing]:
    for name, value, _ in _named(listed, kind):
        shape = _shape(value)
        xmin, ymin, xmax, ymax = bounding_box(shape)
        if xmax <= bounds[0] or ymax <= bounds[1] or xmin >= bounds[2] or ymin >= bounds[3]:
            raise value.error(f"expected a place inside {list(bounds)}; {name} is outside")
        yield Thing(name, shape, value.path)


def _shape(value: ConfigValue) -> Outline:
    kinds = [key for key in _SHAPES if key in value.mapping()]
    if len(kinds) != 1:
        value.mapping(OBSTACLE_KEYS)  # a misspelt key
        raise value.error(f"expected one of radius, size and polygon, got {' and '.join(kinds) or 'none'}")
    kind, keys = kinds[0], value.mapping(_SHAPES[kinds[0]])
    if kind == "polygon":
        corners = [corner.point() for corner in keys["polygon"].items()]
        polygon = convex(corners)
        if polygon is None:
            raise keys["polygon"].error(
                "expected the corners of a convex polygon, at least three, in order around it "
                "(several obstacles together make any form)"
            )
        return polygon
    centre = value.required("at", "[x, y] in m").point()
    if kind == "radius":
        return Circle(centre, keys["radius"].number(above=0))
    width, height = keys["size"].numbers(2, "[width, height] in m")
    if width <= 0 or height <= 0:
        raise keys["size"].expected("a width and a height above 0")
    angle = keys["angle"].number() if "angle" in keys else 0.0
    return box(centre, width, height, math.radians(angle))


def _flat(
    listed: ConfigValue | None, kind: str, make: type[_Flat], known: Mapping[str, str], bounds: Extent
) -> Iterator[_Flat]:
    """Flat things: each with a name, a place, and positive numbers that have defaults."""
    for name, value, keys in _named(listed, kind, known):
        at = _place(value, bounds)
        numbers = {key: _flat_number(key, item) for key, item in keys.items() if key not in ("name", "at")}
        yield make(name, at, **numbers)


def _place(value: ConfigValue, bounds: Extent, key: str = "at") -> Point:
    """Return a place on the ground."""
    place = value.required(key, "[x, y] in m")
    return _on_ground(place, place.point(), bounds)


def _on_ground(value: ConfigValue, place: Point, bounds: Extent) -> Point:
    if not inside(bounds, place):
        raise value.expected(f"a place on the ground, inside {list(bounds)}")
    return place


def _flat_number(key: str, value: ConfigValue) -> float:
    return value.number() if key == "heading" else value.number(above=0)


def _parcels(listed: ConfigValue | None, stations: tuple[StationConfig, ...], bounds: Extent) -> Iterator[ParcelConfig]:
    """Parcels, which lie at a station or at a place."""
    places = {station.name: station.at for station in stations}
    for name, value, keys in _named(listed, "parcel", PARCEL_KEYS):
        at = value.required("at", "a station, or [x, y] in m")
        place = places[at.choice(places, "a station")] if isinstance(at.data, str) else at.point()
        to = keys["to"].choice(places, "a station") if "to" in keys else ""
        yield ParcelConfig(name, _on_ground(at, place, bounds), to)


def _doors(listed: ConfigValue | None, bounds: Extent) -> Iterator[DoorConfig]:
    for name, value, keys in _named(listed, "door", DOOR_KEYS):
        _check_name(name, value)
        start, end = (_place(value, bounds, key) for key in ("from", "to"))
        if start == end:
            raise keys["to"].expected("another place than the other end")
        times = {key: keys[key].number(above=0) for key in ("time", "open") if key in keys}
        yield DoorConfig(name, start, end, **times)


def _check_name(name: str, value: ConfigValue) -> None:
    """Raise ConfigError for a name that cannot be a namespace."""
    if not _NAME.fullmatch(name):
        raise value.error(f"expected a name of ASCII letters, digits and _ that begins with a letter, got {name!r}")


def inside(bounds: Extent, place: Point) -> bool:
    """Return whether a place is on the ground."""
    return bounds[0] <= place[0] <= bounds[2] and bounds[1] <= place[1] <= bounds[3]


def _robots(listed: ConfigValue, bounds: Extent) -> tuple[RobotConfig, ...]:
    robots: dict[str, RobotConfig] = {}
    for name, value in listed.mapping().items():
        _check_name(name, value)
        if name.casefold() in robots:
            raise value.error(
                f"expected names that differ in more than case, got {robots[name.casefold()].name!r} and {name!r}"
            )
        robots[name.casefold()] = _robot(name, value, bounds)
    return tuple(robots.values())


def _robot(name: str, value: ConfigValue, bounds: Extent) -> RobotConfig:
    keys = value.mapping()
    kind = value.required("type", f"one of {', '.join(robot_types())}")
    try:
        robot = robot_class(kind.text(), Path(value.source.file).parent)
    except ConfigError as error:
        raise error if error.file else kind.error(error.text) from None
    parameters: Any = fill(robot.Parameters(), value, besides=("type", "at", "heading"))
    at = _place(value, bounds)
    heading = keys["heading"].number() if "heading" in keys else 0.0
    return RobotConfig(name, kind.text(), robot, at, math.radians(heading), parameters, value.path)
