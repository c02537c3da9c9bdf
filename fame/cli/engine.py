"""``fame engine``: one robot's engine, waiting for its process on the topic."""

from __future__ import annotations

import re
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.cli.arguments import Commands, Parser, add_library, add_trust, command, epoch, natural, trusted_keys
from fame.cli.network import add_network, guard, lockstep, note_ready, wait_until
from fame.cli.output import note, survive_stdout
from fame.errors import ConfigError, FameError
from fame.rooms import DDS_RELAY, ENGINE_LOG, METRICS, MIDDLEWARES, ZENOH_MEETING, load

if TYPE_CHECKING:
    import socket
    from datetime import datetime

    from fame.bpmn.library import Library
    from fame.clock import WallScheduler
    from fame.deploy import EngineNode
    from fame.middleware.interface import Middleware
    from fame.middleware.simulated_time import ClockFollower
    from fame.robot import Event
    from fame.robot.journal import StateDirectory

STUCK = 10.0
"""CPU time (s) after which a call that cannot be interrupted ends the engine."""


def add(commands: Commands) -> None:
    parser = command(
        commands, "engine", run,
        examples=(
            "fame engine REX --type car",
            "fame engine Tractor_1 --type tractor --state state/Tractor_1",
            "fame engine Drone_1 Drone_2 Drone_3 --middleware zenoh  # three engines, each a process",
        ),
        help="run one robot's engine: it waits for its process on /NAME/bpmn_process",
    )  # fmt: skip
    add_options(parser)


def add_options(parser: Parser, *, here: bool = True) -> None:
    """Declare names and options of an engine. `here`: for an engine of this machine."""
    parser.add_argument(
        "names", nargs="+", type=_name, metavar="NAME",
        help="the robot's name and namespace; of several, each gets a process of its own, which starts faster than by "
        "a command of its own",
    )  # fmt: skip
    parser.add_argument("--type", metavar="TYPE", help="kind of robot (car ...), which determines its safe state")
    add_trust(parser, "run only deployments signed with this key; repeatable (see fame keys)")
    parser.add_argument(
        "--identity", type=Path, metavar="FILE.key",
        help="sign the engine's messages with this key, which proves the robot's name (see fame keys); needs --trust",
    )  # fmt: skip
    parser.add_argument(
        "--unsigned-tasks", action="store_true",
        help="with --trust: accept unsigned requests (fame complete, activate, retry, skip, set, move)",
    )  # fmt: skip
    parser.add_argument("--insecure", action="store_true", help="accept unsigned processes from other machines")
    parser.add_argument(
        "--use-sim-time",
        action="store_true",
        help="use the time on /clock, which a simulated world publishes",
    )
    parser.add_argument(
        "--lockstep", action="store_true", help="as --use-sim-time; the world waits for this engine after each step"
    )
    parser.add_argument(
        "--epoch", type=epoch, metavar="DATE|now",
        help="the date at second 0 of the mission (default: the real date; 1970-01-01T00:00Z in simulated time)",
    )  # fmt: skip
    parser.add_argument(
        "--files", type=Path, metavar="DIR",
        help="folder of the files that service tasks use, such as learned models (default: the current folder)",
    )  # fmt: skip
    parser.add_argument(
        "--seed", type=natural, metavar="N",
        help="random numbers of the mission: robot.random, and the modules random and numpy.random (default: a new "
        "seed, which recordings contain)",
    )  # fmt: skip
    _add_storage(parser)
    add_network(parser, here=here)
    add_library(parser)


def _add_storage(parser: ArgumentParser) -> None:
    """Declare the options on state, errors and recordings."""
    parser.add_argument(
        "--state", type=Path, metavar="DIR",
        help="keep the mission on disk: after a crash the same command continues it (docs/durability.md)",
    )  # fmt: skip
    parser.add_argument(
        "--fresh", action="store_true", help="with --state: start over; the old state is moved to DIR/old-N"
    )
    parser.add_argument(
        "--on-error", choices=("fail", "hold"), default="fail",
        help="after an uncaught error: fail the mission, or hold the robot in its safe state until the mission is "
        "repaired (fame retry, skip, set, move)",
    )  # fmt: skip
    parser.add_argument(
        "--log", type=Path, metavar="DIR",
        help="write recordings to this folder; the last 10 files of about 50 MB are kept (fame log merge)",
    )  # fmt: skip
    parser.add_argument(
        "--diagnostics", action="store_true",
        help="publish the state of the mission on /diagnostics (diagnostic_msgs), once a second",
    )  # fmt: skip
    parser.add_argument(
        "--markers", type=_frame, metavar="FRAME",
        help="publish the mission for RViz on /mission_markers, once a second: the state at the robot's FRAME (such as "
        "NAME/base_link), goals, zones",
    )  # fmt: skip
    parser.add_argument(
        "--metrics", type=_address, metavar="[ADDRESS:]PORT",
        help="serve the state of the mission to Prometheus, at http://ADDRESS:PORT/metrics (127.0.0.1: to this machine "
        "only)",
    )  # fmt: skip
    parser.add_argument(
        "--lifecycle", action="store_true",
        help="be a managed node of ROS 2 (lifecycle_msgs): what is deployed starts when all its robots are activated",
    )  # fmt: skip
    parser.add_argument(
        "--fame-dt", action="store_true", help="publish every step on /fame_dt, for the viewer of the original FaMe"
    )


def _name(text: str) -> str:
    """The name of a robot, which is a namespace of ROS."""
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", text):
        raise ArgumentTypeError(f"expected ASCII letters, digits and _, a letter first, got {text!r}")
    return text


def _frame(text: str) -> str:
    """A frame of tf2: without spaces, and without a slash in front. Raises ArgumentTypeError."""
    if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_./-]*", text):
        raise ArgumentTypeError(f"expected a frame such as NAME/base_link, got {text!r}")
    return text


def _address(text: str) -> tuple[str, int]:
    """An address and a port, of this machine only unless an address is given."""
    address, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdecimal() and 0 < int(port) < 65536):
        raise ArgumentTypeError(f"expected a port, or ADDRESS:PORT, got {text!r}")
    return address.strip("[]") or "127.0.0.1", int(port)


def run(arguments: Namespace) -> int:
    """Serve until interrupted."""
    arguments.name, arguments.relay = arguments.names[0], None
    survive_stdout()
    if len(arguments.names) > 1:
        from fame.scenario.forking import fork_each

        _prepare_several(arguments)
        arguments.name, children, ends = fork_each(arguments.names)
        if children:
            return _wait(arguments, children, ends)
        if arguments.middleware == "dds" and not arguments.lockstep:
            (arguments.relay,) = ends
    return _run_one(arguments)


def _prepare_several(arguments: Namespace) -> None:
    """Load what all engines need. Raises ConfigError for what only one engine can have."""
    from fame.deploy.loading import preload_all

    options = {"--identity": arguments.identity, "--state": arguments.state, "--metrics": arguments.metrics}
    for option, value in options.items():
        if value is not None:
            raise ConfigError(f"{option} belongs to one robot: start each engine by its own command")
    if "NAME" not in (arguments.markers or "NAME"):
        raise ConfigError("--markers of several robots needs NAME, as in NAME/base_link: each has a frame of its own")
    twice = [name for name in dict.fromkeys(arguments.names) if arguments.names.count(name) > 1]
    if twice:
        raise ConfigError(f"named twice: {', '.join(twice)}")
    if arguments.middleware in MIDDLEWARES:
        load(MIDDLEWARES[arguments.middleware])
    preload_all()


def _wait(arguments: Namespace, children: Mapping[int, str], ends: Sequence[socket.socket]) -> int:
    """Wait for the engines, and be the process in which they meet. Their exit code: the first that is not 0."""
    from fame.scenario.forking import wait_for

    with ExitStack() as opened:
        codes = wait_for(children, *_meeting(arguments, ends, opened))
    for name, code in codes.items():
        if code < 0:
            note(f"fame: engine {name} was ended by signal {-code}")
    return next((code if code > 0 else 1 for code in codes.values() if code), 0)


def _meeting(arguments: Namespace, ends: Sequence[socket.socket], opened: ExitStack) -> Sequence[Callable[..., object]]:
    """Open what the engines meet in. Return what `wait_for` is to call meanwhile."""
    if arguments.middleware == "dds" and not arguments.lockstep:
        from fame.clock import SECOND
        from fame.scenario.process import scheduler_for

        scheduler = scheduler_for("dds")
        relay = load(DDS_RELAY)(scheduler, network=arguments.network)
        opened.callback(relay.close)
        served = {name: relay.serve(end) for name, end in zip(arguments.names, ends, strict=True)}
        return (
            lambda seconds: scheduler.run(scheduler.now + round(seconds * SECOND)),
            lambda name, stopped: served[name].on_stopped(stopped),
        )
    if arguments.middleware == "zenoh" and arguments.network is None:
        from fame.middleware.wire_base import domain_id

        meeting = load(ZENOH_MEETING)(domain_id(), len(ends))
        if meeting is not None:
            opened.callback(meeting.close)
    return ()


def _run_one(arguments: Namespace) -> int:
    from fame.gc_tuning import uncollected
    from fame.scripting.budget import heartbeat

    with ExitStack() as starting, heartbeat(last_resort=STUCK):
        starting.enter_context(uncollected(stays=True))
        _serve(arguments, starting)
    return 0


def _serve(arguments: Namespace, starting: ExitStack) -> None:
    from fame.deploy import EngineNode, engines
    from fame.deploy.loading import preload
    from fame.deploy.options import EngineOptions
    from fame.randomness import ModuleRandom
    from fame.scenario import serve

    check_options(arguments)
    trusted, identity = _keys(arguments)
    _check_files(arguments)
    expect_guarded = guard(arguments, trusted, "--trust FILE.pub")
    safe, suspended = safe_states(arguments.type)
    state = _state(arguments)
    library = _library(arguments)
    opened = ExitStack()

    def build(scheduler: WallScheduler, middleware: Middleware) -> EngineNode:
        expect_guarded(middleware)
        if _is_there(arguments.name, trusted, scheduler, middleware):
            raise FameError(f"there is an engine {arguments.name!r} already")
        time = _simulated_time(arguments, scheduler, middleware)
        starting.close()
        options = EngineOptions(
            log=opened.enter_context(_log(arguments.log, arguments.name, scheduler)) if arguments.log else None,
            recordings=arguments.log,
            observer=_element_feed(middleware, arguments.name) if arguments.fame_dt else None,
            time=time,
            library=library,
            on_report=_print_event,
            safe_state=safe,
            safe_suspended=suspended,
            trusted=trusted,
            identity=identity,
            unsigned_tasks=arguments.unsigned_tasks,
            files=arguments.files,
            epoch=arguments.epoch or _epoch(scheduler, simulated=time is not None),
            state=state,
            seed=arguments.seed,
            hold_errors=arguments.on_error == "hold",
            diagnostics=arguments.diagnostics,
            markers=(arguments.markers or "").replace("NAME", arguments.name),
            on_status=metrics,
            lifecycle=arguments.lifecycle,
        )
        engine = EngineNode(arguments.name, scheduler=scheduler, middleware=middleware, options=options)
        if time is not None:
            time.on_jump = engine.warn
        preload(scheduler, lambda: engine.state == "waiting", lambda: len(engines(middleware)))
        waits = f"waits for its process on /{arguments.name}/bpmn_process"
        note_ready(
            f"{arguments.name} " + (f"restores its mission from {arguments.state}" if engine.resuming else waits)
        )
        return engine

    with opened:
        metrics = [opened.enter_context(load(METRICS)(*arguments.metrics))] if arguments.metrics else []
        if arguments.seed is not None:
            opened.enter_context(ModuleRandom(arguments.seed, arguments.name))
        several = len(arguments.names) if len(arguments.names) > 1 else 0
        serve(arguments.middleware, arguments.network, build, crowd=several, relay=arguments.relay)


def check_options(arguments: Namespace) -> None:
    """Refuse options that exclude each other, on any machine. Raises ConfigError."""
    if arguments.identity is not None and not arguments.trust:
        raise ConfigError("--identity needs --trust FILE.pub")
    if arguments.lifecycle and arguments.trust and not arguments.unsigned_tasks:
        raise ConfigError("--lifecycle with --trust needs --unsigned-tasks: requests to services are not signed")


def _check_files(arguments: Namespace) -> None:
    if arguments.files is not None and not arguments.files.is_dir():
        raise ConfigError("expected a folder", file=str(arguments.files))


def _library(arguments: Namespace) -> Library | None:
    """The library of --library; without it, an engine loads none before its first process."""
    if not arguments.library:
        return None
    from fame.bpmn.library import Library

    return Library(arguments.library)


def _keys(arguments: Namespace) -> tuple[Any, Any]:
    """The public keys that are trusted, and the engine's identity or None. Raises ConfigError."""
    from fame.deploy.signing import read_identity

    trusted = trusted_keys(arguments)
    if arguments.identity is None:
        return trusted, None
    return trusted, read_identity(arguments.identity, arguments.name)


def _simulated_time(arguments: Namespace, scheduler: WallScheduler, middleware: Middleware) -> ClockFollower | None:
    """The follower of /clock, or None for wall-clock time."""
    if not (arguments.use_sim_time or arguments.lockstep or middleware.use_sim_time):
        return None
    from fame.middleware.interface import ENGINE, MISSION
    from fame.middleware.simulated_time import ClockFollower

    time, node = ClockFollower(scheduler), middleware.node(ENGINE, arguments.name, "clock")
    if arguments.lockstep:
        time.subscribe_in_lockstep(node, lockstep(middleware, lambda node: node.part == MISSION))
    else:
        time.subscribe(node)
    return time


def _log(folder: Path, robot: str, scheduler: WallScheduler) -> Any:
    """The log that the engine keeps. Raises ConfigError for a folder that cannot be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"expected a folder: {error.strerror}", file=str(folder)) from None
    return load(ENGINE_LOG)(folder, robot, scheduler, lambda text: note(f"{robot}: {text}"))


def _element_feed(middleware: Middleware, robot: str) -> Callable[[Event], object]:
    from fame.middleware.interface import ENGINE
    from fame.robot.live import ElementFeed

    return ElementFeed(middleware.node(ENGINE, robot, "elements"))


def _state(arguments: Namespace) -> StateDirectory | None:
    """The directory of the engine's state. Raises ConfigError."""
    if arguments.state is None:
        if arguments.fresh:
            raise ConfigError("--fresh needs --state DIR")
        return None
    from fame.imports import require

    require("orjson")
    from fame.robot.journal import StateDirectory

    state = StateDirectory(arguments.state)
    if arguments.fresh and (old := state.set_aside()) is not None:
        note(f"the old state is in {old}")
    return state


def _epoch(scheduler: WallScheduler, *, simulated: bool) -> datetime:
    """The date of second 0: on the wall clock such that dates are the real ones."""
    from datetime import UTC, datetime, timedelta

    from fame.clock import EPOCH

    return EPOCH if simulated else datetime.now(UTC) - timedelta(microseconds=scheduler.now // 1000)


def _is_there(name: str, trusted: Sequence[Any], scheduler: WallScheduler, middleware: Middleware) -> bool:
    """Whether an engine of that name publishes its status, with a proof where keys are used.

    A killed engine stays in the graph for a while, but publishes nothing.
    """
    import time

    from fame.clock import SECOND
    from fame.deploy import STATUS_QOS, STRING, Report, engines
    from fame.deploy.authentication import proves_presence
    from fame.deploy.status import HEARTBEAT

    scheduler.run(scheduler.now + SECOND // 2)  # until others are found
    reports: list[Report] = []

    def listen(message: Any) -> None:
        report = Report.from_json(message.data)
        if report is not None and proves_presence(report, name, trusted, time.time()):
            reports.append(report)

    if name not in engines(middleware):
        return False  # nobody to listen to, nothing that all others would have to hear of
    node = middleware.node("_fame_twin", name)
    node.subscription("bpmn_status", STRING, listen, STATUS_QOS)
    wait_until(scheduler, lambda: reports or name not in engines(middleware), 1.5 * HEARTBEAT)
    node.close()
    return bool(reports)


def safe_states(kind: str | None) -> tuple[Sequence[Any], Sequence[Any] | None]:
    """Return the safe states of a robot type: when its process has ended, and while it is suspended.

    Raises ConfigError for an unknown type.
    """
    if kind is None:
        return (), None
    from sim2d.robot import robot_class

    robot = robot_class(kind)
    return robot.SAFE_STATE, robot.SAFE_SUSPENDED


def _print_event(event: Event) -> None:
    from fame.scenario.process import encode_event, event_text, is_child

    if not is_child():
        note(event_text(event))
    elif event.what != "answer":  # the process that asked has the answer as a report
        note(encode_event(event))
