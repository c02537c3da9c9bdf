"""A battery: it drains with what a robot does, and says once a second what is left.

Power is what the robot always takes (`idle`), what it takes for its speed (`motion`), and what it takes for its work
(`work`: a tractor's blade, a drone's hovering). A charger gives some back. What an empty battery drives stands still.
"""

from __future__ import annotations

from dataclasses import dataclass

from fame.config.parameters import parameter
from fame.middleware import messages
from fame.middleware.interface import Node
from robots.robot import MEASUREMENT
from robots.template import header_maker, maker

BATTERY = "sensor_msgs/msg/BatteryState"
_HOUR = 3600.0
DRAIN_RATE = 20.0
"""How often it is reckoned what a robot took, Hz."""
_CHARGING, _DISCHARGING, _FULL = 1, 2, 4  # as sensor_msgs/msg/BatteryState has them
_SAG = 0.1
"""By what part of itself the voltage of an empty battery is lower than that of a full one."""


@dataclass(frozen=True, slots=True)
class BatteryParameters:
    """`charge` is what part of the capacity it has at the beginning."""

    rate: float = parameter(1.0, "Hz", above=0)
    capacity: float = parameter(100.0, "Wh", above=0)
    voltage: float = parameter(24.0, "V", above=0)
    charge: float = parameter(1.0, "", minimum=0, maximum=1)
    idle: float = parameter(5.0, "W", minimum=0)
    motion: float = parameter(60.0, "W per m/s", minimum=0)
    work: float = parameter(150.0, "W", minimum=0)


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
        """Give power for `duration` s at a speed (m/s), and get what a charger has (W)."""
        p = self._parameters
        self._power = p.idle + p.motion * abs(speed) + (p.work if works else 0.0) - charging
        left = min(max(0.0, self._left - self._power * duration), self._full)
        self._flow, self._left = (left - self._left) / duration, left

    def measure(self, now: int) -> None:
        """Publish what is left."""
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
