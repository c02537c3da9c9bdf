"""``fame activate``: let an element of a running robot's ad-hoc sub-process begin."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from fame.cli.arguments import Commands, add_json, command, positive
from fame.cli.complete import ask_and_tell
from fame.cli.network import add_network


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "activate", run, examples=("fame activate REX Task_Photo", "fame activate REX Task_Photo --json"),
        help="let an element of a running robot's ad-hoc sub-process begin, once more if it has",
    )  # fmt: skip
    parser.add_argument("robot", metavar="ROBOT")
    parser.add_argument("element", metavar="ELEMENT", help="the id of what shall begin; fame status shows what can")
    parser.add_argument("--key", type=Path, metavar="FILE.key", help="sign it with this key (see fame keys)")
    parser.add_argument("--wait", type=positive, default=5.0, metavar="S", help="how long to wait for the answer (5)")
    add_network(parser)
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Ask the robot, and say how it answered."""
    return ask_and_tell(arguments, "activate", {})
