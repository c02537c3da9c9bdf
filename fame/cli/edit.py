"""``fame edit``: draw a model in the browser."""

from __future__ import annotations

import threading
from argparse import Namespace
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.arguments import Commands, add_from_room, add_key, add_library, command, private_key
from fame.cli.network import add_network, person
from fame.cli.output import note
from fame.errors import ConfigError
from fame.rooms import VIEW_ADDRESS, VIEW_SERVING, load
from fame.text import unreadable

if TYPE_CHECKING:
    from fame.clock import WallScheduler
    from fame.edit.session import ModelEdit
    from fame.middleware.interface import Middleware
    from fame.view import TeamView

_LARGEST = 20_000_000
"""Bytes of the library that draws; version 5.35.0 has 6 million."""
_STAYS = "The page stays until Ctrl-C."
_EXAMPLES = (
    "fame edit --fetch",
    "fame edit mission.bpmn",
    "fame edit examples/agriculture.yaml --port 8080 --no-open",
    "fame edit mission.bpmn --team",
)


def add(commands: Commands) -> None:
    parser = command(
        commands, "edit", run, examples=_EXAMPLES,
        help="draw a model in the browser: findings of fame check while you draw, a run that changes with it, and a "
        "file that keeps all else",
    )  # fmt: skip
    parser.add_argument(
        "subject", type=Path, nargs="?", metavar="MODEL.bpmn|SCENARIO.yaml",
        help="what to draw; a model that is not there is begun",
    )  # fmt: skip
    parser.add_argument(
        "--fetch",
        action="store_true",
        help="download the library that draws (camunda-bpmn-js) from the registry of npm",
    )
    parser.add_argument(
        "--modeler", type=Path, metavar="FILE.tgz", help="take the library from this file, which npm pack makes"
    )
    parser.add_argument(
        "--team", action="store_true",
        help="add the page of what each save would change in the robots on the network, which deploys and migrates: "
        "whoever has its address can run code on them",
    )  # fmt: skip
    add_from_room(parser, VIEW_ADDRESS)
    add_key(parser, "--team: sign what is deployed")
    add_network(parser)
    add_library(parser)


def run(arguments: Namespace) -> int:
    """Serve the page until Ctrl-C; without a model, only install the library."""
    from fame.edit.modeler import fetch, installed, unpack

    if arguments.fetch and arguments.modeler is not None:
        raise ConfigError("--fetch and --modeler are two ways to the same library: choose one")
    if arguments.fetch:
        note(str(fetch()))
    if arguments.modeler is not None:
        try:
            with open(arguments.modeler, "rb") as file:
                content = file.read(_LARGEST + 1)
            if len(content) > _LARGEST:
                text = f"expected at most {_LARGEST // 1_000_000} MB, got more"
                raise ConfigError(text, file=str(arguments.modeler))
            note(str(unpack(content, str(arguments.modeler))))
        except OSError as error:
            raise ConfigError(unreadable(error), file=str(arguments.modeler)) from None
    if arguments.subject is None:
        if arguments.fetch or arguments.modeler is not None:
            return 0
        raise ConfigError("expected a model or a scenario: fame edit mission.bpmn")
    from fame.bpmn.library import Library
    from fame.edit.session import ModelEdit

    Library(arguments.library)  # a folder that is not there is told before the page is served
    with (
        ModelEdit(arguments.subject, installed(), arguments.library, arguments.types) as source,
        ExitStack() as served,
        suppress(KeyboardInterrupt),
    ):
        if not source.model.exists():
            note(f"{source.model} is not there: it is begun, and written when you save")
        if arguments.team:
            _beside_team(source, served, arguments)
            return 0
        _serve(source, served, arguments)
        threading.Event().wait()
    return 0


def _serve(source: ModelEdit, served: ExitStack, arguments: Namespace) -> None:
    """Serve the page. What it explores and runs ends before it does: an answer would be waited for."""
    served.enter_context(load(VIEW_SERVING)(source, arguments))
    served.callback(source.close)
    note(_STAYS)


def _beside_team(source: ModelEdit, served: ExitStack, arguments: Namespace) -> None:
    """Serve the page, and below it that of what a running team would change, until Ctrl-C."""
    from fame.scenario import serve
    from fame.view import TeamView

    key = private_key(arguments)

    def build(scheduler: WallScheduler, middleware: Middleware) -> TeamView:
        view = TeamView(middleware, scheduler, key=key, who=person())
        view.allow_change(source.model, arguments.library)
        source.change = view.change
        _serve(source, served, arguments)
        return view

    serve(arguments.middleware, arguments.network, build)
