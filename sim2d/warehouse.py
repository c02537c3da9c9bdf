"""Stations, parcels and doors: things of the world that robots use, move, and ask to open.

Stations and parcels are flat: neither solid nor in the map. A parcel lies at a station or anywhere on the ground, or a
robot carries it. A door is solid while it is closed, and not in the map. It offers the service ``/<door>/open``
(std_srvs/srv/Trigger), which answers when the door is open. A door closes by itself when it has been open for a while
and no robot stands in it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND, Entry, Scheduler
from fame.config.values import Point
from fame.dataclasses import dataclass
from fame.middleware.interface import AnyMessage, DeferredResponse, Middleware

if TYPE_CHECKING:
    import pymunk

_TICK = 0.1
"""s between two movements of a door."""
_RETRY = 1.0
"""s after which a door tries to close again that a robot keeps open."""
THICKNESS = 0.1
"""Thickness of a door, m."""


@dataclass(frozen=True, slots=True)
class StationConfig:
    """A place where parcels are handed over; `radius` in m."""

    name: str
    at: Point
    radius: float = 0.6


@dataclass(frozen=True, slots=True)
class ParcelConfig:
    """A parcel, where it lies first, and the name of the station where it is wanted (empty: nowhere)."""

    name: str
    at: Point
    to: str = ""


@dataclass(frozen=True, slots=True)
class DoorConfig:
    """A door between two points (m). It opens in `time` s and stays open for `open` s."""

    name: str
    start: Point
    end: Point
    time: float = 1.5
    open: float = 8.0


@dataclass(slots=True)
class Parcel:
    """A parcel. `carrier` is the robot that carries it, else it lies `at` a place."""

    name: str
    at: Point
    to: str = ""
    carrier: str = ""


class Parcels:
    """All parcels and stations, in the order of the file."""

    def __init__(self, parcels: Iterable[ParcelConfig], stations: Iterable[StationConfig]) -> None:
        self.all = [Parcel(config.name, config.at, config.to) for config in parcels]
        self.stations = {station.name: station for station in stations}

    def take(self, place: Point, reach: float, robot: str) -> Parcel | None:
        """Load the nearest parcel within `reach` (m) of a place; return it, or None."""
        near = [parcel for parcel in self.all if not parcel.carrier and math.dist(parcel.at, place) <= reach]
        parcel = min(near, key=lambda one: math.dist(one.at, place), default=None)
        if parcel is not None:
            parcel.carrier = robot
        return parcel

    def put(self, parcel: Parcel, place: Point, reach: float) -> str:
        """Put a parcel down: at the station within `reach` (m), else at the place. Return the name of the station."""
        parcel.carrier, parcel.at = "", place
        near = [station for station in self.stations.values() if math.dist(station.at, place) <= reach]
        station = min(near, key=lambda one: math.dist(one.at, place), default=None)
        if station is None:
            return ""
        others = (other for other in self.all if other is not parcel and not other.carrier)
        taken = sum(math.dist(other.at, station.at) <= station.radius for other in others)
        turn, aside = math.tau * taken / 6, min(0.25, station.radius / 2)
        parcel.at = (station.at[0] + aside * math.cos(turn), station.at[1] + aside * math.sin(turn))
        return station.name

    def station_of(self, parcel: Parcel) -> str:
        """Return the station at which a parcel lies, the nearest of several, empty if none."""
        near = [station for station in self.stations.values() if math.dist(station.at, parcel.at) <= station.radius]
        station = min(near, key=lambda one: math.dist(one.at, parcel.at), default=None)
        return station.name if station is not None and not parcel.carrier else ""

    def summary(self, parcel: Parcel) -> dict[str, Any]:
        """Return where a parcel is, JSON-serialisable."""
        x, y = parcel.at
        place = {"x": round(x, 4), "y": round(y, 4), "station": self.station_of(parcel), "carrier": parcel.carrier}
        return {**place, "to": parcel.to}


class Door:
    """A door. `opening` is 0 (closed) to 1 (open)."""

    def __init__(
        self,
        config: DoorConfig,
        space: pymunk.Space,
        shape: pymunk.Shape,
        scheduler: Scheduler,
        middleware: Middleware,
    ) -> None:
        self.config, self.opening = config, 0.0
        self._space, self._shape, self._scheduler = space, shape, scheduler
        self._responses: list[DeferredResponse] = []
        self._next: Entry | None = None
        self._direction = 0
        self._node = middleware.node("door", config.name)
        self._node.service("open", "std_srvs/srv/Trigger", self._on_open)

    def close(self) -> None:
        if self._next is not None:
            self._next.cancel()
        self._node.close()

    def _on_open(self, request: AnyMessage) -> Mapping[str, Any] | DeferredResponse:
        if self._next is not None:
            self._next.cancel()
        if self.opening >= 1:
            self._stay()
            return {"success": True, "message": "open"}
        self._direction = 1
        self._later(_TICK, self._move)
        response = DeferredResponse()
        self._responses.append(response)
        return response

    def _later(self, seconds: float, action: Callable[[], object]) -> None:
        self._next = self._scheduler.after(round(seconds * SECOND), action)

    def _stay(self) -> None:
        self._later(self.config.open, self._shut)

    def _move(self) -> None:
        self.opening = min(max(self.opening + self._direction * _TICK / self.config.time, 0.0), 1.0)
        if self.opening >= 1 and self._direction > 0:
            if self._shape in self._space.shapes:
                self._space.remove(self._shape)
            for response in self._responses:
                response.respond({"success": True, "message": "open"})
            self._responses.clear()
            self._stay()
        elif self.opening > 0:
            self._later(_TICK, self._move)

    def _shut(self) -> None:
        """Begin to close, unless a robot stands in the door. It is solid from then on."""
        static = self._space.static_body
        if any(hit.shape is not None and hit.shape.body is not static for hit in self._space.shape_query(self._shape)):
            self._later(_RETRY, self._shut)
            return
        self._space.add(self._shape)
        self._direction = -1
        self._move()
