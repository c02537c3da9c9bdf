"""A scenario: a world, its robots and a collaboration, run in one process or in many.

In one process, a `Scenario` is a checked scenario file. `run` builds everything anew, runs until the mission is over or
its duration has passed, and returns a `Result`. A robot whose process fails is brought to its safe state; the others
continue, and all are stopped safely at the end. In many processes, a `DistributedTeam` does the same: it starts the
world and one engine per robot, deploys to them, monitors them and ends them.

    plan           the content of a scenario: cast, world, faults, completions; reading scenario files
    scenario       a plan that is read from files and can be run
    run            one run in one process
    result         progress and result of a run
    film_captions  captions: the current activity of each robot's process
    process        scheduler, middleware and signals of a FAME process
    distributed    a scenario in many processes
    team_logs      its logs, made from its recording; films: films and pictures of recordings
    world_process  a simulated world in its own process, which publishes the clock; lockstep
    deployment     deploying to discovered robots and to late joiners
    settings       network and mission parameters of a scenario
    explore        exploring the states of a scenario, and the page for people who sign
"""

from typing import TYPE_CHECKING

from fame.imports import attach

if TYPE_CHECKING:
    from fame.scenario.deployment import Sending as Sending
    from fame.scenario.distributed import DistributedTeam as DistributedTeam, TeamOptions as TeamOptions
    from fame.scenario.plan import (
        DURATION as DURATION,
        Completion as Completion,
        Fault as Fault,
        Plan as Plan,
        read_scenario_world as read_scenario_world,
    )
    from fame.scenario.process import (
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
    __getattr__, __dir__, __all__ = attach(__name__)
