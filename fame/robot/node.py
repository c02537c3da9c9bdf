"""The robot's node: host of one engine, with the endpoints, scripts and timers that the process needs.

`RobotNode` is the host of one engine. Endpoints of every topic that the process and its scripts name are made at load,
before the first token moves. A message that comes in is one stimulus; a script's step is one; a timer is one. What
the robot publishes itself is heard by its own catchers inside the engine, since the middleware drops own samples.
"""

from __future__ import annotations

import difflib
from collections import deque
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from datetime import datetime
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from fame.bpmn import model
from fame.bpmn.model import CallActivity, Expression, Process, Task
from fame.clock import EPOCH, SECOND, Kind, Scheduler, WallScheduler, date_at, date_text
from fame.engine import Engine, Instance, Program, compile_program
from fame.engine.host import Compiled
from fame.engine.state import Trail
from fame.errors import MessageError, MissionError, ModelError
from fame.middleware import messages
from fame.middleware.interface import Middleware, resolve
from fame.robot.endpoints import Ends
from fame.robot.events import Event, Observer, by_trails
from fame.robot.gaps import Gaps
from fame.robot.mission import Mission
from fame.robot.scripts import Scripts
from fame.robot.service_tasks import ask, asking_task
from fame.robot.services import BuiltInService, ServiceContext, compile_service
from fame.robot.timers import Timers
from fame.robot.waiting_tokens import Wait, waits_of
from fame.scripting import (
    compile_expression,
    compile_script,
    error_line,
    script_topics,
)

Ahead = Literal["", "endless", "due"]
"""What is still to come of the timers of start events: nothing, nothing but cycles without end, or more."""

_POLL = SECOND // 50  # between two looks whether scripts are out
_EARLY = 1000
"""How many messages are kept for a process that is loaded and has not been started."""


class RobotNode:
    """A robot's engine. `load` makes it ready, `start` lets it begin; it lives until `close`.

    observer   gets every `Event`, if given; the program is compiled for it
    safe_state (topic, type, fields) to publish when the robot is to be safe
    safe_suspended  the same while its mission is suspended, if it is not `safe_state`
    epoch      the date of the scheduler's time 0: what dates of timers and `robot.date` are counted from
    strict     an undefined name in a payload is an error, not a warning
    until      when the run ends at the latest (ns): dates and cycles that are due later are reported
    keep       how many instances to remember (all by default); counted are all, in `started`, `completed`, `failed`
    on_end     called with each instance that has ended
    built_in_services  services that run as long as their service task, by name (`fame.robot.services`)
    compiled   False leaves that to whoever makes it: `compile_process`, in any thread, then `assemble`
    """

    def __init__(
        self,
        name: str,
        mission: Mission,
        *,
        scheduler: Scheduler,
        middleware: Middleware,
        namespace: str | None = None,
        observer: Observer | None = None,
        on_report: Callable[[Event], object] | None = None,
        safe_state: Sequence[tuple[str, str, Mapping[str, Any]]] = (),
        safe_suspended: Sequence[tuple[str, str, Mapping[str, Any]]] | None = None,
        strict: bool = False,
        epoch: datetime = EPOCH,
        until: int | None = None,
        keep: int | None = None,
        on_end: Callable[[Instance], object] = lambda instance: None,
        built_in_services: Mapping[str, BuiltInService] = MappingProxyType({}),
        compiled: bool = True,
    ) -> None:
        self.name, self.mission, self.scheduler, self.strict = name, mission, scheduler, strict
        self.namespace = name if namespace is None else namespace
        self.middleware = middleware
        self.node = middleware.node("fame_engine", self.namespace)
        self.safe_state, self.epoch = safe_state, epoch
        self.safe_suspended = safe_state if safe_suspended is None else safe_suspended
        self._observer, self._on_report = observer, on_report or (lambda event: None)
        self._hear = by_trails(observer) if observer is not None else None
        self.instances: list[Instance] = []
        self.started = self.completed = self.failed = self._elements = 0
        self._keep, self._on_end, self._built_in_services = keep, on_end, built_in_services
        self._seen: dict[Hashable, int] = {}  # resting token -> when `waits` saw it first
        self.missed: dict[str, int] = {}  # topic -> when its last message came for which nobody waited (ns)
        self.gaps = Gaps()
        self._timers = Timers(scheduler, epoch, self._fire)
        self._until, self._told_late = until, set[str]()
        self._lacking: set[tuple[str, str]] = set()
        self._ends = Ends(self.node, mission.types, middleware, scheduler)
        self._early: deque[tuple[str, Any]] | None = deque(maxlen=_EARLY)  # heard between `load` and `start`
        self.scripts = Scripts(self, self._ends)
        self.runner = self.scripts.runner
        self.engine: Engine
        if compiled:
            self._assemble_or_close()

    # ---- life ----------------------------------------------------------------------------------------------------

    def _assemble_or_close(self) -> None:
        try:
            self.assemble(self.compile_process())
        except Exception:  # nobody has the robot yet who could close it
            self.close()
            raise

    def compile_process(self) -> Program:
        """The program of its process. Touches no endpoint, so any thread may do it. Raises ModelError."""
        mission = self.mission
        homes = {mission.definitions.file: mission.definitions}

        def library(name: str, file: str, call: CallActivity) -> tuple[Process, str]:
            home, process = mission.library.find(homes[file], call)
            homes[home.file] = home
            return process, home.file

        return compile_program(
            mission.process,
            host=self,
            library=library,
            file=mission.definitions.file,
            observed=self._observer is not None,
        )

    def assemble(self, program: Program) -> None:
        """Make the engine of what `compile_process` gave."""
        self.engine = Engine(program, self, self.scripts.variables)
        if isinstance(self.scheduler, WallScheduler):
            self.engine.at_once = True  # all that happens has a time of its own

    def load(self) -> None:
        """Make every endpoint that the process and its scripts name. Raises MessageError, ModelError."""
        self._ends.open(self._heard)
        self._ends.open_named(self._all_scripts(), self.runner.inbox)

    def _all_scripts(self) -> Iterator[Expression]:
        mission = self.mission
        for _, process in mission.library.closure(mission.definitions, mission.process):
            for node in process.body.walk():
                if isinstance(node, Task) and node.script is not None:
                    yield node.script

    def start(self, variables: Mapping[str, Any] | None = None) -> None:
        """Let the process begin; `variables` are those of the instance that starts by itself."""
        self.engine.begin(dict(variables or {}))
        self.runner.poll()
        early, self._early = self._early or (), None
        for topic, message in early:
            self._heard(topic, message)

    def hold(self) -> None:
        """Suspend all that goes on, in the safe state, until `release`. Does nothing the second time."""
        self.engine.hold()
        self.runner.poll()

    def release(self) -> None:
        """Go on after `hold`, as soon as its scripts are out. Does nothing without one."""
        if self.engine.held is not None and self.leaving:
            self.scheduler.after(_POLL, self.release, Kind.RESUMPTION)
        elif self.engine.held is not None:
            self.engine.release()
            self.runner.poll()

    def stop(self) -> None:
        """Cancel all that goes on and bring the robot to its safe state."""
        self.engine.stop()

    @property
    def leaving(self) -> bool:
        """After `stop`: whether scripts are still in ``finally``; their grace bounds it."""
        return self.runner.at_work

    def close(self) -> None:
        """Leave: scripts are closed, timers forgotten, endpoints gone."""
        self.scripts.close()
        self._timers.close()
        self._ends.addressed.close()
        self.node.close()

    # ---- what people ask -----------------------------------------------------------------------------------------

    @property
    def ahead(self) -> Ahead:
        """Whether a timer will still start an instance."""
        starts = self.starts_due()
        if not starts:
            return ""
        return "endless" if all(map(self._timers.is_endless, starts)) else "due"

    @property
    def elements(self) -> int:
        """How many elements have been completed."""
        return self._elements + sum(sum(instance.counts[1:]) for instance in self.engine.instances.values())

    @cached_property
    def conditions(self) -> dict[tuple[str, str], Expression]:
        """What conditional events wait for, by file and id."""
        mission = self.mission
        return {
            (home.file, node.id): definition.condition
            for home, process in mission.library.closure(mission.definitions, mission.process)
            for node in process.body.walk()
            if isinstance(node, model.Event)
            for definition in node.definitions
            if isinstance(definition, model.ConditionalDefinition) and definition.condition is not None
        }

    def starts_due(self) -> dict[int, int]:
        """The timers of start events that are still to fire, by key, and when they are due next (ns)."""
        times = {key: self._timers.due(key) for key in self.engine.armed_starts}
        return {key: time for key, time in times.items() if time is not None}

    def waits(self) -> list[Wait]:
        """Every resting token, and what it waits for; starts that wait for their first trigger if nothing runs."""
        return waits_of(self, self._seen)

    def complete(self, element: str, values: Mapping[str, Any] | None = None) -> None:
        """Somebody did what a user, manual or receive task waits for. Raises MissionError if none waits there."""
        self.engine.complete_task(element, dict(values or {}))
        self.runner.poll()

    def activate(self, element: str) -> None:
        """Let an element of an ad-hoc sub-process that is open begin. Raises MissionError if none is."""
        self.engine.activate(element)
        self.runner.poll()

    def offers(self) -> list[str]:
        """The ids of what `activate` could let begin now."""
        return self.engine.offers()

    def deliver(self, topic: str, value: Any) -> None:
        """A message from outside on a topic, as if it had come over the middleware.

        Raises MessageError if it does not fit the type, and for a topic that no event or script of the model names.
        """
        full = resolve(topic, self.namespace)
        name, heard = self._ends.qualified(full), self.runner.inbox.types
        if name is None and full not in heard:
            self._expect_topic(full)
        type = (self.mission.types[name].declared if name is not None else None) or heard.get(full)
        message = messages.create(type, value) if type is not None else value
        if name is not None:
            self._heard(name, message)
        self.runner.inbox.deliver(full, message)

    def _expect_topic(self, full: str) -> None:
        scripts = (topic for script in self._all_scripts() for topic in script_topics(script))
        named = {resolve(topic.name, self.namespace) for topic in scripts if topic.direction not in ("call", "act")}
        if full not in named:
            known = sorted({*named, *(resolve(name, self.namespace) for name in self.mission.types)})
            similar = difflib.get_close_matches(full, known, 1) or known
            raise MessageError(f"no event or script of the model names topic {full}; known are: {', '.join(similar)}")

    # ---- stimuli -------------------------------------------------------------------------------------------------

    def _heard(self, topic: str, message: Any) -> None:
        if self._early is not None:
            self._early.append((topic, message))
            return
        if topic in self.engine.listeners:
            self.missed.pop(topic, None)
        else:
            self.missed[topic] = self.scheduler.now
        self.engine.deliver(topic, message)
        self.runner.poll()

    def _fire(self, key: int, last: bool) -> None:
        self.engine.timer_fired(key, last=last)
        self.runner.poll()

    # ---- the host ------------------------------------------------------------------------------------------------

    def compile(self, expression: Expression, *, element: str, file: str, script: bool = False) -> Compiled:
        """See `fame.engine.host.Host`, here and below."""
        if script:
            return compile_script(expression, file=file, element=element)
        return compile_expression(
            expression, file=file, element=element, warn=partial(self.report, element), strict=self.strict
        )

    def service(self, operation: str, *, element: str, file: str) -> Compiled:
        mission, services = self.mission, self.mission.services
        if operation in services:
            return services[operation]
        if operation in self._built_in_services:
            return compile_service(self._built_in_services[operation].start, self._service_context(element))
        closure = mission.library.closure(mission.definitions, mission.process)
        found = asking_task((process for home, process in closure if home.file == file), element)
        if found is not None:
            return ask(*found, file=file, inbox=self.runner.inbox, compile=self.compile)
        known = ", ".join(sorted(services) or sorted(self._built_in_services)) or "none"
        raise ModelError(f"calls the service {operation!r}; known are: {known}", file=file, element=element)

    def _service_context(self, element: str) -> ServiceContext:
        return ServiceContext(
            robot=self.name,
            namespace=self.namespace,
            middleware=self.middleware,
            scheduler=self.scheduler,
            folder=Path(self.mission.definitions.file).parent,
            report=partial(self.report, element),
            changed=self.runner.poll,
        )

    def publish(self, topic: str, value: Any) -> Any:
        full, message = self._ends.throw(topic, value)
        self.runner.inbox.deliver(full, message)
        return message

    def send(self, topic: str, value: Any, robot: Any) -> None:
        self._ends.addressed.send(topic, value, robot)

    def meet(self) -> None:
        """Make the ends towards single robots, as far as these are there."""
        self._ends.addressed.meet()

    def set_timer(self, key: int, kind: str, text: str) -> None:
        self._timers.set(key, kind, text)
        due = self._timers.due(key)
        if kind != "duration" and due is not None and self._until is not None and due > self._until:
            self._tell_late(self.engine.timed(key).id, f"{kind} timer {text}", due, self._until)

    def _tell_late(self, element: str, timer: str, due: int, until: int) -> None:
        """Say once of an element that its timer will not fire in this run."""
        if element not in self._told_late:
            self._told_late.add(element)
            first, last, moment = (date_text(date_at(self.epoch, time)) for time in (0, until, due))
            self.report(element, f"{timer} is due at {moment}, and the run goes from {first} to {last}: see epoch")

    def cancel_timer(self, key: int) -> None:
        self._timers.cancel(key)

    def run(self, key: int, script: Any) -> None:
        self.runner.start(key, script)

    def cancel(self, key: int) -> bool:
        return self.runner.cancel(key)

    def make_safe(self, reason: str) -> None:
        for topic, type, fields in self.safe_suspended if reason == "suspended" else self.safe_state:
            full = resolve(topic, self.namespace)
            self._ends.publisher(full, type).publish(messages.create(type, fields))

    def observe(self, trail: Trail) -> None:
        if self._hear is not None:
            self._hear(self.scheduler.now, self.name, trail)

    def begun(self, instance: Instance) -> None:
        self.started += 1
        self.instances.append(instance)
        if self._keep is not None:
            del self.instances[: -self._keep]

    def tell(self, event: Event) -> None:
        """Something that is no step of a token: for reports, and for whoever observes."""
        self._on_report(event)
        if self._observer is not None:
            self.engine.observe()
            self._observer(event)

    def report(self, element: str, text: str) -> None:
        self._on_report(Event(self.scheduler.now, self.name, 0, 0, element, "report", text))

    def lacks(self, element: str, output: str) -> None:
        text = f"has ended, and nothing has set its output {output}"
        if self.strict:
            raise NameError(text)
        if (element, output) not in self._lacking:
            self._lacking.add((element, output))
            self.report(element, text)

    def ended(self, instance: Instance) -> None:
        """Say of a failed instance which robot it was, and the line of the script."""
        error = instance.error
        if error is not None:
            file, line = self._script_line(error)
            located = MissionError(
                error.text, robot=self.name, element=error.element, file=file, line=line, code=error.code
            )
            located.__cause__ = error.__cause__
            instance.error = located
        self._elements += sum(instance.counts[1:])
        self.completed += instance.status == "completed"
        self.failed += instance.status == "failed"
        self._on_end(instance)
        self.scripts.forget(instance.root_variables)

    def _script_line(self, error: MissionError) -> tuple[str, int]:
        """Where in which file a script raised the error; else the line of the element."""
        cause = error.__cause__
        if cause is not None:
            for file in sorted({node.file for node in self.engine.program.nodes}):
                line = error_line(cause, file)
                if line:
                    return file, line
        return error.file, error.line
