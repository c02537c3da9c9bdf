"""Runs in simulated time whose robot keeps a journal, and their resumption from any prefix of it."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fame
from fame.bpmn.model import Definitions
from fame.clock import SECOND
from fame.robot.durable import Recorder, restored
from fame.robot.journal import Contents, Journal, StateDirectory
from fame.robot.state_tables import fold

Step = Callable[[fame.Simulation], bool]


class Recorded:
    """A simulation with a journal in `folder`: a new one, or one that goes on from what is there."""

    def __init__(
        self,
        definitions: Definitions,
        folder: Path,
        variables: dict[str, Any] | None = None,
        *,
        now: int = 0,
        away: float = 0.0,
        **options: Any,
    ) -> None:
        self.events: list[Any] = []
        self.simulation = fame.Simulation(definitions, "P", variables, observer=self.events.append, **options)
        self.node, self.directory = self.simulation.node, StateDirectory(folder)
        self.found = self.directory.read()
        self.simulation.scheduler.now = now
        self.simulation._until = now / SECOND
        if self.found is None:
            self.recorder = Recorder(self.node, Journal(self.directory, {"robot": "robot"}))
            self.recorder.begin()
        else:
            tables = restored(self.node, self.found)
            self.recorder = Recorder(self.node, Journal.resume(self.directory, self.found))
            self.simulation._begun = True
            self.recorder.go_on(tables, away)

    def close(self) -> None:
        """End as a crash does: nothing more is written."""
        self.recorder.close()
        self.recorder.journal.close()
        self.directory.close()

    @property
    def records(self) -> int:
        """How many records the newest segment has."""
        return self.recorder.journal._number

    def visits(self) -> Counter[str]:
        """How often each element has completed, in all instances."""
        return sum((instance.visits for instance in self.simulation.instances), Counter[str]())

    def outcome(self) -> Any:
        """What counts in the end: status, variables and visits of each instance."""
        return sorted(
            [
                instance.status,
                json.dumps(instance.variables, default=str, sort_keys=True),
                sorted(instance.visits.items()),
            ]
            for instance in self.simulation.instances
        )


def prefixes(found: Contents) -> list[tuple[int, int]]:
    """Where each record of a segment ends (bytes), and the time of it (ns)."""
    records = [found.state, *found.changes]
    return [(end, record["time"]) for end, record in zip(found.ends, records, strict=True)]


def cut(folder: Path, to: Path, length: int) -> Path:
    """A copy of a state directory whose newest segment is cut at that length."""
    shutil.copytree(folder, to)
    segment = sorted(to.glob("journal-*"))[-1]
    segment.write_bytes(segment.read_bytes()[:length])
    return to


def state_at(found: Contents, records: int) -> dict[str, Any]:
    """The tables after that many records."""
    tables: dict[str, Any] = {}
    for change in [found.state, *found.changes][:records]:
        fold(tables, json.loads(json.dumps(change)))
    return tables


def play(recorded: Recorded, steps: Sequence[Step]) -> list[int]:
    """Play some steps. Returns the number of records after each."""
    return [step(recorded.simulation) and recorded.records for step in steps]


def left(steps: Sequence[Step], after: Sequence[int], records: int) -> Sequence[Step]:
    """The steps that are still to be played when only so many records are there. Running to a time can be repeated."""
    for number, step in enumerate(steps):
        if records < after[number]:
            begun = number > 0 and records > after[number - 1] and not isinstance(step, Until)
            return steps[number + begun :]
    return ()


@dataclass(frozen=True)
class Until:
    """A step: run to a simulated second."""

    second: float

    def __call__(self, simulation: fame.Simulation) -> bool:
        simulation.run(self.second)
        return True


@dataclass(frozen=True)
class Do:
    """A step: a stimulus from outside, by the name of the method and its arguments."""

    method: str
    arguments: tuple[Any, ...]

    def __call__(self, simulation: fame.Simulation) -> bool:
        getattr(simulation, self.method)(*self.arguments)
        return True
