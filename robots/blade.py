"""A blade under a vehicle: cuts the weeds above which it has turned for a while."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from fame.clock import SECOND
from fame.config.parameters import parameter
from fame.middleware.interface import Message, Node
from robots.robot import Pose

if TYPE_CHECKING:
    from sim2d.weeds import Weeds


@dataclass(frozen=True, slots=True)
class BladeParameters:
    """`radius` is that of its disc, `ahead` how far in front of the vehicle's middle its axis is, both in m."""

    radius: float = parameter(0.3, "m", above=0)
    ahead: float = parameter(0.0, "m")
    time: float = parameter(0.5, "s above a weed to cut it", minimum=0)


class Blade:
    """Obeys `blade_force` (geometry_msgs/msg/Wrench): it `turns` while `torque.z` is above 0."""

    def __init__(self, node: Node, parameters: BladeParameters, owner: str, weeds: Weeds) -> None:
        self.turns = self.blocked = False
        self.radius, self._ahead, self._time = parameters.radius, parameters.ahead, round(parameters.time * SECOND)
        self._owner, self._weeds = owner, weeds
        self._since: dict[str, int] = {}  # when (ns) it came above each weed that it is above
        node.subscription("blade_force", "geometry_msgs/msg/Wrench", self._on_force)

    def _on_force(self, wrench: Message) -> None:
        self.turn(wrench.torque.z > 0 and not self.blocked)

    def turn(self, turns: bool) -> None:
        """Begin or end to turn."""
        self.turns = turns
        if not turns:
            self._since.clear()

    def cut(self, now: int, pose: Pose) -> None:
        """Cut what it has turned above for long enough, under a vehicle at `pose`. Only while it turns."""
        above = [weed for weed in self._weeds.near(pose.ahead(self._ahead), self.radius) if not weed.covered]
        self._since = {weed.name: self._since.get(weed.name, now) for weed in above}
        for weed in above:
            if now - self._since[weed.name] >= self._time:
                self._weeds.cut(weed, self._owner)
