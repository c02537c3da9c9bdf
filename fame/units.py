"""Units: what a service task keeps running for as long as its scope lasts, as processing, recording, watching an arm.

A unit is made when the token reaches its task, from the variables there are then; what is wrong with them fails the
task. It works on topics of its own, beside the engine. The task ends when the unit says so, and sets the variables that
it gives; if the scope is cancelled first, the unit is closed.

Theory of operation: the task is a coroutine that awaits the end of its unit, as a script would; the engine knows no
units. A unit that has ended by itself calls `Around.changed`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

from fame.clock import Scheduler
from fame.engine.host import Compiled
from fame.errors import ConfigError
from fame.middleware.interface import Middleware
from fame.scripting.requests import Until

Value = TypeVar("Value", str, float, int)


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
