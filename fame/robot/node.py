"""The node of a robot: one engine, from loading its process to its end.

Endpoints of every topic that the process and its scripts name are made at load, before the first token moves. A message
is one stimulus of the engine; so is a step of a script, and a timer. What the robot publishes reaches its own catching
events inside the engine, since the middleware does not deliver a node's messages to itself. What the engine asks of the
world is in `fame.robot.host`.
"""

from __future__ import annotations

import difflib
from collections import defaultdict, deque
from collections.abc import Callable, Mapping
from datetime import datetime
from functools import partial
from itertools import count
from operator import itemgetter
from typing import TYPE_CHECKING, Any, Literal

from fame.bpmn.linked_forms import left_out, unfit_values
from fame.bpmn.model import CallActivity, Process
from fame.clock import SECOND, Kind, Scheduler
from fame.engine import BpmnError, Engine, Instance, Program, compile_program
from fame.engine.state import Wait
from fame.errors import MessageError, MissionError
from fame.middleware import messages
from fame.middleware.interface import ENGINE, MISSION, Middleware, Node, resolve
from fame.robot.endpoints import Endpoints, direct_topic
from fame.robot.events import Event
from fame.robot.host import EngineHost
from fame.robot.mission import Mission
from fame.robot.options import RobotOptions
from fame.robot.suspension import Suspension
from fame.robot.waiting_tokens import WaitingToken, WaitingTokens
from fame.scripting import Runner
from fame.scripting.requests import STILL_RUNNING

if TYPE_CHECKING:
    from fame.robot.acknowledged import AcknowledgedSignals

PendingStarts = Literal["", "endless", "due"]
"""The timers of start events that will still fire: none, only cycles without end, or others."""

_POLL = SECOND // 50
"""Interval in which `release` checks whether cancelled scripts have ended (ns)."""
_EARLY = 1000
"""Number of messages of each topic that are kept between `load` and `start`."""


INCIDENT = "incident"
"""Why a robot holds while there are incidents."""


def _given(values: Mapping[str, Any] | None) -> str:
    """The variables that a person sets, as text."""
    return "".join(f" {name}={value!r}" for name, value in (values or {}).items())


class RobotNode:
    """A robot's engine. `load` makes it ready, `start` starts its process; `close` ends it.

    compiled   False leaves compiling to the caller: `compile_process`, in any thread, then `assemble`

    Raises ModelError for a process that cannot be compiled.
    """

    mission: Mission
    scheduler: Scheduler
    middleware: Middleware

    def __init__(
        self,
        name: str,
        mission: Mission,
        *,
        scheduler: Scheduler,
        middleware: Middleware,
        options: RobotOptions | None = None,
        compiled: bool = True,
    ) -> None:
        options = options or RobotOptions()
        self._hold_errors = options.hold_errors
        self.holds: set[str] = set()  # the reasons
        self.name: str = name
        self.namespace: str = name
        self.mission, self.scheduler, self.middleware = mission, scheduler, middleware
        self.epoch: datetime = options.epoch
        self.node: Node = middleware.node(ENGINE, self.namespace, MISSION)
        self.engine: Engine
        self.endpoints: Endpoints = Endpoints(
            self.node, mission.types, middleware, scheduler, lambda text: self.host.report("", text)
        )
        self.acknowledged: AcknowledgedSignals | None = None
        if any(use.ttl for use in mission.types.values()):
            from fame.robot.acknowledged import AcknowledgedSignals

            self.acknowledged = AcknowledgedSignals(self, options.membership)
        self.host: EngineHost = EngineHost(name, mission, self.node, middleware, scheduler, self.endpoints, options)
        self.host.acknowledged = self.acknowledged
        self.host.hold, self.host.release = self.hold, self.release
        self.runner: Runner = self.host.runner
        self.runner.on_lost, self.runner.doubtful = self._on_lost_request, self._doubtful
        self.runner.cancelled.on_still_running = partial(self.raise_signal, f"~/{STILL_RUNNING}", "std_msgs/msg/String")
        self.waiting: WaitingTokens = WaitingTokens(name, mission, self.node, middleware, scheduler, self.runner)
        self.host.on_suspended = self.waiting.on_suspended
        self.suspension: Suspension = Suspension(self)
        self._observed = options.observer is not None
        self._arrivals = count()
        # Messages between `load` and `start`, each with its place: a sensor pushes out none but its own.
        self._early: defaultdict[str, deque[tuple[int, Any]]] | None = defaultdict(partial(deque, maxlen=_EARLY))
        if compiled:
            self._assemble_or_close()

    # ---- life --------------------------------------------------------------------------------------------------------

    def _assemble_or_close(self) -> None:
        try:
            self.assemble(self.compile_process())
        except Exception:  # the caller gets no robot to close
            self.close()
            raise

    def compile_process(self) -> Program:
        """Compile the process. Touches no endpoint, so any thread may call it (`tests/test_loading.py`). Raises
        ModelError."""
        mission = self.mission
        homes = {mission.definitions.file: mission.definitions}

        def library(name: str, file: str, call: CallActivity) -> tuple[Process, str]:
            home, process = mission.library.find(homes[file], call)
            homes[home.file] = home
            return process, home.file

        file = mission.definitions.file
        return compile_program(
            mission.process, host=self.host, library=library, file=file, texts=mission.hash, observed=self._observed
        )

    def assemble(self, program: Program) -> None:
        """Make the engine of a compiled program."""
        engine = Engine(program, self.host, self.host.scripts.variables)
        engine.at_once = not self.scheduler.is_simulated  # every event has a time of its own
        self.attach(engine)

    def attach(self, engine: Engine) -> None:
        """Drive this engine from now on: a new one, or one restored from a snapshot of the last, which may be in the
        middle of something: observers watch the robot anew."""
        self.engine = self.host.engine = self.host.scripts.engine = engine
        engine.on_incident = self._on_incident if self._hold_errors else None
        self.instances[:] = [engine.instances.get(instance.key, instance) for instance in self.instances]
        if self.host.observer is not None:
            self.host.scripts.on_step = self.host.observer.watch(self)

    def load(self) -> None:
        """Make every endpoint that the process and its scripts name. Raises MessageError, ModelError."""
        self.endpoints.open(self.on_message)
        self.endpoints.open_for_scripts(self.mission.script_topics, self.runner.inbox)
        self.host.make_clients()
        if self.acknowledged is not None:
            self.acknowledged.open()

    def connect(self) -> None:
        """Make the publishers towards single robots, as far as these are there."""
        self.endpoints.direct.connect()
        if self.acknowledged is not None:
            self.acknowledged.connect()

    def start(self, variables: Mapping[str, Any] | None = None) -> None:
        """Start the process. `variables` are those of the instance that its none start event begins."""
        self.engine.begin(dict(variables or {}))
        self.runner.poll()
        self._take_early()

    def go_on(self) -> None:
        """Deliver messages again after an engine was restored: first those received since `load`."""
        self.runner.poll()
        self._take_early()

    def forget_early(self) -> None:
        """Forget the messages received since `load`: the process from which this one takes over has had them."""
        if self._early is not None:
            self._early.clear()

    def _take_early(self) -> None:
        boxes: Mapping[str, deque[tuple[int, Any]]] = self._early or {}
        self._early = None
        if self.acknowledged is not None:
            self.acknowledged.begin()
        early = [(place, topic, message) for topic, box in boxes.items() for place, message in box]
        for _, topic, message in sorted(early, key=itemgetter(0)):
            self.on_message(topic, message)

    def hold(self, reason: str = "", *, safe: bool = True) -> None:
        """Suspend the mission until `release` is called for each reason; in the `safe` state, unless it is to go on at
        this instant."""
        self.holds.add(reason)
        self.engine.hold(safe=safe)
        self.runner.poll()

    def release(self, reason: str = "") -> None:
        """Continue after `hold`, as soon as its scripts have ended, unless there is another reason to hold."""
        self.holds.discard(reason)
        self._continue_unless_held()

    def _continue_unless_held(self) -> None:
        """Continue if nothing holds it: also not what began to while it waited for its scripts."""
        if self.holds or self.engine.held is None:
            return
        if self.leaving:
            self.scheduler.after(_POLL, self._continue_unless_held, Kind.RESUMPTION)
        else:
            self.engine.release()
            self.runner.poll()

    def stop(self, *, observed: bool = True) -> None:
        """Cancel everything, and bring the robot to its safe state. `observed`: observers hear what is cancelled."""
        self.host.observed = observed
        self.engine.stop()

    @property
    def leaving(self) -> bool:
        """After `stop`: whether scripts are still in ``finally``; their grace period bounds it."""
        return self.runner.at_work

    def close(self) -> None:
        """Close scripts, timers and all endpoints."""
        self.suspension.close()
        self.host.close()
        self.endpoints.direct.close()
        if self.acknowledged is not None:
            self.acknowledged.close()
        self.node.close()

    # ---- state -------------------------------------------------------------------------------------------------------

    @property
    def instances(self) -> list[Instance]:
        """The process instances, in the order of their starts: all that run, and of those that have ended the last
        (`fame.robot.options.RobotOptions.keep`)."""
        return self.host.instances

    @property
    def started(self) -> int:
        return self.host.started

    @property
    def completed(self) -> int:
        return self.host.completed

    @property
    def failed(self) -> int:
        return self.host.failed

    @property
    def has_failed(self) -> bool:
        """Whether the mission is over by a failure."""
        return self.host.failed > 0 and self.is_over

    @property
    def is_over(self) -> bool:
        """Whether nothing runs, and nothing will start."""
        engine = self.engine
        return not (engine.instances or engine.program.starts or engine.armed_starts or engine.waiting_starts)

    @property
    def elements(self) -> int:
        running = self.engine.instances.values()
        return self.host.elements_done + sum(sum(instance.counts[1:]) for instance in running)

    @property
    def pending_starts(self) -> PendingStarts:
        """Whether a timer will still start an instance."""
        if self.engine.waiting_starts:
            return "due"
        starts = self._starts_due()
        if not starts:
            return ""
        return "endless" if all(map(self.host.timers.is_endless, starts)) else "due"

    def _starts_due(self) -> dict[int, int]:
        """The timers of start events that will still fire: key -> when (ns)."""
        times = {key: self.host.timers.due(key) for key in self.engine.armed_starts}
        return {key: time for key, time in times.items() if time is not None}

    @property
    def start_topics(self) -> set[str]:
        """Full names of the topics on which a message of another node may start the process."""
        return {way(name, self.namespace) for name in self.engine.program.starts for way in (resolve, direct_topic)}

    def waiting_tokens(self, most: int | None = None) -> list[WaitingToken]:
        """Return the waiting tokens, at most `most`, and what each waits for.

        If nothing runs: the start events that wait for their trigger.
        """
        waiting = self.waiting.list(self.engine, most)
        due = {} if self.engine.instances else self._starts_due()
        return [*waiting, *self.waiting.starts(self.engine, due, epoch=self.epoch, by_message=not self.instances)]

    def untaken(self) -> dict[str, int]:
        """Return how many BPMN messages no event has taken, by full name of their topic."""
        return {resolve(topic, self.namespace): count for topic, count in self.engine.untaken.items() if count > 0}

    def offers(self) -> list[str]:
        """Return the ids of the elements that `activate` can start now."""
        return self.engine.offers()

    # ---- stimuli -----------------------------------------------------------------------------------------------------

    def complete(self, element: str, values: Mapping[str, Any] | None = None) -> bool:
        """Complete a user, manual or receive task, and set variables.

        Returns whether its token goes on at once, not after a suspension. Raises MissionError if no token waits there,
        and for a value that its form does not take.
        """
        if wrong := unfit_values(self.mission.flow_nodes(), element, values or {}):
            raise MissionError(wrong, robot=self.name, element=element)
        goes_on = self.engine.complete_task(element, dict(values or {}))
        self.runner.poll()
        return goes_on

    def left_out(self, element: str, values: Mapping[str, Any] | None = None) -> str:
        """Return what the form of a task requires and neither `values` nor a variable gives, as text; empty if nothing
        is."""
        keys = left_out(self.mission.flow_nodes(), element, values or {})
        without = [key for key in keys if self.engine.unset([key.partition(".")[0]])]
        return f"without {', '.join(without)}, which its form requires" if without else ""

    def others_at(self, element: str, act: str) -> int:
        """Return how many tokens a request could mean besides the first, which it takes
        (`fame.engine.Engine.others_at`)."""
        return self.engine.others_at(element, act)

    def activate(self, element: str) -> None:
        """Start an element of an open ad-hoc sub-process. Raises MissionError if it cannot start in any."""
        self.engine.activate(element)
        self.runner.poll()

    # ---- repair ------------------------------------------------------------------------------------------------------

    @property
    def incidents(self) -> list[tuple[str, str, str]]:
        """Elements that have failed and wait for repair: id, code of the error, text."""
        return [(wait.node.id, code, text) for wait, (code, text) in self.engine.incidents.items()]

    def retry(self, element: str, values: Mapping[str, Any] | None = None, *, who: str = "") -> None:
        """Set variables, and execute a failed element again. Raises MissionError if it has no incident."""
        self._repair(element, f"retried{_given(values)}", who, lambda: self.engine.retry(element, dict(values or {})))

    def set_variables(self, values: Mapping[str, Any], *, who: str = "") -> list[str]:
        """Set variables of the running instances. Returns those that none had. Raises MissionError if none runs."""
        new = self.engine.unset(values)
        self._repair("", f"set{_given(values)}", who, lambda: self.engine.set_variables(dict(values)))
        return new

    def move(self, source: str, target: str, *, who: str = "") -> None:
        """Move a token to another element of its scope. Raises MissionError if that is not possible."""
        self._repair(source, f"moved to {target}", who, lambda: self.engine.move(source, target))

    def skip(self, element: str, *, who: str = "") -> None:
        """Go on behind an element without its results. Raises MissionError if that is not possible."""
        self._repair(element, "skipped", who, lambda: self.engine.skip(element))

    def restart(self, element: str, *, who: str = "") -> None:
        """Cancel an element, and execute it from its beginning. Raises MissionError if no token is there."""
        self._repair(element, "restarted", who, lambda: self.engine.move(element, element))

    def fail(self, element: str, lease: str = "", *, who: str = "") -> None:
        """Raise an error at an element of a suspended mission, which continues (`Suspension.fail`)."""
        self._repair(element, "failed", who, lambda: self.suspension.fail(element, who, lease))

    def _repair(self, element: str, text: str, who: str, act: Callable[[], object]) -> None:
        """Execute a person's request, with a note in journal and event log. `act` may say what comes next."""
        note = f"{text} by {who}" if who else text
        self._record_note(element, note)
        if (following := act()) is not None:
            note = f"{note}, on to {following}"
        self._report(element, note)
        if not self.engine.incidents:
            self.release(INCIDENT)
        self.runner.poll()

    def note(self, element: str, text: str) -> None:
        """Report a request of a person in journal and event log."""
        self._record_note(element, text)
        self._report(element, text)

    def _record_note(self, element: str, text: str) -> None:
        if self.host.recorder is not None:
            self.host.recorder.note(f"{element}: {text}" if element else text)

    def _report(self, element: str, text: str) -> None:
        self.host.emit(Event(self.scheduler.now, self.name, 0, 0, element, "report", text))

    def _on_lost_request(
        self, key: int, element: str, text: str, again: Callable[[], object], fail: Callable[[BaseException], object]
    ) -> None:
        """The fate of a goal or service call is unknown: do what the property ``retry`` of its task says."""
        wait = self.engine.waits.get(key)
        element = wait.node.id if wait is not None else element
        retry = self.mission.retries().get(element, "safe")
        self.host.report(element, f"{text}; retry: {retry}")
        if retry == "safe":
            again()
        elif retry == "ask" and wait is not None and self.engine.on_incident is not None:
            self.scheduler.soon(partial(self.engine.keep_script, key, text, "lost"), Kind.RESUMPTION)
        else:
            fail(BpmnError("lost", text))

    def _doubtful(self, key: int, request: str) -> tuple[str, bytes]:
        """Return why a request of a task that begins again may have been done, if it may not simply be made again, and
        the id of its goal."""
        wait = self.engine.waits.get(key)
        made, goal = self.host.unanswered.get(wait, ("", b"")) if wait is not None else ("", b"")
        if wait is None or made != request:
            return "", b""
        del self.host.unanswered[wait]
        safe = self.mission.retries().get(wait.node.id, "safe") == "safe"
        return "" if safe else "its task was suspended before it was answered", goal

    def raise_signal(self, topic: str, type: str, value: Any) -> None:
        """Raise a signal inside this engine, if an event catches it: with `value` if its type, by default `type`, is
        that of one value."""
        if topic in self.engine.listeners or topic in self.engine.program.starts:  # its type is slow to load
            use = self.mission.types.get(topic)
            type = use.declared if use is not None and use.declared else type
            self.engine.deliver(topic, messages.create(type, value if messages.is_wrapper(type) else None))
            self.runner.poll()

    def _on_incident(self, wait: Wait) -> None:
        """An element has failed: hold the robot, as soon as this stimulus is over."""
        self.host.make_safe("suspended")
        _, text = self.engine.incidents[wait]
        self.host.emit(Event(self.scheduler.now, self.name, 0, 0, wait.node.id, "report", f"incident: {text}"))
        self.scheduler.soon(self._hold_for_incident, Kind.RESUMPTION)

    def _hold_for_incident(self) -> None:
        if self.engine.incidents:
            self.hold(INCIDENT)

    def deliver(self, topic: str, value: Any) -> None:
        """Deliver a message from outside, as if it had come over the middleware.

        Raises MessageError if it does not fit the type, and for a topic that no event or script of the model names.
        """
        full = resolve(topic, self.namespace)
        inbox, name = self.runner.inbox, self.endpoints.qualified(full)
        type = (self.mission.types[name].declared if name is not None else None) or inbox.type_of(full)
        if name is None and type is None:
            self._check_topic(full)
        message = messages.create(type, value) if type is not None else value
        if name is not None:
            self.on_message(name, message)
        inbox.deliver(full, message)

    def _check_topic(self, full: str) -> None:
        """Raise MessageError if no script names a topic."""
        topics = (topic for _, topic in self.mission.script_topics if topic.direction not in ("call", "act"))
        named = {resolve(topic.name, self.namespace) for topic in topics}
        if full not in named:
            known = sorted({*named, *(resolve(name, self.namespace) for name in self.mission.types)})
            similar = difflib.get_close_matches(full, known, 1) or known
            raise MessageError(f"no event or script of the model names topic {full}; known are: {', '.join(similar)}")

    def on_message(self, topic: str, message: Any) -> None:
        """Deliver a message on a topic of its events (the qualified name)."""
        if self._early is not None:
            self._early[topic].append((next(self._arrivals), message))
            return
        engine = self.engine
        listeners = engine.listeners.get(topic)
        self.waiting.on_message(topic, awaited=listeners is not None)
        correlated = [end for end in listeners or () if end.catch.keys] if topic in engine.program.messages else ()
        engine.deliver(topic, message)
        if correlated:
            self.waiting.on_uncorrelated(topic, [end.key for end in correlated if end.alive])
        self.runner.poll()
