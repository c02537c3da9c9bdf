"""What a robot says of itself on ``bpmn_status``: every second, and whenever it answers somebody."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND, Kind, Scheduler
from fame.deploy.envelope import STATUS_QOS, STRING, Report
from fame.deploy.refusals import Digest
from fame.deploy.signing import Identity, sign
from fame.deploy.voice import is_twin
from fame.deploy.warnings import Warnings
from fame.errors import FameError
from fame.middleware import messages
from fame.middleware.interface import LATCHED, Node

if TYPE_CHECKING:
    from fame.robot import RobotNode

HEARTBEAT = 1.0
"""How often a robot repeats how it stands (s)."""
_ANSWERS = 100
"""Deployments whose answer is remembered."""


class Status:
    """The voice of a robot: `standing` gives what a `Report` says beside the answer. It minds who speaks on `topic`
    with another type, and listens to itself: the younger of two with one name leaves, unless it runs something. Where
    keys are used (`trusted`) reports are signed by `identity`, and only an engine that proves its name ends another.
    `refused` is told why something was refused, and as an answer to which deployment, if it was one; `warn` the rest.
    Of refusals that nobody waits for, those of one cause are one a second.
    """

    def __init__(
        self,
        robot: str,
        topic: str,
        born: int,
        standing: Callable[[], Mapping[str, Any]],
        *,
        node: Node,
        scheduler: Scheduler,
        refused: Callable[[str, str], object],
        warnings: Warnings,
        warn: Callable[[str], object],
        identity: Identity | None = None,
        trusted: Sequence[Any] = (),
        wall_time: Callable[[], float] = time.time,
    ) -> None:
        self._identity, self._trusted, self._wall_time, self._warn = identity, trusted, wall_time, warn
        self._met_others: set[str] = set()
        self._robot, self._topic, self._born, self._standing = robot, topic, born, standing
        self._scheduler, self._refused, self._warnings = scheduler, refused, warnings
        self._garbage = Digest(scheduler, self._refuse)
        self._answers: dict[str, tuple[str, str]] = {}
        self._out = node.publisher("bpmn_status", STRING, LATCHED)
        node.subscription("bpmn_status", STRING, self._met, STATUS_QOS)

    def begin(self) -> None:
        """Say it now, and every second from now on."""
        self.say()
        self._refuse_unread()
        self._pulse = self._scheduler.after(round(HEARTBEAT * SECOND), self.begin, Kind.TIMER)

    def say(self, answer: str = "", deployment: str = "", reason: str = "") -> None:
        """How it stands, perhaps as an answer."""
        if answer == "refused" and not deployment:
            self._garbage(reason)
            return
        self._publish(answer, deployment, reason)
        if answer == "refused":
            self._refused(reason, deployment)

    def _refuse(self, reason: str) -> None:
        self._publish("refused", "", reason)
        self._refused(reason, "")

    def _publish(self, answer: str, deployment: str, reason: str) -> None:
        report = Report(
            robot=self._robot,
            deployment=deployment,
            answer=answer,
            reason=reason,
            born=self._born,
            time=self._scheduler.now / SECOND,
            **self._standing(),
        )
        if self._identity is not None:
            report = replace(report, key=self._identity.key, voucher=self._identity.voucher)
            report = replace(report, signature=sign(asdict(report), self._identity.private))
        self._out.publish(messages.create(STRING, report.to_json()))

    def answer(self, answer: str, deployment: str, reason: str = "") -> None:
        """The last word on a deployment so far, which is said `again` to whoever asks."""
        self._answers[deployment] = answer, reason
        if len(self._answers) > _ANSWERS:
            del self._answers[next(iter(self._answers))]
        self.say(answer, deployment, reason)

    def answered(self, deployment: str) -> str:
        """The last word on it, or nothing."""
        return self._answers.get(deployment, ("", ""))[0]

    def again(self, deployment: str, otherwise: tuple[str, str] = ("", "")) -> None:
        """Say what was answered, or else something."""
        known = self._answers.get(deployment)
        if known is not None:
            self._publish(known[0], deployment, known[1])
        else:
            self.say(otherwise[0], deployment, otherwise[1])

    def close(self) -> None:
        """Say it no more by itself."""
        self._pulse.cancel()
        self._garbage.close()

    def _refuse_unread(self) -> None:
        """What the middleware does not even bring: messages of another type."""
        for text in self._warnings.look(f"{self._topic}:"):
            self.say("refused", reason=text)

    def _met(self, message: Any) -> None:
        """Somebody else speaks for this robot: the younger of the two leaves, if that can be known and nothing runs."""
        other = Report.from_json(message.data)
        if other is None or not 0 < other.born < self._born:
            return
        proved = is_twin(other, self._robot, self._trusted, self._wall_time())
        if proved and self._standing()["state"] == "waiting":
            raise FameError(f"there is an engine {self._robot!r} already; a robot has one")
        if other.engine not in self._met_others and len(self._met_others) < _ANSWERS:
            self._met_others.add(other.engine)
            why = "runs a process" if proved else "cannot tell it from a stranger: it does not prove its name"
            self._warn(f"an older engine says that it is {self._robot!r}; this one goes on, because it {why}")


class Absences:
    """Which robots of a team have no engine any more, and since when."""

    def __init__(self) -> None:
        self._since: dict[str, int] = {}
        self._looked = -1

    def seen(self, team: Collection[str], now: int, engines: Callable[[], Collection[str]]) -> dict[str, float]:
        """For how long each has been absent (s) at `now` (ns); who is there is looked up once a heartbeat."""
        if team and (self._looked < 0 or now - self._looked >= HEARTBEAT * SECOND):
            self._looked, there = now, engines()
            self._since = {robot: self._since.get(robot, now) for robot in team if robot not in there}
        return {robot: (now - since) / SECOND for robot, since in self._since.items() if robot in team}


def state_of(process: RobotNode | None) -> str:
    """How a process stands, in the words of `Report`."""
    if process is None:
        return "waiting"
    if any(instance.status == "failed" for instance in process.instances[-1:]):
        return "failed"
    return "running" if process.engine.instances else "idle"


def progress(process: RobotNode | None) -> dict[str, Any]:
    """The part of a report that tells how a process goes."""
    if process is None:
        return {}
    last = process.instances[-1].error if process.instances else None
    return {
        "instances": len(process.engine.instances),
        "started": process.started,
        "completed": process.completed,
        "failed": process.failed,
        "elements": process.elements,
        "ahead": process.ahead,
        "waits": [
            {"element": wait.element, "for": wait.text, "since": wait.since / SECOND, "topics": dict(wait.topics)}
            for wait in process.waits()
        ],
        "offers": process.offers(),
        "error": str(last) if last is not None else "",
        "errors": [instance.error.to_json() for instance in process.instances if instance.error is not None],
    }
