"""``fame status``: what every robot's engine is at."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

from fame.cli.arguments import Commands, add_json, command
from fame.cli.network import add_network, connected
from fame.cli.output import print_json, table

if TYPE_CHECKING:
    from fame.deployment import Report

HEADS = ("robot", "state", "model", "instances", "token at", "since", "waits for", "publishers")


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "status", run, examples=("fame status", "fame status --json"),
        help="show every robot: its model, its instances, where its tokens are, since when, and what they wait for",
    )  # fmt: skip
    add_network(parser)
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Listen for a moment, and print what was said."""
    from dataclasses import asdict

    from fame.clock import SECOND
    from fame.deployment import STATUS_QOS, STRING, Report, engines
    from fame.errors import DeploymentError

    reports: dict[str, Report] = {}

    def heard(robot: str, message: Any) -> None:
        report = Report.from_json(message.data)
        if report is not None:
            reports[robot] = report

    with connected(arguments) as (scheduler, middleware):
        scheduler.run(scheduler.now + SECOND)
        node = middleware.node("fame_status")
        robots = engines(middleware)
        for robot in robots:
            node.subscription(f"/{robot}/bpmn_status", STRING, partial(heard, robot), STATUS_QOS)
        scheduler.run(scheduler.now + 3 * SECOND // 2)
    if not reports:
        raise DeploymentError("no engine was found")
    if arguments.json:
        print_json({"robots": {name: asdict(report) for name, report in sorted(reports.items())}})
    else:
        print(table(HEADS, [row for name in sorted(reports) for row in rows(name, reports[name])]))
    return 0


def rows(robot: str, report: Report) -> Iterator[tuple[str, ...]]:
    """A line for a robot, and one more for each further token."""
    head = (robot, report.state, report.hash[:12], str(report.instances))
    for wait in report.waits:
        since = f"{max(0.0, report.now - wait.get('since', 0.0)):.0f} s" if report.instances else ""
        counts = ", ".join(str(count) for count in wait.get("topics", {}).values())
        yield (*head, wait.get("element", ""), since, wait.get("for", ""), counts)
        head = ("", "", "", "")
    if report.offers:
        yield (*head, "", "", f"fame activate {robot}: {', '.join(report.offers)}", "")
    elif head[0]:
        yield (*head, "", "", report.error, "")
