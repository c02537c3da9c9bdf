"""Runs in simulated time whose robot keeps a journal, and their resumption from any prefix of it."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, islice
from pathlib import Path
from typing import Any

import fame
from fame.bpmn.model import Definitions
from fame.clock import SECOND
from fame.robot import RobotNode
from fame.robot.durable import DurableRecorder
from fame.robot.journal import Journal, SegmentContents, StateDirectory
from fame.robot.restoring import restored
from fame.robot.state_tables import fold
from fame.scenario.run import Run

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
            self.recorder = DurableRecorder(self.node, Journal(self.directory, {"robot": "robot"}))
            self.recorder.begin()
        else:
            tables = restored(self.node, self.found)
            self.recorder = DurableRecorder(self.node, Journal.resume(self.directory, self.found))
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


def prefixes(found: SegmentContents) -> list[tuple[int, int]]:
    """Where each record of a segment ends (bytes), and the time of it (ns)."""
    return [(end, record["time"]) for end, record in zip(ends(found.path), found.records(), strict=True)]


def ends(path: Path) -> list[int]:
    """Where each record of a whole segment ends (bytes)."""
    return list(accumulate(map(len, path.read_bytes().splitlines(keepends=True))))[1:]


def cut(folder: Path, to: Path, length: int) -> Path:
    """A copy of a state directory whose newest segment is cut at that length."""
    shutil.copytree(folder, to)
    segment = sorted(to.glob("journal-*"))[-1]
    segment.write_bytes(segment.read_bytes()[:length])
    return to


def state_at(found: SegmentContents, records: int) -> dict[str, Any]:
    """The tables after that many records."""
    tables: dict[str, Any] = {}
    for change in islice(found.records(), records):
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


class DurableRun(Run):
    """A run whose engines keep journals; `kill` ends one as its process would, and starts it again."""

    folder: Path

    def begin(self) -> None:
        self.keepers: dict[str, tuple[StateDirectory, DurableRecorder]] = {}
        self.kills = 0
        for node in self.nodes:
            directory = StateDirectory(self.folder / node.name)
            recorder = DurableRecorder(node, Journal(directory, {"robot": node.name}))
            recorder.begin()
            self.keepers[node.name] = directory, recorder
        super().begin()

    def kill(self, robot: str) -> None:
        """Kill the engine of a robot now, and start it again."""
        place, old = next((place, node) for place, node in enumerate(self.nodes) if node.name == robot)
        if not old.engine.instances:
            return
        self.kills += 1
        directory, recorder = self.keepers[robot]
        recorder._quiet = True
        recorder.journal.close()
        for task in old.runner._tasks.values():
            if task.due is not None:
                task.due.cancel()
        old.runner._tasks.clear()
        old.runner._untils.clear()
        old.host.timers.close()
        old.node.close()
        new = self._alone(robot)
        found = directory.read()
        assert found is not None
        tables = restored(new, found)
        again = DurableRecorder(new, Journal.resume(directory, found))
        self.keepers[robot] = directory, again
        self.nodes[place] = new
        again.go_on(tables, 0.0)

    def _alone(self, robot: str) -> RobotNode:
        """A node of one robot, loaded."""
        team = self.scenario
        self.scenario = replace(team, cast={robot: team.cast[robot]})
        try:
            (node,) = self._build_nodes(strict=False)
        finally:
            self.scenario = team
        return node
