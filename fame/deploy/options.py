"""Options of engines and of deployments."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from fame.dataclasses import dataclass, field
from fame.robot.options import RobotOptions

if TYPE_CHECKING:
    from pathlib import Path

    from fame.bpmn.library import Library
    from fame.bpmn.pools import Pool
    from fame.clock import Scheduler
    from fame.deploy.envelope import Report
    from fame.deploy.migration import Foreseen
    from fame.deploy.signing import Identity
    from fame.robot import ServiceFunction
    from fame.robot.journal import StateDirectory
    from fame.robot.live import FeedLog

PATIENCE, PATIENCE_PER_ROBOT = 10.0, 1.0
"""How long a deployment waits for its robots, at least and for each of them (s)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EngineOptions(RobotOptions):
    """Options of a `fame.deploy.EngineNode`, besides those of its robot.

    library    where called processes are found that a model does not bring
    services   Python functions for service tasks, by name
    trusted    public keys: only what one of them signed is run
    identity   signs the reports where keys are used, by default one made now
    unsigned_tasks  with `trusted`, requests on tasks need not be signed
    wall_time  gives s since 1970
    time       the scheduler of the mission, if it has another time: simulated, with `epoch` as the date of second 0
    state      keeps the mission on disk: what was running when the engine before ended goes on
    seed       of the random numbers, by default and after a resumption a new one, which recordings contain
    log        takes what live views get, with and without subscribers
    recordings folder of the files of `log`, which others may fetch (`fame.fleet.log_server`)
    diagnostics     publish reports on ``/diagnostics``, too
    markers    publish the mission for RViz, in this frame of the robot (`fame.fleet.markers`); empty: do not
    on_status  get its reports, too
    lifecycle  be a managed node of ROS: missions run while it is active (`fame.deploy.lifecycle`)
    """

    library: Library | None = None
    services: Mapping[str, ServiceFunction] | None = None
    trusted: Sequence[Any] = ()
    identity: Identity | None = None
    unsigned_tasks: bool = False
    wall_time: Callable[[], float] = time.time
    time: Scheduler | None = None
    state: StateDirectory | None = None
    seed: int | None = None
    log: FeedLog | None = None
    recordings: Path | None = None
    diagnostics: bool = False
    markers: str = ""
    on_status: Sequence[Callable[[Report], object]] = ()
    lifecycle: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class DeploymentOptions:
    """Options of a `fame.deploy.Deployment`.

    robots     the namespaces to play the model; by default those that have an engine and that a pool wants
    only       restricts it to some of them
    again      those that had the model before
    joins      those that are to take it only while they have no process: what they got meanwhile is newer
    library    where called processes are found
    patience   how long its robots may take to answer (s); by default it grows with their number, and with `load`
    load       gives how many times as long (`fame.middleware.wire_base.load_of_machine`)
    key        signs what is sent
    wall_time  gives s since 1970
    migrate    what runs goes over to the model by a `plan` (`fame.deploy.migration`), for somebody (`who`)
    approve    gives a reason against a migration, or nothing; called in a thread with the pool of each robot, and what
               is foreseen of it
    preview    only ask what would become of what runs
    """

    robots: Sequence[str] | None = None
    only: Sequence[str] = ()
    again: Collection[str] = ()
    joins: Collection[str] = ()
    library: Library | None = None
    patience: float | None = None
    load: Callable[[], float] = lambda: 1.0
    key: Any = None
    wall_time: Callable[[], float] = time.time
    migrate: bool = False
    plan: Mapping[str, Any] = field(default_factory=dict)
    who: str = ""
    approve: Callable[[Mapping[str, Pool], Mapping[str, Foreseen]], str] = lambda pools, foreseen: ""
    preview: bool = False

    def patience_of(self, robots: int) -> float:
        """Return how long a deployment to some robots waits for their answers (s)."""
        if self.patience is not None:
            return self.patience
        return max(PATIENCE, PATIENCE_PER_ROBOT * robots) * self.load()
