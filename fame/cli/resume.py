"""``fame resume``: let the time of a simulated world go on."""

from __future__ import annotations

from argparse import Namespace

from fame.cli.arguments import Commands, command
from fame.cli.network import add_network
from fame.cli.pause import ask


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "resume", run, examples=("fame resume",),
        help="let the time of a simulated world go on that was paused, or began so",
    )  # fmt: skip
    add_network(parser)


def run(arguments: Namespace) -> int:
    """Ask the world."""
    from fame.scenario.world_process import RESUME

    return ask(arguments, RESUME)
