"""What is to be run: who plays which pool, in which world, what will break, and what somebody will do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import TYPE_CHECKING, Any

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions, Process
from fame.bpmn.pools import Pool
from fame.clock import EPOCH

if TYPE_CHECKING:
    from sim2d.config import WorldConfig


@dataclass(frozen=True, slots=True)
class Fault:
    """What breaks of a robot at simulated second `time`, for good.

    `kind`: its ``engine``, which vanishes without a safe state, or what a robot of its type can break.
    """

    robot: str
    time: float
    kind: str


@dataclass(frozen=True, slots=True)
class Completion:
    """What somebody does at simulated second `time`: completes a user, manual or receive task, with results.

    `values` are the variables that are set. Where no token waits then, nothing happens, and that is reported.
    """

    robot: str
    time: float
    element: str
    values: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What is to be run, checked. `cast` is who plays which pool, by robot; `faults` is what will break.

    `completions` is what somebody will do; `duration` in simulated s; `epoch` is the date of simulated second 0.
    """

    file: str
    definitions: Definitions
    library: Library
    cast: Mapping[str, Pool]
    world: WorldConfig | None
    seed: int
    duration: float
    faults: tuple[Fault, ...] = ()
    completions: tuple[Completion, ...] = ()
    epoch: datetime = EPOCH

    def processes(self) -> list[Process]:
        """Those that the robots run, each once."""
        return list({pool.process.id: pool.process for pool in self.cast.values()}.values())

    def closures(self) -> list[Definitions]:
        """The files of all that runs: that of the model first, then those of called processes."""
        files = {self.definitions.file: self.definitions}
        for pool in self.cast.values():
            files.update((home.file, home) for home, _ in self.library.closure(self.definitions, pool.process))
        return list(files.values())
