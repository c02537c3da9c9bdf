"""``fame deploy``: split a model, send it to its robots, and wait for every one of them."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.arguments import Commands, add_json, add_library, command, positive
from fame.cli.network import add_network, connected
from fame.cli.output import note, print_json, table

if TYPE_CHECKING:
    from fame.deploy import Deployment


def add(commands: Commands) -> None:
    """Declare the command."""
    examples = ("fame deploy models/ground_vehicles.bpmn", "fame deploy models/other.bpmn --to Tractor_2")
    parser = command(
        commands, "deploy", run, examples=examples,
        help="send a model to the engines of its robots; all start, or none does",
    )  # fmt: skip
    parser.add_argument("model", type=Path, metavar="MODEL.bpmn")
    parser.add_argument("--to", action="append", default=[], metavar="ROBOT", help="only to this robot; repeatable")
    parser.add_argument(
        "--stay", action="store_true", help="then stay, and send robots that come late (or back) their process"
    )
    parser.add_argument("--wait", type=positive, default=10.0, metavar="S", help="how long to wait for answers (10)")
    parser.add_argument("--key", type=Path, metavar="FILE.key", help="sign it with this key (see fame keys)")
    add_network(parser)
    add_library(parser)
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Deploy, and print how each robot answered; then stay, if that is wanted."""
    from fame.bpmn.library import Library
    from fame.bpmn.pools import matches, pools_of
    from fame.bpmn.reader import read
    from fame.check.gate import refuse_errors
    from fame.deploy.signing import read_private
    from fame.scenario import Sending

    definitions, library = read(arguments.model), Library(arguments.library)
    key = read_private(arguments.key) if arguments.key is not None else None
    names, pools = arguments.to, pools_of(definitions)
    sent = [pool.process for pool in pools if not names or any(matches(robot, pool) for robot in names)]
    refuse_errors(definitions, sent, library, sent=True)  # before any robot is looked for
    with connected(arguments) as (scheduler, middleware):
        sending = Sending(definitions, scheduler, middleware, library=library, patience=arguments.wait, key=key)
        deployment = sending.deploy(arguments.to, arguments.wait, note)
        _tell(deployment, json=arguments.json)
        if arguments.stay and not deployment.failed:
            deployment.close()
            sending.stay(deployment.robots, note)
    return 1 if deployment.failed else 0


def _tell(deployment: Deployment, *, json: bool) -> None:
    robots = deployment.robots.values()
    if json:
        results = {each.robot: {"state": each.state, "reason": each.reason, "seconds": each.took} for each in robots}
        print_json({"status": "failed" if deployment.failed else "completed", "robots": results})
    else:
        rows = [
            (each.robot, each.state, f"{1000 * each.took:.0f} ms" if each.state != "silent" else "", each.reason)
            for each in robots
        ]
        print(table(("robot", "state", "time", "reason"), rows), flush=True)
