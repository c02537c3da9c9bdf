"""``fame keys``: keys that sign deployments."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from fame.cli.arguments import Commands, command


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "keys", run, examples=("fame keys new team",),
        help="make a pair of Ed25519 keys: NAME.key signs deployments, NAME.pub is what engines trust",
    )  # fmt: skip
    parser.add_argument("action", choices=("new",))
    parser.add_argument("name", type=Path, metavar="NAME", help="path of the two files, without their endings")


def run(arguments: Namespace) -> int:
    """Make them and name them."""
    from fame.signing import new_keys

    secret, public = new_keys(arguments.name)
    print(f"{secret}   keep it secret: fame deploy MODEL.bpmn --key {secret}")
    print(f"{public}   give it to the robots: fame engine ROBOT --trust {public}")
    return 0
