"""A simulated world as `foxglove.SceneUpdate`, for recordings: Foxglove and Lichtblick show it as it is.

What stands still is on ``/fame/ground``, again whenever a weed was cut, a door moved or a parcel was moved; robots are
on ``/fame/world``, ten times a second while something moves. The metadata of each entity has what FAME's own view
draws: ``appearance`` of a robot, ``ground`` of the ground.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from fame.config.values import Point
from fame.fast_json import json_bytes, json_fragment
from sim2d import style
from sim2d.ground import ChargerConfig, Circle, Outline, Polygon, disc
from sim2d.robot import Appearance, SimulatedRobot, period
from sim2d.warehouse import StationConfig

if TYPE_CHECKING:
    from sim2d.config import WorldConfig
    from sim2d.world import World

PutScene = Callable[[str, int, Mapping[str, Any]], object]
"""Takes a topic, a time (ns) and a message."""

_RATE = 10.0
_FRAME = "world"
_LINE_LOOP = 1


def sampling(world: World) -> int:
    """After how many steps a world is sampled."""
    return period(_RATE, world.step)


class SceneRecorder:
    """Samples a world ten times a second (as near as its step allows), from its start to its stop.

    Robots are sampled while they are `wanted`.
    """

    def __init__(self, world: World, put: PutScene, wanted: Callable[[], bool] = lambda: True) -> None:
        self._put, self._wanted = put, wanted
        self._every = sampling(world)
        self._robots = [_Sampled(robot, number) for number, robot in enumerate(world.robots.values())]
        self._shows = False
        self._state: _GroundState | None = None
        world.watchers.append(self._watch)

    def _watch(self, world: World) -> None:
        if world.steps % self._every == 0:
            self.look(world)

    def show(self, world: World) -> None:
        """Record the robots, whether they move or not."""
        self._shows = False
        self.look(world)

    def look(self, world: World) -> None:
        """Record what is different since the last look."""
        state = _ground_state(world)
        if state != self._state:
            self._state = state
            self._put("/fame/ground", world.scheduler.now, _ground_scene(world.config, world.now, state))
        if not self._wanted():
            self._shows = False
            return
        different = [robot.is_different() for robot in self._robots]
        if any(different) or (different and not self._shows):
            self._shows, timestamp = True, _timestamp(world.now)
            entities = [{**robot.entity, "timestamp": timestamp} for robot in self._robots]
            self._put("/fame/world", world.scheduler.now, {"deletions": [], "entities": entities})


class _Sampled:
    """A robot at the last look, as `entity`: its outline, its name above it, and its appearance."""

    def __init__(self, robot: SimulatedRobot, number: int) -> None:
        self._robot = robot
        self._look: Mapping[str, Any] = {}
        self.entity: Mapping[str, Any] = _empty_entity(robot.name, 0.0)
        colour = style.robot_colour(number)
        text = {
            "billboard": True,
            "font_size": 14,
            "scale_invariant": True,
            "color": _colour(colour),
            "text": robot.name,
        }
        look = {"type": robot.type, "outline": _rounded(robot.outline)}
        self._constant, self._line, self._text = (
            {name: json_fragment(json_bytes(value)) for name, value in part.items()}
            for part in (look, _line(robot.outline, colour, 0.03), text)
        )

    def is_different(self) -> bool:
        """Look at it, and return whether it appears otherwise than at the last look."""
        look = _look_data(self._robot.appearance)
        if look == self._look:
            return False
        self._look, half = look, look["heading"] / 2
        pose = {
            "position": {"x": look["x"], "y": look["y"], "z": look.get("altitude", 0.0)},
            "orientation": {"x": 0, "y": 0, "z": round(math.sin(half), 5), "w": round(math.cos(half), 5)},
        }
        posed = {"pose": json_fragment(json_bytes(pose))}
        self.entity = {
            **self.entity,
            "metadata": [{"key": "appearance", "value": json_bytes({**self._constant, **look}).decode()}],
            "lines": [{**self._line, **posed}],
            "texts": [{**self._text, **posed}],
        }
        return True


_GroundState = tuple[
    Sequence[tuple[float | None, str | None]], Sequence[float], Sequence[tuple[tuple[float, float], str]]
]
"""The changeable part of the ground: the time of the cut (s) and the robot that cut it, or None and None, of each weed;
the opening of each door, 0 to 1; the position (m) of each parcel, and the robot that carries it, or ""."""


def _ground_state(world: World) -> _GroundState:
    weeds = [(weed.cut_at, weed.cut_by) for weed in world.weeds.all]
    doors = [round(door.opening, 2) for door in world.doors]
    return weeds, doors, [((*parcel.at,), parcel.carrier) for parcel in world.parcels.all]


def _look_data(look: Appearance) -> dict[str, Any]:
    """An appearance as plain data (m, rad), without default values."""
    (x, y, heading), altitude, led, cone, footprint, blade, cargo, charge, limb, jaws, workpieces, note = look
    data: dict[str, Any] = {"x": round(x, 4), "y": round(y, 4), "heading": round(heading, 4)}
    if altitude:
        data["altitude"] = round(altitude, 3)
    if led != "off":
        data["led"] = led
    if cone is not None:
        place, angle, length = cone
        data["cone"] = {
            "pose": [round(value, 4) for value in place],
            "angle": round(angle, 4),
            "length": round(length, 3),
        }
    for key, value, usual in (
        ("footprint", footprint, 0.0),
        ("blade", blade, 0.0),
        ("charge", charge, 1.0),
        ("jaws", jaws, -1.0),
    ):
        if value != usual:
            data[key] = round(value, 4)
    if cargo:
        data["cargo"] = True
    if limb:
        data["limb"] = _rounded(limb)
    if workpieces:
        data["workpieces"] = [
            {"kind": kind, "corners": _rounded(corners), "closed": closed} for kind, corners, closed in workpieces
        ]
    if note:
        data["note"] = note
    return data


def _ground_scene(config: WorldConfig, now: float, state: _GroundState) -> dict[str, Any]:
    """The ground at a time (s), as a SceneUpdate with one entity."""
    weeds, doors, parcels = state
    low_x, low_y, high_x, high_y = config.bounds
    solid = [(thing.shape, style.OBSTACLE, 0.3) for thing in config.obstacles]
    solid += [(thing.shape, style.TARGET, 0.3) for thing in config.targets]
    solid += [
        (Circle(weed.at, weed.radius), style.WEED if cut_at is None else style.STUBBLE, 0.01)
        for weed, (cut_at, _) in zip(config.weeds, weeds, strict=True)
    ]
    solid += [(Circle(one.at, one.radius), style.LINES, 0.005) for one in config.chargers]
    solid += [(Circle(one.at, one.radius), style.LINES, 0.005) for one in config.stations]
    solid += [
        (Polygon(tuple(style.parcel(at))), style.PARCEL, style.PARCEL_SIZE) for at, carrier in parcels if not carrier
    ]
    edge = [(low_x, low_y), (high_x, low_y), (high_x, high_y), (low_x, high_y)]
    leaves = [
        leaf
        for door, opening in zip(config.doors, doors, strict=True)
        for leaf in style.door_leaves(door.start, door.end, opening)
    ]
    entity = {
        **_empty_entity("ground", now),
        "metadata": [{"key": "ground", "value": json_bytes(_ground_data(config, state)).decode()}],
        "lines": [_line(edge, style.LINES, 0.02), *(_line(leaf, style.DOOR, 0.1) for leaf in leaves)],
        "triangles": [_prism(shape, colour, height) for shape, colour, height in solid],
    }
    return {"deletions": [], "entities": [entity]}


def _ground_data(config: WorldConfig, state: _GroundState) -> dict[str, Any]:
    """The objects on the ground, as plain data: m."""
    weeds, doors, parcels = state
    warehouse: dict[str, Any] = {}
    if config.stations:
        warehouse["stations"] = [_flat(one) for one in config.stations]
    if config.doors:
        warehouse["doors"] = [
            {"name": one.name, "from": list(one.start), "to": list(one.end), "opening": opening}
            for one, opening in zip(config.doors, doors, strict=True)
        ]
    if config.parcels:
        warehouse["parcels"] = [
            {"name": parcel.name, "at": _rounded([at])[0], "carrier": carrier}
            for parcel, (at, carrier) in zip(config.parcels, parcels, strict=True)
        ]
    return {
        "bounds": list(config.bounds),
        "walls": config.walls,
        "obstacles": [{"name": thing.name, **_shape(thing.shape)} for thing in config.obstacles],
        "targets": [{"name": thing.name, **_shape(thing.shape)} for thing in config.targets],
        "chargers": [_flat(charger) for charger in config.chargers],
        "weeds": [
            {"name": weed.name, "at": list(weed.at), "radius": weed.radius, "cut": cut_at, "by": by}
            for weed, (cut_at, by) in zip(config.weeds, weeds, strict=True)
        ],
        **warehouse,
    }


def _flat(place: ChargerConfig | StationConfig) -> dict[str, Any]:
    return {"name": place.name, "at": list(place.at), "radius": place.radius}


def _empty_entity(name: str, now: float) -> dict[str, Any]:
    kinds = ("metadata", "arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
    return {
        "timestamp": _timestamp(now),
        "frame_id": _FRAME,
        "id": name,
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": False,
        **{kind: [] for kind in kinds},
    }


def _timestamp(now: float) -> dict[str, int]:
    return {"sec": math.floor(now), "nsec": round((now - math.floor(now)) * 1e9)}


def _line(points: Iterable[Point], colour: str, thickness: float) -> dict[str, Any]:
    return {
        "type": _LINE_LOOP,
        "pose": _ORIGIN,
        "thickness": thickness,
        "scale_invariant": False,
        "points": [{"x": round(x, 4), "y": round(y, 4), "z": 0} for x, y in points],
        "color": _colour(colour),
        "colors": [],
        "indices": [],
    }


def _prism(shape: Outline, colour: str, height: float) -> dict[str, Any]:
    """The top of a solid as a fan of triangles."""
    corners = disc(shape.centre, shape.radius) if isinstance(shape, Circle) else list(shape.corners)
    fan = [index for number in range(1, len(corners) - 1) for index in (0, number, number + 1)]
    points = [{"x": round(x, 4), "y": round(y, 4), "z": height} for x, y in corners]
    return {"pose": _ORIGIN, "points": points, "color": _colour(colour), "colors": [], "indices": fan}


_ORIGIN: Mapping[str, Any] = {"position": {"x": 0, "y": 0, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}


def _colour(colour: str) -> dict[str, float]:
    """A colour ``#rrggbb``."""
    red, green, blue = (int(colour[place : place + 2], 16) / 255 for place in (1, 3, 5))
    return {"r": round(red, 3), "g": round(green, 3), "b": round(blue, 3), "a": 1}


def _shape(shape: Outline) -> dict[str, Any]:
    if isinstance(shape, Circle):
        return {"at": list(shape.centre), "radius": shape.radius}
    return {"corners": _rounded(shape.corners)}


def _rounded(points: Iterable[Point]) -> list[list[float]]:
    return [[round(float(x), 4), round(float(y), 4)] for x, y in points]
