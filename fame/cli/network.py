"""What the commands share that talk to other processes: which middleware, on which network."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from fame.cli.arguments import Parser

if TYPE_CHECKING:
    from fame.clock import WallScheduler
    from fame.middleware.interface import Middleware


def add_network(parser: Parser) -> None:
    """``--middleware`` and ``--network``."""
    parser.add_argument(
        "--middleware", choices=("dds", "ros"), default="dds", help="how to reach the others (dds: the wire of ROS 2)"
    )
    parser.add_argument("--network", metavar="IFACE", help="interface to use; loopback alone if not given")


@contextmanager
def connected(arguments: Namespace) -> Iterator[tuple[WallScheduler, Middleware]]:
    """A scheduler and a middleware for a command that asks something and ends."""
    from fame.remote import connect, scheduler_for

    scheduler = scheduler_for(arguments.middleware)
    middleware = connect(arguments.middleware, scheduler, arguments.network)
    try:
        yield scheduler, middleware
    finally:
        middleware.close()
