"""``fame view``: the page that shows a mission."""

from __future__ import annotations

from argparse import ArgumentTypeError, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.arguments import Commands, command
from fame.errors import ConfigError

if TYPE_CHECKING:
    from fame.view import Server

_EXAMPLES = (
    "fame view run.mcap",
    "fame view run.mcap --port 8080 --no-open",
)


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "view", run, examples=_EXAMPLES,
        help="show a mission in the browser: a recording",
    )  # fmt: skip
    parser.add_argument("subject", type=Path, metavar="RUN.mcap", help="what to show")
    add_page(parser)


def add_page(parser: object) -> None:
    """``--port``, ``--host``, ``--no-open``."""
    add_argument = parser.add_argument  # type: ignore[attr-defined]
    add_argument("--port", type=_port, default=0, metavar="N", help="port of the page (any free one)")
    add_argument(
        "--host", default="127.0.0.1", metavar="ADDRESS", help="address to serve on (127.0.0.1: this machine only)"
    )
    add_argument("--no-open", action="store_true", help="do not open the browser")


def _port(text: str) -> int:
    if not text.isdecimal() or int(text) > 65535:
        raise ArgumentTypeError(f"expected a port from 0 to 65535, got {text!r}")
    return int(text)


def run(arguments: Namespace) -> int:
    """Serve the page until Ctrl-C."""

    from fame.view import Replay, Server

    path = arguments.subject
    if path.suffix.lower() != ".mcap":
        raise ConfigError(f"expected a recording (.mcap), got {path.suffix!r}", file=str(path))
    source = Replay(path)
    for notice in source.notices:
        print(f"fame: {notice}", flush=True)
    serve(Server(source, host=arguments.host, port=arguments.port), arguments)
    return 0


def serve(server: Server, arguments: Namespace) -> None:
    """Print the address, open the browser, and serve until Ctrl-C."""
    announce(server, arguments)
    server.run()


def announce(server: Server, arguments: Namespace) -> None:
    """Print the address of a page, and open it in the browser unless told not to."""
    print(server.address, flush=True)
    if not arguments.no_open:
        import threading
        import webbrowser

        threading.Thread(target=webbrowser.open, args=(server.address,), daemon=True).start()
