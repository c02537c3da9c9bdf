"""Which of several splitters has the role: the oldest that is heard; a younger one while that is silent."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from fame.clock import SECOND, Scheduler

HEARTBEAT = 1.0
"""How often a splitter says that it is there (s)."""
GONE = 3.0
"""After how long a splitter that says nothing is taken to be gone (s)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Role:
    """What a splitter says of itself. `born` (ns since 1970) is its age and name; `deployed` the hash of a diagram."""

    born: int
    state: str
    deployed: str = ""
    text: str = ""

    def to_json(self) -> str:
        """As it is sent."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Role | None:
        """What another one said, or None if it is nothing of that kind."""
        try:
            role = cls(**json.loads(text))
        except (ValueError, TypeError, RecursionError):
            return None
        return role if isinstance(role.born, int) and isinstance(role.deployed, str) else None


class Others:
    """The other splitters, as one that was `born` then hears them.

    `regent` is what a younger one has deployed that has the role though we are there: we were stopped, or cut off.
    """

    def __init__(self, born: int, scheduler: Scheduler) -> None:
        self._born, self._scheduler = born, scheduler
        self._elders: dict[int, tuple[int, Role]] = {}  # born -> when it was heard last, and what it said
        self.regent = ""

    @property
    def older(self) -> bool:
        """Whether one of them is older."""
        return bool(self._elders)

    def heard(self, text: str) -> None:
        """One of them spoke."""
        role = Role.from_json(text)
        if role is not None and 0 < role.born < self._born:
            self._elders[role.born] = self._scheduler.now, role
        elif role is not None and role.born > self._born and role.state == "keeping":
            self.regent = role.deployed

    def forget_silent(self) -> Sequence[str]:
        """What those had deployed that are gone."""
        horizon = self._scheduler.now - round(GONE * SECOND)
        heirloom = [role.deployed for heard, role in self._elders.values() if heard < horizon]
        self._elders = {born: said for born, said in self._elders.items() if said[0] >= horizon}
        return heirloom
