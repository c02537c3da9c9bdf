"""``fame status``: what every robot's engine is at."""

from __future__ import annotations

from argparse import Namespace
from functools import partial
from typing import Any

from fame.cli.arguments import Commands, add_json, command
from fame.cli.network import add_network, connected
from fame.cli.output import print_json, table


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "status", run, examples=("fame status",),
        help="show every robot: its model, its instances, what it waits for",
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
        for robot in engines(middleware):
            node.subscription(f"/{robot}/bpmn_status", STRING, partial(heard, robot), STATUS_QOS)
        scheduler.run(scheduler.now + 3 * SECOND // 2)
    if not reports:
        raise DeploymentError("no engine was found")
    if arguments.json:
        print_json({"robots": {name: asdict(report) for name, report in sorted(reports.items())}})
        return 0
    rows = [
        (name, report.state, report.hash[:12], report.instances, _waits(report))
        for name, report in sorted(reports.items())
    ]
    print(table(("robot", "state", "model", "instances", "waits at"), rows))
    return 0


def _waits(report: Any) -> str:
    return "; ".join(f"{wait['element']} for {wait['for']}" for wait in report.waits) or report.error
