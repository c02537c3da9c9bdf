"""``fame team inventory``: what each robot of a team is: its computer, its FAME, its model, its key, its clock."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Iterable, Mapping
from datetime import UTC, datetime
from functools import partial
from typing import TYPE_CHECKING, Any

from fame.cli.arguments import Commands, add_json, add_trust, command, positive, trusted_keys
from fame.cli.network import add_network, connected, wait_until
from fame.cli.output import print_json, table
from fame.cli.robots import subscribe_reports
from fame.errors import DeploymentError

if TYPE_CHECKING:
    from fame.clock import WallScheduler
    from fame.deploy import Report
    from fame.log.clocks import ClockAnswer
    from fame.middleware.interface import Node

_ROUNDS = 1.5
"""For how long robots are asked for their time and their state (s)."""
_HEADS = ("robot", "computer", "FAME", "protocol", "state", "model", "before it", "key", "clock", "free", "up")
_NOT_KNOWN = "not known"


def add(commands: Commands) -> None:
    parser = command(
        commands, "inventory", run,
        examples=("fame inventory", "fame inventory --trust team.pub --json"),
        help="list the robots: computer, version, model and the one before it, key, clock offset, free disk, uptime",
    )  # fmt: skip
    add_trust(parser, "say which robots prove their names with a key that this one vouches for; repeatable")
    parser.add_argument("--wait", type=positive, default=5.0, metavar="S", help="how long to wait for answers (5 s)")
    add_network(parser)
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Ask every robot, and print what it says."""
    from fame.clock import SECOND
    from fame.deploy import engines
    from fame.version import current

    trusted = trusted_keys(arguments)
    with connected(arguments) as (scheduler, middleware):
        scheduler.run(scheduler.now + SECOND)
        robots = sorted(engines(middleware))
        if not robots:
            raise DeploymentError("no engine was found")
        node = middleware.node("_fame_inventory")
        reports, rivals, strange = subscribe_reports(node, robots, trusted)
        everyone = set(robots)
        answers = ask_times(node, scheduler, robots, lambda: reports.keys() >= everyone, arguments.wait)
    items = {robot: item(robot, reports.get(robot), answers.get(robot), trusted) for robot in robots}
    for robot in everyone & (rivals | strange.keys()):
        items[robot]["warning"] = strange.get(robot, "two engines have this name")
    if arguments.json:
        print_json({"fame": current(), "robots": items})
    else:
        print(table(_HEADS, [(robot, *_cells(values)) for robot, values in items.items()]))
        print(
            *(f"{robot}: warning: {values['warning']}\n" for robot, values in items.items() if "warning" in values),
            sep="",
            end="",
        )
    return 0


def ask_times(
    node: Node, scheduler: WallScheduler, robots: Iterable[str], done: Callable[[], bool], seconds: float
) -> dict[str, ClockAnswer]:
    """Ask robots for their time, until all have answered and something else is `done`, or for some `seconds` more.

    Returns the quickest answer of each.
    """
    from fame.clock import SECOND
    from fame.log.clocks import ClockQuestions
    from fame.log.live_team import now_since

    begun, everyone = datetime.now(UTC), set(robots)
    answers: dict[str, ClockAnswer] = {}

    def on_answer(robot: str, answer: ClockAnswer) -> None:
        if robot not in answers or answer.trip < answers[robot].trip:
            answers[robot] = answer

    with ClockQuestions(node, scheduler, lambda: everyone, partial(now_since, begun), lambda: begun, on_answer):
        scheduler.run(scheduler.now + round(_ROUNDS * SECOND))
        wait_until(scheduler, lambda: answers.keys() >= everyone and done(), seconds)
    return answers


def item(robot: str, report: Report | None, answer: ClockAnswer | None, trusted: Any) -> dict[str, Any]:
    """Return what is known of a robot, None for what is not: times in s, `free` in bytes."""
    from fame.deploy.authentication import proves_name

    said: Mapping[str, Any] = report.said if report is not None else {}
    told: Mapping[str, Any] = answer.answer if answer is not None else {}
    fame = said.get("fame", told.get("fame"))
    found: dict[str, Any] = {
        "computer": told.get("host"),
        "fame": fame,
        "protocol": report.protocol if report is not None else told.get("protocol"),
        "state": None, "model": None, "deployment": None, "previous": None, "key": None, "proved": None,
        "offset": None, "doubt": None, "simulated": told.get("simulated"),
        "free": told.get("disk"),
        "up": None,
    }  # fmt: skip
    if report is not None:
        previous = said.get("previous")
        found |= {
            "state": report.state, "model": report.hash, "deployment": report.deployed, "up": report.time,
            "previous": previous if isinstance(previous, dict) else None, "key": report.key or None,
            "proved": proves_name(report, robot, trusted) if trusted else None,
        }  # fmt: skip
    if answer is not None:
        found |= {"offset": answer.ahead / 1e9, "doubt": answer.trip / 2e9}
    return found


def _cells(values: Mapping[str, Any]) -> Iterable[str]:
    """The cells of a row, without the name."""
    previous = values["previous"]
    before = _NOT_KNOWN if previous is None else str(previous.get("hash", ""))[:12]
    key = {None: "", True: " (proved)", False: " (not proved)"}[values["proved"]]
    clock = _NOT_KNOWN if values["offset"] is None else f"{values['offset']:+.3f} s"
    clock = "simulated" if values["simulated"] else clock
    free = "" if values["free"] is None else f"{values['free'] / 1e9:.1f} GB"
    up = _NOT_KNOWN if values["up"] is None else _duration(values["up"])
    known = (
        _NOT_KNOWN if values[name] is None else str(values[name]) for name in ("computer", "fame", "protocol", "state")
    )
    return *known, (values["model"] or "")[:12], before, (values["key"] or "")[:12] + key, clock, free, up


def _duration(seconds: float) -> str:
    """Seconds as days, hours and minutes."""
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    days, hours = divmod(hours, 24)
    parts = ((days, "d"), (hours, "h"), (minutes, "min"), (rest, "s"))
    shown = [f"{number} {unit}" for number, unit in parts if number]
    return " ".join(shown[:2]) or "0 s"
