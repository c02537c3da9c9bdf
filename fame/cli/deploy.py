"""``fame deploy``: split a model, send it to its robots, and wait for every one of them."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from fame.cli.arguments import Commands, add_json, add_library, command, positive
from fame.cli.network import add_network, connected
from fame.cli.output import print_json, table


def add(commands: Commands) -> None:
    """Declare the command."""
    examples = ("fame deploy models/ground_vehicles.bpmn", "fame deploy models/other.bpmn --to Tractor_2")
    parser = command(
        commands, "deploy", run, examples=examples,
        help="send a model to the engines of its robots; all start, or none does",
    )  # fmt: skip
    parser.add_argument("model", type=Path, metavar="MODEL.bpmn")
    parser.add_argument("--to", action="append", default=[], metavar="ROBOT", help="only to this robot; repeatable")
    parser.add_argument("--wait", type=positive, default=10.0, metavar="S", help="how long to wait for answers (10)")
    parser.add_argument("--key", type=Path, metavar="FILE.key", help="sign it with this key (see fame keys)")
    add_network(parser)
    add_library(parser)
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Deploy, and print how each robot answered."""
    from fame.bpmn.reader import read
    from fame.library import Library
    from fame.remote import deploy
    from fame.signing import read_private

    definitions, library = read(arguments.model), Library(arguments.library)
    key = read_private(arguments.key) if arguments.key is not None else None
    with connected(arguments) as (scheduler, middleware):
        deployment = deploy(
            definitions, middleware, scheduler, only=arguments.to, library=library, patience=arguments.wait, key=key
        )
    standings = deployment.standings.values()
    if arguments.json:
        robots = {each.robot: {"state": each.state, "reason": each.reason} for each in standings}
        print_json({"status": "failed" if deployment.failed else "completed", "robots": robots})
    else:
        print(table(("robot", "state", "reason"), [(each.robot, each.state, each.reason) for each in standings]))
    return 1 if deployment.failed else 0
