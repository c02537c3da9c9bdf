"""What the scripts of one robot may use of their host: its clock, its topics, and where their errors are reported."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import count
from typing import Any, Protocol

from fame.clock import Scheduler
from fame.scripting.inbox import Inbox
from fame.scripting.javascript.values import Encoded

HOST_API = "__javascript__"
"""The name under which the script interface of the variables holds it."""

REALM = "__realm__"
"""The name under which the script interface holds the realm of its scripts, once there is one."""


class OpenRealm(Protocol):
    """The scripts of one process instance."""

    variables: dict[str, Any]

    def close(self) -> None: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class HostApi:
    """One for each robot.

    namespace  of the robot, without slashes
    epoch      date of simulated second 0 (ms since 1970)
    advertise  (topic, type): create a publisher; raises MessageError
    publish    (topic, type, value): publish a message; raises MessageError
    log        (level, text): write a line of log
    report     (element, text): a warning that stops nothing
    stepped    (): a callback has ended, so variables may have changed
    failed     (variables, element, error): a callback of a script that is over has failed
    alive      (variables): whether their scope is still open
    realms     the open realms; `numbers` counts all realms ever opened
    encoded    the JSON text of a message, shared by all its subscriptions
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
    realms: list[OpenRealm] = field(default_factory=list)
    numbers: Iterator[int] = field(default_factory=count)
    encoded: Encoded = field(default_factory=Encoded)

    def sweep(self) -> None:
        """Close the realms whose variables are no longer in use, after a process instance has ended."""
        for realm in list(self.realms):
            if not self.alive(realm.variables):
                realm.close()

    def close(self) -> None:
        """Close all realms."""
        for realm in list(self.realms):
            realm.close()
