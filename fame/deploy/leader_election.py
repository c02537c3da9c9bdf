"""Which of several splitters has the role: the oldest that is heard; a younger one while that is silent.

Where keys are used splitters sign what they say of themselves, and believe nothing else.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from fame.clock import SECOND, Scheduler
from fame.deploy import fields
from fame.deploy.signing import sign, verify_signature
from fame.errors import DeploymentError

HEARTBEAT = 1.0
"""How often a splitter says that it is there (s)."""
RECENT = 30.0
"""How old what a splitter signed may be (s): what it said while it was there must not stand for it afterwards."""
GONE = 3.0
"""After how long a splitter that says nothing is taken to be gone (s)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Role:
    """What a splitter says of itself. `born` (ns since 1970) is its age and name; `deployed` the hash of a diagram.

    `issued` (s since 1970) and `signature` are there where keys are used.
    """

    born: int
    state: str
    deployed: str = ""
    text: str = ""
    issued: float = 0.0
    signature: str = ""

    def signed(self, key: Any, now: float) -> Role:
        """It as a private key signs it `now`; as it is without a key."""
        if key is None:
            return self
        said = replace(self, issued=now)
        return replace(said, signature=sign(asdict(said), key))

    def to_json(self) -> str:
        """As it is sent."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Role | None:
        """What another one said, or None if it is nothing of that kind."""
        try:
            said = json.loads(text)
            return cls(**said) if fields.wrong(said, _ROLE) is None else None
        except (ValueError, TypeError, AttributeError, RecursionError):
            return None


_ROLE: dict[str, fields.Check] = {
    "born": fields.integer(1, 2**63),
    "state": fields.among("standby", "idle", "deploying", "keeping"),
    "deployed": fields.text(64),
    "text": fields.text(100_000),
    "issued": fields.number,
    "signature": fields.text(1000),
}


class Others:
    """The other splitters, as one that was `born` then hears them. With `trusted` keys, those that one of them signed.

    `regent` is what a younger one has deployed that has the role though we are there: we were stopped, or cut off.
    """

    def __init__(
        self,
        born: int,
        scheduler: Scheduler,
        *,
        trusted: Sequence[Any] = (),
        wall_time: Callable[[], float] = time.time,
    ) -> None:
        self._born, self._scheduler = born, scheduler
        self._trusted, self._wall_time = trusted, wall_time
        self._elders: dict[int, tuple[int, Role]] = {}  # born -> when it was heard last, and what it said
        self.regent = ""

    @property
    def older(self) -> bool:
        """Whether one of them is older."""
        return bool(self._elders)

    def heard(self, text: str) -> None:
        """One of them spoke."""
        role = Role.from_json(text)
        if role is None or not self._believes(role):
            return
        if role.born < self._born:
            self._elders[role.born] = self._scheduler.now, role
        elif role.born > self._born and role.state == "keeping":
            self.regent = role.deployed

    def _believes(self, role: Role) -> bool:
        if not self._trusted:
            return True
        try:
            verify_signature(asdict(role), self._trusted)
        except DeploymentError:
            return False
        return abs(self._wall_time() - role.issued) <= RECENT

    def forget_silent(self) -> Sequence[str]:
        """What those had deployed that are gone."""
        horizon = self._scheduler.now - round(GONE * SECOND)
        heirloom = [role.deployed for heard, role in self._elders.values() if heard < horizon]
        self._elders = {born: said for born, said in self._elders.items() if said[0] >= horizon}
        return heirloom
