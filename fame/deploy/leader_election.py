"""Leader election among splitters as a pure state machine: ``step(state, event) -> (state, actions)``.

Theory of operation. Every splitter publishes its `SplitterStatus` once a second. The oldest one whose status is
received leads, the others stand by::

    standby ──no status of an older splitter──> leader
       └───<──status of an older one, a younger one leads, or it was stopped──┘

A splitter without status for `GONE` s is gone. So a leader that was itself stopped for longer may have a successor:
it stands by, and learns what became of the team, before it leads again. A new leader inherits what the
ones before it had deployed, so that the team goes on with it.

Where keys are used splitters sign their status, and believe nothing else. Nothing here looks at a clock: events carry
the time (ns).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Annotated, Any

from fame.clock import SECOND
from fame.dataclasses import dataclass, replace
from fame.deploy import fields
from fame.deploy.signing import verify_signature, with_signature
from fame.errors import DeploymentError
from fame.text import read_json

HEARTBEAT = 1.0
"""How often a splitter publishes its status (s)."""
RECENT = 30.0
"""Maximum age of a signed status (s): a recorded one must not pass for a splitter that has ended."""
GONE = 3.0
"""After how long without a status a splitter is taken to be gone (s)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SplitterStatus:
    """The status of a splitter. `born` (ns since 1970) identifies it and is its age; `deployed` the hash of a diagram.

    `issued` (s since 1970) and `signature` are there where keys are used.
    """

    born: Annotated[int, fields.integer(1, 2**63)]
    state: Annotated[str, fields.among("standby", "idle", "deploying", "keeping")]
    deployed: fields.Hash = ""
    text: Annotated[str, fields.text(100_000)] = ""
    issued: fields.Number = 0.0
    signature: fields.Name = ""

    def signed(self, key: Any, now: float) -> SplitterStatus:
        """Return the status signed by a private key `now`, or unchanged without a key."""
        return self if key is None else with_signature(self, key, issued=now)

    def is_believed(self, trusted: Sequence[Any], now: float) -> bool:
        """Return whether one of the trusted keys signed it not long before `now` (s since 1970); true without keys."""
        if not trusted:
            return True
        try:
            verify_signature(fields.values(self), trusted)
        except DeploymentError:
            return False
        return abs(now - self.issued) <= RECENT

    def to_json(self) -> str:
        """Return the JSON text that is sent."""
        return json.dumps(fields.values(self))

    @classmethod
    def from_json(cls, text: str) -> SplitterStatus | None:
        """Return the status in a text, or None if it has none."""
        try:
            return fields.read(cls, read_json(text))
        except (ValueError, TypeError):
            return None


# ---- state, events, actions ------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Older:
    """An older splitter: when its last status arrived (ns), and what it has deployed."""

    born: int
    last_seen: int
    deployed: str


@dataclass(frozen=True, slots=True)
class ElectionState:
    """What a splitter that was `born` then knows of the others.

    beaten      when its own heart beat last (ns)
    usurped_by  what a younger splitter has deployed that leads though this one is there: it was stopped, or cut off
    inherited   what older splitters had deployed that are gone
    """

    born: int
    beaten: int = 0
    leads: bool = False
    older: tuple[Older, ...] = ()
    usurped_by: str = ""
    inherited: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class SplitterStatusReceived:
    """The status of another splitter was received."""

    status: SplitterStatus
    now: int


@dataclass(frozen=True, slots=True)
class Beat:
    now: int


@dataclass(frozen=True, slots=True)
class Woken:
    """Something else is about to be handled: a leader that was stopped must not act on it."""

    now: int


@dataclass(frozen=True, slots=True)
class Lead:
    """Take the lead. `inherited`: hashes of diagrams that others had deployed; `gone`: an older splitter is gone."""

    inherited: frozenset[str]
    gone: bool


@dataclass(frozen=True, slots=True)
class StandBy:
    """Stop leading."""

    reason: str


ElectionEvent = SplitterStatusReceived | Beat | Woken
ElectionAction = Lead | StandBy


# ---- transitions -----------------------------------------------------------------------------------------------------


def step(state: ElectionState, event: ElectionEvent) -> tuple[ElectionState, tuple[ElectionAction, ...]]:
    """Return the next state and the actions."""
    match event:
        case SplitterStatusReceived(status, now):
            return _on_status(state, status, now), ()
        case Woken(now):
            return _stand_by_if_replaced(state, now)
        case Beat(now):
            away = _was_stopped(state, now)
            state, stands_by = _stand_by_if_replaced(_forget_silent(state, now), now)
            state, elected = _elect(state, away=away)
            return replace(state, beaten=now), (*stands_by, *elected)


def _on_status(state: ElectionState, status: SplitterStatus, now: int) -> ElectionState:
    if status.born < state.born:
        others = tuple(one for one in state.older if one.born != status.born)
        return replace(state, older=(*others, Older(status.born, now, status.deployed)))
    if status.born > state.born and status.state == "keeping":
        return replace(state, usurped_by=status.deployed)
    return state


def _forget_silent(state: ElectionState, now: int) -> ElectionState:
    horizon = now - round(GONE * SECOND)
    there = tuple(one for one in state.older if one.last_seen >= horizon)
    gone = frozenset(one.deployed for one in state.older if one.last_seen < horizon)
    return replace(state, older=there, inherited=gone or state.inherited)


def _was_stopped(state: ElectionState, now: int) -> bool:
    return now - state.beaten > GONE * SECOND


def _stand_by_if_replaced(state: ElectionState, now: int) -> tuple[ElectionState, tuple[ElectionAction, ...]]:
    if state.leads and (_was_stopped(state, now) or state.usurped_by):
        reason = "it was stopped or cut off, and listens what became of the team"
        return replace(state, leads=False), (StandBy(reason),)
    return state, ()


def _elect(state: ElectionState, *, away: bool) -> tuple[ElectionState, tuple[ElectionAction, ...]]:
    if state.leads and state.older:
        return replace(state, leads=False), (StandBy("there is an older splitter"),)
    if state.leads or state.older or away:
        return state, ()
    inherited = (state.inherited | {state.usurped_by}) - {""}
    gone = bool(state.inherited)
    return replace(state, leads=True, usurped_by="", inherited=frozenset()), (Lead(inherited, gone),)
