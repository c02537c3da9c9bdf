"""What a run comes to: how it went for each robot, whether it is over, its status, topics that look mistyped.

A run is over when no instance runs and no timer will start one. Cycles without end never end it: such a run lasts for
its duration. It is completed if then no instance runs, none has failed, and of each pool whose process is not optional
at least one robot has started.
"""

from __future__ import annotations

import difflib
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND
from fame.deploy import Report
from fame.errors import MissionError
from fame.middleware.interface import TopicInfo
from fame.robot import Event, WaitingToken
from fame.scenario.result import RobotResult

if TYPE_CHECKING:
    from fame.bpmn.pools import Pool
    from fame.robot import RobotNode
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
    """The status of a run that was not interrupted."""
    if any(robot.failed for robot in robots):
        return "failed"
    if not at_rest(robots):
        return "timeout"
    return "failed" if unstarted else "completed"


def robot_result(node: RobotNode, waits: tuple[WaitingToken, ...]) -> RobotResult:
    """The result of one robot, from its engine; `waits` is what still waits."""
    instances = node.instances
    return RobotResult(
        name=node.name,
        instances=len(instances),
        completed=sum(instance.status == "completed" for instance in instances),
        failed=sum(instance.status == "failed" for instance in instances),
        elements=sum(instance.visits.total() for instance in instances),
        errors=tuple(instance.error for instance in instances if instance.error is not None),
        waits=waits,
        ahead=node.pending_starts,
    )


def reported_result(robot: str, report: Report | None) -> RobotResult:
    """The result of one robot, from its last report."""
    if report is None:
        return RobotResult(robot, 0, 0, 0, 0, (), ())
    return RobotResult(
        name=robot,
        instances=report.started,
        completed=report.completed,
        failed=report.failed,
        elements=report.elements,
        errors=tuple(_error(robot, error) for error in report.errors),
        waits=tuple(_wait(robot, wait) for wait in report.waits),
        ahead=report.ahead,  # type: ignore[arg-type]
    )


def _error(robot: str, said: Mapping[str, Any]) -> MissionError:
    return MissionError(
        said.get("text", ""),
        robot=robot,
        element=said.get("element", ""),
        name=said.get("name", ""),
        file=said.get("file", ""),
        line=said.get("line", 0),
        code=said.get("code", ""),
    )


def _wait(robot: str, said: Mapping[str, Any]) -> WaitingToken:
    since = round(said.get("since", 0.0) * SECOND)
    return WaitingToken(robot, said.get("element", ""), said.get("for", ""), since, said.get("topics", {}))


_REPORT = re.compile(r"\s*(\d+\.\d) s   \w+: (.*)")
"""A line with which an engine reports something (`fame.cli.engine`)."""


def event_of(robot: str, line: str) -> Event | None:
    """The event that a line of a process reports, None if it reports none."""
    found = _REPORT.match(line)
    return Event(round(float(found[1]) * SECOND), robot, 0, 0, "", "report", found[2]) if found is not None else None


def mistyped_topics(graph: Iterable[TopicInfo]) -> Iterator[tuple[str, str]]:
    """The full name of a node that publishes, and what to say of it. Names are compared within a namespace."""
    heard: dict[str, dict[str, str]] = defaultdict(dict)
    lonely: list[TopicInfo] = []
    for info in graph:
        namespace, _, name = info.name.rpartition("/")
        if info.subscribers:
            heard[namespace][name.lower()] = name
        else:
            lonely.append(info)
    for info in lonely:
        namespace, _, name = info.name.rpartition("/")
        for similar in difflib.get_close_matches(name.lower(), heard[namespace], 1, 0.85):
            for node in dict.fromkeys(info.publishers):
                right = f"{namespace}/{heard[namespace][similar]}"
                yield node, f"publishes on {info.name}, which has no subscriber; did you mean {right}?"
