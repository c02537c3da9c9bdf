"""What a run in many processes says of itself: how it stands while it lasts, and what it comes to."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from fame.clock import SECOND
from fame.deploy import Report
from fame.errors import MissionError
from fame.robot import Event, WaitingToken
from fame.scenario.result import RobotResult

_SAID = re.compile(r"\s*(\d+\.\d) s   \w+: (.*)")
"""A line in which an engine tells something that it reports (`fame.cli.engine`)."""


@dataclass(frozen=True, slots=True)
class Sight:
    """How things stand: s of the mission, what robots said last, and the number of each process."""

    time: float
    reports: Mapping[str, Report]
    pids: Mapping[str, int]


def robot_result(robot: str, report: Report | None) -> RobotResult:
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
        file=said.get("file", ""),
        line=said.get("line", 0),
        name=said.get("name", ""),
        code=said.get("code", ""),
    )


def _wait(robot: str, said: Mapping[str, Any]) -> WaitingToken:
    since = round(said.get("since", 0.0) * SECOND)
    return WaitingToken(robot, said.get("element", ""), said.get("for", ""), since, said.get("topics", {}))


def event_of(robot: str, line: str) -> Event | None:
    """What a line of a process reports, if it does."""
    found = _SAID.match(line)
    return Event(round(float(found[1]) * SECOND), robot, 0, 0, "", "report", found[2]) if found is not None else None
