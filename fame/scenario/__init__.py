"""A scenario: a world, its robots and a collaboration, run in one process or in many.

In one process, a `Scenario` is what a scenario file says, checked. `run` builds everything anew, lets it go on until
the mission is over or its duration has passed, and says how it went. A robot whose process fails is brought to its safe
state; the others go on, and all are stopped safely at the end. In many processes, a `Team` does the same: the world and
one engine per robot, started, deployed to, watched and ended.

    file           what a scenario file says
    plan           what is to be run: who plays which pool, in which world
    scenario       a plan that is read from files and can be run
    run            one run in one process
    outcome        what a run comes to, in one process or in many
    result         how it goes, and how it went
    film_captions  what each robot's process is doing, in words
    process        what every process of FAME does: scheduler, middleware, signals
    distributed    a scenario in many processes
    subprocesses   the processes of a team: started, listened to and ended together
    world_process  a simulated world in its own process, which makes the time of all; lockstep
    deployment     deploying to the robots that are there, and to those that join late
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fame.imports import attach

if TYPE_CHECKING:
    from fame.scenario.deployment import Sending as Sending
    from fame.scenario.distributed import Team as Team
    from fame.scenario.file import DURATION as DURATION, read_scenario_world as read_scenario_world
    from fame.scenario.plan import Completion as Completion, Fault as Fault, Plan as Plan
    from fame.scenario.process import (
        BACKENDS as BACKENDS,
        connect as connect,
        scheduler_for as scheduler_for,
        serve as serve,
    )
    from fame.scenario.result import (
        Progress as Progress,
        Result as Result,
        RobotResult as RobotResult,
        Status as Status,
        TeamStatus as TeamStatus,
    )
    from fame.scenario.scenario import Scenario as Scenario
    from fame.scenario.world_process import WorldNode as WorldNode
else:
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "deployment": ["Sending"],
            "distributed": ["Team"],
            "file": ["DURATION", "read_scenario_world"],
            "process": ["BACKENDS", "connect", "scheduler_for", "serve"],
            "plan": ["Completion", "Fault", "Plan"],
            "result": ["Progress", "Result", "RobotResult", "Status", "TeamStatus"],
            "scenario": ["Scenario"],
            "world_process": ["WorldNode"],
        },
    )
