"""The robot's end of a deployment: it takes a process, runs it, and takes the next one.

At any time one process runs at most, one is a candidate for its place at most (`candidate`), and one envelope waits at
most to be looked at. Until the candidate is told to start, what runs is not touched.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from datetime import datetime
from functools import partial
from typing import TYPE_CHECKING, Any

from fame.clock import EPOCH, SECOND, Kind, Scheduler
from fame.deploy.beside import Work
from fame.deploy.candidate import Candidate, Stage
from fame.deploy.envelope import PLAIN, PROCESS_QOS, SIZE, STRING, Envelope, engines, read_envelope
from fame.deploy.loading import load
from fame.deploy.refusals import Digest
from fame.deploy.reports import Absences, Status, progress, state_of
from fame.deploy.signing import Identity, verify, verify_signature
from fame.deploy.tasks import Done, Tasks
from fame.deploy.termination import Told, reply
from fame.deploy.warnings import Warnings
from fame.errors import DeploymentError, FameError
from fame.middleware.interface import Middleware

if TYPE_CHECKING:
    from fame.bpmn.library import Library
    from fame.robot import Event, RobotNode, Service

_NONE = ("refused", "no such deployment is loaded here")
_SILENT = "the sender fell silent"
_NEWER = "a newer one waits; its sender decides, since others may have been told to start"


class EngineNode:
    """One robot's end: it takes a process, runs it, and takes the next one.

    `observer`, `safe_state` and others: as of `fame.robot.RobotNode`. With `trusted` public keys it takes only what one
    of them signed, and signs what it says with the key of its `identity`, or one made now; with `unsigned_tasks` what
    people did need not be signed. `wall_time` gives s since 1970. `time` is the scheduler of the mission if that is not
    `scheduler`: one of simulated time, and `epoch` the date of its second 0. `close` brings the robot to its safe state
    and leaves. Raises FameError, from the scheduler's `run`, when an older engine of the same robot makes itself heard
    before this one has a process.
    """

    def __init__(
        self,
        robot: str,
        *,
        scheduler: Scheduler,
        middleware: Middleware,
        library: Library | None = None,
        services: Mapping[str, Service] | None = None,
        observer: Callable[[Event], object] | None = None,
        on_report: Callable[[Event], object] | None = None,
        safe_state: Sequence[tuple[str, str, Mapping[str, Any]]] = (),
        safe_suspended: Sequence[tuple[str, str, Mapping[str, Any]]] | None = None,
        trusted: Sequence[Any] = (),
        identity: Identity | None = None,
        unsigned_tasks: bool = False,
        wall_time: Callable[[], float] = time.time,
        time: Scheduler | None = None,
        epoch: datetime = EPOCH,
    ) -> None:
        self._trusted, self._wall_time = trusted, wall_time
        self._signers = () if unsigned_tasks else trusted  # of what people did
        self.robot, self.scheduler, self.middleware = robot, scheduler, middleware
        self._time = scheduler if time is None else time  # a scheduler with nothing to do is false
        self._options: dict[str, Any] = {
            "library": library,
            "services": services,
            "observer": observer,
            "on_report": on_report,
            "safe_state": safe_state,
            "safe_suspended": safe_suspended,
            "epoch": epoch,
            "on_end": lambda instance: self.status.say(),
        }
        self._on_report = on_report or (lambda event: None)
        self.born = round(wall_time() * SECOND)
        self.running: RobotNode | None = None
        self.hash = self.deployed = ""
        self._team: Sequence[str] = ()  # of what runs
        self._absences = Absences()
        self.candidate: Candidate | None = None
        self._refusals = {
            what: Digest(scheduler, partial(self._note, what=what)) for what in ("answer", "report")
        }  # of those who wait for an answer, and of bare models
        self._next: Envelope | None = None
        self._loading = False  # whether `_next`, or one before it, is being loaded
        self._newest = (-1, "")  # `Envelope.order` of the newest that was looked at
        self._stopped = False
        self.node = middleware.node("fame_deployment", robot)
        self._process = self.node.subscription("bpmn_process", STRING, self._heard, PROCESS_QOS)
        self._process.limit = SIZE
        self.warn = Warnings(middleware, self._warned)
        about = (robot, self._process.topic, self.born, self._standing)
        self.status: Status = Status(
            *about,
            refused=self._refused,
            warn=self._note,
            identity=(identity or Identity.new()) if trusted else None,
            trusted=trusted,
            wall_time=wall_time,
            node=self.node,
            scheduler=scheduler,
            warnings=self.warn,
        )
        self._process.dropped = lambda text: self.status.say("refused", reason=text)
        self._tasks = Tasks(self.node, lambda: self.running, self.status.say, self._check_done)
        self.status.begin()

    @property
    def state(self) -> str:
        """See `Report`."""
        if self.candidate is None:
            return "loading" if self._loading else state_of(self.running)
        if self.candidate.stage is not Stage.READY:
            return "loading"
        return "holding" if self.candidate.holds else "ready"

    def _standing(self) -> dict[str, Any]:
        said = {"state": self.state, "hash": self.hash, "deployed": self.deployed, "sequence": self._newest[0]}
        said["candidate"] = self.candidate.deployment if self.candidate is not None else ""
        absent = self._absences.seen(self._team, self.scheduler.now, lambda: engines(self.middleware))
        said |= {"absent": absent, "warnings": self.warn.lines()}
        return {**said, "now": self._time.now / SECOND, **progress(self.running)}

    def _refused(self, reason: str, deployment: str) -> None:
        if not deployment:
            self._note(f"refused: {reason}")
        else:
            self._refusals["report" if deployment.startswith(PLAIN) else "answer"](f"refused: {reason}")

    def _note(self, text: str, what: str = "report") -> None:
        """Tell whoever looks at this engine. Of an answer whoever asked is told as well."""
        from fame.robot import Event

        self._on_report(Event(self.scheduler.now, self.robot, 0, 0, "", what, text))

    def _warned(self, text: str) -> None:
        """For whoever looks at this engine, and for who observes its mission."""
        from fame.robot import Event

        tell = self._on_report if self.running is None else self.running.tell
        tell(Event(self._time.now, self.robot, 0, 0, "", "report", text))

    # ---- what it is told -------------------------------------------------------------------------------------------

    def _heard(self, message: Any) -> None:
        said = ""
        try:
            envelope = read_envelope(message.data, self.robot, self._wall_time())
            said = envelope.deployment
            if self._trusted:
                self._verify(envelope)
        except DeploymentError as error:
            self.status.say("refused", said, str(error))
            return
        if envelope.phase in ("load", "run"):
            self._take(envelope)
        elif envelope.phase == "ask":
            self._asked(envelope)
        elif self._next is not None and self._next.deployment == said:
            if envelope.phase == "abort":
                self._next = None
                self.status.answer("aborted", said)
        elif self.candidate is None or self.candidate.deployment != said:
            self.status.again(said, otherwise=_NONE)
        else:
            self._decide(self.candidate, Told(envelope.phase, envelope.begun))

    def _check_done(self, done: Done) -> None:
        """Raises DeploymentError for what a person did if keys are used and it was not signed for this robot."""
        if self._signers:
            verify(asdict(done), self._signers, self._wall_time(), self.born)
            if done.robot != self.robot:
                raise DeploymentError(f"meant for robot {done.robot!r}, not for {self.robot!r}")

    def _verify(self, envelope: Envelope) -> None:
        """Raises DeploymentError unless a trusted key says it; another robot asks with what its own sender signed."""
        if envelope.phase != "ask":
            verify(asdict(envelope), self._trusted, self._wall_time(), self.born)
            return
        verify_signature(envelope.proof, self._trusted)
        if (envelope.proof.get("deployment"), envelope.proof.get("sequence")) != (
            envelope.deployment,
            envelope.sequence,
        ):
            raise DeploymentError("asks about another deployment than was signed")

    def _asked(self, envelope: Envelope) -> None:
        """Another robot wants to know what became of a deployment, since its sender fell silent."""
        said, candidate = envelope.deployment, self.candidate
        started = said == self.deployed or self.status.answered(said) == "started"
        ours = candidate if candidate is not None and candidate.deployment == said else None
        if ours is not None and ours.stage is Stage.LEAVING:
            return  # it is about to start, and says so then
        answer = reply(ours.commit if ours is not None else None, started=started)
        reason = ""
        if answer == "aborted":
            reason = f"{_SILENT}; it was not ready here"
            self._never(envelope, reason)
        self.status.say(answer, said, reason)

    def _never(self, envelope: Envelope, reason: str) -> None:
        """Neither take a deployment that is not ready here, nor let it become so."""
        self._newest = max(self._newest, envelope.order)
        if self._next is not None and self._next.deployment == envelope.deployment:
            self._next = None
            self.status.answer("aborted", envelope.deployment, reason)
        elif self.candidate is not None and self.candidate.deployment == envelope.deployment:
            self.drop("aborted", reason)

    def _take(self, envelope: Envelope) -> None:
        """A model: it waits its turn, as the newest."""
        said = envelope.deployment
        under_way = [other.deployment for other in (self._next, self.candidate) if other is not None]
        newest = max(self._newest, self._next.order if self._next is not None else self._newest)
        if envelope.phase == "load" and (said in under_way or self.status.answered(said)):
            self.status.again(said)
        elif envelope.phase == "load" and envelope.order <= newest:
            self.status.say("stale", said, f"sequence {envelope.sequence} is older than {newest[0]}")
        else:
            if self._next is not None:
                self.status.answer("superseded", self._next.deployment)
            else:
                self.scheduler.soon(self._load_next, Kind.RESUMPTION)
            self._next = envelope

    def _decide(self, candidate: Candidate, told: Told) -> None:
        """The word of its sender on what is loaded."""
        if candidate.stage is Stage.READY:
            candidate.happen(told)
            self._ask_for_room()
        elif candidate.stage is Stage.LOADING and told.phase == "abort":
            self.drop("aborted")
        elif candidate.stage is Stage.LOADING and told.phase == "start":
            reason = "it is not ready: the ends of others are not there yet"
            self.status.say("refused", candidate.deployment, reason)

    def _ask_for_room(self) -> None:
        """Whoever is ready for one thing may wish another, but has given its word."""
        candidate = self.candidate
        if self._next is not None and candidate is not None and candidate.stage is Stage.READY:
            self.status.say("superseded", candidate.deployment, _NEWER)

    # ---- one process after the other -------------------------------------------------------------------------------

    def _load_next(self) -> None:
        if self._next is None or self._loading:
            return
        if self.candidate is not None and self.candidate.stage is not Stage.LOADING:
            self._ask_for_room()
            return
        envelope = self._next  # it waits on, so a newer one takes its place, and its sender may abort it
        self.drop("superseded")
        self._newest = max(self._newest, envelope.order)
        self._loading = True
        task = load(envelope.model, self.robot, scheduler=self._time, middleware=self.middleware, **self._options)
        Work(self.scheduler, task, partial(self._loaded, envelope))

    def _loaded(self, envelope: Envelope, process: RobotNode | FameError) -> None:
        self._loading = False
        if self._next is not envelope:
            if not isinstance(process, FameError):
                process.close()
            self._load_next_soon()
            return
        self._next = None
        if isinstance(process, FameError):
            self.status.answer("refused", envelope.deployment, str(process))
            return
        self.candidate = Candidate(
            envelope, process, self, node=self.node, scheduler=self.scheduler, middleware=self.middleware
        )
        self.candidate.begin()

    def ready(self, candidate: Candidate) -> None:
        """It gives its word."""
        self.status.answer("ready", candidate.deployment)

    def hold(self, candidate: Candidate, first: bool) -> None:
        """The sender fell silent, and so did others: hold in the safe state, and let no newer one wait."""
        why = f"holds deployment {candidate.deployment}: {candidate.why}"
        if first:
            if self.running is not None:
                self.running.hold()
            self._note(why)
        if self._next is not None:
            waiting, self._next = self._next, None
            self.status.answer("refused", waiting.deployment, f"{why}; fame abort {self.robot} ends that")

    def report(self, candidate: Candidate) -> None:
        """Say that it holds, and why."""
        self.status.say("asking", candidate.deployment, candidate.why)

    def start(self, candidate: Candidate) -> None:
        """The candidate takes the place of what runs, whose scripts may leave before."""
        candidate.replace(self.running, self._run_candidate)

    def _run_candidate(self) -> None:
        candidate, self.candidate = self.candidate, None
        assert candidate is not None
        self._close_running()
        envelope, self.running = candidate.envelope, candidate.process
        self.hash, self.deployed, self._team = envelope.hash, envelope.deployment, envelope.team
        self.running.start()
        reason = "it had this process before, and takes it up again from the start" if envelope.again else ""
        if reason:
            self._note(reason)
        self.status.answer("started", envelope.deployment, reason)
        self._load_next_soon()

    def drop(self, answer: str, reason: str = "") -> None:
        """Forget the candidate; what runs goes on."""
        candidate, self.candidate = self.candidate, None
        if candidate is not None:
            candidate.close()
            if self.running is not None:
                self.running.release()
            self.status.answer(answer, candidate.deployment, reason)
            self._load_next_soon()

    def _load_next_soon(self) -> None:
        if self._next is not None:
            self.scheduler.soon(self._load_next, Kind.RESUMPTION)

    def _close_running(self) -> None:
        """Scripts may have had the last word while they left: the robot's safe state comes after it."""
        if self.running is not None:
            self.running.make_safe("terminated")
            self.running.close()

    # ---- the end ---------------------------------------------------------------------------------------------------

    def stop(self) -> bool:
        """Cancel what runs and take no more; whether scripts are still leaving, which `close` would not wait for."""
        if not self._stopped:
            self._stopped = True
            self.status.close()
            self._process.close()
            self._tasks.close()
            for refusals in self._refusals.values():
                refusals.close()
            waiting, self._next = self._next, None
            if waiting is not None:
                self.status.answer("aborted", waiting.deployment, "the engine ends")
            ready = self.candidate is not None and self.candidate.stage is Stage.READY
            self.drop("left" if ready else "aborted", "the engine ends")  # who is ready has promised not to abort
            if self.running is not None:
                self.running.stop()
        return self.running is not None and self.running.leaving

    def close(self) -> None:
        """Stop safely and leave."""
        self.stop()
        self._close_running()
        self.node.close()
