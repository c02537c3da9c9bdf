"""Commands for simulated worlds: ``fame world``, and ``pause`` and ``resume`` for its time."""

from __future__ import annotations

import os
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.arguments import Commands, command, natural, positive
from fame.cli.network import add_network, connected, lockstep, note_ready, note_warning, wait_until
from fame.errors import ConfigError, DeploymentError

if TYPE_CHECKING:
    from fame.clock import WallScheduler
    from fame.middleware.interface import Middleware


def add_world(commands: Commands) -> None:
    parser = command(
        commands, "world", run_world,
        examples=("fame world examples/ground_vehicles.yaml", "fame world examples/agriculture.yaml --speed 4 --pause"),
        help="run a simulated world with its robots, for engines in other processes; it publishes /clock",
    )  # fmt: skip
    parser.add_argument("world", type=Path, metavar="WORLD.yaml", help="a world file, or a scenario with a world")
    parser.add_argument("--seed", type=natural, metavar="N", help="random seed (default: the file's, or 0)")
    parser.add_argument("--speed", type=positive, metavar="F", help="simulated seconds per second (1)")
    parser.add_argument("--pause", action="store_true", help="start paused; fame resume continues")
    parser.add_argument(
        "--lockstep", action="append", default=[], metavar="ROBOT",
        help="wait for this engine (fame engine --lockstep) after each step, as fast as possible unless --speed is "
        "given; repeatable",
    )  # fmt: skip
    add_network(parser)


def run_world(arguments: Namespace) -> int:
    """Serve until interrupted."""
    from fame.scenario import WorldNode, read_scenario_world, serve

    config, seed = read_scenario_world(arguments.world)
    if config is None:
        raise ConfigError("has no world", file=str(arguments.world))
    chosen = seed if arguments.seed is None else arguments.seed
    speed = arguments.speed or (None if arguments.lockstep else 1.0)

    def build(scheduler: WallScheduler, middleware: Middleware) -> WorldNode:
        _expect_no_other(scheduler, middleware)
        steps = lockstep(middleware, lambda node: node.name != "world") if arguments.lockstep else None
        team = arguments.lockstep
        world = WorldNode(
            config, chosen, scheduler, middleware, speed=speed, paused=arguments.pause, team=team, steps=steps
        )
        robots = ", ".join(robot.name for robot in config.robots)
        note_ready(f"a world with {robots}" + ("; paused until fame resume" if arguments.pause else ""))
        return world

    serve(arguments.middleware, arguments.network, build, on_warning=note_warning)
    return 0


def _expect_no_other(scheduler: WallScheduler, middleware: Middleware) -> None:
    """Raise ConfigError where another world makes the time. One that was killed stays in the graph, and is silent."""
    from fame.clock import SECOND
    from fame.middleware.interface import SENSOR_DATA
    from fame.middleware.simulated_time import CLOCK, CLOCK_TYPE

    scheduler.run(scheduler.now + SECOND // 2)  # until others are found
    if not any(topic.name == CLOCK and topic.publishers for topic in middleware.graph()):
        return
    ticks: list[object] = []
    node = middleware.node("_fame_twin", "world")
    node.subscription(CLOCK, CLOCK_TYPE, ticks.append, SENSOR_DATA)
    is_heard = wait_until(scheduler, lambda: ticks, 1.0)
    node.close()
    if is_heard:
        domain = os.environ.get("ROS_DOMAIN_ID") or "0"
        text = f"another world is on /clock in ROS domain {domain}; for a second one set ROS_DOMAIN_ID to another"
        raise ConfigError(f"{text} number here, and for its engines and commands")


_PATIENCE = 5.0
"""Seconds to find the world, and then to wait for its answer."""


def add_time(commands: Commands) -> None:
    for act, help in (
        ("pause", "pause the time of a running world (/clock), and thereby its missions"),
        ("resume", "continue the time of a paused world"),
    ):
        parser = command(commands, act, run_time, examples=(f"fame {act}",), help=help)
        parser.set_defaults(act=act)
        add_network(parser)


def run_time(arguments: Namespace) -> int:
    """Stop the time of the world, or continue it, and wait for its answer. Raises DeploymentError."""
    from fame.scenario.world_process import EMPTY, PAUSE, RESUME

    service = PAUSE if arguments.act == "pause" else RESUME
    answers: list[object] = []
    with connected(arguments) as (scheduler, middleware):
        client = middleware.node("_fame_pause").client(service, EMPTY)
        if wait_until(scheduler, lambda: client.available, _PATIENCE):
            client.call(None, answers.append)
            wait_until(scheduler, lambda: answers, _PATIENCE)
    if not answers:
        raise DeploymentError(f"no world answered within {_PATIENCE:g} s; start one with: fame world WORLD.yaml")
    return 0
