"""``fame splitter``: splits whole collaborations that come on a topic, and keeps their robots supplied."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.arguments import Commands, add_library, command, positive
from fame.cli.network import OPEN, add_network
from fame.cli.output import note
from fame.errors import FameError

if TYPE_CHECKING:
    from fame.clock import WallScheduler
    from fame.deploy import SplitterNode
    from fame.middleware.interface import Middleware

_OPEN = f"{OPEN}: give --key FILE.key, or --insecure to take what anybody sends"


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "splitter", run, examples=("fame splitter", "fame splitter --library behaviours"),
        help="wait for collaborations on /collaboration_diagram, deploy them, and supply robots that come late",
    )  # fmt: skip
    parser.add_argument("--wait", type=positive, default=10.0, metavar="S", help="how long to wait for answers (10)")
    parser.add_argument(
        "--key", type=Path, metavar="FILE.key",
        help="sign what is sent with this key, and take only diagrams that it or --trust signed (see fame keys)",
    )  # fmt: skip
    parser.add_argument(
        "--trust", action="append", default=[], type=Path, metavar="FILE.pub",
        help="take diagrams that this key signed; repeatable",
    )  # fmt: skip
    parser.add_argument("--insecure", action="store_true", help="take (and sign) diagrams that anybody sends")
    add_network(parser)
    add_library(parser)


def run(arguments: Namespace) -> int:
    """Serve until interrupted."""
    from fame.bpmn.library import Library
    from fame.deploy import SplitterNode
    from fame.deploy.signing import read_private, read_trusted
    from fame.scenario import serve

    key = read_private(arguments.key) if arguments.key is not None else None
    trusted = read_trusted(arguments.trust) if arguments.trust else []
    if key is not None:
        trusted.append(key.public_key())
    guarded = bool(trusted or arguments.insecure)
    if arguments.network is not None and not guarded:
        raise FameError(_OPEN)

    def build(scheduler: WallScheduler, middleware: Middleware) -> SplitterNode:
        if not (guarded or middleware.confined):
            raise FameError(_OPEN)
        return SplitterNode(
            scheduler=scheduler,
            middleware=middleware,
            library=Library(arguments.library),
            patience=arguments.wait,
            key=key,
            trusted=() if arguments.insecure else trusted,
            say=lambda text: note(f"{scheduler.now / 1e9:9.1f} s   {text}"),
        )

    serve(arguments.middleware, arguments.network, build)
    return 0
