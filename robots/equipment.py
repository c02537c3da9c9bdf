"""Equipment besides sensors: a battery, a blade, a tray for parcels, an LED.

A battery supplies a constant power (`idle`), a power per speed (`motion`), and the power of work (`work`: a tractor's
blade, a drone's rotors). A charger recharges it. With an empty battery the equipment stops.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND
from fame.config.values import Point, parameter
from fame.dataclasses import dataclass
from fame.middleware import messages
from fame.middleware.interface import AnyMessage, Node
from robots.sensors import header_maker, maker
from sim2d.robot import MEASUREMENT, Pose

if TYPE_CHECKING:
    from sim2d.ground import Weeds
    from sim2d.warehouse import Parcel, Parcels


BATTERY = "sensor_msgs/msg/BatteryState"
_HOUR = 3600.0
DRAIN_RATE = 20.0
"""Rate at which the consumed energy is integrated, Hz."""
_CHARGING, _DISCHARGING, _FULL = 1, 2, 4  # as sensor_msgs/msg/BatteryState has them
_SAG = 0.1
"""Relative voltage drop of an empty battery."""


@dataclass(frozen=True, slots=True)
class BatteryParameters:
    """`charge` is the initial state of charge, 0 to 1."""

    rate: float = parameter(1.0, "Hz", above=0)
    capacity: float = parameter(100.0, "Wh", above=0)
    voltage: float = parameter(24.0, "V when full", above=0)
    charge: float = parameter(1.0, "of the capacity at the start", minimum=0, maximum=1)
    idle: float = parameter(5.0, "W, always", minimum=0)
    motion: float = parameter(60.0, "W per m/s", minimum=0)
    work: float = parameter(150.0, "W while the blade turns, or a drone flies", minimum=0)


class Battery:
    """Publishes `battery_state`. `charge` is from 0 to 1."""

    def __init__(self, node: Node, parameters: BatteryParameters) -> None:
        self._parameters = parameters
        self._full = parameters.capacity * _HOUR  # J
        self._left, self._power, self._flow = self._full * parameters.charge, 0.0, 0.0
        self._publisher = node.publisher("battery_state", BATTERY, MEASUREMENT)
        amperes = parameters.capacity / parameters.voltage
        template = messages.create(
            BATTERY,
            {
                "temperature": float("nan"),  # not measured, as the type says
                "capacity": amperes,
                "design_capacity": amperes,
                "power_supply_health": 1,  # good
                "power_supply_technology": 2,  # lithium ion
                "present": True,
            },
        )
        self._header = header_maker(f"{node.namespace}/base_link")
        self._make = maker(template, "header", "voltage", "current", "charge", "percentage", "power_supply_status")

    @property
    def charge(self) -> float:
        return self._left / self._full

    @property
    def empty(self) -> bool:
        return self._left <= 0

    def drain(self, duration: float, speed: float, works: bool, charging: float = 0.0) -> None:
        """Integrate the consumption over `duration` s at a speed (m/s), minus the power of a charger (W)."""
        p = self._parameters
        self._power = p.idle + p.motion * abs(speed) + (p.work if works else 0.0) - charging
        left = min(max(0.0, self._left - self._power * duration), self._full)
        self._flow, self._left = (left - self._left) / duration, left

    def measure(self, now: int) -> None:
        """Publish the state of charge."""
        charge, p = self.charge, self._parameters
        voltage = p.voltage * (1 - _SAG * (1 - charge))
        state = self._make(
            header=self._header(now),
            voltage=voltage,
            current=self._flow / voltage if charge else 0.0,
            charge=charge * p.capacity / p.voltage,
            percentage=charge,
            power_supply_status=_DISCHARGING if self._power >= 0 else _CHARGING if charge < 1 else _FULL,
        )
        self._publisher.publish(state)


@dataclass(frozen=True, slots=True)
class BladeParameters:
    """`radius` of the disc and distance `ahead` of the vehicle's centre, both in m."""

    radius: float = parameter(0.3, "m, of the disc", above=0)
    ahead: float = parameter(0.0, "m in front of the centre")
    time: float = parameter(0.5, "s above a weed to cut it", minimum=0)


class Blade:
    """Obeys `blade_force` (geometry_msgs/msg/Wrench): it `turns` while `torque.z` is above 0."""

    def __init__(self, node: Node, parameters: BladeParameters, owner: str, weeds: Weeds) -> None:
        self.turns = self.blocked = False
        self.radius, self._ahead, self._time = parameters.radius, parameters.ahead, round(parameters.time * SECOND)
        self._owner, self._weeds = owner, weeds
        self._since: dict[str, int] = {}  # when (ns) it came above each weed that it is above
        node.subscription("blade_force", "geometry_msgs/msg/Wrench", self._on_force)

    def _on_force(self, wrench: AnyMessage) -> None:
        self.turn(wrench.torque.z > 0 and not self.blocked)

    def turn(self, turns: bool) -> None:
        """Start or stop the blade."""
        self.turns = turns
        if not turns:
            self._since.clear()

    def cut(self, now: int, pose: Pose) -> None:
        """Cut the weeds that the turning blade has covered for long enough, under a vehicle at `pose`."""
        above = [weed for weed in self._weeds.near(pose.ahead(self._ahead), self.radius) if not weed.covered]
        self._since = {weed.name: self._since.get(weed.name, now) for weed in above}
        for weed in above:
            if now - self._since[weed.name] >= self._time:
                self._weeds.cut(weed, self._owner)


@dataclass(frozen=True, slots=True)
class TrayParameters:
    """A tray takes parcels, and reaches stations, within `reach` of the middle of its vehicle."""

    reach: float = parameter(0.8, "m to parcels and stations", above=0)


class Tray:
    """Carries one parcel: the services `load` and `unload` (std_srvs/srv/Trigger) take and put down the nearest one.

    `message` of the response is the name of the parcel (`load`) or of the station (`unload`).
    """

    def __init__(
        self, node: Node, parameters: TrayParameters, owner: str, parcels: Parcels, place: Callable[[], Point]
    ) -> None:
        self.parcel: Parcel | None = None
        self._reach, self._owner, self._parcels, self._place = parameters.reach, owner, parcels, place
        node.service("load", "std_srvs/srv/Trigger", lambda request: self._load())
        node.service("unload", "std_srvs/srv/Trigger", lambda request: self._unload())

    def _load(self) -> dict[str, Any]:
        if self.parcel is not None:
            return {"success": False, "message": f"carries {self.parcel.name} already"}
        self.parcel = self._parcels.take(self._place(), self._reach, self._owner)
        if self.parcel is None:
            return {"success": False, "message": f"no parcel within {self._reach:g} m"}
        return {"success": True, "message": self.parcel.name}

    def _unload(self) -> dict[str, Any]:
        if self.parcel is None:
            return {"success": False, "message": "carries no parcel"}
        station = self._parcels.put(self.parcel, self._place(), self._reach)
        self.parcel = None
        return {"success": True, "message": station}


COLOURS: Mapping[tuple[bool, bool, bool], str] = {
    (False, False, False): "off",
    (True, False, False): "red",
    (False, True, False): "green",
    (False, False, True): "blue",
    (True, True, False): "yellow",
    (False, True, True): "cyan",
    (True, False, True): "magenta",
    (True, True, True): "white",
}
"""Names of colours by which of red, green and blue are on."""


class Led:
    """An LED set by `led` (std_msgs/msg/ColorRGBA). `rgb` is 0 to 1 each."""

    def __init__(self, node: Node) -> None:
        self.rgb = (0.0, 0.0, 0.0)
        node.subscription("led", "std_msgs/msg/ColorRGBA", self._light)

    def _light(self, colour: AnyMessage) -> None:
        r, g, b = (min(max(float(c), 0.0), 1.0) if math.isfinite(c) else 0.0 for c in (colour.r, colour.g, colour.b))
        self.rgb = (r, g, b)

    @property
    def colour(self) -> str:
        """The name of the colour. A component counts as on if it has at least half the brightness of the strongest."""
        r, g, b = self.rgb
        half = max(r, g, b) / 2
        return COLOURS[r > 0 and r >= half, g > 0 and g >= half, b > 0 and b >= half]
