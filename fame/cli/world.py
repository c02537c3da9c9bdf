"""``fame world``: the world and its robots alone, as nodes."""

from __future__ import annotations

import json
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.cli.arguments import Commands, command, natural
from fame.cli.network import add_network
from fame.errors import ConfigError

if TYPE_CHECKING:
    from fame.clock import WallScheduler
    from fame.middleware.interface import Middleware


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "world", run, examples=("fame world examples/ground_vehicles.yaml",),
        help="run a simulated world with its robots in real time, for engines in other processes",
    )  # fmt: skip
    parser.add_argument("world", type=Path, metavar="WORLD.yaml", help="a world file, or a scenario that has one")
    parser.add_argument("--seed", type=natural, metavar="N", help="seed of all noise; the file's, else 0")
    add_network(parser)


class WorldPart:
    """A world that runs in real time and says how things stand."""

    def __init__(self, config: Any, seed: int, scheduler: WallScheduler, middleware: Middleware) -> None:
        from fame.deployment import STRING
        from fame.middleware.interface import LATCHED
        from fame.remote import WORLD_STATE
        from sim2d.world import World

        self._scheduler = scheduler
        self._world = World(config, seed=seed, scheduler=scheduler, middleware=middleware)
        self._node = middleware.node("world")
        self._state = self._node.publisher(WORLD_STATE, STRING, LATCHED)
        self._world.start()
        self._tell()

    def _tell(self) -> None:
        from fame.clock import SECOND
        from fame.middleware import messages

        self._state.publish(messages.create(self._state.type, json.dumps(self._world.summary())))
        self._next = self._scheduler.after(SECOND // 2, self._tell)

    def close(self) -> None:
        """Leave."""
        self._next.cancel()
        self._world.close()
        self._node.close()


def run(arguments: Namespace) -> int:
    """Serve until interrupted."""
    from fame.remote import serve
    from fame.scenario import read_scenario_world

    config, seed = read_scenario_world(arguments.world)
    if config is None:
        raise ConfigError("has no world", file=str(arguments.world))
    chosen = seed if arguments.seed is None else arguments.seed
    serve(
        arguments.middleware,
        arguments.network,
        lambda scheduler, middleware: WorldPart(config, chosen, scheduler, middleware),
    )
    return 0
