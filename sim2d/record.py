"""A recorded run as drawings need it: robots, doors and parcels by time, and the ground at its end.

It is made of the scenes of a recording (`sim2d.scene`), which `WorldRecorder` takes from a world without one.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from fame.clock import SECOND
from fame.config.values import Point
from fame.dataclasses import dataclass, field
from fame.log.recording import scene_values
from sim2d.config import WorldConfig
from sim2d.ground import ChargerConfig, Circle, Polygon, Thing, Weed
from sim2d.robot import Appearance, Cone, Pose, Workpiece
from sim2d.scene import SceneRecorder
from sim2d.warehouse import DoorConfig, StationConfig

if TYPE_CHECKING:
    from sim2d.world import World


@dataclass(frozen=True, slots=True)
class Track:
    """One robot during a run, with one entry per sample. `outline` has its corners in its own frame, m."""

    name: str
    type: str
    outline: tuple[Point, ...]
    poses: list[Pose] = field(default_factory=list)
    appearances: list[Appearance] = field(default_factory=list)


class Things(NamedTuple):
    """At a sample: how far each door is open (0 to 1), and where each parcel lies (None: a robot carries it)."""

    doors: tuple[float, ...]
    parcels: tuple[Point | None, ...]


@dataclass(frozen=True, slots=True)
class WorldRecord:
    """A run in the world: its configuration, sample times (s), a track for each robot, and the weeds at the end."""

    config: WorldConfig
    times: list[float]
    tracks: list[Track]
    weeds: list[Weed]
    things: list[Things]

    def cutter(self, weed: Weed) -> int | None:
        """Return the index of the robot that cut a weed, or None."""
        names = [track.name for track in self.tracks]
        return names.index(weed.cut_by) if weed.cut_by in names else None


class WorldRecorder:
    """Keeps the scenes of a world from its start to its stop."""

    def __init__(self, world: World) -> None:
        self._scenes: list[tuple[int, str, Mapping[str, Any]]] = []
        self._world = world
        SceneRecorder(world, self._put)

    def _put(self, topic: str, time: int, scene: Mapping[str, Any]) -> None:
        self._scenes += [(time, *each) for each in scene_values(scene)]

    @property
    def record(self) -> WorldRecord:
        """The run until now."""
        return read_record(self._scenes, self._world.scheduler.now)


def read_record(scenes: Iterable[tuple[int, str, Mapping[str, Any]]], end: int) -> WorldRecord:
    """Return the record of a run until `end` (ns), from its scenes: ns, id of an entity, value
    that FAME's own view draws.

    Raises LookupError, TypeError or ValueError for values of another form.
    """
    times: list[float] = []
    things: list[Things] = []
    looks: dict[str, Mapping[str, Any]] = {}
    tracks: dict[str, Track] = {}
    ground: Mapping[str, Any] = {"bounds": (0, 0, 1, 1), "walls": False}

    def sample(second: float) -> None:
        times.append(second)
        things.append(_things(ground))
        for name, look in looks.items():
            if name not in tracks:
                tracks[name] = Track(name, look["type"], tuple(_points(look["outline"])))
            seen = _appearance(look)
            tracks[name].poses.append(seen.pose)
            tracks[name].appearances.append(seen)

    now = 0
    for time, name, value in scenes:
        if looks and time > now:
            sample(now / SECOND)
        now = time
        if name == "ground":
            ground = value
        else:
            looks[name] = value
    if looks:
        sample(now / SECOND)
        if end > now:
            sample(end / SECOND)
    weeds = [
        Weed(weed["name"], tuple(weed["at"]), weed["radius"], weed["cut"], weed["by"])
        for weed in ground.get("weeds", ())
    ]
    return WorldRecord(_config(ground), times, list(tracks.values()), weeds, things)


def _config(ground: Mapping[str, Any]) -> WorldConfig:
    """What stands still on the ground."""
    return WorldConfig(
        tuple(ground["bounds"]),
        walls=ground["walls"],
        obstacles=tuple(_thing(each) for each in ground.get("obstacles", ())),
        targets=tuple(_thing(each) for each in ground.get("targets", ())),
        chargers=tuple(ChargerConfig(each["name"], each["at"], each["radius"]) for each in ground.get("chargers", ())),
        stations=tuple(StationConfig(each["name"], each["at"], each["radius"]) for each in ground.get("stations", ())),
        doors=tuple(DoorConfig(each["name"], each["from"], each["to"]) for each in ground.get("doors", ())),
    )


def _thing(data: Mapping[str, Any]) -> Thing:
    if "radius" in data:
        return Thing(data["name"], Circle(data["at"], data["radius"]))
    return Thing(data["name"], Polygon(tuple(_points(data["corners"]))))


def _things(ground: Mapping[str, Any]) -> Things:
    doors = tuple(door["opening"] for door in ground.get("doors", ()))
    parcels = ground.get("parcels", ())
    return Things(doors, tuple(None if each["carrier"] else (each["at"][0], each["at"][1]) for each in parcels))


def _appearance(look: Mapping[str, Any]) -> Appearance:
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


def __getattr__(name: str) -> Any:
    """The class that docs/world.md named `Recorder` until 0.2. Deprecated: it goes with the release after the next."""
    if name != "Recorder":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    warnings.warn("sim2d.record.Recorder is now sim2d.WorldRecorder", DeprecationWarning, stacklevel=2)
    return WorldRecorder
