"""Services that run as long as their service task: processing, recording, watching an arm.

A service is started when a token reaches its task, from the process variables of that moment; wrong variables fail the
task. It uses topics of its own, beside the engine. The task ends when the service ends by itself, and its results are
set as variables. If the scope is cancelled first, the service is closed.

Theory of operation: the task is a coroutine that awaits the end of its service, as a script would; the engine does not
know about services. A service that has ended by itself calls `ServiceContext.changed`.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeAlias, TypeVar

from fame.clock import Scheduler
from fame.dataclasses import dataclass
from fame.engine.program import Compiled
from fame.errors import ConfigError
from fame.middleware.interface import Middleware
from fame.scripting.requests import Until

_Value = TypeVar("_Value", str, float, int)


@dataclass(frozen=True, slots=True)
class ServiceContext:
    """The context of a service.

    folder   folder of the mission's model: names of files are relative to it
    report   gets a line of text for people
    changed  to be called when the service has ended by itself, has thrown a signal, or has changed a variable
    signals  (full topic, type): a function that throws a signal there, as an event of the robot does
    blind    gets the name of a monitor and why it cannot judge, empty once it can, None when it ends. With a function
             that ends it, the mission is held meanwhile: its task is cancelled, and its `close` must not end it then
    """

    robot: str
    namespace: str
    middleware: Middleware
    scheduler: Scheduler
    folder: Path
    report: Callable[[str], object]
    changed: Callable[[], object]
    signals: Callable[[str, str], Callable[[Any], object]]
    blind: Callable[[str, str | None, Callable[[], object] | None], object] = lambda name, reason, end: None


class RunningService(Protocol):
    """A started service."""

    def results(self) -> Mapping[str, Any] | None:
        """Return the variables to set if the service has ended by itself, None while it runs."""

    def close(self) -> None:
        """End the service, which may have ended by itself already."""


class ServiceTopic(NamedTuple):
    """A topic of a service, as models write it: ``~/name`` is in the namespace of its robot. `file` and `line`: where a
    file gives its type."""

    name: str
    type: str
    throws: bool
    file: str = ""
    line: int = 0


class MissingFileError(ConfigError):
    """A file that a service needs is not here; it may be on the robot's computer."""


StartService: TypeAlias = Callable[[ServiceContext, dict[str, Any]], RunningService]
"""Starts a service with the variables of its task. Raises FameError."""


class CommandService:
    """A `fame` command in a process of its own, beside the engine. It takes no simulated time, but that of a world that
    does not wait for it.

    `results` turns the object that the command prints with ``--json`` into variables.
    """

    def __init__(
        self,
        context: ServiceContext,
        arguments: Sequence[str],
        results: Callable[[Mapping[str, Any]], Mapping[str, Any]],
    ) -> None:
        import subprocess

        self._context, self._to_variables, self._name = context, results, " ".join(arguments[:2])
        command = [sys.executable, "-m", "fame", *arguments, "--json", "--no-project"]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self._output: dict[str, Any] | None = None
        self._open = True
        self._worker = context.scheduler.worker("fame command")
        self._worker.call(self._process.communicate, self._on_ended)

    def results(self) -> Mapping[str, Any] | None:
        """Return the variables to set, None while the command runs. Raises ConfigError if the command failed."""
        if self._output is None:
            return None
        if "error" in self._output:
            raise ConfigError(str(self._output["error"]["text"]), file=str(self._output["error"].get("file", "")))
        return self._to_variables(self._output)

    def close(self) -> None:
        """Kill the command if it runs."""
        self._open = False
        self._process.kill()
        self._worker.close()

    def _on_ended(self, output: tuple[str, str], error: Exception | None) -> None:
        if not self._open:
            return
        said, reported = output if error is None else ("", str(error))
        for line in reported.splitlines():
            self._context.report(line)
        try:
            self._output = json.loads(said)
        except ValueError:  # killed, for instance for the memory that it needs
            text = f"fame {self._name} ended without a result, with exit code {self._process.returncode}"
            self._output = {"error": {"text": text}}
        self._context.changed()


def compile_service(start: StartService, context: ServiceContext) -> Compiled:
    """Return the behaviour of a service task: a function of the variables that gives a coroutine."""

    async def run(variables: dict[str, Any]) -> None:
        service = start(context, variables)
        try:
            await Until(lambda: service.results() is not None)
            variables.update(service.results() or {})
        finally:
            service.close()

    return run


def variable(variables: Mapping[str, Any], name: str, default: _Value | None = None, *, type: type[_Value]) -> _Value:
    """Return a variable that a service reads, `default` if it is not set.

    Raises ConfigError if it is missing or not of this type.
    """
    value = variables.get(name)
    if value is None:
        value = default
    if value is None:
        raise ConfigError(f"needs the variable {name}: draw it as a property of the data object that goes in")
    if type is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if not isinstance(value, type) or isinstance(value, bool):
        raise ConfigError(f"variable {name}: expected {_TYPE_NAMES[type]}, got {value!r}")
    return value


_TYPE_NAMES: Mapping[type, str] = {str: "a text", float: "a number", int: "a whole number"}
