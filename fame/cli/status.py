"""``fame status``: what every robot's engine is at."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.cli.arguments import Commands, add_json, command
from fame.cli.network import add_network, connected
from fame.cli.output import print_json, table

if TYPE_CHECKING:
    from fame.deploy import Report

_LISTENING = 1.5  # heartbeats
HEADS = ("robot", "state", "model", "instances", "token at", "since", "waits for", "publishers")


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "status", run, examples=("fame status", "fame status --json"),
        help="show every robot: its model, its instances, where its tokens are, since when, and what they wait for",
    )  # fmt: skip
    parser.add_argument(
        "--trust", action="append", default=[], type=Path, metavar="FILE.pub",
        help="show only what engines signed, and prefer those that prove their names by this key; repeatable",
    )  # fmt: skip
    add_network(parser)
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Listen for a moment, and print what was said."""
    from dataclasses import asdict

    from fame.clock import SECOND
    from fame.deploy import STATUS_QOS, STRING, engines
    from fame.deploy.authentication import ReportReader
    from fame.deploy.signing import read_trusted
    from fame.deploy.status import HEARTBEAT
    from fame.errors import DeploymentError

    reports: dict[str, Report] = {}
    belief: dict[str, Any] = {"signed": bool(arguments.trust), "trusted": ()}
    if arguments.trust:
        belief["trusted"] = read_trusted(arguments.trust)

    def heard(reader: ReportReader, message: Any) -> None:
        report = reader.read(message.data)
        if report is not None:
            reports[reader.robot] = report

    with connected(arguments) as (scheduler, middleware):
        scheduler.run(scheduler.now + SECOND)
        node = middleware.node("fame_status")
        robots = engines(middleware)
        for robot in robots:
            node.subscription(
                f"/{robot}/bpmn_status", STRING, partial(heard, ReportReader(robot, **belief)), STATUS_QOS
            )
        scheduler.run(scheduler.now + round(_LISTENING * HEARTBEAT * SECOND))
    silent = silences(reports, robots, _LISTENING * HEARTBEAT)
    if not reports and not silent:
        raise DeploymentError("no engine was found")
    if arguments.json:
        print_json({"robots": {name: asdict(report) for name, report in sorted(reports.items())}, "silent": silent})
    else:
        lines = {name: list(rows(name, report)) for name, report in reports.items()}
        lines |= {name: [(name, "silent", "", "", "", f"{s:.0f} s", "", "")] for name, s in silent.items()}
        print(table(HEADS, [row for name in sorted(lines) for row in lines[name]]))
    return 0


def silences(reports: Mapping[str, Report], engines: Iterable[str], listened: float) -> dict[str, float]:
    """The robots that say nothing, and for how long at least (s).

    Their engines are in the graph and said nothing while they were `listened` to, or their team misses them.
    """
    missed = [item for report in reports.values() for item in report.absent.items()]
    silent = dict.fromkeys(engines, listened)
    for robot, seconds in missed:
        silent[robot] = max(seconds, silent.get(robot, 0.0))
    return {robot: seconds for robot, seconds in sorted(silent.items()) if robot not in reports}


def rows(robot: str, report: Report) -> Iterator[tuple[str, ...]]:
    """A line for a robot, and one more for each further token."""
    head = (robot, report.state, report.hash[:12], str(report.instances))
    for wait in report.waits:
        since = f"{max(0.0, report.now - wait.get('since', 0.0)):.0f} s" if report.instances else ""
        counts = ", ".join(str(count) for count in wait.get("topics", {}).values())
        yield (*head, wait.get("element", ""), since, wait.get("for", ""), counts)
        head = ("", "", "", "")
    if report.state == "holding":
        yield (*head, "", "", f"its sender and the others for {report.candidate}; fame abort {robot} ends that", "")
        head = ("", "", "", "")
    if report.offers:
        yield (*head, "", "", f"fame activate {robot}: {', '.join(report.offers)}", "")
    elif head[0]:
        yield (*head, "", "", report.error, "")
    for text in report.warnings:
        yield ("", "", "", "", "", "", f"warning: {text}", "")
