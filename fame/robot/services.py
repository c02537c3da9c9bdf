"""Units: what a service task keeps running for as long as its scope lasts, as processing, recording, watching an arm.

A unit is made when the token reaches its task, from the variables there are then; what is wrong with them fails the
task. It works on topics of its own, beside the engine. The task ends when the unit says so, and sets the variables that
it gives; if the scope is cancelled first, the unit is closed.

Theory of operation: the task is a coroutine that awaits the end of its unit, as a script would; the engine knows no
units. A unit that has ended by itself calls `Around.changed`.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

from fame.clock import SECOND, Entry, Scheduler, WallScheduler
from fame.engine.host import Compiled
from fame.errors import ConfigError
from fame.middleware.interface import Middleware
from fame.scripting.requests import Until

Value = TypeVar("Value", str, float, int)
_POLL = SECOND // 5


@dataclass(frozen=True, slots=True)
class Around:
    """What a unit has around it.

    folder   that of the mission's model: names of files are relative to it
    report   says a line for people
    changed  to be called when the unit has ended
    """

    robot: str
    namespace: str
    middleware: Middleware
    scheduler: Scheduler
    folder: Path
    report: Callable[[str], object]
    changed: Callable[[], object]


class Unit(Protocol):
    """Something that runs."""

    def results(self) -> Mapping[str, Any] | None:
        """The variables to set if it has ended by itself; None as long as it runs."""

    def close(self) -> None:
        """Leave. It may have ended or not."""


Make = Callable[[Around, Mapping[str, Any]], Unit]
"""Makes a unit from the variables of its task. Raises FameError."""


class Command:
    """A command of `fame` in a process of its own, so that the engine goes on meanwhile. It takes no simulated time.

    `told` turns the object that it prints with ``--json`` into variables.
    """

    def __init__(
        self, around: Around, arguments: Sequence[str], told: Callable[[Mapping[str, Any]], Mapping[str, Any]]
    ) -> None:
        self._around, self._results = around, told
        command = [sys.executable, "-m", "fame", *arguments, "--json"]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self._told: dict[str, Any] | None = None
        self._poll: Entry | None = None
        if isinstance(around.scheduler, WallScheduler):
            self._poll = around.scheduler.after(_POLL, self._look)
        else:
            self._end()

    def results(self) -> Mapping[str, Any] | None:
        """The variables. Raises ConfigError if the command failed."""
        if self._told is None:
            return None
        if "error" in self._told:
            raise ConfigError(str(self._told["error"]["text"]), file=str(self._told["error"].get("file", "")))
        return self._results(self._told)

    def close(self) -> None:
        """End it, if it goes on."""
        if self._poll is not None:
            self._poll.cancel()
        if self._told is None:
            self._process.kill()
            self._process.communicate()

    def _look(self) -> None:
        if self._process.poll() is None:
            self._poll = self._around.scheduler.after(_POLL, self._look)
            return
        self._end()
        self._around.changed()

    def _end(self) -> None:
        out, said = self._process.communicate()
        for line in said.splitlines():
            self._around.report(line)
        self._told = json.loads(out)


def living(make: Make, around: Around) -> Compiled:
    """What the service task does: a function of the variables that gives a coroutine."""

    async def live(variables: dict[str, Any]) -> None:
        unit = make(around, variables)
        try:
            await Until(lambda: unit.results() is not None)
            variables.update(unit.results() or {})
        finally:
            unit.close()

    return live


def setting(variables: Mapping[str, Any], name: str, default: Value | None = None, *, type: type[Value]) -> Value:
    """A variable that a unit reads; `default` if it is not set. Raises ConfigError if it is missing or of no `type`."""
    value = variables.get(name)
    if value is None:
        value = default
    if value is None:
        raise ConfigError(f"needs the variable {name}: draw it as a property of the data object that goes in")
    if type is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if not isinstance(value, type) or isinstance(value, bool):
        raise ConfigError(f"found {name} = {value!r}; {_RIGHT[type]} would be right")
    return value


_RIGHT: Mapping[type, str] = {str: "a text", float: "a number", int: "a whole number"}
