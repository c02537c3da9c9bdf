"""Behaviours that a test replaces: a library in which a called process is a service task of the test."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import Any
from xml.sax.saxutils import quoteattr

from fame.bpmn.library import Library
from fame.bpmn.model import CallActivity, Definitions, Process
from fame.dataclasses import dataclass, field
from fame.errors import ConfigError
from fame.robot import ServiceFunction
from fame.text import suggestion

_BPMN = "http://www.omg.org/spec/BPMN/20100524/MODEL"
_CAMUNDA = "http://camunda.org/schema/1.0/bpmn"


@dataclass(frozen=True, slots=True)
class StubCall:
    """A call of a stub: the robot, and the variables when it was called."""

    robot: str
    variables: Mapping[str, Any]


@dataclass(slots=True)
class Stub:
    """A replaced behaviour. `calls` has its calls so far, in order."""

    name: str
    after: Any
    sets: Any
    raises: Any
    signals: Any
    calls: list[StubCall] = field(default_factory=list)

    def service(self, robot: str) -> ServiceFunction:
        """Return what its service task does for a robot."""

        async def run(variables: dict[str, Any]) -> None:
            from fame.engine import BpmnError, plain
            from fame.engine.data import own_copy
            from fame.scripting import Sleep

            number = len(self.calls)
            self.calls.append(StubCall(robot, plain(variables)))
            given = (self.after, self.sets, self.raises, self.signals)
            after, sets, raises, signals = (_nth(value, number) for value in given)
            if after:
                await Sleep(float(after))
            found = sets(plain(variables)) if callable(sets) else sets or {}
            variables.update({name: own_copy(value) for name, value in found.items()})
            for name, payload in (signals or {}).items():
                variables["__builtins__"]["signal"](name, payload)
            if raises is not None:
                raise BpmnError(raises)

        return run


class StubLibrary(Library):
    """A library whose `find` gives stubs in the place of the behaviours that they replace."""

    def __init__(self, base: Library) -> None:
        super().__init__(base.folders)
        self._files, self._folders, self._base = base._files, base._folders, base
        self._stubs: dict[str, tuple[Stub, Definitions]] = {}

    @property
    def declared(self) -> Library:
        """The library without stubs: what a stub replaces still says the types of its topics."""
        return self._base

    def stub(
        self, files: Iterable[Definitions], name: str, *, after: Any, sets: Any, raises: Any, signals: Any
    ) -> Stub:
        """Replace a behaviour. Raises ConfigError for one that is neither called nor in the library."""
        _expect("after", after, lambda value: isinstance(value, int | float) and value >= 0, "seconds from 0 on")
        _expect("sets", sets, lambda value: callable(value) or isinstance(value, Mapping), "variables, or a function")
        _expect("raises", raises, lambda value: isinstance(value, str), "the code of an error")
        _expect("signals", signals, lambda value: isinstance(value, Mapping), "payloads by signal")
        files = list(files)
        known = _named(files).union(*map(self.names, files))
        if name not in known:
            text = f"stub: no behaviour {name!r} is called or in the library; {suggestion(name, sorted(known))}"
            raise ConfigError(text)
        made = Stub(name, after, sets, raises, signals)
        self._stubs[name] = made, _definitions(name)
        return made

    def unused(self) -> list[str]:
        """Return the stubs that nothing has called so far, each as the call that made it."""
        return [f"stub({name!r})" for name, (stub, _) in self._stubs.items() if not stub.calls]

    def services(self, robot: str) -> dict[str, ServiceFunction]:
        """Return the service of each stub, for one robot."""
        return {_operation(name): stub.service(robot) for name, (stub, _) in self._stubs.items()}

    def find(self, caller: Definitions, call: CallActivity) -> tuple[Definitions, Process]:
        """Return the process that a call activity calls, or its stub. Raises ModelError."""
        if call.called in self._stubs and call.called_expression is None and not call.refused:
            definitions = self._stubs[call.called][1]
            return definitions, definitions.processes[0]
        return super().find(caller, call)


def _named(files: Iterable[Definitions]) -> set[str]:
    """The processes of some files, and what they call."""
    names: set[str] = set()
    for definitions in files:
        for process in definitions.processes:
            names.add(process.id)
            names.update(call.called for call in process.body.calls())
    return names - {""}


def _operation(name: str) -> str:
    return f"fame.testing.stub {name}"


@cache
def _definitions(name: str) -> Definitions:
    """A model with one process, whose one task is the stub."""
    from fame.bpmn.reader import read_text

    start, stub, end = (quoteattr(f"{name}_{part}") for part in ("start", "stub", "end"))
    return read_text(
        f'<definitions xmlns="{_BPMN}" xmlns:camunda="{_CAMUNDA}" targetNamespace="http://fame/testing">'
        f'<process id={quoteattr(name)} isExecutable="true"><startEvent id={start}/>'
        f'<serviceTask id={stub} camunda:type="external" camunda:topic={quoteattr(_operation(name))}/>'
        f"<endEvent id={end}/><sequenceFlow id={quoteattr(f'{name}_begins')} sourceRef={start} targetRef={stub}/>"
        f"<sequenceFlow id={quoteattr(f'{name}_ends')} sourceRef={stub} targetRef={end}/></process></definitions>",
        file=f"<stub of {name}>",
    )


def _nth(value: Any, number: int) -> Any:
    """Of a list the value for a call; the last one is repeated."""
    return value[min(number, len(value) - 1)] if isinstance(value, list) else value


def _expect(name: str, value: Any, holds: Callable[[Any], bool], right: str) -> None:
    for one in value if isinstance(value, list) else [value]:
        if one is not None and not holds(one):
            raise ConfigError(f"stub: {name}: expected {right}, got {one!r}")
    if isinstance(value, list) and not value:
        raise ConfigError(f"stub: {name}: expected {right}, or a list with one for each call, got an empty list")
