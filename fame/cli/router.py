"""``fame router``: connect processes of several machines over Zenoh."""

from __future__ import annotations

import ipaddress
from argparse import Namespace
from contextlib import suppress
from pathlib import Path

from fame.cli.arguments import Commands, command, natural
from fame.cli.network import addresses_4, interface, note_ready, router, zenoh_config
from fame.cli.output import note
from fame.errors import FameError

_PORT = 7447


def add(commands: Commands) -> None:
    parser = command(
        commands, "router", _run,
        help="connect processes of several machines over Zenoh: one router on each machine, until Ctrl-C",
        examples=(
            "fame router --network wlan0  # on the base station",
            "fame router --connect 10.0.0.7  # on each robot, to the router of the base station",
            "fame engine REX --middleware zenoh --router 127.0.0.1 --trust team.pub",
            "fame deploy mission.bpmn --middleware zenoh --router 127.0.0.1 --key team.key",
        ),
    )  # fmt: skip
    parser.add_argument(
        "--network", type=interface, metavar="IFACE",
        help="listen on this network interface too (name or address); by default on this machine only",
    )  # fmt: skip
    parser.add_argument("--port", type=natural, default=_PORT, help=f"TCP port to listen on ({_PORT})")
    parser.add_argument(
        "--connect", action="append", default=[], type=router, metavar="ADDRESS",
        help="the router of another machine, such as 10.0.0.7 or tls/depot:7447; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--zenoh-config", type=zenoh_config, metavar="FILE",
        help="a configuration file of Zenoh (JSON5), for TLS, user and password",
    )  # fmt: skip


_ANSWERS = 5_000_000_000
"""How long routers of other machines may take to answer until a warning says that none does (ns)."""


def _run(arguments: Namespace) -> int:
    from fame.clock import WallScheduler
    from fame.middleware.zenoh import locators, open_router
    from fame.scenario.process import run_until_signal

    listen = [f"tcp/127.0.0.1:{arguments.port}"]
    if arguments.network is not None:
        address = _address(arguments.network)
        listen.append(f"tcp/{f'[{address}]' if ':' in address else address}:{arguments.port}")
    others = [locator for text in arguments.connect for locator in locators(text)]
    session = open_router(listen, others, arguments.zenoh_config and Path(arguments.zenoh_config))
    try:
        note_ready(f"router on {', '.join(listen)}")
        scheduler = WallScheduler()

        def warn() -> None:
            if others and not session.info.routers_zid():
                note(f"fame: warning: no router answers at {', '.join(others)}; it keeps trying")

        scheduler.after(_ANSWERS, warn)
        run_until_signal(scheduler)
    finally:
        session.close()  # type: ignore[no-untyped-call]
    return 0


def _address(interface: str) -> str:
    with suppress(ValueError):
        return str(ipaddress.ip_address(interface))
    found = [address for address, name in addresses_4().items() if name == interface]
    if not found:
        raise FameError(f"--network {interface}: this interface has no IPv4 address; name an address")
    return str(found[0])
