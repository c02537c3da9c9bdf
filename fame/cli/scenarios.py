"""The arguments that vary a scenario, and the scenario of a command line."""

from __future__ import annotations

import re
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from fame.cli.arguments import number, positive
from fame.errors import ConfigError

if TYPE_CHECKING:
    from fame.middleware.network import NetworkConfig
    from fame.scenario import Fault, Scenario


def add_variations(parser: ArgumentParser) -> None:
    """Declare what differs from the files: robots, faults, completions, values, the network between robots."""
    parser.add_argument(
        "--robots", action="append", default=[], type=_robots, metavar="POOL=N",
        help="number of robots for a multi-instance pool, placed on free ground; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--fault", action="append", default=[], type=_fault, metavar="ROBOT@S:KIND",
        help="inject a fault at simulated second S: engine, or a device of the robot (range, wheels, camera ...)",
    )  # fmt: skip
    parser.add_argument(
        "--complete", action="append", default=[], type=_completion, metavar="ROBOT@S:ELEMENT[:NAME=VALUE,...]",
        help="complete a user, manual or receive task at simulated second S, with results",
    )  # fmt: skip
    parser.add_argument(
        "--set", action="append", default=[], type=_setting, metavar="[ROBOT.]NAME=VALUE",
        help="value of a mission parameter, instead of the model's (fame check --explain lists them); repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--change", action="append", default=[], type=_change, metavar="PATH=VALUE",
        help="another value in the scenario file, as in world.robots.REX.at=[1, 2]; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--network-delay", type=_seconds, metavar="S", help="delay of each message between robots (s); local only"
    )
    parser.add_argument(
        "--loss",
        type=number("a probability from 0 to 0.99", 0, 0.99),
        metavar="P",
        help="probability that a message between robots is lost; local only",
    )
    parser.add_argument(
        "--partition", action="append", default=[], type=_partition, metavar="ROBOT,ROBOT@S-S",
        help="cut two robots off from each other between two simulated seconds; local only; repeatable",
    )  # fmt: skip


def _robots(text: str) -> tuple[str, int]:
    """``Tractor=12``."""
    match = re.fullmatch(r"(.*\S)\s*=\s*([0-9]+)", text)
    if match is None:
        raise ArgumentTypeError(f"expected POOL=N, as in Tractor=12, got {text!r}")
    return match[1], int(match[2])


def _fault(text: str) -> Fault:
    from fame.scenario import Fault

    try:
        return Fault.of(text)
    except ConfigError as error:
        raise ArgumentTypeError(str(error)) from None


def _completion(text: str) -> tuple[str, float, str, dict[str, Any]]:
    """``PORTER@12:Task_Sign:approved=true,count=3``."""
    from fame.cli.robots import value

    match = re.fullmatch(r"(\S.*?)@([0-9]+\.?[0-9]*):([^\s:](?:[^:]*[^\s:])?)(?::(.+))?", text)
    if match is None:
        right = "ROBOT@SECOND:ELEMENT[:NAME=VALUE,...] as in REX@12:Task_Sign:approved=true"
        raise ArgumentTypeError(f"expected {right}, got {text!r}")
    values = re.split(r",(?=\s*[^\W\d]\w*\s*=)", match[4]) if match[4] else []
    return match[1], float(match[2]), match[3], dict(map(value, values))


def _setting(text: str) -> tuple[str, str, Any]:
    """``REX.speed=0.5``, or ``speed=0.5`` for all robots."""
    from fame.cli.robots import value

    robot, dot, _ = text.partition("=")[0].rpartition(".")
    return (robot, *value(text[len(robot) + len(dot) :]))


def _change(text: str) -> tuple[str, Any]:
    """``world.robots.REX.at=[1, 2]``."""
    from fame.config.loader import parse_document

    path, equals, given = text.partition("=")
    with suppress(ConfigError):
        if equals and path.strip():
            return path.strip(), parse_document(given).data
    raise ArgumentTypeError(f"expected PATH=VALUE, as in world.robots.REX.at=[1, 2], got {text!r}")


def _seconds(text: str) -> float:
    return positive(text) if text.strip("0.") else 0.0


def _partition(text: str) -> tuple[str, str, float, float]:
    """``REX,DINGO@30-60``."""
    match = re.fullmatch(r"([^,@]*[^,@\s]),\s*([^,@]*[^,@\s])@([0-9]+\.?[0-9]*)-([0-9]+\.?[0-9]*)", text)
    if match is None or match[1] == match[2] or float(match[3]) >= float(match[4]):
        raise ArgumentTypeError(f"expected ROBOT,ROBOT@FROM-TO, as in REX,DINGO@30-60, got {text!r}")
    return match[1], match[2], float(match[3]), float(match[4])


def _network(arguments: Namespace) -> NetworkConfig | None:
    """The network of the command line. Raises ConfigError with another middleware than local."""
    delay, loss = arguments.network_delay, arguments.loss
    given = {"--network-delay": delay is not None, "--loss": loss is not None, "--partition": bool(arguments.partition)}
    if not any(given.values()):
        return None
    if arguments.middleware != "local":
        option = next(option for option, is_given in given.items() if is_given)
        raise ConfigError(f"{option} needs --middleware local: it simulates a network")
    from fame.middleware.network import Delay, Link, NetworkConfig, Partition

    links = [Link(Delay("fixed", delay or 0.0), loss or 0.0)] if delay is not None or loss is not None else []
    cuts = [Partition((one, other), start, end) for one, other, start, end in arguments.partition]
    return NetworkConfig(tuple(links), tuple(cuts))


def scenario_of(arguments: Namespace) -> Scenario:
    """Return the scenario of a command line."""
    from fame.scenario import Completion, Scenario

    variables: dict[str, dict[str, Any]] = {}
    for robot, name, setting in arguments.set:
        variables.setdefault(robot, {})[name] = setting
    if arguments.change and arguments.middleware != "local":
        raise ConfigError("--change needs --middleware local: other processes read the file as it is")
    if variables and arguments.middleware != "local":
        raise ConfigError("--set needs --middleware local: deployed processes have the values of the model")
    return Scenario.load(
        arguments.scenario,
        seed=arguments.seed,
        duration=arguments.duration,
        epoch=arguments.epoch,
        semantics=arguments.semantics,
        library=arguments.library,
        robots=dict(arguments.robots),
        faults=arguments.fault,
        completions=[Completion(*done) for done in arguments.complete],
        network=_network(arguments),
        variables=variables,
        changes=dict(arguments.change),
    )
