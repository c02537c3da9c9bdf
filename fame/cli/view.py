"""``fame view``: the page that shows a mission."""

from __future__ import annotations

import atexit
import re
import shlex
import sys
import threading
from argparse import ArgumentTypeError, Namespace
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.cli.arguments import (
    Commands,
    Parser,
    add_from_room,
    add_key,
    add_library,
    add_properties,
    command,
    positive,
    private_key,
    register_types,
    whole,
)
from fame.cli.network import add_network, person
from fame.cli.output import note
from fame.errors import ConfigError, FameError
from fame.rooms import FOXGLOVE, JUDGE_FOR, MONITOR_INPUTS, MONITOR_LABEL, MONITOR_ON_PAGE, load
from fame.text import writable

if TYPE_CHECKING:
    from fame.clock import WallScheduler
    from fame.log import Recording
    from fame.log.team_recorder import RecordingJudge
    from fame.middleware.interface import Middleware
    from fame.scenario import Scenario
    from fame.view import HeatMap, LiveRun, ModelWatch, PageSource, Replay

SECOND = 1_000_000_000
PORT = whole("a port from 0 to 65535", 0, 65535)

_EXAMPLES = (
    "fame view run.mcap",
    "fame view run.mcap --port 8080 --no-open",
    "fame view run.mcap -o run.html",
    "fame view run.mcap --branch 12.5",
    "fame view run.mcap --monitor joint_monitor.skops --config low_pass.yaml --namespace Arm",
    "fame view out/runs",
    "fame view models/agriculture.bpmn",
    "fame view --robot REX --control",
    "fame view --foxglove 8765",
)


def add(commands: Commands) -> None:
    parser = command(commands, "view", run, examples=_EXAMPLES)
    parser.add_argument(
        "subject", type=Path, nargs="?", metavar="RUN.mcap|FOLDER|MODEL.bpmn|SCENARIO.yaml",
        help="what to show (of a folder: heat maps of all its recordings); without it, the team on the network",
    )  # fmt: skip
    parser.add_argument(
        "-o", "--output", type=Path, metavar="RUN.html",
        help="write RUN.mcap as one page that needs no server: to send it, or for a site",
    )  # fmt: skip
    parser.add_argument(
        "--without", action="append", default=[], metavar="KIND[,...]",
        help="-o: leave out what is private: variables, messages, log, world, properties, scripts, command, or "
        "what was published on a /topic; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--size",
        type=positive,
        default=25,
        metavar="MB",
        help="-o: thin what changes often until the page has this size (25)",
    )
    parser.add_argument(
        "--branch", type=positive, metavar="S",
        help="repeat the recorded run to simulated second S, and continue it differently in the browser",
    )  # fmt: skip
    parser.add_argument("--yes", action="store_true", help="--branch: run the files that the recording names, unasked")
    parser.add_argument(
        "--changed", action="store_true", help="--branch: also run files that differ from those in the recording"
    )
    parser.add_argument(
        "--robot", action="append", default=[], metavar="NAME", help="team: show this robot only; repeatable"
    )
    parser.add_argument(
        "--control", action="store_true", help="team: let the page complete tasks, repair missions and take robots over"
    )
    parser.add_argument(
        "--allow", action="append", default=[], choices=("deploy",),
        help="with --control: let the page deploy models, and migrate what runs: whoever has its address can run code "
        "on them",
    )  # fmt: skip
    parser.add_argument(
        "--foxglove", type=PORT, metavar="PORT",
        help="team: instead of the page, serve Foxglove at ws://ADDRESS:PORT (0: any free port): world, events, waits, "
        "variables, the robots' topics, to whoever reaches that address: Foxglove knows no token",
    )  # fmt: skip
    parser.add_argument(
        "--change", type=Path, metavar="MODEL.bpmn",
        help="with --allow deploy: show at each save what this model would change, beside those dropped on the page",
    )  # fmt: skip
    parser.add_argument(
        "--monitor", type=Path, metavar="MODEL.skops",
        help="RUN.mcap: judge it by this model, and draw what it alarms about in the band of its training runs",
    )  # fmt: skip
    add_from_room(parser, MONITOR_INPUTS)
    add_key(parser, "sign the requests of --control, and what --allow deploy sends")
    add_properties(parser)
    add_page(parser)
    add_network(parser)
    add_library(parser)


def add_address(parser: Parser) -> None:
    """``--port``, ``--host``, ``--tls``, ``--no-open``."""
    parser.add_argument(
        "--port",
        type=PORT,
        default=0,
        metavar="N",
        help="port of the page (any free one)",
    )
    parser.add_argument(
        "--host", default="127.0.0.1", metavar="ADDRESS", help="address of the page (127.0.0.1: from this machine only)"
    )
    parser.add_argument(
        "--tls", nargs=2, type=Path, metavar=("CERT", "KEY"), help="encrypt the page (https) with these PEM files"
    )
    parser.add_argument("--no-open", action="store_true", help="do not open the browser")


def add_page(parser: Parser) -> None:
    """Add where the page is, and who may use it."""
    add_address(parser)
    parser.add_argument(
        "--as", action="append", default=[], type=_person, metavar="USER:ROLE",
        help="print one more address, where USER can only complete tasks for USER, ROLE or anybody; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--take-over", action="append", default=[], metavar="ROLE",
        help="people of this ROLE (--as) may also take robots over, from their own address; repeatable",
    )  # fmt: skip


_STAYS = "The page stays until Ctrl-C."


def _person(text: str) -> tuple[str, str]:
    user, _, role = (part.strip() for part in text.partition(":"))
    if not user or not role:
        raise ArgumentTypeError(f"expected USER:ROLE, as ann:nurse, got {text!r}")
    return user, role


def run(arguments: Namespace) -> int:
    """Serve the page until Ctrl-C."""
    path = arguments.subject
    _refuse_inputs(arguments)
    if arguments.output is not None:
        return _write(arguments)
    if arguments.without:
        raise ConfigError("--without is for a page that is written: fame view RUN.mcap -o RUN.html")
    if path is None:
        return _team(arguments)
    for name in ("control", "allow", "change", "robot", "foxglove"):
        if getattr(arguments, name) not in (None, False, []):
            raise ConfigError(f"--{name} is for a running team: fame view without a file", file=str(path))
    if arguments.branch is not None:
        return _branch(arguments)
    if arguments.properties is not None:
        raise ConfigError("--properties judges a running team; of a recording: fame log judge FILE.yaml RUN.mcap")
    if vars(arguments)["as"]:
        raise ConfigError("--as is for a running team (with --control) or a run: nobody completes tasks of a file")
    with _source(path, arguments) as source, serving(source, arguments), suppress(KeyboardInterrupt):
        note(_STAYS)
        threading.Event().wait()
    return 0


def _write(arguments: Namespace) -> int:
    """Write a recording as a page that is one file."""
    from fame.view.page_file import write_page

    path = arguments.subject
    if path is None or path.suffix.lower() != ".mcap" or arguments.branch is not None:
        raise ConfigError("--output writes a recording (RUN.mcap) as a page, without --branch", file=str(path or ""))
    writable(arguments.output, path)
    without = [word for words in arguments.without for word in words.split(",") if word]
    with _replay(path, arguments) as replay:
        write_page(arguments.output, replay, without=without, size=arguments.size * 1e6, tell=note)
    written = arguments.output.stat().st_size
    print(f"{arguments.output}: {written / 1e6:.1f} MB")
    if written > arguments.size * 1e6:
        note(f"larger than {arguments.size:g} MB: events and what tokens wait for are not thinned")
    return 0


def _refuse_inputs(arguments: Namespace) -> None:
    """Raise ConfigError for options of monitors that would do nothing."""
    path, given = arguments.subject, [name for name in ("config", "namespace") if getattr(arguments, name, None)]
    if arguments.monitor is None:
        if given:
            raise ConfigError(f"--{given[0]} says what --monitor MODEL.skops reads of a recording")
    elif path is None or path.suffix.lower() != ".mcap" or arguments.branch is not None:
        raise ConfigError("--monitor judges a recording (RUN.mcap), without --branch", file=str(path or ""))


def _source(path: Path, arguments: Namespace) -> ModelWatch | Replay | HeatMap:
    """The viewer of a file or folder. Raises ConfigError for one that cannot be shown."""
    from fame.view import HeatMap, ModelWatch

    if path.is_dir():
        return HeatMap(path, show=partial(_page_of_run, arguments))
    kind = path.suffix.lower()
    if kind in (".bpmn", ".xml", ".yaml", ".yml"):
        return ModelWatch(path, arguments.library)
    if kind != ".mcap":
        expected = "a recording (.mcap), a model (.bpmn) or a scenario (.yaml)"
        raise ConfigError(f"expected {expected}, got {kind!r}", file=str(path))
    label = None if arguments.monitor is None else partial(load(MONITOR_LABEL), arguments.monitor, path, arguments)
    return _replay(path, arguments, branch=partial(_branch_of_page, arguments), label=label)


def _replay(path: Path, arguments: Namespace, **options: Any) -> Replay:
    """The viewer of a recording."""
    from fame.view import Replay

    monitor = None if arguments.monitor is None else load(MONITOR_ON_PAGE)(arguments.monitor, path, arguments)
    replay = Replay(path, monitor=monitor, **options)
    for notice in replay.notices:
        print(f"fame: {notice}", file=sys.stderr, flush=True)
    return replay


def _team(arguments: Namespace) -> int:
    """The team on the network, until Ctrl-C."""
    from fame.scenario import serve
    from fame.view import TeamView

    if arguments.branch is not None:
        raise ConfigError("--branch needs a recording: fame view run.mcap --branch S")
    if vars(arguments)["as"] and not arguments.control:
        raise ConfigError("--as needs --control: without it nobody completes tasks")
    if arguments.allow and not arguments.control:
        raise ConfigError("--allow deploy needs --control: without it the page only shows the team")
    if arguments.change is not None and not arguments.allow:
        raise ConfigError("--change needs --control --allow deploy")
    if arguments.change is not None and not arguments.change.is_file():
        raise ConfigError("cannot be read: no such file", file=str(arguments.change))
    key, judging = private_key(arguments), None
    if arguments.properties is not None:
        judging = load(JUDGE_FOR)(arguments, note)
    if arguments.foxglove is not None:
        return _foxglove(arguments, judging)
    with ExitStack() as served:

        def build(scheduler: WallScheduler, middleware: Middleware) -> TeamView:
            robots = frozenset(arguments.robot)
            view = TeamView(
                middleware, scheduler, robots=robots, control=arguments.control, key=key, judging=judging, who=person()
            )
            if arguments.allow:
                view.allow_change(arguments.change, arguments.library)
            served.enter_context(serving(view, arguments))
            note(_STAYS)
            return view

        serve(arguments.middleware, arguments.network, build)
    return 0


def _foxglove(arguments: Namespace, judging: RecordingJudge | None) -> int:
    """Serve the team on the network to Foxglove, until Ctrl-C."""
    from fame.log.team_recorder import TeamRecorder, TeamRecorderOptions
    from fame.scenario import serve

    if arguments.control or vars(arguments)["as"]:
        raise ConfigError("--foxglove only shows the team: --control is for the page")
    if arguments.port:
        raise ConfigError("--foxglove has a port of its own: --port is for the page")
    options = TeamRecorderOptions(robots=frozenset(arguments.robot), topics="all", models=False)
    with load(FOXGLOVE)(arguments.host, arguments.foxglove, arguments.tls) as server:

        def build(scheduler: WallScheduler, middleware: Middleware) -> TeamRecorder:
            recorder = TeamRecorder(middleware, scheduler, lambda: server.sink, options, note=note, judging=judging)
            print(server.address, flush=True)
            note("Foxglove is served until Ctrl-C.")
            return recorder

        serve(arguments.middleware, arguments.network, build)
    return 0


# ---- a run that lasts ------------------------------------------------------------------------------------------------


@contextmanager
def viewed(arguments: Namespace, scenario: Scenario) -> Iterator[LiveRun]:
    """The page of a run, served while the block lasts."""
    from fame.view import LiveRun, RunControl

    control = RunControl(speed=arguments.speed or 1.0)
    if arguments.paused:
        control.pause("Paused before the first step.")
    live = LiveRun(scenario, control)
    with serving(live, arguments):
        yield live


@contextmanager
def serving(source: PageSource, arguments: Namespace) -> Iterator[None]:
    """Serve the page of a source. Print its address, and open it in the browser unless told not to."""
    from fame.view import Server
    from fame.view.people import TAKE_OVER, Person

    users = vars(arguments).get("as", ())
    may = dict.fromkeys(getattr(arguments, "take_over", ()), TAKE_OVER)
    if missing := may.keys() - {role for _, role in users}:
        raise ConfigError(f"--take-over {min(missing)}: no --as gives anybody this role")
    tls = (arguments.tls[0], arguments.tls[1]) if arguments.tls else None
    people = [Person(user, role, may.get(role, ())) for user, role in users]
    with Server(source, host=arguments.host, port=arguments.port, people=people, tls=tls) as server:
        print(server.address, flush=True)
        for person, address in server.addresses.items():
            print(f"{person}: {address}", flush=True)
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


def _branch_of_page(arguments: Namespace, command: Mapping[str, Any]) -> Mapping[str, Any]:
    """Say what a branch would run; start it once the page has agreed (`yes`, and `changed` to what differs)."""
    from fame.log import Recording

    time, agreed = int(command["time"]), [f"--{word}" for word in ("yes", "changed") if command.get(word) is True]
    if "--yes" in agreed:
        branch = ("--branch", repr(time / SECOND), *agreed)
        return {
            "address": _page_of_run(arguments, arguments.subject, *branch),
            "said": "The run is at the cursor, in another page.",
        }
    with Recording(arguments.subject) as recording:
        files = _compared(recording, _recorded_command(recording))
        return {"command": recording.metadata["command"], "files": files, "changed": bool(_changed(files))}


def _page_of_run(arguments: Namespace, path: Path, *options: str) -> str:
    """Start the page of a recording, or of a branch of it, in a process of its own; gives its address."""
    from subprocess import PIPE, Popen

    words = ["view", str(path), "--no-open", *options]
    words += ["--host", arguments.host, *(("--tls", *map(str, arguments.tls)) if arguments.tls else ())]
    process = Popen([sys.executable, "-m", "fame", *words], stdout=PIPE, stderr=PIPE, text=True)
    assert process.stdout is not None
    assert process.stderr is not None
    address = process.stdout.readline().strip()
    if not address.startswith("http"):
        lines = [line for line in process.communicate()[1].splitlines() if line]
        raise FameError(lines[-1].removeprefix("fame: error: ") if lines else "the page has ended")
    atexit.register(process.terminate)
    return address


def _branch(arguments: Namespace) -> int:
    """Run a recorded run again to a time, stop there, and hand it over to the page."""
    from fame.cli.scenarios import scenario_of
    from fame.log import Recording
    from fame.view import LiveRun, RunControl, SameRun

    with Recording(arguments.subject) as recording:
        again = _recorded_command(recording)
        time = round(arguments.branch * SECOND)
        if time >= recording.end:
            text = f"expected a second before the end of the recording at {recording.end / SECOND:g} s"
            raise ConfigError(f"{text}, got {arguments.branch:g}", file=recording.file)
        _agree(arguments, recording, _compared(recording, again))
        scenario = scenario_of(again)
        live = LiveRun(
            scenario, RunControl(pause_at=time), title=f"{Path(scenario.file).stem} from {time / SECOND:g} s"
        )
        same = SameRun(recording, time, live)
        with serving(live, arguments):
            try:
                result = scenario.run(
                    observer=live.observer,
                    strict=again.strict,
                    on_interrupt=None,
                    pace=same,
                    hold_errors=again.on_error == "hold",
                )
            except FameError as error:  # the page says so, too
                live.end("failed", str(error))
                print(f"fame: error: {error}", file=sys.stderr, flush=True)
                wait_for_interrupt()
                return error.exit_code
            live.end(result.status)
            if result.status != "interrupted":
                wait_for_interrupt()
    return 0


def _recorded_command(recording: Recording) -> Namespace:
    """The command line of a recorded run. Raises ConfigError for what cannot be run again."""
    from fame.cli import parser

    command = shlex.split(recording.metadata.get("command", ""))
    if command[:2] != ["fame", "run"]:
        raise ConfigError("cannot be run again: it is not a recording of fame run", file=recording.file)
    try:
        again = parser("run").parse_args(command[1:])
    except SystemExit:
        raise ConfigError(f"cannot be run again: {shlex.join(command)} is no run", file=recording.file) from None
    register_types(again)
    if again.middleware != "local" or again.real_time:
        raise ConfigError("cannot be run again: only simulated runs in one process repeat exactly", file=recording.file)
    return again


_SAME, _DIFFERS, _GONE, _UNKNOWN = (
    "as recorded",
    "differs",
    "recorded, not used now",
    "not compared: not in the recording",
)


def _compared(recording: Recording, again: Namespace) -> list[tuple[str, str]]:
    """The files that a recorded command runs now, each with how it compares. None of their code is run for that.

    Raises ConfigError and ModelError for files that cannot be read.
    """
    from fame.bpmn.library import Library
    from fame.bpmn.pools import pools_of
    from fame.bpmn.reader import read
    from fame.config.loader import read_document
    from fame.scenario.plan import named_files

    named = named_files(again.scenario, dict(again.change))
    found = [(folder, path) for folder, path in named if folder != "models"]
    folders = [*again.library]
    if found and found[0][0] == "scenario":
        own = read_document(again.scenario).mapping().get("library")
        folders += [again.scenario.parent / folder.text() for folder in own.items()] if own is not None else []
    library = Library(folders)
    for mission in (read(path) for folder, path in named if folder == "models"):
        homes = [mission, *(home for pool in pools_of(mission) for home, _ in library.closure(mission, pool.process))]
        found += [("models", path) for path in dict.fromkeys(Path(home.file) for home in homes)]
    left, states = {*recording.attachments}, list[tuple[str, str]]()
    for folder, path in found:
        try:
            state = _UNKNOWN if folder == "module" else _state(recording, folder, path, left)
        except OSError as error:
            raise ConfigError(f"cannot be read: {error.strerror}", file=str(path)) from None
        states.append((str(path) if folder == "module" else str(path.resolve()), state))
    ours = ("scenario/", "models/", "world/", "code/")
    return states + [(name, _GONE) for name in sorted(left) if name.startswith(ours)]


def _state(recording: Recording, folder: str, path: Path, left: set[str]) -> str:
    """How a file compares with those of its name in a recording, which are taken from `left`."""
    content = path.read_bytes()
    numbered = re.compile(rf"{folder}/{re.escape(path.stem)}(-\d+)?{re.escape(path.suffix)}")
    known = [name for name in recording.attachments if numbered.fullmatch(name)]
    same = [name for name in known if recording.attachments[name] == content]
    left.difference_update(same or known)
    return _SAME if same else _DIFFERS if known else _UNKNOWN


def _changed(files: Sequence[tuple[str, str]]) -> list[str]:
    return [f"{path} ({state})" for path, state in files if state in (_DIFFERS, _GONE)]


def _agree(arguments: Namespace, recording: Recording, files: Sequence[tuple[str, str]]) -> None:
    """Ask whether to run these files. Raises ConfigError if not, or if nobody can be asked."""
    changed = _changed(files)
    if changed and not arguments.changed:
        text = f"is not of the files as they are now: {', '.join(changed)}; --changed runs them all the same"
        raise ConfigError(text, file=recording.file)
    if arguments.yes:
        return
    listed = [f"{path} ({state})" for path, state in files]
    if not sys.stdin.isatty():
        raise ConfigError(f"would run {', '.join(listed)}: --yes runs them unasked", file=recording.file)
    print("\n  ".join([f"The recording names: {recording.metadata['command']}", *listed]), file=sys.stderr)
    print("Run these files? [y/N] ", end="", file=sys.stderr, flush=True)
    if sys.stdin.readline().strip().lower() not in ("y", "yes"):
        raise ConfigError("is not run again, as you said", file=recording.file)
