"""``fame world``: the world and its robots alone, as nodes."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from fame.cli.arguments import Commands, command, natural, positive
from fame.cli.network import add_network
from fame.errors import ConfigError


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "world", run,
        examples=("fame world examples/ground_vehicles.yaml", "fame world examples/agriculture.yaml --speed 4 --pause"),
        help="run a simulated world with its robots, for engines in other processes; its time is on /clock",
    )  # fmt: skip
    parser.add_argument("world", type=Path, metavar="WORLD.yaml", help="a world file, or a scenario that has one")
    parser.add_argument("--seed", type=natural, metavar="N", help="seed of all noise; the file's, else 0")
    parser.add_argument("--speed", type=positive, default=1.0, metavar="F", help="so many times as fast as reality (1)")
    parser.add_argument("--pause", action="store_true", help="begin with time stopped; fame resume lets it go")
    add_network(parser)


def run(arguments: Namespace) -> int:
    """Serve until interrupted."""
    from fame.remote import WorldPart, serve
    from fame.scenario import read_scenario_world

    config, seed = read_scenario_world(arguments.world)
    if config is None:
        raise ConfigError("has no world", file=str(arguments.world))
    chosen = seed if arguments.seed is None else arguments.seed
    serve(
        arguments.middleware,
        arguments.network,
        lambda scheduler, middleware: WorldPart(
            config, chosen, scheduler, middleware, speed=arguments.speed, paused=arguments.pause
        ),
    )
    return 0
