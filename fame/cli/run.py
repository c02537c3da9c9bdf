"""``fame run``: a scenario, or a model alone, in one process."""

from __future__ import annotations

import os
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.arguments import (
    BackendNames,
    Commands,
    add_from_room,
    add_json,
    add_library,
    add_show,
    command,
    epoch,
    natural,
    positive,
)
from fame.cli.output import coloured, live_table, note, print_json, progress_line, table, table_within
from fame.cli.scenarios import add_variations, scenario_of
from fame.errors import ConfigError
from fame.rooms import CHECK_DRAWINGS, DRAW_RUN, JUDGE_LOG, TEAM_VOCABULARY, VIEW_OPTIONS, VIEW_RUN, VIEW_WAIT, load

if TYPE_CHECKING:
    from fame.log import About
    from fame.properties import Judgement
    from fame.robot.events import Observer
    from fame.scenario import Result, Scenario, TeamStatus

_EXAMPLES = (
    "fame run examples/ground_vehicles.yaml",
    "fame run examples/ground_vehicles.yaml --seed 7 --animate out/run.gif",
    "fame run examples/agriculture.yaml --robots Tractor=12 --fault Tractor_2@40:engine",
    "fame run mission.bpmn --duration 60 --log out/run.jsonl --log out/run.xes",
)
_APART = 0.1
"""How far the clocks of two processes of a run may be apart (s on the wall clock)."""
_SPARE = ("process", "model", "publishers", "instances", "since", "token at")
"""Columns of the live table that a narrow terminal can do without, the first one first."""


def add(commands: Commands) -> None:
    parser = command(commands, "run", run, examples=_EXAMPLES)
    parser.add_argument(
        "scenario", type=Path, nargs="?", metavar="SCENARIO.yaml|MODEL.bpmn",
        help="without it, the first scenario of the project (fame.yaml)",
    )  # fmt: skip
    parser.add_argument("--seed", type=natural, metavar="N", help="random seed (default: the scenario's, or 0)")
    parser.add_argument("--duration", type=positive, metavar="S", help="simulated seconds after which the run ends")
    parser.add_argument(
        "--epoch", type=epoch, metavar="DATE|now",
        help="the date at second 0, for date timers and now() (default: the scenario's, or 1970-01-01T00:00Z)",
    )  # fmt: skip
    add_variations(parser)
    _add_processes(parser)
    _add_outputs(parser)
    add_from_room(parser, VIEW_OPTIONS)
    add_library(parser)
    add_json(parser)
    parser.add_argument("--quiet", action="store_true", help="print nothing if all goes well")


def _add_processes(parser: ArgumentParser) -> None:
    """Declare where and how fast the mission runs, and how strictly it is read."""
    parser.add_argument(
        "--middleware", choices=BackendNames("local"), metavar="local|dds|zenoh|ros", default="local",
        help="local (default): everything in one process; otherwise the world and each engine are separate processes, "
        "at --speed, which do not receive the arguments after --ros-args",
    )  # fmt: skip
    parser.add_argument(
        "--speed",
        type=positive,
        metavar="F",
        help="with --view or separate processes: simulated seconds per second (1)",
    )
    parser.add_argument(
        "--lockstep", action="store_true",
        help="with --middleware dds or zenoh: the world waits for all engines after each step, so that runs are "
        "reproducible",
    )  # fmt: skip
    parser.add_argument(
        "--state", type=Path, metavar="DIR",
        help="with separate processes: each engine keeps its mission in DIR/ROBOT; one that dies is started again",
    )  # fmt: skip
    parser.add_argument(
        "--key", type=Path, metavar="FILE.key",
        help="with separate processes: the engines run what is signed with this key, so that fame deploy --key can "
        "redeploy them (default: a key of this run alone)",
    )  # fmt: skip
    parser.add_argument(
        "--real-time", action="store_true", help="run at wall-clock speed instead of as fast as possible"
    )
    parser.add_argument(
        "--semantics", choices=("standard", "original"),
        help="interrupting event sub-processes: standard, or original: they suspend and resume their scope",
    )  # fmt: skip
    parser.add_argument(
        "--strict", action="store_true", help="treat an undefined name in a payload and an output never set as errors"
    )


def _add_outputs(parser: ArgumentParser) -> None:
    """Declare what a run writes and shows."""
    parser.add_argument(
        "--log", action="append", default=[], type=Path, metavar="FILE",
        help="write the events as .jsonl, .csv or .xes, or a recording (.mcap) with variables, waiting tokens, signals "
        "and the world; overwrites the file; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--log-topics", choices=("signals", "all"), default="signals",
        help="messages in recordings: those of signals (default), or of all topics, sensors and motors included",
    )  # fmt: skip
    parser.add_argument("--picture", type=Path, metavar="FILE.png", help="draw the world and the paths of the robots")
    parser.add_argument("--animate", type=Path, metavar="FILE.gif|webp|mp4", help="make a film of the run")
    add_show(parser)
    parser.add_argument(
        "--view", action="store_true",
        help="show the run in the browser, at --speed (1), and control it there; Ctrl-C ends the run, then its page",
    )  # fmt: skip
    parser.add_argument("--paused", action="store_true", help="with --view: the run begins paused")
    parser.add_argument(
        "--on-error", choices=("fail", "hold"), default="fail",
        help="what an uncaught error does: its mission fails (default), or its robot holds until it is repaired on "
        "the page: retry, skip, move",
    )  # fmt: skip


def run(arguments: Namespace) -> int:
    """Run it and say how it went."""
    from fame.robot.events import combine_observers

    scenario = scenario_of(arguments)
    if not scenario.cast:
        raise ConfigError("expected at least one robot to run, got none", file=scenario.file)
    if arguments.middleware != "local":
        return _run_team(arguments, scenario)
    _check_options(arguments)
    _check_packages(arguments, scenario)
    quiet = arguments.quiet or arguments.json
    with (
        _log_files(arguments) as logs,
        progress_line(sys.stderr, wanted=not quiet) as line,
        load(VIEW_RUN)(arguments, scenario) if arguments.view else nullcontext() as page,
    ):
        with _logs(arguments, scenario, logs) as writes:
            result = scenario.run(
                real_time=arguments.real_time,
                observer=combine_observers([*writes, *([page.observer] if page is not None else [])]),
                progress=line.show if line is not None else None,
                strict=arguments.strict,
                on_interrupt=_note_stopping if page is None else _note_page_stays,
                pace=page,
                hold_errors=arguments.on_error == "hold",
            )
            if page is not None:
                page.end(result.status)
        if drawings := _drawings(arguments):
            load(DRAW_RUN)(arguments, drawings, logs, line)
        if page is not None:
            code = _print_result(arguments, result)
            load(VIEW_WAIT)()
            return code
    return _print_result(arguments, result)


def _check_options(arguments: Namespace) -> None:
    """Raise ConfigError for options that a run in one process does not have."""
    if arguments.speed is not None and not arguments.view:
        raise ConfigError(
            "--speed needs --view, or --middleware dds, zenoh or ros: a run in one process is as fast as possible, "
            "or in real time with --real-time"
        )
    if arguments.paused and not arguments.view:
        raise ConfigError("--paused needs --view")
    if vars(arguments).get("as") and not arguments.view:
        raise ConfigError("--as needs --view: its addresses are of a page")
    if arguments.on_error == "hold" and not arguments.view:
        raise ConfigError("--on-error hold needs --view, where somebody repairs what has failed")
    if arguments.state is not None:
        raise ConfigError("--state needs --middleware dds, zenoh or ros; in one process see Simulation.save")
    if arguments.lockstep:
        raise ConfigError("--lockstep needs --middleware dds or zenoh")
    if arguments.key is not None:
        raise ConfigError("--key needs --middleware dds, zenoh or ros: nothing is deployed to one process")
    if arguments.real_time and arguments.view:
        raise ConfigError("--real-time does not go with --view: it runs at wall-clock speed, or at --speed")


def _print_result(arguments: Namespace, result: Result, *, reports: bool = True) -> int:
    """Print what a run came to, and give the exit code. Without `reports`, only what was reported several times."""
    if arguments.json:
        print_json(result.to_json())
    else:
        _print_summary(result, quiet=arguments.quiet, reports=reports)
    return result.exit_code


def _note_stopping() -> None:
    _note_in_handler(b"\nstopping after this step; Ctrl-C again to stop now\n")


def _note_page_stays() -> None:
    _note_in_handler(b"\nthe run ends after this step, and its page stays until you press Ctrl-C again\n")


def _note_in_handler(text: bytes) -> None:
    """Write unbuffered: a signal handler may interrupt a buffered stream, and the terminal may be gone."""
    with suppress(OSError):
        os.write(sys.stderr.fileno(), text)


def _run_team(arguments: Namespace, scenario: Scenario) -> int:
    """World and engines in processes of their own."""
    from fame.scenario import DistributedTeam, TeamOptions
    from fame.scenario.team_logs import team_logs

    wanted = ("robots", "fault")
    for option in wanted:
        if getattr(arguments, option):
            raise ConfigError(f"--{option} needs --middleware local: world and engines are in other processes")
    _check_packages(arguments, scenario)
    if arguments.lockstep and (scenario.completions or scenario.signals):
        note("fame: the world waits for the engines only: complete and signal come in a step that differs between runs")
    if arguments.state is not None:
        from fame.robot.journal import StateDirectory

        for robot in scenario.cast:  # before anything is started
            StateDirectory(arguments.state / robot).close()
    quiet = arguments.quiet or arguments.json
    options = TeamOptions(
        speed=arguments.speed, lockstep=arguments.lockstep, types=arguments.types, state=arguments.state,
        key=arguments.key,
    )  # fmt: skip
    with (
        _log_files(arguments, recorded=bool(scenario.properties)) as files,
        team_logs(scenario, files, _about(arguments, scenario), arguments.log_topics) as logs,
    ):
        with live_table(sys.stderr, wanted=not quiet) as live:
            result = DistributedTeam(
                scenario,
                arguments.middleware,
                options,
                on_status=lambda status: live.show(_seen(status)),
                on_line=lambda name, line: live.write(line),
                logs=logs,
            ).run()
        if logs is not None:
            judge = partial(_judgements, arguments, scenario)
            result = replace(result, judgements=tuple(logs.finish(judge)))
        with progress_line(sys.stderr, wanted=not quiet) as line:
            if drawings := _drawings(arguments):
                load(DRAW_RUN)(arguments, drawings, files, line)
    return _print_result(arguments, result, reports=False)


def _judgements(arguments: Namespace, scenario: Scenario, recording: Path) -> list[Judgement]:
    """The judgements about the recording of a team: nobody sees all of it while it runs."""
    if not scenario.properties:
        return []
    from fame.clock import SECOND

    apart = round(_APART * (arguments.speed or 1.0) * SECOND)
    team = load(TEAM_VOCABULARY)(scenario)
    found: list[Judgement] = load(JUDGE_LOG)(recording, scenario.properties, team=team, apart=apart, is_open=True)
    return found


def _seen(sight: TeamStatus) -> str:
    """The live table of a run in many processes."""
    from fame.cli.robots import HEADS, rows

    lines: list[tuple[str, ...]] = []
    for name, pid in sight.pids.items():
        report = sight.reports.get(name)
        found = list(rows(name, report)) if report is not None else [(name, "" if name == "world" else "comes")]
        lines += [
            (str(pid) if number == 0 else "", *row, *[""] * (len(HEADS) - len(row))) for number, row in enumerate(found)
        ]
    import shutil

    width = shutil.get_terminal_size().columns
    return f"{sight.time:.1f} s\n{table_within(width, ('process', *HEADS), lines, _SPARE)}"


@contextmanager
def _log_files(arguments: Namespace, *, recorded: bool = False) -> Iterator[list[Path]]:
    """The logs to write: those that are wanted, and a recording as long as needed, for drawings or if `recorded`."""
    from tempfile import TemporaryDirectory

    with TemporaryDirectory(prefix="fame-") if _drawings(arguments) or recorded else nullcontext("") as folder:
        needs_one = folder and not any(path.suffix.lower() == ".mcap" for path in arguments.log)
        yield [*arguments.log, *([Path(folder) / "run.mcap"] if needs_one else [])]


@contextmanager
def _logs(arguments: Namespace, scenario: Scenario, paths: Sequence[Path]) -> Iterator[list[Observer]]:
    """The writers of logs, open while the block runs."""
    if not paths:
        yield []
        return
    from fame.log import logging_to

    files, about, topics = scenario.closures(), _about(arguments, scenario), arguments.log_topics
    with ExitStack() as stack:
        yield [stack.enter_context(logging_to(path, files, about, topics=topics)) for path in paths]


def _about(arguments: Namespace, scenario: Scenario) -> About:
    """The metadata of a run for its recording, and its files besides the models."""
    from fame.clock import date_text
    from fame.log import About
    from fame.scenario.plan import named_files

    metadata = {
        "command": arguments.command_line,
        "seed": str(scenario.seed),
        "duration": f"{scenario.duration:g}",
        "epoch": date_text(scenario.epoch),
        "scenario": Path(scenario.file).name,
    }
    media = {"scenario": "application/yaml", "world": "application/yaml", "code": "text/x-python"}
    files = named_files(Path(scenario.file), dict(arguments.change))
    attachments = [
        (f"{folder}/{path.name}", media[folder], path.read_bytes()) for folder, path in files if folder in media
    ]
    return About(metadata=metadata, attachments=attachments)


def _drawings(arguments: Namespace) -> list[Path]:
    return [path for path in (arguments.picture, arguments.animate) if path is not None]


def _check_packages(arguments: Namespace, scenario: Scenario) -> None:
    """Complain about what is missing for the world or drawings, before anything is written."""
    from fame.imports import require

    if scenario.world is not None:
        require("pymunk")
    if _drawings(arguments):
        load(CHECK_DRAWINGS)(arguments, scenario)


# ---- text ------------------------------------------------------------------------------------------------------------


def _print_summary(result: Result, *, quiet: bool, reports: bool) -> None:
    """The summary on stdout; what scripts and robots reported, and what went wrong, on stderr."""
    from fame.scenario.result import HEADS

    if not quiet:
        for event, count in result.told:
            if not reports and count == 1:
                continue
            times = f" ({count} times)" if count > 1 else ""
            text = ": ".join(filter(None, (event.robot, event.element, event.detail)))
            note(f"{event.time / 1e9:7.1f} s   {text}{times}")
        print(table(HEADS, [robot.row for robot in result.robots]), end="\n\n")
        ended = f"{result.status}: {result.simulated:.1f} s simulated in {result.wall:.2f} s{_speed(result)}"
        print(coloured(ended, sys.stdout), flush=True)
        if result.judgements:
            from fame.properties.judgement import HEADS as HEADS_OF_PROPERTIES

            print(f"\n{table(HEADS_OF_PROPERTIES, [each.row for each in result.judgements])}", flush=True)
    for message in result.messages:
        note(f"fame: {message}")


def _speed(result: Result) -> str:
    """The speed of the run relative to real time, if it is defined."""
    faster = result.simulated / result.wall if result.wall > 0 else 0
    return f", {faster:.0f} times real time" if faster >= 2 else ""
