"""The tractor: a field robot with a blade under it, an ultrasonic sensor at its nose and a battery.

Besides what every vehicle has, it obeys `blade_force` and publishes `battery_state`. With an empty battery it brakes
and its blade stands still.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

from fame.config.parameters import parameter
from robots.battery import DRAIN_RATE, Battery, BatteryParameters
from robots.blade import Blade, BladeParameters
from robots.drive import FRICTION
from robots.planner import PlannerParameters
from robots.robot import Command, Look, period
from robots.ultrasonic import UltrasonicParameters
from robots.vehicle import STOP, Vehicle, VehicleParameters

if TYPE_CHECKING:
    from robots.robot import Surroundings
    from sim2d.config import RobotConfig


@dataclass(frozen=True, slots=True)
class TractorParameters(VehicleParameters):
    """What a world file may say of a tractor."""

    length: float = parameter(0.6, "m", above=0, maximum=20)
    width: float = parameter(0.4, "m", above=0, maximum=20)
    mass: float = parameter(30.0, "kg", above=0)
    max_turn_rate: float = parameter(1.5, "rad/s", above=0)
    acceleration: float = parameter(1.0, "m/s²", above=0)
    turn_acceleration: float = parameter(5.0, "rad/s²", above=0)
    friction: float = parameter(FRICTION["grass"], "", above=0, names=FRICTION)
    range: UltrasonicParameters = field(default=UltrasonicParameters(max=3.0))
    planner: PlannerParameters = field(default=PlannerParameters(margin=0.1, tolerance=0.25))
    blade: BladeParameters = field(default=BladeParameters())
    battery: BatteryParameters = field(default=BatteryParameters())


class Tractor(Vehicle):
    """A robot of type ``tractor``."""

    Parameters: ClassVar[type[Any]] = TractorParameters
    SAFE_STATE: ClassVar[tuple[Command, ...]] = (STOP, Command("blade_force", "geometry_msgs/msg/Wrench", {}))
    SAFE_SUSPENDED: ClassVar[tuple[Command, ...]] = SAFE_STATE

    def __init__(self, config: RobotConfig, world: Surroundings) -> None:
        super().__init__(config, world)
        p: TractorParameters = config.parameters
        self._blade = Blade(self.node, p.blade, config.name, world.weeds)
        self._battery, self._charging = Battery(self.node, p.battery), world.charging
        self._tell, self._drain = period(p.battery.rate, world.step), period(DRAIN_RATE, world.step)
        self._drain_time = self._drain * world.step

    @property
    def look(self) -> Look:
        blade = self._blade.radius if self._blade.turns else 0.0
        return super().look._replace(blade=blade, charge=self._battery.charge)

    @property
    def status(self) -> Mapping[str, Any]:
        return {"battery": round(self._battery.charge, 4), "blade": self._blade.turns}

    def sense(self, now: int, count: int) -> None:
        super().sense(now, count)
        if self._blade.turns:
            self._blade.cut(now, self.pose)
        if count and count % self._drain == 0:
            gained = self._charging((self.pose.x, self.pose.y))
            self._battery.drain(self._drain_time, self.drive.motion.ahead, self._blade.turns, gained)
            if self._battery.empty:
                self.drive.blocked = self._blade.blocked = True
                self._blade.turn(False)
        if count % self._tell == 0:
            self._battery.measure(now)
