"""A robot type of one's own: a car with a thermometer in its box. `courier.yaml` names it as ``courier.py:Courier``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from robots import Car, VehicleParameters, message_class, parameter
from sim2d import MEASUREMENT, RobotConfig, RobotWorld, period

TEMPERATURE = "sensor_msgs/msg/Temperature"


@dataclass(frozen=True, slots=True)
class CourierParameters(VehicleParameters):
    """What a world file may say of a courier: all that it may say of a car, and these."""

    inside: float = parameter(6.0, "degrees C", minimum=-40, maximum=60)
    noise: float = parameter(0.1, "degrees C", minimum=0)


class Courier(Car):
    """A car that publishes `temperature` (sensor_msgs/msg/Temperature) once a second."""

    Parameters: ClassVar[type[Any]] = CourierParameters

    def __init__(self, config: RobotConfig, world: RobotWorld) -> None:
        super().__init__(config, world)
        self._box: CourierParameters = config.parameters
        self._random = world.random(config.name, "temperature")
        self._every = period(1.0, world.step)
        self._reading = message_class(TEMPERATURE)
        self._temperature = self.node.publisher("temperature", TEMPERATURE, MEASUREMENT)

    def sense(self, now: int, count: int) -> None:
        super().sense(now, count)
        if count % self._every == 0:
            measured = self._box.inside + self._box.noise * self._random.standard_normal()
            self._temperature.publish(self._reading(temperature=measured, variance=self._box.noise**2))
