"""A simulated world as `foxglove.SceneUpdate`, for recordings: Foxglove and Lichtblick show it as it is.

What stands still is on ``/fame/ground``, again whenever a weed was cut, a door moved or a parcel was moved; robots are
on ``/fame/world``, ten times a second while something moves. The metadata of each entity has what FAME's own view
draws: ``appearance`` of a robot, ``ground`` of the ground.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from fame.config.values import Point
from sim2d import style
from sim2d.ground import ChargerConfig, Circle, Polygon, Shape, Thing, Weed, WeedConfig, disc
from sim2d.record import Record, Things, Track
from sim2d.robot import Appearance, Cone, Pose, SimulatedRobot, Workpiece
from sim2d.warehouse import DoorConfig, ParcelConfig, StationConfig

if TYPE_CHECKING:
    from sim2d.config import WorldConfig
    from sim2d.world import World

Put = Callable[..., object]
"""Takes a topic, a time (ns), the function that makes the message (JSON), always the same one for a topic, and its
arguments, which are plain data: it may be called in another process."""

_RATE = 10.0
_FRAME = "world"
_LINE_LOOP = 1
_encode = json.JSONEncoder(ensure_ascii=False, separators=(",", ":")).encode
_string: Callable[[str], str] = json.encoder.encode_basestring


class SceneRecorder:
    """Samples a world ten times a second (as near as its step allows), from its start to its stop.

    Robots are sampled while they are `wanted`.
    """

    def __init__(self, world: World, put: Put, wanted: Callable[[], bool] = lambda: True) -> None:
        self._put, self._wanted = put, wanted
        self._every = max(1, math.floor(1 / (_RATE * world.step) + 0.5))
        robots = [Shown.of(robot, number) for number, robot in enumerate(world.robots.values())]
        self._scene, self._ground = SceneText(robots).scene, GroundText.of(world).scene
        self._last: list[_Look] = []
        self._state: _GroundState | None = None
        world.watchers.append(self._watch)

    def _watch(self, world: World) -> None:
        if world.steps % self._every:
            return
        state = _ground_state(world)
        if state != self._state:
            self._state = state
            self._put("/fame/ground", world.scheduler.now, self._ground, world.now, state)
        if not self._wanted():
            self._last = []
            return
        looks = [_plain(robot.appearance) for robot in world.robots.values()]
        if looks != self._last:
            self._last = looks
            self._put("/fame/world", world.scheduler.now, self._scene, world.now, looks)


_Look = tuple[Any, ...]
"""The fields of an `Appearance` as plain tuples and lists."""
_GroundState = tuple[
    Sequence[tuple[float | None, str | None]], Sequence[float], Sequence[tuple[tuple[float, float], str]]
]
"""The changeable part of the ground: the time of the cut (s) and the robot that cut it, or None and None, of each weed;
the opening of each door, 0 to 1; the position (m) of each parcel, and the robot that carries it, or ""."""


def _plain(look: Appearance) -> _Look:
    pose, altitude, led, cone, *others, limb, jaws, workpieces, note = look
    return (
        (*pose,),
        altitude,
        led,
        cone and ((*cone.pose,), *cone[1:]),
        *others,
        limb and _plain_points(limb),
        jaws,
        workpieces and [(kind, _plain_points(corners), closed) for kind, corners, closed in workpieces],
        note,
    )


def _plain_points(points: Iterable[Point]) -> list[Point]:
    return [(x, y) for x, y in points]


def _ground_state(world: World) -> _GroundState:
    weeds = [(weed.cut_at, weed.cut_by) for weed in world.weeds.all]
    doors = [round(door.opening, 2) for door in world.doors]
    return weeds, doors, [((*parcel.at,), parcel.carrier) for parcel in world.parcels.all]


@dataclass(frozen=True, slots=True)
class Shown:
    """The constant part of a robot's drawing as JSON: its name, outline and label; `look` are members of each look."""

    name: str
    look: str
    line: str
    label: str

    @classmethod
    def of(cls, robot: SimulatedRobot, number: int) -> Shown:
        """The drawing of a robot, the `number`-th of its world."""
        look = {"type": robot.type, "outline": _rounded(robot.outline)}
        return cls(_string(robot.name), _encode(look)[1:-1], *_outline(robot, number))


class SceneText:
    """Makes the messages of robots, as they looked at one time."""

    def __init__(self, robots: Sequence[Shown]) -> None:
        self._robots = robots

    def scene(self, now: float, looks: Sequence[_Look]) -> str:
        """The message of a time (s)."""
        time, pairs = _time(now), zip(self._robots, looks, strict=True)
        entities = ",".join([self._entity(robot, look, time) for robot, look in pairs])
        return f'{{"deletions":[],"entities":[{entities}]}}'

    def _entity(self, robot: Shown, look: _Look, now: str) -> str:
        """One robot: its outline, its name above it, and its appearance."""
        (x, y, heading), altitude = look[:2]
        half = heading / 2
        pose = (
            f'{{"position":{{"x":{x:.4f},"y":{y:.4f},"z":{altitude:.3f}}},'
            f'"orientation":{{"x":0,"y":0,"z":{math.sin(half):.5f},"w":{math.cos(half):.5f}}}}}'
        )
        text = _string(f"{{{robot.look},{_encode(_data(look))[1:]}")
        return (
            f'{{"timestamp":{now},"frame_id":"{_FRAME}","id":{robot.name},"lifetime":{{"sec":0,"nsec":0}},'
            f'"frame_locked":false,"metadata":[{{"key":"appearance","value":{text}}}],'
            f'"arrows":[],"cubes":[],"spheres":[],"cylinders":[],"lines":[{robot.line % pose}],"triangles":[],'
            f'"texts":[{robot.label % pose}],"models":[]}}'
        )


def _data(look: _Look) -> dict[str, Any]:
    """A look as plain data (m, rad), without default values."""
    (x, y, heading), altitude, led, cone, footprint, blade, cargo, charge, limb, jaws, workpieces, note = look
    data: dict[str, Any] = {"x": round(x, 4), "y": round(y, 4), "heading": round(heading, 4)}
    if altitude:
        data["altitude"] = round(altitude, 3)
    if led != "off":
        data["led"] = led
    if cone is not None:
        place, angle, length = cone
        place = [round(value, 4) for value in place]
        data["cone"] = {"pose": place, "angle": round(angle, 4), "length": round(length, 3)}
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


def read_record(
    config: WorldConfig,
    samples: Iterable[tuple[float, bytes]],
    grounds: Iterable[tuple[float, bytes]],
    summary: Mapping[str, Any],
) -> Record:
    """The record of a run that drawings need, from its recording.

    `samples` are seconds and scenes of robots, `grounds` those of the ground, `summary` is that of the world.
    """
    changes = [(second, _ground(scene)) for second, scene in grounds]
    ground = changes[-1][1] if changes else {"weeds": []}
    things: list[Things] = []
    times: list[float] = []
    tracks: dict[str, Track] = {}
    for second, scene in samples:
        entities = json.loads(scene)["entities"]
        times.append(second)
        while len(changes) > 1 and changes[1][0] <= second:
            del changes[0]
        things.append(_things(changes[0][1] if changes else {}))
        for entity in entities:
            look = json.loads(entity["metadata"][0]["value"])
            if entity["id"] not in tracks:
                tracks[entity["id"]] = Track(entity["id"], look["type"], tuple(_points(look["outline"])))
            seen = _appearance(look)
            tracks[entity["id"]].poses.append(seen.pose)
            tracks[entity["id"]].appearances.append(seen)
    weeds = [Weed(weed["name"], tuple(weed["at"]), weed["radius"], weed["cut"], weed["by"]) for weed in ground["weeds"]]
    from sim2d.world import Collision

    collisions = [Collision(each["time"], each["a"], each["b"]) for each in summary.get("collisions", ())]
    return Record(config, times, list(tracks.values()), collisions, weeds, things)


def _ground(scene: bytes) -> dict[str, Any]:
    """The data of a scene of the ground (`ground_data`)."""
    data: dict[str, Any] = json.loads(json.loads(scene)["entities"][0]["metadata"][0]["value"])
    return data


def _things(ground: Mapping[str, Any]) -> Things:
    doors = tuple(door["opening"] for door in ground.get("doors", ()))
    parcels = ground.get("parcels", ())
    return Things(doors, tuple(None if each["carrier"] else (each["at"][0], each["at"][1]) for each in parcels))


def _appearance(look: Mapping[str, Any]) -> Appearance:
    """The look that `_data` and the constant part describe."""
    cone = look.get("cone")
    return Appearance(
        Pose(look["x"], look["y"], look["heading"]),
        altitude=look.get("altitude", 0.0),
        led=look.get("led", "off"),
        cone=Cone(Pose(*cone["pose"]), cone["angle"], cone["length"]) if cone is not None else None,
        footprint=look.get("footprint", 0.0),
        blade=look.get("blade", 0.0),
        cargo=look.get("cargo", False),
        charge=look.get("charge", 1.0),
        limb=_points(look.get("limb", ())),
        jaws=look.get("jaws", -1.0),
        workpieces=[
            Workpiece(piece["kind"], _points(piece["corners"]), piece["closed"]) for piece in look.get("workpieces", ())
        ],
        note=look.get("note", ""),
    )


def _points(points: Iterable[Sequence[float]]) -> list[Point]:
    return [(x, y) for x, y in points]


@dataclass(frozen=True, slots=True)
class GroundText:
    """Makes the messages of the ground. It has what does not change of it."""

    bounds: tuple[float, float, float, float]
    walls: bool
    obstacles: Sequence[Thing]
    targets: Sequence[Thing]
    chargers: Sequence[ChargerConfig]
    stations: Sequence[StationConfig]
    weeds: Sequence[WeedConfig]
    doors: Sequence[DoorConfig]
    parcels: Sequence[ParcelConfig]

    @classmethod
    def of(cls, world: World) -> GroundText:
        """Of a world."""
        config = world.config
        return cls(**{each.name: getattr(config, each.name) for each in dataclasses.fields(cls)})

    def scene(self, now: float, state: _GroundState) -> str:
        """The ground at a time (s), as a SceneUpdate with one entity."""
        weeds, doors, parcels = state
        low_x, low_y, high_x, high_y = self.bounds
        solid = [(thing.shape, style.OBSTACLE, 0.3) for thing in self.obstacles]
        solid += [(thing.shape, style.TARGET, 0.3) for thing in self.targets]
        solid += [
            (Circle(weed.at, weed.radius), style.WEED if cut_at is None else style.STUBBLE, 0.01)
            for weed, (cut_at, _) in zip(self.weeds, weeds, strict=True)
        ]
        solid += [(Circle(one.at, one.radius), style.LINES, 0.005) for one in self.chargers]
        solid += [(Circle(one.at, one.radius), style.LINES, 0.005) for one in self.stations]
        solid += [
            (Polygon(tuple(style.parcel(at))), style.PARCEL, style.PARCEL_SIZE)
            for at, carrier in parcels
            if not carrier
        ]
        edge = [(low_x, low_y), (high_x, low_y), (high_x, high_y), (low_x, high_y)]
        leaves = [
            leaf
            for door, opening in zip(self.doors, doors, strict=True)
            for leaf in style.door_leaves(door.start, door.end, opening)
        ]
        entity = {
            **_empty_entity("ground", now),
            "metadata": [{"key": "ground", "value": _encode(self._data(state))}],
            "lines": [_line(edge, style.LINES, 0.02), *(_line(leaf, style.DOOR, 0.1) for leaf in leaves)],
            "triangles": [_prism(shape, colour, height) for shape, colour, height in solid],
        }
        return _encode({"deletions": [], "entities": [entity]})

    def _data(self, state: _GroundState) -> dict[str, Any]:
        """The objects on the ground, as plain data: m."""
        weeds, doors, parcels = state
        warehouse: dict[str, Any] = {}
        if self.stations:
            warehouse["stations"] = [_flat(one) for one in self.stations]
        if self.doors:
            warehouse["doors"] = [
                {"name": one.name, "from": list(one.start), "to": list(one.end), "opening": opening}
                for one, opening in zip(self.doors, doors, strict=True)
            ]
        if self.parcels:
            warehouse["parcels"] = [
                {"name": parcel.name, "at": _rounded([at])[0], "carrier": carrier}
                for parcel, (at, carrier) in zip(self.parcels, parcels, strict=True)
            ]
        return {
            "bounds": list(self.bounds),
            "walls": self.walls,
            "obstacles": [{"name": thing.name, **_shape(thing.shape)} for thing in self.obstacles],
            "targets": [{"name": thing.name, **_shape(thing.shape)} for thing in self.targets],
            "chargers": [_flat(charger) for charger in self.chargers],
            "weeds": [
                {"name": weed.name, "at": list(weed.at), "radius": weed.radius, "cut": cut_at, "by": by}
                for weed, (cut_at, by) in zip(self.weeds, weeds, strict=True)
            ],
            **warehouse,
        }


def _flat(place: ChargerConfig | StationConfig) -> dict[str, Any]:
    return {"name": place.name, "at": list(place.at), "radius": place.radius}


def _empty_entity(name: str, now: float) -> dict[str, Any]:
    kinds = ("metadata", "arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
    return {
        "timestamp": json.loads(_time(now)),
        "frame_id": _FRAME,
        "id": name,
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": False,
        **{kind: [] for kind in kinds},
    }


def _outline(robot: SimulatedRobot, number: int) -> tuple[str, str]:
    """JSON of a robot's outline and name, each with a place for its pose."""
    colour = style.robot_colour(number)
    line = _line(robot.outline, colour, 0.03)
    text = {
        "pose": "%s",
        "billboard": True,
        "font_size": 14,
        "scale_invariant": True,
        "color": _colour(colour),
        "text": robot.name,
    }
    return tuple(
        _encode({**part, "pose": 0}).replace("%", "%%").replace('"pose":0', '"pose":%s') for part in (line, text)
    )  # type: ignore[return-value]


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


def _prism(shape: Shape, colour: str, height: float) -> dict[str, Any]:
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


def _shape(shape: Shape) -> dict[str, Any]:
    if isinstance(shape, Circle):
        return {"at": list(shape.centre), "radius": shape.radius}
    return {"corners": _rounded(shape.corners)}


def _rounded(points: Iterable[Point]) -> list[list[float]]:
    return [[round(x, 4), round(y, 4)] for x, y in points]


def _time(seconds: float) -> str:
    whole = math.floor(seconds)
    return f'{{"sec":{whole},"nsec":{round((seconds - whole) * 1e9)}}}'
