"""The host of one robot's engine: the implementation of `fame.engine.host.Host`.

Messages go to the middleware, timers to the scheduler, scripts to their runner, and events of the run to the observer.
Methods without a docstring are those of `fame.engine.host.Host`.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from fame.bpmn.model import Expression, Task
from fame.clock import Scheduler, date_at, date_text
from fame.engine import Engine, Instance
from fame.engine.program import Compiled
from fame.engine.state import Trail, Wait
from fame.errors import MissionError, ModelError
from fame.imports import require
from fame.middleware import messages
from fame.middleware.interface import Middleware, Node, Publisher, resolve
from fame.robot.endpoints import Endpoints
from fame.robot.events import Event, Observer, observer_of
from fame.robot.mission import Mission
from fame.robot.options import RobotOptions
from fame.robot.scripts import Scripts
from fame.robot.service_tasks import call_service, make_client, ros_service_task
from fame.robot.services import ServiceContext, compile_service
from fame.robot.timers import RobotTimers
from fame.rooms import SERVICES, load
from fame.scripting import Inbox, Runner, compile_expression, compile_script, error_line

if TYPE_CHECKING:
    from fame.robot.acknowledged import AcknowledgedSignals


class Outbox(Protocol):
    """Takes the effects of an engine, and sends them later (`fame.robot.durable`)."""

    def signal(self, publisher: Publisher, message: Any) -> None:
        """Send a signal, or a message to all robots."""

    def message(self, topic: str, value: Any, robot: Any) -> None:
        """Send a message to one robot. Raises BpmnError ``unreachable``, MessageError."""

    def once_written(self, send: Callable[[], object]) -> None:
        """Call this when what has happened so far is on the disk; never, if the engine ends before."""

    def at_once(self) -> AbstractContextManager[None]:
        """Record all that a block does at once."""

    def instance_ended(self, instance: Instance) -> None:
        """Record the end of an instance."""

    def task_cancelled(self, key: int) -> None:
        """Forget the requests of a task that is cancelled."""

    def note(self, text: str) -> None:
        """Add a line for people to the next record."""


_BLIND = "its monitor, which is blind"
"""Why a mission is held."""


class EngineHost:
    """The host of one engine. `engine` is to be set before the first stimulus; `recorder` takes its effects, if set."""

    runner: Runner
    inbox: Inbox

    def __init__(
        self,
        robot: str,
        mission: Mission,
        node: Node,
        middleware: Middleware,
        scheduler: Scheduler,
        endpoints: Endpoints,
        options: RobotOptions,
    ) -> None:
        self.engine: Engine
        self.instances: list[Instance] = []
        self.started: int = 0
        self.completed: int = 0
        self.failed: int = 0
        self.elements_done: int = 0  # of instances that have ended
        self._robot, self._mission, self._node, self._options = robot, mission, node, options
        self._middleware, self._scheduler, self._endpoints = middleware, scheduler, endpoints
        self.recorder: Outbox | None = None
        self.unanswered: dict[Wait, tuple[str, bytes]] = {}  # tasks suspended before their call or goal has ended
        self.acknowledged: AcknowledgedSignals | None = None
        self.on_suspended: Callable[[Engine], object] = lambda engine: None
        self.observer: Observer | None = observer_of(options.observer) if options.observer is not None else None
        self.observed: bool = True
        self.scripts: Scripts = Scripts(
            robot,
            node,
            scheduler,
            endpoints,
            options,
            report=self.report,
            log=self._log,
            send=self._send,
            missing=self._field_missing,
        )
        self.runner, self.inbox = self.scripts.runner, self.scripts.runner.inbox
        self.timers: RobotTimers = RobotTimers(scheduler, options.epoch, self._on_timer)
        self._asks: list[tuple[Task, str]] = []  # the compiled tasks that call a service or action, and their files
        self.blind: dict[str, str] = {}  # monitors that cannot judge, and why
        self.hold: Callable[[str], object] = lambda reason: None  # the mission, until `release`
        self.release: Callable[[str], object] = self.hold
        self._held_for: dict[str, Callable[[], object]] = {}  # monitors that the mission waits for, and their ends
        self._late: set[str] = set()  # elements whose timer was reported as too late
        self._known_missing: set[tuple[str, str]] = set()

    # ---- texts and services ------------------------------------------------------------------------------------------

    def compile(self, expression: Expression, *, element: str, file: str, script: bool = False) -> Compiled:
        return (compile_script if script else compile_expression)(expression, file=file, element=element)

    def service(self, operation: str, *, element: str, file: str) -> Compiled:
        services, starts = self._mission.services, self._options.service_starts
        if operation in services:
            return services[operation]
        if operation in starts:
            return compile_service(starts[operation], self._service_context(element))
        if operation in SERVICES:
            require(*SERVICES[operation].packages)
            return compile_service(load(SERVICES[operation].start), self._service_context(element))
        processes = (process for home, process in self._mission.processes() if home.file == file)
        task = ros_service_task(processes, element)
        if task is not None:
            self._asks.append((task[1], file))
            return call_service(*task, file=file, compile=self.compile)
        known = ", ".join(sorted(services) or sorted({*SERVICES, *starts}))
        raise ModelError(f"unknown service {operation!r}; known are: {known}", file=file, element=element)

    def make_clients(self) -> None:
        """Make the clients of all tasks that call a service or action of ROS. Raises ModelError."""
        for task, file in self._asks:
            make_client(task, file, self.inbox)

    def _service_context(self, element: str) -> ServiceContext:
        return ServiceContext(
            robot=self._robot,
            namespace=self._node.namespace,
            middleware=self._middleware,
            scheduler=self._scheduler,
            folder=self._options.files or Path(self._mission.definitions.file).parent,
            report=partial(self.report, element),
            changed=self.scripts.on_changed,
            signals=self.scripts.signals,
            blind=partial(self._on_blind, element),
        )

    def _on_blind(self, element: str, name: str, reason: str | None, end: Callable[[], object] | None) -> None:
        self.blind = {**self.blind, name: reason or ""}
        if not reason:
            del self.blind[name]
        if reason is not None:
            text = f"the monitor is blind: {reason}" if reason else "the monitor sees"
            self.emit(Event(self._scheduler.now, self._robot, 0, 0, element, "report", text))
        if end is not None and reason:
            self._held_for[name] = end
            self.hold(_BLIND)
        elif self._held_for.pop(name, None) is not None and not self._held_for:
            self.release(_BLIND)

    # ---- messages ----------------------------------------------------------------------------------------------------

    def publish(self, topic: str, value: Any) -> Any:
        publisher, message = self._endpoints.prepare(topic, value)
        self._send(publisher, message)
        self.inbox.deliver(publisher.topic, message)
        return message

    def send(self, topic: str, value: Any, robot: Any) -> None:
        if self.acknowledged is not None and topic in self.acknowledged.outgoing:
            self.acknowledged.send(topic, value, robot)
        elif self.recorder is None:
            self._endpoints.direct.send(topic, value, robot)
        else:
            self.recorder.message(topic, value, robot)

    def _send(self, publisher: Publisher, message: Any) -> None:
        """Publish a signal, also one that a script raises."""
        if self.acknowledged is not None:
            self.acknowledged.throw(publisher.topic, message)
        if self.recorder is None:
            publisher.publish(message)
        else:
            self.recorder.signal(publisher, message)

    def make_safe(self, reason: str) -> None:
        options = self._options
        if reason == "suspended":
            self.on_suspended(self.engine)
        suspended = reason == "suspended" and options.safe_suspended is not None
        for topic, type, fields in (options.safe_suspended or ()) if suspended else options.safe_state:
            full = resolve(topic, self._node.namespace)
            self._endpoints.publisher(full, type).publish(messages.create(type, fields))

    # ---- timers and scripts ------------------------------------------------------------------------------------------

    def set_timer(self, key: int, kind: str, text: str) -> None:
        self.timers.set(key, kind, text)
        due, until = self.timers.due(key), self._options.until
        if due is None:
            self._report_late(key, f"{kind} timer {text} never fires: its last time was before {self._date()}")
        elif kind != "duration" and until is not None and due > until:
            run = f"the run goes from {self._date(0)} to {self._date(until)}"
            self._report_late(key, f"{kind} timer {text} is due at {self._date(due)}, and {run}: see epoch")

    def cancel_timer(self, key: int) -> None:
        self.timers.cancel(key)

    def run(self, key: int, script: Any) -> None:
        self.runner.start(key, script)

    def cancel(self, key: int) -> bool:
        wait = self.engine.waits.get(key)
        if wait is not None and wait.paused and (made := self.runner.unanswered(key))[0]:
            self.unanswered = {one: known for one, known in self.unanswered.items() if one.alive} | {wait: made}
        if self.recorder is not None:
            self.recorder.task_cancelled(key)
        return self.runner.cancel(key)

    def _on_timer(self, key: int, last: bool) -> None:
        self.engine.timer_fired(key, last=last)
        self.runner.poll()

    def _report_late(self, key: int, text: str) -> None:
        """Report once for each element that its timer will not fire in this run."""
        element = self.engine.timed(key).id
        if element not in self._late:
            self._late.add(element)
            self.report(element, text)

    def _date(self, time: int | None = None) -> str:
        return date_text(date_at(self._options.epoch, self._scheduler.now if time is None else time))

    # ---- observation -------------------------------------------------------------------------------------------------

    def observe(self, trail: Trail) -> None:
        if self.observer is not None and self.observed:
            self.observer.trail(self._scheduler.now, self._robot, trail)

    def report(self, element: str, text: str) -> None:
        if self._options.on_report is not None:
            self._options.on_report(self._event(element, "report", text))

    def emit(self, event: Event) -> None:
        """Pass on an event that is not a step of a token, to reports and observer."""
        if self._options.on_report is not None:
            self._options.on_report(event)
        if self.observer is not None:
            self.engine.observe()  # first what happened before
            self.observer(event)

    def _log(self, level: str, text: str) -> None:
        self.emit(self._event("", "log", f"{level}: {text}" if level != "info" else text))

    def _event(self, element: str, what: str, text: str) -> Event:
        return Event(self._scheduler.now, self._robot, 0, 0, element, what, text)

    def output_missing(self, element: str, output: str) -> None:
        self._missing(element, output, f"has ended, and nothing has set its output {output}")

    def _field_missing(self, element: str, field: str, error: NameError) -> None:
        self._missing(element, field, f"{field}: {error}", "; left at its default")

    def _missing(self, element: str, name: str, text: str, instead: str = "") -> None:
        """Report once that a value is missing, and what takes its place. Raises NameError if names are strict."""
        if self._options.strict:
            raise NameError(text) from None
        if (element, name) not in self._known_missing:
            self._known_missing.add((element, name))
            self.report(element, text + instead)

    # ---- instances ---------------------------------------------------------------------------------------------------

    def begun(self, instance: Instance) -> None:
        self.started += 1
        self.instances.append(instance)

    def ended(self, instance: Instance) -> None:
        if instance.error is not None:
            instance.error = self._located(instance.error)
            if self.observer is not None:  # for recordings: whoever runs the mission prints the error itself
                self.engine.observe()
                self.observer(self._event(instance.error.element, "report", instance.error.text))
        self.elements_done += sum(instance.counts[1:])
        self.completed += instance.status == "completed"
        self.failed += instance.status == "failed"
        if self.recorder is not None:
            self.recorder.instance_ended(instance)
        self._options.on_end(instance)
        if self.acknowledged is not None and instance.status == "failed":
            self.acknowledged.on_failed()
        self.scripts.forget(instance.root_variables)
        if len(self.instances) - len(self.engine.instances) > self._options.keep:
            self.instances.remove(next(each for each in self.instances if each.status != "running"))

    def _located(self, error: MissionError) -> MissionError:
        """The error of an instance with the robot, and the line of the script that raised it."""
        file, line = self._script_line(error)
        located = MissionError(
            error.text, robot=self._robot, element=error.element, file=file, line=line, code=error.code
        )
        located.__cause__ = error.__cause__
        return located

    def _script_line(self, error: MissionError) -> tuple[str, int]:
        """The file and line in which a script raised an error; else those of the element."""
        cause = error.__cause__
        if cause is not None:
            for file in sorted({node.file for node in self.engine.program.nodes}):
                line = error_line(cause, file)
                if line:
                    return file, line
        return error.file, error.line

    def close(self) -> None:
        """Close scripts, and cancel timers."""
        for end in self._held_for.values():
            end()
        self.scripts.close()
        self.timers.close()
