"""The robot's end of a deployment: it takes a process, runs it, and takes the next one.

At any time one process runs at most, one is loaded at most (it waits for the ends of others, or for the word to start),
and one envelope waits at most to be looked at. Until the word to start, what runs is not touched.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND, Entry, Kind, Scheduler
from fame.deployment.abandoned import Inquiry
from fame.deployment.envelope import PROCESS_QOS, STATUS_QOS, STRING, Envelope, Report, read_envelope
from fame.deployment.loading import load, missing
from fame.deployment.tasks import Tasks
from fame.errors import DeploymentError, FameError
from fame.middleware import messages
from fame.middleware.interface import LATCHED, Middleware
from fame.signing import verify

if TYPE_CHECKING:
    from fame.library import Library
    from fame.node import Event, RobotNode, Service

MATCHING = 5.0
"""How long a robot waits for the other ends of its topics (s)."""
HEARTBEAT = 1.0
"""How often a robot repeats how it stands (s)."""
SILENCE = 5.0
"""After how long without a word from its sender a robot that is ready asks the others (s)."""
_POLL = 0.02
_LEAVING = 2.5  # s that scripts may take to leave, should their own clock stand
_ANSWERS = 100  # deployments whose answer is remembered


class EngineNode:
    """One robot's end: it takes a process, runs it, and takes the next one.

    `observer`, `safe_state` and others: as of `fame.node.RobotNode`. With `trusted` public keys it takes only what one
    of them signed; `wall_time` gives s since 1970. `time` is the scheduler of the mission if that is not `scheduler`:
    one of simulated time. `close` brings the robot to its safe state and leaves. Raises FameError, from the scheduler's
    `run`, when an older engine of the same robot makes itself heard.
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
        wall_time: Callable[[], float] = time.time,
        time: Scheduler | None = None,
    ) -> None:
        self._trusted, self._wall_time = trusted, wall_time
        self.robot, self.scheduler, self.middleware = robot, scheduler, middleware
        self._time = scheduler if time is None else time  # a scheduler with nothing to do is false
        self._options: dict[str, Any] = {
            "library": library,
            "services": services,
            "observer": observer,
            "on_report": on_report,
            "safe_state": safe_state,
            "safe_suspended": safe_suspended,
            "on_end": lambda instance: self.report(),
        }
        self._on_report = on_report or (lambda event: None)
        self.running: RobotNode | None = None
        self.hash = self.deployed = ""
        self.born = round(wall_time() * SECOND)
        self._loaded: tuple[Envelope, RobotNode] | None = None
        self._loading: Entry | None = None  # the next look whether the ends of others are there
        self._silence: Entry | None = None  # when the sender of what is loaded has been silent for too long
        self._inquiry: Inquiry | None = None
        self._starting: tuple[Envelope, RobotNode] | None = None  # until the scripts of the old process are out
        self._newest = -1  # sequence
        self._done: dict[str, tuple[str, str]] = {}  # deployment -> answer and reason
        self._waiting: Envelope | None = None
        self._stopped = False
        self._warned = len(middleware.warnings)
        self.node = middleware.node("fame_deployment", robot)
        self._status = self.node.publisher("bpmn_status", STRING, LATCHED)
        self.node.subscription("bpmn_status", STRING, self._met, STATUS_QOS)
        self._process = self.node.subscription("bpmn_process", STRING, self._heard, PROCESS_QOS)
        self._tasks = Tasks(self.node, lambda: self.running, self.report)
        self._beat()

    # ---- saying how it stands --------------------------------------------------------------------------------------

    @property
    def state(self) -> str:
        """See `Report`."""
        if self._starting is not None:
            return "loading"
        if self._loaded is not None:
            return "loading" if self._loading is not None else "ready"
        if self.running is None:
            return "waiting"
        if any(instance.status == "failed" for instance in self.running.instances[-1:]):
            return "failed"
        return "running" if self.running.engine.instances else "idle"

    def report(self, answer: str = "", deployment: str = "", reason: str = "") -> None:
        """Say how it stands, perhaps as an answer."""
        said = _progress(self.running) if self.running is not None else {}
        report = Report(
            robot=self.robot,
            state=self.state,
            hash=self.hash,
            deployed=self.deployed,
            deployment=deployment,
            answer=answer,
            reason=reason,
            born=self.born,
            now=self._time.now / SECOND,
            time=self.scheduler.now / SECOND,
            **said,
        )
        self._status.publish(messages.create(STRING, report.to_json()))

    def _beat(self) -> None:
        self.report()
        self._refuse_unread()
        self._pulse = self.scheduler.after(round(HEARTBEAT * SECOND), self._beat, Kind.TIMER)

    def _refuse_unread(self) -> None:
        """What the middleware could not even hand over: messages of another type, bytes that are none."""
        new = self.middleware.warnings[self._warned :]
        self._warned += len(new)
        for text in new:
            if text.startswith(f"{self._process.topic}:"):
                self.report("refused", reason=text)

    def _met(self, message: Any) -> None:
        """Somebody else speaks for this robot: the younger of the two leaves."""
        other = Report.from_json(message.data)
        if other is not None and 0 < other.born < self.born:
            raise FameError(f"there is an engine {self.robot!r} already; a robot has one")

    def _answer(self, answer: str, envelope: Envelope, reason: str = "") -> None:
        self._done[envelope.deployment] = answer, reason
        if len(self._done) > _ANSWERS:
            del self._done[next(iter(self._done))]
        self.report(answer, envelope.deployment, reason)

    # ---- what it is told -------------------------------------------------------------------------------------------

    def _heard(self, message: Any) -> None:
        said = ""
        try:
            envelope = read_envelope(message.data, self.robot)
            said = envelope.deployment
            if self._trusted:
                verify(asdict(envelope), self._trusted, self._wall_time())
        except DeploymentError as error:
            self.report("refused", said, str(error))
            return
        if envelope.phase in ("start", "abort", "hold"):
            self._decide(envelope)
        elif envelope.sequence >= 0 and (said in self._done or self._under_way(envelope)):
            answer, reason = self._done.get(said, ("", ""))
            self.report(answer, said, reason)
        elif 0 <= envelope.sequence < self._newest:
            self.report("stale", said, f"sequence {envelope.sequence} is older than {self._newest}")
        else:
            if self._waiting is not None:
                self._answer("superseded", self._waiting)
            elif self._starting is None:
                self.scheduler.soon(self._load_newest, Kind.RESUMPTION)
            self._waiting = envelope

    def _under_way(self, envelope: Envelope) -> bool:
        """Whether it is being dealt with already."""
        others = [self._waiting] if self._waiting is not None else []
        others += [pair[0] for pair in (self._loaded, self._starting) if pair is not None]
        return any(other.deployment == envelope.deployment for other in others)

    def _decide(self, envelope: Envelope) -> None:
        """Start or abort what is loaded, or wait on."""
        loaded = self._loaded
        if self._starting is not None and self._starting[0].deployment == envelope.deployment:
            return
        if self._waiting is not None and self._waiting.deployment == envelope.deployment:
            if envelope.phase == "abort":
                waiting, self._waiting = self._waiting, None
                self._answer("aborted", waiting)
        elif loaded is None or loaded[0].deployment != envelope.deployment:
            answer, reason = self._done.get(envelope.deployment, ("refused", "no such deployment is loaded here"))
            self.report(answer, envelope.deployment, reason)
        elif envelope.phase == "hold":
            self._listen()
        elif envelope.phase == "abort":
            self._drop_loaded("aborted")
        elif self._loading is None:
            self._begin()
        else:
            self.report("refused", envelope.deployment, "it is not ready: the ends of others are not there yet")

    # ---- loading ---------------------------------------------------------------------------------------------------

    def _load_newest(self) -> None:
        envelope, self._waiting = self._waiting, None
        if envelope is None:
            return
        self._drop_loaded("superseded")
        self._newest = max(self._newest, envelope.sequence)
        try:
            node = load(envelope.model, self.robot, scheduler=self._time, middleware=self.middleware, **self._options)
        except FameError as error:
            self._answer("refused", envelope, str(error))
            return
        self._loaded = (envelope, node)
        self._await_ends(envelope, self.scheduler.now + round(MATCHING * SECOND))

    def _await_ends(self, envelope: Envelope, until: int) -> None:
        """Ready when every promised end is there; without a promise, at once."""
        self._loading = None
        absent = missing(envelope.promises, self.robot, self.middleware)
        unheard = self.middleware.connecting(self._loaded[1].node) if self._loaded is not None else ()
        if (absent or unheard) and self.scheduler.now < until:
            again = partial(self._await_ends, envelope, until)
            self._loading = self.scheduler.after(round(_POLL * SECOND), again, Kind.TIMER)
        elif absent:
            self._drop_loaded("refused", f"nobody came to {', '.join(absent)} within {MATCHING:g} s")
        elif envelope.phase == "run":
            self._begin()
        else:
            self._listen()
            self._answer("ready", envelope)

    def _listen(self) -> None:
        """The sender of what is loaded spoke a moment ago."""
        self._stop_listening()
        self._silence = self.scheduler.after(round(SILENCE * SECOND), self._inquire, Kind.TIMER)

    def _stop_listening(self) -> None:
        if self._silence is not None:
            self._silence.cancel()
        if self._inquiry is not None:
            self._inquiry.close()
        self._silence = self._inquiry = None

    def _inquire(self) -> None:
        assert self._loaded is not None
        envelope = self._loaded[0]
        others = [robot for robot in envelope.team if robot != self.robot]
        self._inquiry = Inquiry(envelope.deployment, others, self.node, self.scheduler, self._abandoned)

    def _abandoned(self, started: bool) -> None:
        """The sender fell silent: do what the others did."""
        if started:
            self._begin()
        else:
            self._drop_loaded("aborted", f"the sender said nothing for {SILENCE:g} s, and nobody was told to start")

    def _drop_loaded(self, answer: str, reason: str = "") -> None:
        """Forget what is loaded; what runs goes on."""
        self._stop_listening()
        if self._loading is not None:
            self._loading.cancel()
            self._loading = None
        if self._loaded is not None:
            envelope, node = self._loaded
            self._loaded = None
            node.close()
            if answer:
                self._answer(answer, envelope, reason)

    def _begin(self) -> None:
        """Cancel the old process, and let the new one begin when the scripts of the old one are out."""
        self._stop_listening()
        self._starting, self._loaded = self._loaded, None
        if self.running is not None:
            self.running.stop()
        self._start(self.scheduler.now + round(_LEAVING * SECOND))

    def _start(self, until: int) -> None:
        assert self._starting is not None
        if self.running is not None and self.running.leaving and self.scheduler.now < until:
            self._loading = self.scheduler.after(round(_POLL * SECOND), partial(self._start, until), Kind.TIMER)
            return
        self._close_running()
        (envelope, self.running), self._starting, self._loading = self._starting, None, None
        self.hash, self.deployed = envelope.hash, envelope.deployment
        self.running.start()
        reason = "it had this process before, and takes it up again from the start" if envelope.again else ""
        if reason:
            from fame.node import Event

            self._on_report(Event(self.scheduler.now, self.robot, 0, 0, "", "report", reason))
        self._answer("started", envelope, reason)
        if self._waiting is not None:
            self.scheduler.soon(self._load_newest, Kind.RESUMPTION)

    def _close_running(self) -> None:
        """Scripts may have had the last word while they left: the robot's safe state comes after it."""
        if self.running is not None:
            self.running.make_safe("terminated")
            self.running.close()

    def stop(self) -> bool:
        """Cancel what runs and take no more; whether scripts are still leaving, which `close` would not wait for."""
        if not self._stopped:
            self._stopped = True
            self._pulse.cancel()
            self._process.close()
            self._tasks.close()
            self._loaded, self._starting = self._loaded or self._starting, None
            self._drop_loaded("")
            if self.running is not None:
                self.running.stop()
        return self.running is not None and self.running.leaving

    def close(self) -> None:
        """Stop safely and leave."""
        self.stop()
        self._close_running()
        self.node.close()


def _progress(node: RobotNode) -> dict[str, Any]:
    """The part of a report that tells how a process goes."""
    last = node.instances[-1].error if node.instances else None
    return {
        "instances": len(node.engine.instances),
        "started": node.started,
        "completed": node.completed,
        "failed": node.failed,
        "waits": [
            {"element": wait.element, "for": wait.text, "since": wait.since / SECOND, "topics": dict(wait.topics)}
            for wait in node.waits()
        ],
        "offers": node.offers(),
        "error": str(last) if last is not None else "",
    }
