"""A robot's reports as diagnostics of ROS: diagnostic_msgs/msg/DiagnosticArray on ``/diagnostics`` (REP 107)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from fame.clock import SECOND
from fame.deploy.envelope import Report
from fame.middleware import messages
from fame.middleware.interface import Node

TYPE = "diagnostic_msgs/msg/DiagnosticArray"
OK, WARN, ERROR = 0, 1, 2
"""Levels of diagnostic_msgs/msg/DiagnosticStatus."""
_ERRORS, _WARNINGS = ("incident", "failed"), ("suspended", "holding")
"""States of a `Report` in which somebody is needed, and in which a mission does not go on."""


class DiagnosticsPublisher:
    """Publishes what reports say of a robot. `wall_time` gives s since 1970."""

    def __init__(self, node: Node, wall_time: Callable[[], float]) -> None:
        self._out, self._wall_time = node.publisher("/diagnostics", TYPE), wall_time

    def __call__(self, report: Report) -> None:
        now = round(self._wall_time() * SECOND)
        stamp = {"sec": now // SECOND, "nanosec": now % SECOND}
        array = {"header": {"stamp": stamp, "frame_id": ""}, "status": [diagnostic_status(report)]}
        self._out.publish(messages.create(TYPE, array))


def diagnostic_status(report: Report) -> dict[str, Any]:
    """Return the fields of a diagnostic_msgs/msg/DiagnosticStatus: the mission of one robot."""
    past = report.state == "running" and report.failures
    doubts = [*report.warnings, *(f"misses {robot} of its team" for robot in sorted(report.absent))]
    return {
        "level": ERROR
        if report.state in _ERRORS or (report.error and not past)
        else WARN
        if report.state in _WARNINGS or doubts or past
        else OK,
        "name": f"{report.robot}: mission",
        "message": next(_messages(report, doubts)),
        "hardware_id": report.robot,
        "values": [{"key": key, "value": value} for key, value in _values(report) if value],
    }


def _messages(report: Report, doubts: list[str]) -> Iterator[str]:
    """What there is to say, the gravest first."""
    yield from (f"{each['element']}: {each['text']}" for each in report.incidents)
    if report.failures:
        yield report.failures
    elif report.error:
        yield f"{report.state}: {report.error}"
    if report.suspended:
        goals = ", ".join(report.goals)
        yield f"suspended by {report.suspended.get('by', '')}{f'; its goal still runs: {goals}' if goals else ''}"
    yield from doubts
    yield report.state


def _values(report: Report) -> Iterator[tuple[str, str]]:
    yield "state", report.state
    yield "model", report.hash
    for key in ("instances", "started", "completed", "failed"):
        yield key, str(getattr(report, key))
    for wait in report.waits:
        seconds = max(0.0, report.now - wait.get("since", 0.0))
        yield f"waits at {wait.get('place') or wait['element']}", f"{wait['for']}, for {seconds:.0f} s"
    yield "more waits", str(report.more_waits or "")
    for topic, count in report.untaken.items():
        yield f"not taken from {topic}", str(count)
    for robot, seconds in report.absent.items():
        yield f"misses {robot}", f"for {seconds:.0f} s"
    for number, text in enumerate(report.warnings, 1):
        yield f"warning {number}", text
