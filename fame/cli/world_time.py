"""``fame pause`` and ``fame resume``: stop the time of a simulated world, and let it go on."""

from __future__ import annotations

from argparse import Namespace

from fame.cli.arguments import Commands, command
from fame.cli.network import add_network, connected

_PATIENCE = 5.0
"""Seconds to find the world, and to wait for its answer."""


def add(commands: Commands) -> None:
    """Declare the commands."""
    pausing = command(
        commands, "pause", pause, examples=("fame pause",),
        help="stop the time of a simulated world, and so of all that follow it",
    )  # fmt: skip
    resuming = command(
        commands, "resume", resume, examples=("fame resume",),
        help="let the time of a simulated world go on that was paused, or started paused",
    )  # fmt: skip
    add_network(pausing)
    add_network(resuming)


def pause(arguments: Namespace) -> int:
    """Stop the time."""
    from fame.scenario.world_process import PAUSE

    return _call(arguments, PAUSE)


def resume(arguments: Namespace) -> int:
    """Let it go on."""
    from fame.scenario.world_process import RESUME

    return _call(arguments, RESUME)


def _call(arguments: Namespace, service: str) -> int:
    """Call a service of the world without arguments, and wait for its answer. Raises DeploymentError."""
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
