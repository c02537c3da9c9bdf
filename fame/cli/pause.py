"""``fame pause``: stop the time of a simulated world."""

from __future__ import annotations

from argparse import Namespace

from fame.cli.arguments import Commands, command
from fame.cli.network import add_network, connected

_PATIENCE = 5.0  # s to find the world, and for its answer


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "pause", run, examples=("fame pause",),
        help="stop the time of a simulated world, and so of all that follow it",
    )  # fmt: skip
    add_network(parser)


def run(arguments: Namespace) -> int:
    """Ask the world."""
    from fame.scenario.world_process import PAUSE

    return ask(arguments, PAUSE)


def ask(arguments: Namespace, service: str) -> int:
    """Call a service of the world that takes and gives nothing, and wait until it has answered."""
    from fame.clock import SECOND
    from fame.errors import DeploymentError
    from fame.scenario.world_process import EMPTY

    answers: list[object] = []
    with connected(arguments) as (scheduler, middleware):
        client = middleware.node("fame_pause").client(service, EMPTY)
        until = scheduler.now + round(_PATIENCE * SECOND)
        asked = False
        while not answers and scheduler.now < until:
            if client.available and not asked:
                asked = True
                client.call(None, answers.append)
            scheduler.run(scheduler.now + SECOND // 50)
    if not answers:
        raise DeploymentError(f"no world answered within {_PATIENCE:g} s; start one with: fame world WORLD.yaml")
    return 0
