"""Weeds: what grows on the ground until a blade cuts it. They are not solid, and not in the map."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from fame.config.values import Point

if TYPE_CHECKING:
    from sim2d.config import WeedConfig


@dataclass(slots=True)
class Weed:
    """A weed. `cut_at` is the second since the start at which `cut_by` has cut it; None if it still grows.

    No blade gets to one that is `covered`: it grows in something solid.
    """

    name: str
    at: Point
    radius: float
    cut_at: float | None = None
    cut_by: str | None = None
    covered: bool = False

    def summary(self) -> dict[str, Any]:
        """How it stands, fit for JSON."""
        cut = None if self.cut_at is None else round(self.cut_at, 4)
        return {"x": self.at[0], "y": self.at[1], "cut": cut, "by": self.cut_by}


class Weeds:
    """All weeds, in the order of the file. `clock` gives the seconds since the start."""

    def __init__(self, configs: Iterable[WeedConfig], clock: Callable[[], float]) -> None:
        self.all = [Weed(config.name, config.at, config.radius) for config in configs]
        self._clock = clock

    def near(self, place: Point, distance: float) -> list[Weed]:
        """Those that grow with their middle within `distance` (m) of a place."""
        return [weed for weed in self.all if weed.cut_at is None and math.dist(weed.at, place) <= distance]

    def cut(self, weed: Weed, by: str) -> None:
        """It grows no more."""
        weed.cut_at, weed.cut_by = self._clock(), by
