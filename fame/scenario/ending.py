"""How a run ends: which pools have never started, and what it comes to.

A run is over when no instance runs and no timer will start one. Cycles without end never let it be over: such a run
ends with its duration. It is completed if then no instance runs, none has failed, and of each pool whose process is not
optional at least one robot has started.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fame.bpmn.pools import Pool
    from fame.scenario.result import RobotResult, Status


def never_started(cast: Mapping[str, Pool], robots: Sequence[RobotResult]) -> tuple[str, ...]:
    """The pools of which no robot has started, and whose process is not optional."""
    started = {cast[robot.name].name for robot in robots if robot.instances}
    required = dict.fromkeys(pool.name for pool in cast.values() if not pool.process.optional)
    return tuple(name for name in required if name not in started)


def is_over(robots: Sequence[RobotResult]) -> bool:
    """Whether something has run, nothing runs any more, and nothing will start by itself."""
    return at_rest(robots) and not any(robot.ahead for robot in robots)


def at_rest(robots: Sequence[RobotResult]) -> bool:
    """Whether something has run, nothing runs any more, and only cycles without end are to come."""
    return any(robot.instances for robot in robots) and not any(
        robot.running or robot.ahead == "due" for robot in robots
    )


def status_of(robots: Sequence[RobotResult], unstarted: Sequence[str]) -> Status:
    """What a run comes to that nobody has interrupted."""
    if any(robot.failed for robot in robots):
        return "failed"
    if not at_rest(robots):
        return "timeout"
    return "failed" if unstarted else "completed"
