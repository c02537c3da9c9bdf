"""The events of a mission under test by element: the observer that expectations and coverage read."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping
from typing import NamedTuple

from fame.engine.program import Program
from fame.engine.state import Scope, Trail
from fame.robot import Event
from fame.robot.events import Observer


class TraceStep(NamedTuple):
    """What happened at an element: `what` as in `fame.engine`; `order` counts all steps; `time` in ns."""

    order: int
    time: int
    robot: str
    element: str
    what: str
    detail: object


class Trace(Observer):
    """An observer that keeps what happened, by robot and element. `homes`: robot -> file of its process.

    steps      in order
    covered    (file, element id) of each element that was entered and each flow that was taken
    listeners  called with each step
    """

    def __init__(self, homes: Mapping[str, str]) -> None:
        self._homes = homes
        self._programs: dict[Program, dict[str, str]] = {}
        self.steps: list[TraceStep] = []
        self.covered: set[tuple[str, str]] = set()
        self._at: defaultdict[tuple[str, str], list[TraceStep]] = defaultdict(list)
        self.listeners: list[Callable[[TraceStep], object]] = []

    def __call__(self, event: Event) -> None:
        self._add(event.time, event.robot, event.element, event.what, event.detail)

    def trail(self, time: int, robot: str, trail: Trail) -> None:
        """Keep what happened at one instant."""
        for scope, marks in trail:
            files = self._files_of(scope.instance.program)
            for element, what, detail in marks:
                self._add(time, robot, element, what, detail)
                if what in ("enter", "take"):
                    self.covered.add((files.get(element) or self._file(robot, scope), element))

    def _files_of(self, program: Program) -> dict[str, str]:
        """The file of each element whose id only one of the files of a program has."""
        if program not in self._programs:
            files: dict[str, set[str]] = {}
            for node in program.nodes:
                if node.file:
                    files.setdefault(node.id, set()).add(node.file)
            self._programs[program] = {id: next(iter(found)) for id, found in files.items() if len(found) == 1}
        return self._programs[program]

    def close(self) -> None:
        """Let go of what ran; what has happened is kept."""
        self._programs.clear()
        self.listeners.clear()

    def of(self, robot: str, elements: frozenset[str], what: str) -> list[TraceStep]:
        """Return the steps of one kind at some elements of a robot, in order."""
        steps = [step for element in elements for step in self._at[robot, element] if step.what == what]
        return sorted(steps, key=lambda step: step.order)

    def arrivals(self, robot: str, elements: frozenset[str]) -> list[TraceStep]:
        """When tokens came to some elements of a robot, or took a sequence flow, in order."""
        return self.of(robot, elements, "enter") or self.of(robot, elements, "take")

    def _add(self, time: int, robot: str, element: str, what: str, detail: object) -> None:
        step = TraceStep(len(self.steps), time, robot, element, what, detail)
        self.steps.append(step)
        self._at[robot, element].append(step)
        for listener in self.listeners:
            listener(step)

    def _file(self, robot: str, scope: Scope) -> str:
        """The file of the elements in a scope: that of the innermost call around it, else of the process."""
        found: Scope | None = scope
        while found is not None:
            opening = getattr(found.body, "opening", None)  # the body of a process that nothing calls has none
            if opening is not None and opening.file:
                return str(opening.file)
            found = found.parent
        return self._homes[robot]
