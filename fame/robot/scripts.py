"""The scripts of one robot: the runner that drives them, and the interface that they find in scope.

What a script publishes reaches the robot's own catching events and waiting scripts too, as what an event throws does;
the middleware delivers it to all others.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND, Scheduler
from fame.engine import Engine
from fame.errors import MessageError
from fame.middleware import messages
from fame.middleware.interface import Node, Publisher, resolve
from fame.randomness import robot_random
from fame.robot.endpoints import Endpoints
from fame.robot.options import RobotOptions
from fame.rooms import JAVASCRIPT_HOST, load
from fame.scripting import Robot, Runner, another
from fame.scripting.interface import interface
from fame.scripting.languages import HOST_API, MISSING
from fame.text import topic_of

if TYPE_CHECKING:
    from fame.scripting.languages import JavaScriptHost


class Scripts:
    """The scripts of one robot.

    runner      drives the steps of scripts that wait
    engine      to be set before the first script runs
    on_step     called when a script has gone on and waits again: variables may have changed
    robot       name of the robot, and its `node`
    options     those of the robot: its random numbers, and the date of the scheduler's time 0
    report      (element, text): takes what a person should know
    log         (level, text): takes the lines that scripts log
    send        (publisher, message): sends a signal of a script
    missing     (element, field, error): takes what a payload leaves out
    """

    def __init__(
        self,
        robot: str,
        node: Node,
        scheduler: Scheduler,
        endpoints: Endpoints,
        options: RobotOptions,
        *,
        report: Callable[[str, str], object],
        log: Callable[[str, str], object],
        send: Callable[[Publisher, Any], object],
        missing: Callable[[str, str, NameError], object],
    ) -> None:
        random, epoch, self._send = options.random or robot_random(0, node.namespace), options.epoch, send
        self.engine: Engine
        self.on_step: Callable[[], object] | None = None
        self.altered: Callable[[str, str], object] | None = None
        self._namespace, self._endpoints, self._scheduler = node.namespace, endpoints, scheduler
        self._log, self._report, self._has_javascript = log, report, False
        self.runner: Runner = Runner(
            scheduler,
            node,
            self._on_ended,
            stepped=lambda key: self._on_stepped(),
            report=lambda key, text: report("", text),
            types=endpoints.type,
        )
        clock = lambda: scheduler.now / SECOND  # noqa: E731
        self._robot = Robot(robot, node.namespace, self._publish, self.runner.inbox, clock, epoch, random)
        own = {HOST_API: lambda: self.javascript, MISSING: missing}
        self._builtins = interface(robot=self._robot, signal=self._signal, log=log) | own

    @cached_property
    def javascript(self) -> JavaScriptHost:
        """The interface that only scripts in JavaScript find, made when the first of them runs."""
        self._has_javascript = True
        host: JavaScriptHost = load(JAVASCRIPT_HOST)(
            name=self._robot.name,
            namespace=self._namespace,
            epoch=self._robot._epoch.timestamp() * 1000,
            random=self._robot.random,
            scheduler=self._scheduler,
            inbox=self.runner.inbox,
            advertise=lambda topic, type: self._endpoints.publisher(resolve(topic, self._namespace), type),
            publish=self._publish,
            log=self._log,
            report=self._report,
            altered=lambda: self.altered,
            stepped=self.on_changed,
            lost=self._on_callback_lost,
            failed=self._on_callback_failed,
            alive=self._is_alive,
        )
        return host

    def variables(self) -> dict[str, Any]:
        """Return the variables of a new instance: the interface of its scripts alone."""
        return {"__builtins__": another(self._builtins)}

    def forget(self, variables: dict[str, Any]) -> None:
        """Take the interface of scripts out of the variables of an ended instance, unless JavaScript still needs it."""
        if self._has_javascript:
            self.javascript.sweep()
        if not (self._has_javascript and self.javascript.realms):
            variables.pop("__builtins__", None)

    def close(self) -> None:
        if self._has_javascript:
            self.javascript.close()
        self.runner.close()

    def _on_ended(self, key: int, error: BaseException | None) -> None:
        self.engine.script_ended(key, error)

    def _on_callback_failed(self, variables: dict[str, Any], element: str, error: BaseException) -> None:
        self.engine.fail_callback(variables, element, error)

    def _on_callback_lost(
        self, script: Any, element: str, text: str, again: Callable[[], object], fail: Callable[[BaseException], object]
    ) -> None:
        if self.runner.on_lost is None:
            again()
        else:
            self.runner.on_lost(self.runner.key_of(script), element, text, again, fail)

    def _is_alive(self, variables: dict[str, Any]) -> bool:
        return self.engine.is_alive(variables)

    def _on_stepped(self) -> None:
        self.engine.stepped()
        if self.on_step is not None:
            self.on_step()

    def on_changed(self) -> None:
        """Go on: outside of a script, variables have changed or messages were published."""
        self._on_stepped()
        self.runner.poll()

    def _signal(self, name: str, payload: Any = None) -> None:
        """``signal("done", True)`` in a script."""
        full = resolve(topic_of(name), self._namespace)
        known = self._endpoints.type(full)
        if known is None and payload is not None:
            raise MessageError(f"topic {full}: its type is unknown; use robot.publish, which names one")
        self._emit(full, known or "std_msgs/msg/Empty", payload, self._send)

    def signals(self, topic: str, type: str) -> Callable[[Any], object]:
        """Return a function that throws a signal on a topic (full name)."""
        self._endpoints.publisher(topic, type)  # at once, so that discovery is over in time
        return lambda payload: self._emit(topic, type, payload, self._send)

    def _publish(self, topic: str, type: str, fields: Any) -> None:
        self._emit(resolve(topic, self._namespace), type, fields, lambda publisher, message: publisher.publish(message))

    def _emit(self, full: str, type: str, value: Any, send: Callable[[Publisher, Any], object]) -> None:
        publisher = self._endpoints.publisher(full, type)
        message = messages.create(type, value)
        send(publisher, message)
        caught = self._endpoints.caught.get(full)
        if caught is not None:
            self.engine.post(caught, message)
        self.runner.inbox.deliver(full, message)
