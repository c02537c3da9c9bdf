"""A world, its robots and a collaboration, run in one process.

A `Scenario` is what a scenario file says, checked. `run` builds everything anew, lets it go on until the mission is
over or its duration has passed, and says how it went: the mission is over when something has run and nothing runs any
more. A robot whose process fails is brought to its safe state; the others go on, and all are stopped safely at the end.

    file      what a scenario file says
    scenario  the scenario: who plays which pool, in which world
    run       one run of it, while it lasts
    checking  what keeps it from being run
    result    how it went
    captions  what each robot's process is at, in words
"""

from __future__ import annotations

from fame.scenario.file import DURATION, read_scenario_world
from fame.scenario.result import Completion, Fault, Progress, Result, RobotResult, Status
from fame.scenario.scenario import Scenario

__all__ = [
    "DURATION", "Completion", "Fault", "Progress", "Result", "RobotResult", "Scenario", "Status", "read_scenario_world",
]  # fmt: skip
