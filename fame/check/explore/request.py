"""What to explore of a team."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, get_args

from fame.check.explore.product import Delivery, silent
from fame.dataclasses import dataclass, field
from fame.errors import expect
from fame.properties import Property

LIMIT = 200_000
"""States of all deliveries together, by default."""
DELIVERIES: tuple[Delivery, ...] = ("run", "fast")
"""What is explored by default, one after the other."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """What to explore.

    delivery  ways of delivery, at least one, see `fame.check.explore.product`
    ordered   timers of a robot fire in the order of their durations, where that is known; else in any order
    faults    also explore what single faults lead to
    reduced   leave out orders of steps that make no difference
    limit     states, of all searches together; each may exceed what is left by those of its last step
    seconds   time for all searches together, None for no bound
    sources   topics on which somebody outside of the team publishes
    properties  sentences that are judged
    variables  what the processes of robots start with, by robot
    samples   explore some parts besides if a limit ends a search
    first     explore these parts first, if at all, and end at the first error
    progress  called now and then with the number of states of a delivery, and of those still to be explored
    """

    delivery: tuple[Delivery, ...] = DELIVERIES
    ordered: bool = False
    faults: bool = False
    reduced: bool = True
    limit: int = LIMIT
    seconds: float | None = None
    sources: frozenset[str] = frozenset()
    properties: tuple[Property, ...] = ()
    variables: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    samples: bool = True
    first: bool = False
    progress: Callable[[int, int], object] = silent

    def expect_valid(self) -> None:
        """Raise ConfigError for a limit below 1 or no delivery."""
        known = bool(self.delivery) and {*self.delivery} <= {*get_args(Delivery)}
        expect(known, "delivery", self.delivery, f"at least one of {', '.join(get_args(Delivery))}")
        expect(self.limit > 0, "limit", self.limit, "a number of states above 0")
        expect(self.seconds is None or self.seconds > 0, "seconds", self.seconds, "a number of seconds above 0")
