"""A scenario: a world, its robots and a collaboration, run in one process or in many.

In one process, a `Scenario` is what a scenario file says, checked. `run` builds everything anew, lets it go on until
the mission is over or its duration has passed, and says how it went. A robot whose process fails is brought to its safe
state; the others go on, and all are stopped safely at the end. In many processes, a `Team` does the same: the world and
one engine per robot, started, deployed to, watched and ended.

    file                what a scenario file says
    scenario            the scenario: who plays which pool, in which world
    run                 one run of it in one process
    result              how it went
    film_captions       what each robot's process is at, in words
    process             what a process of a team does: scheduler, middleware, and a part built on both
    distributed         a scenario in many processes
    subprocesses        the processes of a team: started, heard and ended together
    world_process       a simulated world in its own process, which makes the time of all
    deployment          deploying to the robots that are there, and to those that join late
    lockstep            the world waits for all engines after each step
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fame.lazy import from_homes

if TYPE_CHECKING:
    from fame.scenario.deployment import Sending
    from fame.scenario.distributed import Team
    from fame.scenario.distributed_result import Sight
    from fame.scenario.file import DURATION, read_scenario_world
    from fame.scenario.process import BACKENDS, connect, scheduler_for, serve
    from fame.scenario.result import Completion, Fault, Progress, Result, RobotResult, Status
    from fame.scenario.scenario import Scenario
    from fame.scenario.world_process import WorldPart

__all__ = [
    "BACKENDS", "DURATION", "Completion", "Fault", "Progress", "Result", "RobotResult", "Scenario", "Sending", "Sight",
    "Status", "Team", "WorldPart", "connect", "read_scenario_world", "scheduler_for", "serve",
]  # fmt: skip

_HOMES = {
    "BACKENDS": "process",
    "DURATION": "file",
    "Completion": "result",
    "Fault": "result",
    "Progress": "result",
    "Result": "result",
    "RobotResult": "result",
    "Scenario": "scenario",
    "Sending": "deployment",
    "Sight": "distributed_result",
    "Status": "result",
    "Team": "distributed",
    "WorldPart": "world_process",
    "connect": "process",
    "read_scenario_world": "file",
    "scheduler_for": "process",
    "serve": "process",
}

__getattr__ = from_homes(__name__, _HOMES)
"""An engine's process loads nothing of worlds and scenario files."""
