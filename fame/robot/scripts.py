"""The robot's scripts: the runner of their steps, and what they have around them to speak with.

What a script says on a topic is heard by the robot's own catchers and its own waiting scripts too, as what an event
throws is; the middleware brings it to everybody else.
"""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND
from fame.errors import MessageError
from fame.middleware import messages
from fame.middleware.interface import resolve
from fame.robot.endpoints import Ends
from fame.robot.events import Event
from fame.scripting import Robot, Runner, another, interface
from fame.scripting.javascript import SURROUNDINGS, Surroundings

if TYPE_CHECKING:
    from fame.robot.node import RobotNode


class Scripts:
    """Those of one robot. `runner` has their steps, `javascript` what only scripts in JavaScript have around them."""

    def __init__(self, robot: RobotNode, ends: Ends) -> None:
        self._robot, self._ends = robot, ends
        self.runner = Runner(
            robot.scheduler,
            robot.node,
            self._ended,
            stepped=lambda key: robot.engine.stepped(),
            report=lambda key, text: robot.report("", text),
            types=ends.type,
        )
        self.javascript = self._surroundings()
        scheduler = robot.scheduler
        clock, chance = (lambda: scheduler.now / SECOND), Random(robot.namespace)
        inbox = self.runner.inbox
        speaker = Robot(robot.name, robot.namespace, self._publish, inbox, clock, robot.epoch, chance)
        self._in_scope = interface(robot=speaker, signal=self._signal, log=self._log) | {SURROUNDINGS: self.javascript}

    def variables(self) -> dict[str, Any]:
        """What scripts find besides the variables of their instance, for a new instance."""
        return {"__builtins__": another(self._in_scope)}

    def forget(self, variables: dict[str, Any]) -> None:
        """An instance is over; it is kept for its variables, without what its scripts had in scope."""
        self.javascript.sweep()
        if not self.javascript.realms:
            variables.pop("__builtins__", None)

    def close(self) -> None:
        """Leave: scripts that wait are closed."""
        self.javascript.close()
        self.runner.close()

    def _surroundings(self) -> Surroundings:
        robot = self._robot
        return Surroundings(
            name=robot.name,
            namespace=robot.namespace,
            epoch=robot.epoch.timestamp() * 1000,
            scheduler=robot.scheduler,
            inbox=self.runner.inbox,
            advertise=lambda topic, type: self._ends.publisher(resolve(topic, robot.namespace), type),
            publish=self._publish,
            log=self._log,
            report=robot.report,
            stepped=self._called_back,
            failed=self._failed,
            alive=self._is_alive,
        )

    def _ended(self, key: int, error: BaseException | None) -> None:
        self._robot.engine.script_ended(key, error)

    def _failed(self, variables: dict[str, Any], element: str, error: BaseException) -> None:
        self._robot.engine.fail_callback(variables, element, error)

    def _is_alive(self, variables: dict[str, Any]) -> bool:
        return self._robot.engine.is_alive(variables)

    def _called_back(self) -> None:
        self._robot.engine.stepped()
        self.runner.poll()

    def _log(self, level: str, text: str) -> None:
        said = f"{level}: {text}" if level != "info" else text
        self._robot.tell(Event(self._robot.scheduler.now, self._robot.name, 0, 0, "", "log", said))

    def _signal(self, name: str, payload: Any = None) -> None:
        """``signal("done", True)`` in a script."""
        full = resolve(name if name.startswith(("/", "~/")) else f"/{name}", self._robot.namespace)
        known = self._ends.type(full)
        if known is None and payload is not None:
            raise MessageError(f"topic {full}: nobody says its type; use robot.publish, which names one")
        self._emit(full, known or "std_msgs/msg/Empty", payload)

    def _publish(self, topic: str, type: str, fields: Any) -> None:
        self._emit(resolve(topic, self._robot.namespace), type, fields)

    def _emit(self, full: str, type: str, value: Any) -> None:
        publisher = self._ends.publisher(full, type)
        message = messages.create(type, value)
        publisher.publish(message)
        caught = self._ends.caught.get(full)
        if caught is not None:
            self._robot.engine.post(caught, message)
        self.runner.inbox.deliver(full, message)
