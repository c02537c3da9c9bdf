"""``fame view``: the page that shows a mission."""

from __future__ import annotations

import atexit
import shlex
import sys
import threading
from argparse import ArgumentTypeError, Namespace
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.arguments import Commands, Parser, add_library, command, positive
from fame.cli.network import add_network
from fame.errors import ConfigError, FameError

if TYPE_CHECKING:
    from fame.clock import WallScheduler
    from fame.log import Recording
    from fame.middleware.interface import Middleware
    from fame.scenario import Scenario
    from fame.view import LiveRun, ModelWatch, Replay, Source

SECOND = 1_000_000_000

_EXAMPLES = (
    "fame view run.mcap",
    "fame view run.mcap --port 8080 --no-open",
    "fame view run.mcap --branch 12.5",
    "fame view models/agriculture.bpmn",
    "fame view --robot REX --control",
)


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "view", run, examples=_EXAMPLES,
        help="show a mission in the browser: a recording, a model with its findings at each save, or a running team",
    )  # fmt: skip
    parser.add_argument(
        "subject", type=Path, nargs="?", metavar="RUN.mcap|MODEL.bpmn|SCENARIO.yaml",
        help="what to show; without it, the team on the network",
    )  # fmt: skip
    parser.add_argument(
        "--branch", type=positive, metavar="S",
        help="repeat the recorded run to simulated second S, and continue it differently in the browser",
    )  # fmt: skip
    parser.add_argument(
        "--robot", action="append", default=[], metavar="NAME", help="team: show this robot only; repeatable"
    )
    parser.add_argument(
        "--control", action="store_true", help="team: allow the page to complete tasks, retry, set and move"
    )
    parser.add_argument("--key", type=Path, metavar="FILE.key", help="sign the requests of --control (see fame keys)")
    add_page(parser)
    add_network(parser)
    add_library(parser)


def add_page(parser: Parser) -> None:
    """``--port``, ``--host``, ``--no-open``."""
    parser.add_argument("--port", type=_port, default=0, metavar="N", help="port of the page (any free one)")
    parser.add_argument(
        "--host", default="127.0.0.1", metavar="ADDRESS", help="address of the page (127.0.0.1: from this machine only)"
    )
    parser.add_argument("--no-open", action="store_true", help="do not open the browser")


def _port(text: str) -> int:
    if not text.isdecimal() or int(text) > 65535:
        raise ArgumentTypeError(f"expected a port from 0 to 65535, got {text!r}")
    return int(text)


def run(arguments: Namespace) -> int:
    """Serve the page until Ctrl-C."""
    path = arguments.subject
    if path is None:
        return _team(arguments)
    if arguments.branch is not None:
        return _branch(arguments)
    with _source(path, arguments) as source, _serving(source, arguments), suppress(KeyboardInterrupt):
        threading.Event().wait()
    return 0


def _source(path: Path, arguments: Namespace) -> ModelWatch | Replay:
    """The viewer of a file. Raises ConfigError for a file that cannot be shown."""
    from fame.view import ModelWatch, Replay

    kind = path.suffix.lower()
    if kind in (".bpmn", ".xml", ".yaml", ".yml"):
        return ModelWatch(path, arguments.library)
    if kind != ".mcap":
        expected = "a recording (.mcap), a model (.bpmn) or a scenario (.yaml)"
        raise ConfigError(f"expected {expected}, got {kind!r}", file=str(path))
    replay = Replay(path, branch=partial(_in_a_process, arguments))
    for notice in replay.notices:
        print(f"fame: {notice}", file=sys.stderr, flush=True)
    return replay


def _team(arguments: Namespace) -> int:
    """The team on the network, until Ctrl-C."""
    from fame.deploy.signing import read_private
    from fame.scenario import serve
    from fame.view import TeamView

    if arguments.branch is not None:
        raise ConfigError("--branch needs a recording: fame view run.mcap --branch S")
    key = read_private(arguments.key) if arguments.key is not None else None
    with ExitStack() as served:

        def build(scheduler: WallScheduler, middleware: Middleware) -> TeamView:
            robots = frozenset(arguments.robot)
            view = TeamView(middleware, scheduler, robots=robots, control=arguments.control, key=key)
            served.enter_context(_serving(view, arguments))
            return view

        serve(arguments.middleware, arguments.network, build)
    return 0


# ---- a run that lasts ------------------------------------------------------------------------------------------------


@contextmanager
def viewed(arguments: Namespace, scenario: Scenario) -> Iterator[LiveRun | None]:
    """The page of a run, served while the block lasts; None without ``--view``."""
    if not arguments.view:
        yield None
        return
    from fame.view import LiveRun, RunControl

    live = LiveRun(scenario, RunControl(speed=arguments.speed or 1.0))
    with _serving(live, arguments):
        yield live


@contextmanager
def _serving(source: Source, arguments: Namespace) -> Iterator[None]:
    """Serve the page of a source. Print its address, and open it in the browser unless told not to."""
    from fame.view import Server

    with Server(source, host=arguments.host, port=arguments.port) as server:
        print(server.address, flush=True)
        if not arguments.no_open:
            import webbrowser

            threading.Thread(target=webbrowser.open, args=(server.address,), daemon=True).start()
        yield


def wait_for_interrupt() -> None:
    """Wait until Ctrl-C."""
    with suppress(KeyboardInterrupt):
        print("The run has ended. The page stays until Ctrl-C.", file=sys.stderr, flush=True)
        threading.Event().wait()


# ---- branches --------------------------------------------------------------------------------------------------------


def _in_a_process(arguments: Namespace, time: int) -> str:
    """Start a branch of the recording at a time (ns) in a process of its own; gives the address of its page."""
    from subprocess import PIPE, Popen

    words = ["view", str(arguments.subject), "--branch", repr(time / SECOND), "--no-open", "--host", arguments.host]
    process = Popen([sys.executable, "-m", "fame", *words], stdout=PIPE, stderr=PIPE, text=True)
    assert process.stdout is not None
    assert process.stderr is not None
    address = process.stdout.readline().strip()
    if not address.startswith("http"):
        lines = [line for line in process.communicate()[1].splitlines() if line]
        raise FameError(lines[-1].removeprefix("fame: error: ") if lines else "the branch has ended")
    atexit.register(process.terminate)
    return address


def _branch(arguments: Namespace) -> int:
    """Run a recorded run again to a time, stop there, and hand it over to the page."""
    from fame.log import Recording
    from fame.view import LiveRun, RunControl, SameRun

    with Recording(arguments.subject) as recording:
        again, scenario = _recorded_run(recording)
        time = round(arguments.branch * SECOND)
        if time >= recording.end:
            text = f"expected a second before the end of the recording at {recording.end / SECOND:g} s"
            raise ConfigError(f"{text}, got {arguments.branch:g}", file=recording.file)
        live = LiveRun(
            scenario, RunControl(pause_at=time), title=f"{Path(scenario.file).stem} from {time / SECOND:g} s"
        )
        same = SameRun(recording, time, live)
        served = ExitStack()

        def start() -> None:
            """The run has come to the time, and is the recorded one so far."""
            served.enter_context(_serving(live, arguments))

        same.on_reached = start
        with served:
            result = scenario.run(observer=live.observer, strict=again.strict, on_interrupt=None, pace=same)
            live.finish(result.status)
            if result.status != "interrupted":
                wait_for_interrupt()
    return 0


def _recorded_run(recording: Recording) -> tuple[Namespace, Scenario]:
    """The command line of a recorded run, and its scenario. Raises ConfigError for what cannot be run again."""
    from fame.cli import parser
    from fame.cli.scenarios import scenario_of

    command = shlex.split(recording.metadata.get("command", ""))
    if command[:2] != ["fame", "run"]:
        raise ConfigError("cannot be run again: it is not a recording of fame run", file=recording.file)
    again = parser("run").parse_args(command[1:])
    if again.middleware != "local" or again.real_time:
        raise ConfigError("cannot be run again: only simulated runs in one process repeat exactly", file=recording.file)
    return again, scenario_of(again)
