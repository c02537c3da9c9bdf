"""The car: a small differential-drive vehicle with an ultrasonic sensor at its nose and an LED (`led`)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from robots.led import Led
from robots.robot import Look
from robots.vehicle import Vehicle

if TYPE_CHECKING:
    from robots.robot import Surroundings
    from sim2d.config import RobotConfig


class Car(Vehicle):
    """A robot of type ``car``."""

    def __init__(self, config: RobotConfig, world: Surroundings) -> None:
        super().__init__(config, world)
        self._led = Led(self.node)

    @property
    def look(self) -> Look:
        return super().look._replace(led=self._led.colour)

    @property
    def status(self) -> Mapping[str, Any]:
        return {"led": self._led.colour}
