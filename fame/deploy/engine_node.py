"""The robot's end of a deployment as a node: it receives processes, runs one, and replaces it by the next.

`fame.deploy.robot_protocol` decides; here are the topics, the loading, the timers and the signatures around it.
"""

from __future__ import annotations

import shutil
import socket
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from fame.clock import SECOND, Entry, Kind, Scheduler, Turns
from fame.deploy.envelope import (
    PLAIN,
    PROCESS_QOS,
    SIZE,
    STRING,
    Envelope,
    Problem,
    Report,
    engines,
    read_envelope,
)
from fame.deploy.history import History
from fame.deploy.lifecycle import Lifecycle
from fame.deploy.loading import LEAVING, LoadedCandidate, LoadingTask, Work, load
from fame.deploy.machine import ProtocolMachine, unexpected
from fame.deploy.migration import Foreseen, foresee, migrate_robot
from fame.deploy.options import EngineOptions
from fame.deploy.request_verifier import RequestVerifier
from fame.deploy.requests import TaskRequest, TaskServer
from fame.deploy.resumed_mission import ResumedMission
from fame.deploy.resumption import StateKeeper
from fame.deploy.robot_protocol import step
from fame.deploy.robot_state import (
    AskOthers,
    AwaitEndpoints,
    AwaitSender,
    Discard,
    Drop,
    Forget,
    Hold,
    Kept,
    Load,
    LoadDue,
    Loaded,
    Mapped,
    MapState,
    Matched,
    Observe,
    Promise,
    Promised,
    Received,
    Replace,
    Replaced,
    Reply,
    RobotAction,
    RobotDeployment,
    RobotEvent,
    RunCandidate,
    ScheduleLoad,
    SetAside,
    Started,
    Stopped,
    resumed,
)
from fame.deploy.signing import Identity
from fame.deploy.status import Absences, EngineWarnings, LostEnds, RateLimiter, StatusPublisher, progress, state_of
from fame.deploy.termination import Ready, Silence
from fame.errors import DeploymentError, FameError
from fame.middleware.interface import ENGINE, LATCHED, Middleware, Node
from fame.middleware.simulated_time import ClockFollower
from fame.randomness import new_seed, robot_random
from fame.robot.clock_server import ClockServer
from fame.robot.robot_state import EVENTS_TOPIC, MODEL_TOPIC
from fame.rooms import DIAGNOSTICS, LOG_SERVER, MARKERS, load as load_room

if TYPE_CHECKING:
    from random import Random

    from fame.engine.state import Instance
    from fame.robot import RobotNode
    from fame.robot.live import LiveFeed

_DEPLOYMENT, _PROMISE, _DISK, _MEMORY = "deployment", "promise", "disk", "memory"
"""Why a mission is suspended: for `RobotNode.hold`."""
_RESERVE = 16_000_000
"""Memory that is kept for the moment in which no other is left, and is to be there before a mission goes on (bytes)."""
_END_PERIOD = SECOND // 10
"""Least time between two reports because of instances that have ended (ns)."""


class EngineNode:
    """A robot's engine: receive a process, run it, replace it by the next one.

    Raises FameError, from the scheduler's `run`, if an older engine of the same robot reports before this one has a
    process.
    """

    node: Node

    def __init__(
        self,
        robot: str,
        *,
        scheduler: Scheduler,
        middleware: Middleware,
        options: EngineOptions | None = None,
    ) -> None:
        options = options or EngineOptions()
        self._trusted, self._wall_time = options.trusted, options.wall_time
        self.robot: str = robot
        self.scheduler: Scheduler = scheduler
        self.middleware: Middleware = middleware
        time = options.time
        if time is None:  # a scheduler with nothing to do is false
            time = scheduler if scheduler.is_simulated else Turns(scheduler)
        self._time = time
        random = self._random(new_seed() if options.seed is None else options.seed)
        self._options = replace(options, on_end=self._on_end, random=random)
        self._on_report = options.on_report or (lambda event: None)
        self.born: int = round(self._wall_time() * SECOND)
        self._verifier = RequestVerifier(
            robot, self.born, options.trusted, options.wall_time, unsigned_tasks=options.unsigned_tasks
        )
        self.running: RobotNode | None = None
        self.candidate: LoadedCandidate | None = None
        self._loaded: RobotNode | None = None  # on its way to be a candidate
        self._foreseen = "", Foreseen()  # deployment, and what would become of what runs
        self._history = History()
        self._before = ""  # the hash of the model that runs
        self._anew = ""  # why a candidate did not take over what ran
        self._keeper: StateKeeper | None = None
        if options.state is not None:
            self._keeper = StateKeeper(options.state, robot, scheduler, self._on_disk_trouble, options.wall_time)
        self._trouble = ""  # why the state cannot be written
        self._unsure = ""  # why its mission stays suspended until a new deployment
        self._reserve, self._no_memory = bytearray(_RESERVE), ""
        self._memory_check: Entry | None = None
        self._life = 0  # counts how often all was forgotten
        self._resumed: ResumedMission | None = None
        self._protocol: ProtocolMachine[RobotDeployment, RobotEvent, RobotAction] = ProtocolMachine(
            RobotDeployment(robot, born=self.born), step, self._perform
        )
        self._absences, self._lost_ends = Absences(), LostEnds()
        self._end_report: Entry | None = None
        self._end_reported = -_END_PERIOD
        self._stopped = False
        self._feed: LiveFeed | None = None
        self._open_endpoints((options.identity or Identity.new()) if options.trusted else None)
        scheduler.on_no_memory = self._on_no_memory

    def _random(self, seed: int) -> Random:
        """The random numbers of what the robot runs from now on."""
        self._seed = seed
        return robot_random(seed, self.robot)

    def _open_endpoints(self, identity: Identity | None) -> None:
        """Make the node with its subscription, services and status; reports are signed by `identity`."""
        self.node: Node = self.middleware.node(ENGINE, self.robot, "deployment")
        self._process = self.node.subscription("bpmn_process", STRING, self._on_envelope, PROCESS_QOS)
        self._process.max_size = SIZE
        self._live = self.node.publisher(EVENTS_TOPIC, STRING), self.node.publisher(MODEL_TOPIC, STRING, LATCHED)
        self.warn: EngineWarnings = EngineWarnings(self.middleware, self._process.topic, self._on_warning)
        self.status: StatusPublisher = StatusPublisher(
            self.node,
            self.scheduler,
            self._progress,
            verifier=self._verifier,
            identity=identity,
            warnings=self.warn,
            on_refusal=self._on_refusal,
            note=self._note,
            on_report=self._watch_reports(),
        )
        self._process.on_dropped = lambda warning: self.status.publish(
            "refused", reason=str(warning), cause=warning.kind
        )
        self._refusals = {
            kind: RateLimiter(self.scheduler, partial(self._note, kind=kind)) for kind in ("answer", "report")
        }  # of senders that wait for an answer, and of bare models
        self._failures = RateLimiter(self.scheduler, partial(self._note, kind="answer"))
        self._clock_server = ClockServer(self.node, lambda: self._time.now, self._options.epoch, self._machine)
        self._lifecycle: Lifecycle | None = None
        if self._options.lifecycle:
            acts = {"configure": self._expect_process, "activate": self._activate, "deactivate": self._deactivate}
            self._lifecycle = Lifecycle(
                self.node, {**acts, "shutdown": self._shut_down}, now=lambda: self._time.now, note=self._note
            )
        self._tasks = TaskServer(
            self.node,
            lambda: self.running,
            self._answer_task,
            self._verifier.verify_task,
            refuse=self._refuse_task,
            resuming=lambda: self.resuming,
            now=lambda: self.scheduler.now / SECOND,
            answers={} if self._keeper is None else self._keeper.answers,
        )
        if self._options.recordings is not None:
            load_room(LOG_SERVER)(self.node, self.robot, self._options.recordings, self._verifier.verify_request)
        self._resume()
        self.status.begin()

    def _answer_task(self, answer: str, id: str, reason: str = "", *, cause: str = "") -> None:
        """Answer a request once what it did is on the disk, and the answer with it; or say that it is not."""
        stored = self._keeper is not None and id in self._keeper.answers
        recorder = self.running.host.recorder if self.running is not None and stored else None
        if recorder is not None and self._trouble and answer != "refused":
            lost = f"it is lost in a crash before its state can be written: {self._trouble}"
            self.status.publish(answer, id, "; ".join(filter(None, (reason, lost))), cause=cause)
        elif recorder is not None and not self._trouble:
            recorder.once_written(partial(self.status.publish, answer, id, reason, cause=cause))
        else:
            self.status.publish(answer, id, reason, cause=cause)

    def _watch_reports(self) -> Callable[[Report], None]:
        """What passes reports on, also to ``/diagnostics`` and RViz if somebody wants it."""
        watchers = list(self._options.on_status)
        if self._options.diagnostics:
            watchers.append(load_room(DIAGNOSTICS)(self.node, self._wall_time))
        if frame := self._options.markers:
            watchers.append(load_room(MARKERS)(self.node, frame, lambda: self.running))

        def pass_on(report: Report) -> None:
            for watcher in watchers:
                watcher(report)

        return pass_on

    @property
    def state(self) -> str:
        """See `Report`."""
        protocol = self._protocol.state
        if self.resuming:
            return "loading"
        if protocol.candidate is None:
            at_rest = "suspended" if self._why_suspended else state_of(self.running)
            return "loading" if protocol.loading is not None else at_rest
        if protocol.candidate.stage == "starting" and self._trouble:
            return "suspended"
        if protocol.candidate.stage == "promising":  # it waits to be activated
            return "ready"
        if protocol.candidate.stage != "ready":
            return "loading"
        return "holding" if protocol.candidate.asks else "ready"

    @property
    def _why_suspended(self) -> str:
        """Why the mission does not go on by itself, or nothing."""
        return f"its state cannot be written: {self._trouble}" if self._trouble else self._no_memory or self._unsure

    @property
    def deployed(self) -> str:
        """The id of the running deployment, or empty."""
        return self._protocol.state.deployed

    @property
    def hash(self) -> str:
        """The hash of the running model, or empty."""
        running = self._protocol.state.running
        return running.hash if running is not None else ""

    def _progress(self) -> dict[str, Any]:
        """The part of a `Report` beside the answer."""
        protocol = self._protocol.state
        team = protocol.running.team if protocol.running is not None else ()
        mission = progress(self.running)
        lost = self._lost_ends.texts(protocol.running, self.robot, self.scheduler.now, self.middleware)
        waits = mission.get("instances") or mission.get("waits")
        still_running = self.running.runner.cancelled.texts() if self.running is not None else ()
        blind = [f"the monitor is blind: {text}" for text in self.running.host.blind.values()] if self.running else ()
        behind = self.running.acknowledged.behind() if self.running and self.running.acknowledged else ()
        return {
            "state": self.state,
            "hash": self.hash,
            "deployed": self.deployed,
            "sequence": protocol.newest[0],
            "candidate": protocol.candidate.envelope.deployment if protocol.candidate is not None else "",
            "absent": self._absences.seen(team, self.scheduler.now, lambda: engines(self.middleware)),
            "warnings": [*(lost if waits else ()), *still_running, *blind, *behind, *self.warn.lines()],
            "now": self._time.now / SECOND,
            "previous": self._history.previous(),
            **mission,
            **({"error": self._why_suspended} if self._why_suspended else {}),
        }

    def _machine(self) -> Mapping[str, str | int]:
        """The name of its computer, how much is free where it keeps its state (bytes), and that time is simulated."""
        found: dict[str, str | int] = {"host": socket.gethostname()}
        if isinstance(self._time, ClockFollower):
            found["simulated"] = True
        if self._keeper is not None:
            with suppress(OSError):
                found["disk"] = shutil.disk_usage(self._keeper.directory.path).free
        return found

    def _on_refusal(self, reason: str, deployment: str, cause: str) -> None:
        if not deployment:
            self._note(f"refused: {reason}")
        else:
            self._refusals["report" if deployment.startswith(PLAIN) else "answer"](f"refused: {reason}", cause)

    def _on_end(self, instance: Instance) -> None:
        """Report it soon; many instances may end at a time."""
        if self._end_report is None or self._end_report.action is None:
            due = max(self.scheduler.now, self._end_reported + _END_PERIOD)
            self._end_report = self.scheduler.at(due, self._report_end, Kind.RESUMPTION)
        if instance.status == "failed":
            error = instance.error
            text = f"the mission has failed: {error or 'without a reason'}"
            self._failures(text, f"{error.element} {error.code}" if error is not None else "")

    def _report_end(self) -> None:
        self._end_reported = self.scheduler.now
        self.status.publish()

    def _note(self, text: str, kind: str = "report") -> None:
        """Report an event to the observer of this engine; an ``answer`` goes to the sender as well."""
        from fame.robot import Event

        self._on_report(Event(self._time.now, self.robot, 0, 0, "", kind, text))

    def _on_warning(self, text: str) -> None:
        """Report an event to the observer of this engine, or to those of its mission."""
        from fame.robot import Event

        observe = self._on_report if self.running is None else self.running.host.emit
        observe(Event(self._time.now, self.robot, 0, 0, "", "report", text))

    # ---- what it receives ------------------------------------------------------------------------------------------

    def _on_envelope(self, message: Any) -> None:
        if self._no_memory and self._keeper is not None:
            return  # it does not know what it has promised: it is as silent as an engine that has ended
        deployment = ""
        try:
            envelope = read_envelope(message.data, self.robot, self._wall_time())
            deployment = envelope.deployment
            self._verifier.verify_deployment(envelope)
            if envelope.recalls:
                envelope = self._history.recall(envelope)
            if envelope.phase in ("load", "run") and self.running is not None and self.running.suspension.holder:
                raise DeploymentError(f"{self.running.suspension.holder} steers the robot", cause="steered")
            if envelope.phase in ("load", "run") and self.status.is_contested:
                raise DeploymentError(f"another engine has the name {self.robot!r}: end one of them", cause="rival")
            if envelope.phase == "run" and not self._is_active:
                raise DeploymentError(f"it {self._asleep}, and a bare model would start at once", cause="lifecycle")
            self._protocol.handle(Received(envelope))
        except DeploymentError as error:
            self._refuse(deployment or error.about, str(error), error.cause)
        except FameError:
            raise
        except Exception as error:  # no message ends an engine
            self._refuse(deployment, unexpected(error), "error")

    def _refuse_task(self, request: TaskRequest) -> None:
        """Raise DeploymentError for a request that cannot be met now."""
        if request.act == "take_over" and self._protocol.state.candidate is not None:
            raise DeploymentError("a deployment is under way: nobody takes the robot over", cause="deployment")
        if self._no_memory:
            raise DeploymentError(f"{self._no_memory}, and its mission is held", cause="error")
        if request.act not in ("suspend", "note"):  # a robot may be stopped at any time
            self._refuse_promised()
        if request.act in ("continue", "fail") and not self._is_active:
            raise DeploymentError(f"it {self._asleep}: activate it", cause="lifecycle")

    # ---- its lifecycle ---------------------------------------------------------------------------------------------

    @property
    def _is_active(self) -> bool:
        return self._lifecycle is None or self._lifecycle.is_active

    @property
    def _asleep(self) -> str:
        return f"is {self._lifecycle.state} (--lifecycle)" if self._lifecycle is not None else ""

    @property
    def _waits_for_activation(self) -> bool:
        candidate = self._protocol.state.candidate
        return candidate is not None and candidate.stage == "promising"

    def _expect_process(self) -> None:
        """Raise DeploymentError unless a process runs or waits for activation."""
        if self.running is None and not self._waits_for_activation:
            raise DeploymentError("no process is loaded: deploy one first")

    def _activate(self) -> None:
        """Let what runs go on, and promise to start what is loaded. Raises FameError."""
        self._expect_process()
        if self.running is not None and (person := self.running.suspension.activate()):
            self._note(f"its mission stays suspended by {person}: fame continue {self.robot}")
        if self._waits_for_activation:
            self._perform(Promise())

    def _refuse_promised(self) -> None:
        """Raise DeploymentError while a deployment is decided: what runs fits the new process as it is."""
        state = self._protocol.state
        candidate = state.candidate
        waits = candidate is not None and candidate.envelope.migrate and candidate.stage == "promising"
        if state.promises or waits or (candidate is not None and candidate.has_promised):
            text = f"a deployment is under way, which it has promised to start; fame abort {self.robot} ends that"
            raise DeploymentError(text, cause="deployment")

    def _shut_down(self) -> None:
        """End what runs, in the safe state. Raises DeploymentError."""
        self._refuse_promised()
        if self.stop():
            self._note("scripts that cannot be interrupted have not ended yet")

    def _deactivate(self) -> None:
        """Suspend what runs. Raises DeploymentError."""
        self._refuse_promised()
        if self.running is not None:
            self.running.suspension.deactivate()

    def _suspend_inactive(self, process: RobotNode) -> None:
        """Suspend a process that begins without activation: it ran, or was promised, before this engine started."""
        if not self._is_active:
            process.suspension.deactivate()

    def _refuse(self, deployment: str, reason: str, cause: str) -> None:
        """Refuse a message. One about a deployment that is known here may be forged: it is no answer to the sender."""
        known = self._protocol.state.knows(deployment)
        self.status.publish("refused", "" if known else deployment, reason, cause=cause)

    # ---- what it does ----------------------------------------------------------------------------------------------

    def _perform(self, action: RobotAction) -> None:
        """Carry out an action of the protocol. Those on the candidate come only while there is one."""
        match action:
            case Reply():
                deployment, foreseen = self._foreseen
                asked = action.answer in ("ready", "previewed") and action.deployment == deployment
                waits = not action.answer and self._waits_for_activation
                self.status.publish(
                    action.answer,
                    action.deployment,
                    action.reason or (f"{self._asleep}, and waits to be activated" if waits else ""),
                    action.problem,
                    migration=foreseen.to_json() if asked else None,
                    repeated=action.repeated,
                    cause="model" if action.problem is not None else "",
                )
            case Observe(text):
                self._note(text)
            case ScheduleLoad():
                self.scheduler.soon(partial(self._protocol.handle, LoadDue()), Kind.RESUMPTION)
            case Load(envelope):
                Work(self.scheduler, self._loading(envelope), partial(self._on_loaded, self._life))
            case Discard():
                self._discard()
            case AwaitEndpoints(envelope):
                self._match(envelope)
            case Forget(deployment):
                self._decided(deployment)
            case Hold():
                if self.running is not None:
                    self.running.hold(_DEPLOYMENT)
            case Drop():
                if (candidate := self.candidate) is not None:
                    if candidate.process.acknowledged is not None:
                        candidate.process.acknowledged.leave()
                    self._close_candidate()
                    self._decided(candidate.envelope.deployment)
            case SetAside():
                self._close_candidate()
            case _ if self.candidate is not None:
                self._perform_on(self.candidate, action)

    def _perform_on(self, candidate: LoadedCandidate, action: RobotAction) -> None:
        match action:
            case Promise() if self._is_active:
                self._protocol.handle(Promised(self._keeper.promise(candidate) if self._keeper is not None else ""))
            case AwaitSender(seconds):
                candidate.await_sender(seconds, partial(self._on_silence, candidate, seconds))
            case AskOthers():
                candidate.ask_others(self._protocol.handle)
            case MapState():
                self._map_state(candidate, self.scheduler.now + LEAVING)
            case Replace():
                old = self.running
                if self._keeper is not None:
                    self._keeper.stop()  # a crash before the next one is on the disk leaves this one as it was
                ends = not self._migrates(candidate)
                if ends and old is not None and old.acknowledged is not None:
                    old.acknowledged.end()
                candidate.replace(old, partial(self._protocol.handle, Replaced()), stop=ends)
            case RunCandidate():
                self._run(candidate)

    def _on_silence(self, candidate: LoadedCandidate, seconds: float) -> None:
        """Ask the others, once the next engine would know that; until then the robot waits."""
        error = self._keeper.keep_asking(candidate.envelope.deployment) if self._keeper is not None else ""
        if error:
            self._note(error)
            candidate.await_sender(seconds, partial(self._on_silence, candidate, seconds))
        else:
            self._protocol.handle(Silence())

    def _run(self, candidate: LoadedCandidate) -> None:
        """Start the candidate's process, or let it take over the state of what runs, when that is on the disk."""
        before, self._before, self._anew = self._before, candidate.envelope.hash, ""
        migrates = self._migrates(candidate)
        go_on, timers = self._take_over(candidate, before) if migrates else (candidate.process.start, None)
        if self.running is not None and self.running.acknowledged is not None and not migrates:
            self.running.acknowledged.report_owed()
            self.running.acknowledged.leave(candidate.process.acknowledged)
        if self.running is not None:
            runner = candidate.process.runner
            runner.cancelled.take_up(self.running.runner.cancelled.table(), runner.inbox.action)
        self._close_running("suspended" if migrates else "terminated")
        self.running = None
        start = partial(self._start, candidate, go_on, migrates)
        self._trouble = self._unsure = ""
        if self._keeper is not None:
            self._keeper.begin(candidate.envelope, candidate.process, start, timers, self._history.replaced())
        else:
            start()

    def _start(self, candidate: LoadedCandidate, go_on: Callable[[], object], migrates: bool) -> None:
        self.running, self.candidate = candidate.process, None
        if self._feed is not None:
            self._feed.begin(self.running, resumed=migrates)
        envelope = candidate.envelope
        self._history.begin(envelope)
        if envelope.who and not migrates:  # a migration says so itself
            self._on_warning(f"deployed model {envelope.hash[:12]} by {self._verifier.sender(envelope)}")
        go_on()
        self._suspend_inactive(self.running)
        self._protocol.handle(Started("; ".join(filter(None, (self._anew, *candidate.apart.values())))))

    def _migrates(self, candidate: LoadedCandidate) -> bool:
        """Whether what runs goes over to a candidate."""
        return candidate.envelope.migrate and self.running is not None

    def _map_state(self, candidate: LoadedCandidate, until: int) -> None:
        """As soon as the scripts of what runs have left, find out whether its state fits the candidate."""
        if self.candidate is not candidate:
            return
        preview = candidate.envelope.preview
        if self.running is not None and not preview:
            self.running.hold(_DEPLOYMENT)
        busy = self.running is None or (self.running.leaving and not preview)  # it may be resuming
        if busy and self.scheduler.now < until:
            self.scheduler.after(SECOND // 50, partial(self._map_state, candidate, until), Kind.TIMER)
        elif self.running is None:
            self._protocol.handle(Mapped("it is still resuming what it ran before"))
        else:
            try:
                foreseen = foresee(candidate.process, self.running, candidate.envelope.plan, self.hash)
            except Exception as error:  # a plan from elsewhere, and values of any kind: what runs goes on
                self._protocol.handle(Mapped(f"the state cannot be mapped: {type(error).__name__}: {error}"))
                return
            self._foreseen = candidate.envelope.deployment, foreseen
            self._protocol.handle(Mapped(foreseen.blocked))

    def _take_over(self, candidate: LoadedCandidate, before: str) -> tuple[Callable[[], object], dict[str, Any] | None]:
        """Transfer the state of what runs, of the model `before`, to the candidate's process.

        Returns what lets it go on, and the timers that this sets; None for them if it starts from its beginning.
        """
        assert self.running is not None
        envelope = candidate.envelope
        forced = ", whatever the exploration finds (--force)" if envelope.plan.get("forced") else ""
        text = f"migrated from model {before[:12]} to {envelope.hash[:12]} by {self._verifier.sender(envelope)}{forced}"
        try:
            return migrate_robot(candidate.process, self.running, envelope.plan, text)
        except MemoryError:
            raise
        except Exception as error:  # as somebody has moved a token since it was found to fit: others have started
            self._anew = f"starts from the beginning: {error}"
            return candidate.process.start, None

    def _loading(self, envelope: Envelope) -> LoadingTask[RobotNode]:
        """The task that loads a process, which tells what happens in it."""
        from fame.robot.events import combine_observers
        from fame.robot.live import LiveFeed
        from fame.robot.options import Membership

        options = self._options
        if self._feed is None:
            self._feed = LiveFeed(
                *self._live, self.scheduler, session=self.born, epoch=options.epoch, seed=self._seed, log=options.log
            )
        own = self._feed.observer()
        both = combine_observers([own, options.observer]) if options.observer is not None else own
        membership = Membership(uuid4().hex, envelope.receivers, frozenset(envelope.team), max(0, envelope.sequence))
        options = replace(options, observer=both, membership=membership)
        return load(envelope.model, self.robot, options, scheduler=self._time, middleware=self.middleware)

    def _on_loaded(self, life: int, result: RobotNode | FameError) -> None:
        if life != self._life:  # nobody waits for it any more
            if not isinstance(result, FameError):
                result.close()
        elif isinstance(result, FameError):
            self._protocol.handle(Loaded(str(result), Problem.of(result)))
        else:
            self._loaded = result
            self._protocol.handle(Loaded())

    def _discard(self) -> None:
        if self._loaded is not None:
            self._loaded.close()
            self._loaded = None

    def _match(self, envelope: Envelope) -> None:
        assert self._loaded is not None
        self.candidate = LoadedCandidate(
            envelope, self._loaded, node=self.node, scheduler=self.scheduler, middleware=self.middleware
        )
        self._loaded = None
        self.candidate.match(partial(self._on_matched, self.candidate))

    def _on_matched(self, candidate: LoadedCandidate, missing: Sequence[str]) -> None:
        promised = [text for topic, text in candidate.apart.items() if topic in candidate.envelope.promises]
        self._protocol.handle(Matched(tuple(missing), tuple(promised)))

    def _close_candidate(self) -> None:
        candidate, self.candidate = self.candidate, None
        if candidate is not None:
            candidate.close()

    def _decided(self, deployment: str) -> None:
        """Drop the promise for a deployment, and let the mission go on unless another one holds it."""
        if self._keeper is not None and not self._stopped:
            self._keeper.drop_promise(deployment)
        if self.running is not None and not self._protocol.state.holds:
            self.running.release(_DEPLOYMENT)

    def _close_running(self, safe: str) -> None:
        """Close what runs. The safe state is commanded last: scripts that end may have sent other commands."""
        if self._resumed is not None:
            self._resumed.drop()
        if self.running is not None:
            self.running.host.make_safe(safe)
            self.running.close()

    # ---- what was running when the engine ended ----------------------------------------------------------------------

    @property
    def resuming(self) -> bool:
        """Whether a stored mission is being loaded, or waits for its topics."""
        return self._resumed is not None and self._resumed.under_way

    def _resume(self) -> None:
        """Load what was running. Raises ConfigError for a state that cannot be used."""
        if self._keeper is None:
            return
        self._resumed = ResumedMission(
            self._keeper,
            node=self.node,
            scheduler=self.scheduler,
            middleware=self.middleware,
            time=self._time,
            load=self._loading,
            begin=self._begin_again,
            ended=self._on_resumed,
        )
        envelope = self._resumed.read(self._trusted)
        if envelope is not None:
            self._protocol.state, self._before = resumed(self.robot, envelope, self.born), envelope.hash
            self._history = History(self._keeper.before(envelope, self._trusted))
            self._history.begin(envelope)
        self._read_promises()
        if envelope is None:
            self._keep_promise()
        else:
            self._options = replace(self._options, random=self._random(new_seed()))  # not again what was drawn before
            self._resumed.resume()

    def _begin_again(self, process: RobotNode, missing: Sequence[str]) -> None:
        if missing:
            self._note(f"continues without {', '.join(missing)}, not discovered in time")
        self.running = process
        if self._feed is not None:
            self._feed.begin(process, resumed=True)
        self._suspend_inactive(process)

    def _on_resumed(self) -> None:
        if self.running is not None and self._protocol.state.holds:
            self.running.hold(_DEPLOYMENT)
        if self._unsure and self.running is not None:  # others may run what it cannot read any more
            self.running.hold(_PROMISE)
        else:
            over = self.running is not None and self.running.is_over
            self._note("its mission had ended" if over else "continues its mission")
        self._keep_promise()

    def _keep_promise(self) -> None:
        """Load what the engine before had promised to start: its sender, or the others of its team, decide."""
        state = self._protocol.state
        if state.promises and not (state.waiting or state.loading or state.candidate):
            self._protocol.handle(Received(state.promises[-1].envelope))

    def _read_promises(self) -> None:
        """Read what the engine before had promised to start and does not run: nothing else is taken before it."""
        assert self._keeper is not None
        envelopes, lost = self._keeper.promised(self._trusted)
        if lost:  # others of its team are told that it does not know
            self._unsure = f"what it had promised to start is lost: {lost}; deploy again"
            self._note(self._unsure)
        runs = self._protocol.state.running
        if runs is not None:
            self._keeper.forget_promises(runs.order)
            envelopes = [envelope for envelope in envelopes if envelope.order > runs.order]
        asking = {one.deployment for one in envelopes[:-1]} | self._keeper.asking  # what was set aside had asked
        ready = [Ready(frozenset(one.team) - {self.robot}, asking=True) for one in envelopes]
        promises = (
            Kept(one, its if one.deployment in asking else None) for one, its in zip(envelopes, ready, strict=True)
        )
        self._protocol.state = replace(self._protocol.state, promises=tuple(promises))

    def _on_disk_trouble(self, reason: str) -> None:
        """Hold the mission while its state cannot be written; an empty `reason` means that it can again."""
        running, self._trouble = self.running, reason
        self._note(
            f"holds: its state cannot be written: {reason}" if reason else "continues: its state can be written again"
        )
        if running is not None:
            self.scheduler.soon(partial(running.hold if reason else running.release, _DISK), Kind.RESUMPTION)

    # ---- no memory -------------------------------------------------------------------------------------------------

    def _on_no_memory(self) -> None:
        """Hold the mission: a step of it may be half done. With a state on the disk it goes on from its last record."""
        self._reserve = bytearray()
        if self._stopped:
            return
        self._no_memory = "no memory is left"
        if self._memory_check is not None:
            self._memory_check.cancel()
        self._memory_check = self.scheduler.after(SECOND, self._check_memory, Kind.TIMER)
        running = self.running
        if self._keeper is not None:
            self._forget_all(self._keeper)
        elif running is not None and _MEMORY not in running.holds:
            self._unsure = "no memory was left in a step of its mission, which may be half done; deploy again"
            running.hold(_MEMORY)
        if running is not None:
            self._note("holds: no memory is left")

    def _forget_all(self, keeper: StateKeeper) -> None:
        """Forget what is not on the disk, as a crash does: nothing half done is to get there, or to be answered."""
        keeper.drop()
        self._trouble, self._life = "", self._life + 1
        self._discard()
        self._close_candidate()
        self._close_running("suspended")
        self.running = None
        runs = self._protocol.state.running
        self._protocol.state = RobotDeployment(self.robot, running=runs, born=self.born)

    def _check_memory(self) -> None:
        """Go on, if there is memory again. Raises MemoryError, and ConfigError as `_resume`."""
        self._reserve, self._no_memory = bytearray(_RESERVE), ""
        if self._keeper is not None:
            self._protocol.state = RobotDeployment(self.robot, born=self.born)
            self._options = replace(self._options, epoch=self._keeper.epoch_again(self._options))
            self._resume()

    # ---- the end ---------------------------------------------------------------------------------------------------

    def stop(self) -> bool:
        """Cancel what runs and take no more. Returns whether scripts still leave: `close` does not wait for them."""
        if not self._stopped:
            self._stopped = True
            self.status.close()
            self._process.close()
            self._tasks.close()
            for texts in (*self._refusals.values(), self._failures):
                texts.close()
            if self._resumed is not None:
                self._resumed.drop()
            if self._keeper is not None:
                self._keeper.stop()  # the mission does not end with this engine
            self._protocol.handle(Stopped())
            if self.running is not None:
                self.running.stop()
            if self._end_report is not None and self._end_report.action is not None:
                self._end_report.cancel()
                self._report_end()
        return self.running is not None and self.running.leaving

    def close(self) -> None:
        """Bring the robot to its safe state and close all endpoints."""
        self.scheduler.on_no_memory = None
        try:
            self.stop()
        finally:
            self._close_running("terminated")
            if self._feed is not None:
                self._feed.close()
            self.node.close()
