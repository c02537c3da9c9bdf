"""The sender's end of a deployment: one model, sent to its robots; all start, or none does."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions
from fame.bpmn.pools import Pool
from fame.bpmn.split import split
from fame.clock import SECOND, Entry, Kind, Scheduler
from fame.deploy.assignment import cast_of, promises
from fame.deploy.envelope import (
    PROCESS_QOS,
    SILENCE,
    STATUS_QOS,
    STRING,
    Envelope,
    Report,
    engines,
    is_ahead,
    model_hash,
    signed,
)
from fame.deploy.voice import Voice
from fame.middleware import messages
from fame.middleware.interface import Middleware

PATIENCE = 10.0
"""How long a deployment waits for a robot (s)."""
SETTLE = 0.02
"""Before a deployment says its first word (s): its robots have to know who speaks. What DDS brings them sooner they let
fall, and get again 100 to 300 ms later."""
HEARING = 0.5
"""How long it waits at most to have heard every robot before that (s): what they have seen, and which engine it is."""
AGAIN = 1.0
"""After how long a deployment asks again a robot that did not answer (s); asking twice has no effect but the answer."""
REFUSALS = ("refused", "stale", "superseded", "aborted", "left")
"""Answers that end a deployment for all."""


@dataclass(slots=True)
class Standing:
    """How far one robot is. `state` is its last answer, or ``silent``."""

    robot: str
    pool: Pool
    envelope: Envelope
    state: str = "silent"
    reason: str = ""
    took: float = 0.0


class Deployment:
    """One model, sent to its robots: all start, or none does.

    `robots` are the namespaces to play it (by default those that have an engine and that a pool wants); `only`
    restricts it to some of them; `again` are those that had the model before; `key` signs what is sent. `ended` is
    called once, when all have started or it is known that they will not; `standings` then tell the rest, `took` after
    how many seconds. Raises ModelError, ConfigError and DeploymentError for what cannot be sent at all.
    """

    def __init__(
        self,
        definitions: Definitions,
        *,
        id: str,
        sequence: int,
        scheduler: Scheduler,
        middleware: Middleware,
        ended: Callable[[Deployment], object],
        robots: Sequence[str] | None = None,
        only: Sequence[str] = (),
        again: Collection[str] = (),
        library: Library | None = None,
        patience: float = PATIENCE,
        key: Any = None,
        wall_time: Callable[[], float] = time.time,
    ) -> None:
        from fame.check.gate import refuse_errors

        self._key, self._wall_time = key, wall_time
        self.id, self.sequence, self.scheduler, self.middleware = id, sequence, scheduler, middleware
        self._ended, self._patience = ended, patience
        self._definitions, self._library = definitions, library or Library()
        library = self._library
        cast = cast_of(definitions, engines(middleware) if robots is None else robots, found=robots is None, only=only)
        sent = [pool.process for robot, pool in cast.items() if not only or robot in only]
        refuse_errors(definitions, sent, library, sent=True)
        parts = {part.name: part.source.decode() for part in split(definitions, library)}
        promised = promises(definitions, cast, library)
        self.standings = {
            robot: Standing(robot, pool, self._envelope(robot, "load"))
            for robot, pool in cast.items()
            if not only or robot in only
        }
        for robot, standing in self.standings.items():
            standing.envelope = replace(
                standing.envelope,
                model=parts[standing.pool.name],
                hash=model_hash(parts[standing.pool.name].encode()),
                promises=promised[robot],
                team=list(self.standings),
                again=robot in again,
            )
        self.done = False
        self.failed = False
        self._limit: Entry | None = None
        self._again: Entry | None = None
        self._phase = ""
        self._spoke = 0  # when all were last told to wait on, ns
        self._own: dict[str, Callable[[str], str]] = {}  # of each robot: what makes places of its file those of ours
        self._known: dict[str, Report] = {}  # the last report of each, whatever it is about
        trusted = [key.public_key()] if key is not None else []
        self._voices = {name: Voice(name, signed=key is not None, trusted=trusted) for name in self.standings}
        self.node = middleware.node("fame_deploy")
        self._out = {
            robot: self.node.publisher(f"/{robot}/bpmn_process", STRING, PROCESS_QOS) for robot in self.standings
        }
        for robot in self.standings:
            self.node.subscription(f"/{robot}/bpmn_status", STRING, partial(self._heard, robot), STATUS_QOS)

    def _envelope(self, robot: str, phase: str) -> Envelope:
        return Envelope(deployment=self.id, sequence=self.sequence, robot=robot, phase=phase)

    def begin(self) -> None:
        """Send every robot its part, in a moment."""
        self._begun = self.scheduler.now
        self._again = self.scheduler.after(round(SETTLE * SECOND), self._open, Kind.TIMER)
        self._limit = self.scheduler.after(round(self._patience * SECOND), self._give_up, Kind.TIMER)

    def _open(self) -> None:
        """Take a number above all that the robots have seen, whatever their senders' clocks said; then load.

        Where keys are used all have to be heard before that: each is told which engines the others are.
        """
        hears = self._key is not None or self.scheduler.now < self._begun + round(HEARING * SECOND)
        if len(self._known) < len(self.standings) and hears:
            self._again = self.scheduler.after(round(SETTLE * SECOND), self._open, Kind.TIMER)
            return
        now = self._wall_time()
        seen = [report.sequence for report in self._known.values() if not is_ahead(report.sequence, now)]
        self.sequence = max(self.sequence, *(number + 1 for number in seen), 0)
        for standing in self.standings.values():
            heard = {name: report.engine for name, report in self._known.items()}
            standing.envelope = replace(standing.envelope, sequence=self.sequence, engines=heard)
        self._phase = "load"
        self._spoke = self.scheduler.now
        self._ask()

    def _ask(self) -> None:
        """Tell all who have not answered what is wanted of them, until it is over."""
        if self._phase == "load" and self._stood_still():
            return
        self._spoke = self.scheduler.now
        begun = any(standing.state == "started" for standing in self.standings.values())
        for robot, standing in self.standings.items():
            if self._phase == "start":
                if standing.state == "ready":
                    self._send(robot, replace(self._envelope(robot, "start"), begun=begun))
            elif standing.state == "silent":
                self._send(robot, standing.envelope)
            else:
                self._send(robot, self._envelope(robot, "hold"))
        self._again = self.scheduler.after(round(AGAIN * SECOND), self._ask, Kind.TIMER)

    def _stood_still(self) -> bool:
        """Whether robots may have given up a sender that was stopped: then nobody is told to start any more."""
        still = (self.scheduler.now - self._spoke) / SECOND
        if still <= SILENCE:
            return False
        for standing in self.standings.values():
            standing.reason = (
                standing.reason or f"this command stood still for {still:.0f} s, and tells nobody to start"
            )
        self._finish(failed=True)
        return True

    def _send(self, robot: str, envelope: Envelope) -> None:
        if self._key is not None:
            if robot not in self._known:
                return  # it would refuse what was not signed for this engine of it
            envelope = signed(envelope, self._key, born=self._known[robot].born, now=self._wall_time())
        self._out[robot].publish(messages.create(STRING, envelope.to_json()))

    def _heard(self, robot: str, message: Any) -> None:
        report = self._voices[robot].hear(message.data)
        if self._voices[robot].rival and self._phase != "start" and not self.done:
            self.standings[robot].reason = f"two engines say that they are {robot}, and neither can prove it"
            self._finish(failed=True)
        if report is None:
            return
        self._known[robot] = report
        if report.deployment == self.id and not self.done:
            standing = self.standings[robot]
            if self._phase == "load" and report.answer in ("ready", "asking", *REFUSALS):
                self._answered(standing, report)
                self._vote()
            elif self._phase == "start" and report.answer in ("started", *(set(REFUSALS) - {"superseded"})):
                self._answered(standing, report)
                self._count()

    def _answered(self, standing: Standing, report: Report) -> None:
        standing.state, standing.reason = report.answer, self.in_own_files(standing.robot, report.reason)
        standing.took = (self.scheduler.now - self._begun) / SECOND

    def in_own_files(self, robot: str, text: str) -> str:
        """What a robot says, with places of the file that it was sent as those in the files that this was made of."""
        standing = self.standings.get(robot)
        if standing is None or f"{robot}.bpmn" not in text:
            return text
        if robot not in self._own:
            from fame.deploy.source_map import relocated

            process, model = standing.pool.process, standing.envelope.model
            self._own[robot] = relocated(robot, self._definitions, process, self._library, model)
        return self._own[robot](text)

    def _vote(self) -> None:
        """One refusal ends it for all; when all are ready, all are told to start, and that is not taken back."""
        states = {each.state for each in self.standings.values()}
        if states & {"asking", *REFUSALS}:
            self._finish(failed=True)
        elif states == {"ready"} and not self._stood_still():
            self._phase = "start"
            if self._again is not None:
                self._again.cancel()
            self._ask()

    def _count(self) -> None:
        """It is over when all have started, or said why not: one that crashed meanwhile ends it for itself alone."""
        states = [each.state for each in self.standings.values()]
        if "ready" not in states:
            self._finish(failed=any(state != "started" for state in states))

    def _give_up(self) -> None:
        for standing in self.standings.values():
            if standing.state == "silent" and (self._phase or standing.robot not in self._known):
                standing.reason = f"did not answer within {self._patience:g} s"
            elif self._phase == "start" and standing.state == "ready":
                standing.reason = "was ready, and did not answer when it was told to start"
        self._finish(failed=True)

    def _finish(self, failed: bool) -> None:
        if failed and self._phase != "start":
            self._explain()
        self._stop(failed)
        self._ended(self)

    def _explain(self) -> None:
        """Those who have nothing against it are told apart from those on whom it failed."""
        against = [each for each in self.standings.values() if each.state in ("asking", *REFUSALS) or each.reason]
        names = ", ".join(each.robot for each in against)
        waits = "had not answered yet" if self._phase else f"was not asked yet because of {names}"
        for each in self.standings.values():
            if each not in against:
                each.reason = waits if each.state == "silent" else f"called off because of {names}"

    def _stop(self, failed: bool) -> None:
        """Say no more, but that nobody is to start if nobody was told to."""
        self.done, self.failed = True, failed
        for entry in (self._limit, self._again):
            if entry is not None:
                entry.cancel()
        if failed and self._phase == "load":
            for name in self.standings:
                self._send(name, self._envelope(name, "abort"))

    def close(self) -> None:
        """Leave; what was not decided yet is off."""
        if not self.done:
            self._stop(failed=True)
        self.node.close()
