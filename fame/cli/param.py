"""``fame param``: parameters of running nodes."""

from __future__ import annotations

from argparse import Namespace
from typing import Any

from fame.cli.arguments import Commands, add_json, command
from fame.cli.network import add_network, connected
from fame.cli.output import print_json, table

_EXAMPLES = ("fame param list /low_pass", "fame param get /low_pass cutoff", "fame param set /low_pass cutoff 5")


def add(commands: Commands) -> None:
    """Declare the command and its three parts."""
    parser = command(
        commands, "param", run, examples=_EXAMPLES,
        help="list, show and change parameters of running nodes, as ros2 param does",
    )  # fmt: skip
    parts = parser.add_subparsers(metavar="list|get|set", required=True)
    for name, help in (("list", "all of a node"), ("get", "one"), ("set", "change one")):
        part = parts.add_parser(name, help=help)
        part.add_argument("node", metavar="NODE", help="its full name, such as /low_pass")
        if name != "list":
            part.add_argument("name", metavar="NAME")
        if name == "set":
            part.add_argument("value", metavar="VALUE", help="a number, text, true, false, or a list [1, 2]")
        add_network(part)
        add_json(part)
        part.set_defaults(part=name)


def run(arguments: Namespace) -> int:
    """Ask the node, and print what it says."""
    from fame.monitor.pipeline.parameters import ParameterClient

    with connected(arguments) as (scheduler, middleware):
        node = middleware.node("fame_param")
        name = arguments.node if arguments.node.startswith("/") else f"/{arguments.node}"
        client = ParameterClient(node, scheduler, name)
        return _PARTS[arguments.part](client, arguments)


def _list(client: Any, arguments: Namespace) -> int:
    names = client.names()
    values, told = client.get(names), client.describe(names)
    if arguments.json:
        print_json({"node": client.other, "parameters": dict(zip(names, values, strict=True))})
        return 0
    rows = [(name, _shown(value), each.description) for name, value, each in zip(names, values, told, strict=True)]
    print(table(("parameter", "value", "description"), rows) if rows else f"{client.other} has no parameters")
    return 0


def _get(client: Any, arguments: Namespace) -> int:
    from fame.errors import ConfigError

    (value,) = client.get([arguments.name]) or [None]
    if value is None:
        known = ", ".join(client.names()) or "none"
        raise ConfigError(f"there is no such parameter; there are {known}", file=client.other, element=arguments.name)
    print_json({"name": arguments.name, "value": value}) if arguments.json else print(_shown(value))
    return 0


def _set(client: Any, arguments: Namespace) -> int:
    from fame.config.loader import parse_document

    client.set(arguments.name, parse_document(arguments.value, arguments.name).data)
    return _get(client, arguments)


def _shown(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_shown, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else str(value)


_PARTS = {"list": _list, "get": _get, "set": _set}
