"""What the scripts of one robot have around them: its clock, its topics, and who hears of their errors."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import count
from typing import TYPE_CHECKING, Any

from fame.clock import Scheduler
from fame.scripting.inbox import Inbox
from fame.scripting.javascript.values import Encoded

if TYPE_CHECKING:
    from fame.scripting.javascript.realm import Realm

SURROUNDINGS = "__javascript__"
"""Where the interface of the variables holds them."""

REALM = "__realm__"
"""Where it holds the realm of its scripts, once there is one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Surroundings:
    """One for each robot.

    namespace  of the robot, without slashes
    epoch      date of simulated second 0, in ms since 1970
    advertise  (topic, type): make an endpoint; raises MessageError
    publish    (topic, type, value): send; raises MessageError
    log        (level, text)
    report     (element, text): something a person should know that stops nothing
    stepped    (): a callback has ended, so variables may have changed
    failed     (variables, element, error): a callback of a script that is over has failed
    alive      (variables): whether they are those of a scope that still is
    realms     those that are open; `numbers` count all there have been
    encoded    the text of a message for all its subscriptions
    """

    name: str
    namespace: str
    epoch: float
    scheduler: Scheduler
    inbox: Inbox
    advertise: Callable[[str, str], object]
    publish: Callable[[str, str, Any], object]
    log: Callable[[str, str], object]
    report: Callable[[str, str], object]
    stepped: Callable[[], object]
    failed: Callable[[dict[str, Any], str, BaseException], object]
    alive: Callable[[dict[str, Any]], bool]
    realms: list[Realm] = field(default_factory=list)
    numbers: Iterator[int] = field(default_factory=count)
    encoded: Encoded = field(default_factory=Encoded)

    def sweep(self) -> None:
        """A process instance has ended: end the realms whose variables are no longer in use."""
        for realm in list(self.realms):
            if not self.alive(realm.variables):
                realm.close()

    def close(self) -> None:
        """End all of them."""
        for realm in list(self.realms):
            realm.close()
