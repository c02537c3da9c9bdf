"""The interface of an engine to the world, and the errors of scripts.

The engine calls its host; the host never calls back inside such a call. Its reports (a timer fired, a script ended) are
later stimuli. Waits are identified by integer keys, so that no object of the host is part of the engine's state.
"""

from __future__ import annotations

import dis
from typing import Any, Protocol

from fame.bpmn.model import Expression
from fame.engine.program import Compiled
from fame.engine.state import Instance, Trail


class BpmnError(Exception):
    """A business error thrown by a script: ``raise BpmnError("unreachable")``. Caught by the events of that code.

    code     the error code
    message  text for people; by default the code
    """

    code: str
    message: str

    def __init__(self, code: str, message: str = "") -> None:
        super().__init__(message or code)
        self.code, self.message = code, message


class Cancelled(BaseException):
    """Raised at the ``await`` of a cancelled script. ``except Exception`` does not catch it."""


class Host(Protocol):
    """The world as an engine sees it."""

    def compile(self, expression: Expression, *, element: str, file: str, script: bool = False) -> Compiled:
        """Compile a text to a callable of the variables. Raises ModelError if the text is wrong."""

    def service(self, operation: str, *, element: str, file: str) -> Compiled:
        """Return the callable of the service that a service task names. Raises ModelError for an unknown service."""

    def publish(self, topic: str, value: Any) -> Any:
        """Send `value` (the payload, or None) on the qualified topic to other nodes.

        Returns the typed message, as own catchers get it. Raises MessageError if the value does not fit the type.
        """

    def send(self, topic: str, value: Any, robot: Any) -> None:
        """Send a message to one other robot, by name. Raises BpmnError ``unreachable`` if it does not take it."""

    def set_timer(self, key: int, kind: str, text: str) -> None:
        """Call `timer_fired(key)` when the ISO 8601 duration, date or cycle is due. Raises ValueError for bad text."""

    def cancel_timer(self, key: int) -> None:
        """Forget that timer, if it is still set."""

    def run(self, key: int, script: Any) -> None:
        """Continue a suspended script; when it has ended, call `script_ended(key, error or None)`."""

    def cancel(self, key: int) -> bool:
        """Cancel a script. True: it has ended. False: it is still in ``finally``; `script_ended` follows."""

    def make_safe(self, reason: str) -> None:
        """Bring the robot to its safe state. `reason`: ``suspended``, ``failed`` or ``terminated``."""

    def observe(self, trail: Trail) -> None:
        """Receive what happened in an observed program since the last call (see `fame.engine`).

        All of it belongs to one stimulus.
        """

    def report(self, element: str, text: str) -> None:
        """Warn about something that does not stop the mission: a dropped trigger, an uncaught escalation."""

    def output_missing(self, element: str, output: str) -> None:
        """Report a declared output that an activity has not set at its end. Raises NameError to make it fail."""

    def begun(self, instance: Instance) -> None:
        """Note that an instance starts."""

    def ended(self, instance: Instance) -> None:
        """Note that an instance completed, failed or was cancelled. The engine has forgotten it."""


_RAISE = (dis.opmap["RAISE_VARARGS"], dis.opmap["RERAISE"])


def is_from_outside(error: KeyboardInterrupt) -> bool:
    """Return whether it is a user's Ctrl-C, which arrives between two instructions, and was not raised by a script."""
    trace = error.__traceback__
    if trace is None:
        return False
    while trace.tb_next is not None:
        trace = trace.tb_next
    return trace.tb_frame.f_code.co_code[trace.tb_lasti] not in _RAISE
