"""Options of a robot's node: what it runs its process with."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any

from fame.clock import EPOCH
from fame.dataclasses import dataclass, field

if TYPE_CHECKING:
    from fame.engine import Instance
    from fame.robot.events import Event, OnEvent
    from fame.robot.services import StartService

Fields = tuple[str, str, Mapping[str, Any]]
"""A message that brings the robot to its safe state: topic, type, fields."""


@dataclass(frozen=True, slots=True)
class Membership:
    """What a robot knows of its team.

    life       the id of this run of its process
    receivers  topics with acknowledgements -> the robots of its deployment that catch them
    team       the robots that start together with it, in its deployment of this `sequence`
    """

    life: str = "1"
    receivers: Mapping[str, Sequence[str]] = field(default_factory=dict)
    team: frozenset[str] = frozenset()
    sequence: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotOptions:
    """Options of a `fame.robot.RobotNode`.

    observer   gets every `Event` (`fame.robot.events`), if given; the program is compiled for it
    on_report  gets what people should know, as events
    safe_state (topic, type, fields) to publish when the robot is to be safe
    safe_suspended  the same while its mission is suspended, if it differs from `safe_state`
    epoch      the date of the scheduler's time 0: what dates of timers and `robot.date` are counted from
    random     its random numbers; default: those of seed 0 (`fame.randomness`)
    strict     an undefined name in a payload is an error, not a warning
    until      when the run ends at the latest (ns): dates and cycles that are due later are reported
    keep       how many instances that have ended to remember; `started`, `completed` and `failed` count all
    on_end     called with each instance that has ended
    service_starts  how services start, by name, before those of `fame.rooms.SERVICES`
    files      folder that services take names of files from; default: that of the model
    membership  what it knows of its team, for acknowledged signals
    hold_errors  an uncaught error does not fail its instance: the token stays as an incident, and the robot holds
    """

    observer: OnEvent | None = None
    on_report: Callable[[Event], object] | None = None
    safe_state: Sequence[Fields] = ()
    safe_suspended: Sequence[Fields] | None = None
    epoch: datetime = EPOCH
    random: Random | None = None
    strict: bool = False
    until: int | None = None
    keep: int = 1000
    on_end: Callable[[Instance], object] = lambda instance: None
    service_starts: Mapping[str, StartService] = field(default_factory=dict)
    files: Path | None = None
    membership: Membership = field(default_factory=Membership)
    hold_errors: bool = False
