"""``fame process``: processing nodes, from their configurations."""

from __future__ import annotations

from argparse import ArgumentTypeError, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.cli.arguments import Commands, add_types, command, positive
from fame.cli.network import add_network
from fame.cli.output import note

if TYPE_CHECKING:
    from fame.clock import WallScheduler
    from fame.middleware.interface import Middleware
    from fame.monitor.pipeline.configuration import Configuration

_EXAMPLES = (
    "fame process models/monitoring/joint_monitor/low_pass.yaml",
    "fame process encoder_0.yaml --processor my_model.py:Encoder --frequency 20",
    "fame process low_pass.yaml encoders.yaml threshold.yaml --set cutoff=5",
)


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "process", run, examples=_EXAMPLES,
        help="run processing nodes: a model on topics, its verdict on topics, as a configuration says",
    )  # fmt: skip
    parser.add_argument("configurations", type=Path, nargs="+", metavar="CONFIG.yaml")
    parser.add_argument(
        "--processor", action="append", default=[], metavar="CLASS",
        help="instead of the configuration's: LowPass ..., module:Class, file.py:Class; may be given several times",
    )  # fmt: skip
    parser.add_argument(
        "--set", action="append", default=[], type=assignment, metavar="NAME=VALUE", dest="values",
        help="a parameter of the processors; may be given several times",
    )  # fmt: skip
    parser.add_argument("--frequency", type=positive, metavar="HZ", help="of the calls, instead of the configuration's")
    parser.add_argument("--namespace", default="", metavar="NAME", help="that topics are relative to")
    parser.add_argument("--graph", type=Path, metavar="FILE.svg", help="draw the pipeline as configured, and end")
    add_types(parser)
    add_network(parser)


def assignment(text: str) -> tuple[str, Any]:
    """``cutoff=5``, ``names=[a, b]``: a value as YAML reads it."""
    from fame.config.loader import parse_document
    from fame.errors import ConfigError

    name, equals, value = text.partition("=")
    if not equals or not name:
        raise ArgumentTypeError(f"expected NAME=VALUE, as in cutoff=5, got {text!r}")
    try:
        return name.strip(), parse_document(value).data
    except ConfigError as error:
        raise ArgumentTypeError(f"{value!r}: {error.text}") from None


class Nodes:
    """Several nodes in one process."""

    def __init__(self, nodes: list[Any]) -> None:
        self.nodes = nodes

    def stop(self) -> bool:
        """Nothing has to be waited for."""
        return False

    def close(self) -> None:
        """Leave."""
        for node in self.nodes:
            node.close()


def run(arguments: Namespace) -> int:
    """Serve until interrupted."""
    from fame.clock import SECOND
    from fame.monitor.pipeline.node import ProcessingNode
    from fame.monitor.pipeline.processors import assign, make_processors
    from fame.scenario import serve

    configurations = [_configured(path, arguments) for path in arguments.configurations]
    if arguments.graph is not None:
        from fame.monitor.plots import draw

        draw(configurations, arguments.graph)
        return 0
    chains = [make_processors(configuration) for configuration in configurations]
    for chain, configuration in zip(chains, configurations, strict=True):
        assign(chain, configuration)

    def build(scheduler: WallScheduler, middleware: Middleware) -> Nodes:
        scheduler.run(scheduler.now + SECOND // 2)  # until others are found, and with them the types of topics
        nodes = []
        for chain, configuration in zip(chains, configurations, strict=True):
            node = ProcessingNode(
                middleware, scheduler, configuration, processors=chain, namespace=arguments.namespace, report=note
            )
            nodes.append(node)
            for name, value in arguments.values:
                node.set(name, value)
            note(f"{configuration.name}: {' -> '.join(type(each).__name__ for each in chain)} "
                 f"at {configuration.frequency:g} Hz")  # fmt: skip
        return Nodes(nodes)

    serve(arguments.middleware, arguments.network, build)
    return 0


def _configured(path: Path, arguments: Namespace) -> Configuration:
    """A configuration, with what the command line says instead."""
    from dataclasses import replace

    from fame.config.values import ConfigValue
    from fame.monitor.pipeline.configuration import hertz, load, stages_of

    configuration = load(path)
    if arguments.processor:
        stages = stages_of(ConfigValue(list(arguments.processor), "--processor"))
        own = configuration.stages
        if len(own) == len(stages):  # another class, with the parameters that the file has for it
            stages = tuple(replace(stage, parameters=old.parameters) for stage, old in zip(stages, own, strict=True))
        configuration = replace(configuration, stages=stages)
    if arguments.frequency is not None:
        configuration = replace(configuration, frequency=hertz(ConfigValue(arguments.frequency, "--frequency")))
    return configuration
