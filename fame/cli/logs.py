"""Commands for recordings: ``fame log record``, ``collect``, ``merge``, ``convert`` and ``judge``."""

from __future__ import annotations

import sys
from argparse import ArgumentTypeError, Namespace
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.arguments import Commands, Parser, add_json, add_library, add_properties, command, group
from fame.cli.network import add_network, note_ready
from fame.cli.output import note, progress_line, table
from fame.errors import ConfigError, UnavailableError
from fame.rooms import COLLECT, CONVERT_RECORDING, JUDGE_COMMAND, JUDGE_FOR, load

if TYPE_CHECKING:
    from fame.clock import WallScheduler
    from fame.log.recording_file import RecordingFile
    from fame.log.team_recorder import TeamRecorder
    from fame.middleware.interface import Middleware


def add(commands: Commands) -> None:
    parser = group(
        commands, "log", help="record a team on the network; collect, merge, convert and judge recordings",
        examples=("fame log record -o run.mcap", "fame log convert run.mcap -o run.xes"),
    )  # fmt: skip
    parts = parser.add_subparsers(dest="part", required=True, metavar="SUBCOMMAND")
    _add_record(parts)
    _add_convert(parts)
    _add_merge(parts)
    _add_collect(parts)
    _add_judge(parts)


def _add_collect(parts: Commands) -> None:
    """Declare the command of a room; without it, what says so whatever is given."""
    try:
        load(COLLECT)(parts)
    except UnavailableError as error:
        absent, lacking = parts.add_parser("collect", help=str(error), prefix_chars="\0", add_help=False), error

        def refuse(_: object) -> int:
            raise lacking

        absent.add_argument("arguments", nargs="*", type=refuse)
        absent.set_defaults(command=refuse, leaf=absent, no_project=True)


def _add_record(parts: Commands) -> None:
    recording = command(
        parts, "record", record,
        examples=("fame log record -o run.mcap", "fame log record -o run.mcap --robot REX --log-topics all"),
        help="record a team until Ctrl-C: events, variables, what tokens wait for, signals and the simulated world",
    )  # fmt: skip
    _add_output(recording, "FILE.mcap", "the recording, in place of an old one")
    recording.add_argument(
        "--robot", action="append", default=[], metavar="NAME", help="record this robot only; repeatable"
    )
    recording.add_argument(
        "--log-topics", choices=("signals", "all"), default="signals",
        help="messages to record: those of signals (default), or of all topics, sensors and motors included",
    )  # fmt: skip
    add_properties(recording)
    add_network(recording)
    add_library(recording)


def _add_convert(parts: Commands) -> None:
    converting = command(
        parts, "convert", convert,
        examples=(
            "fame log convert run.mcap -o carriers.xes --robot 'Carrier_*' --level mission",
            "fame log convert run.mcap -o run.ocel.json --object parcel=parcel_id",
        ),
        help="convert a recording to .jsonl, .csv, .xes (process mining, IEEE 1849) or .ocel.json (OCEL 2.0), "
        "or the messages of topics to a bag of ROS 2",
    )  # fmt: skip
    converting.add_argument("recording", type=Path, metavar="RUN.mcap")
    _add_output(
        converting,
        "FILE",
        "the log, in place of an old one; the end of its name selects the form. Without one: a new folder, for a bag",
    )
    converting.add_argument(
        "--level", choices=("mission", "all"),
        help="activities and labelled elements of the mission, and its signals (mission, the default for OCEL), or "
        "everything: also what is inside called files, and the messages of sensors and motors",
    )  # fmt: skip
    converting.add_argument(
        "--object", action="append", default=[], type=naming, metavar="TYPE=VARIABLE",
        help="OCEL: what a variable names is an object of this type; repeatable",
    )  # fmt: skip
    converting.add_argument(
        "--robot", action="append", default=[], metavar="NAME",
        help="the events of this robot only, or of those that a pattern names ('Carrier_*'); repeatable",
    )  # fmt: skip


def _add_merge(parts: Commands) -> None:
    merging = command(
        parts, "merge", merge,
        examples=("fame log merge REX-*.mcap DINGO-*.mcap -o team.mcap",),
        help="merge recordings by time, such as those of fame engine --log",
    )  # fmt: skip
    merging.add_argument("recordings", type=Path, nargs="+", metavar="FILE.mcap")
    _add_output(merging, "FILE.mcap", "the merged recording, in place of an old one")


def _add_judge(parts: Commands) -> None:
    judging = command(
        parts, "judge", lambda arguments: int(load(JUDGE_COMMAND)(arguments)),
        examples=("fame log judge mission.properties.yaml run.mcap", "fame log judge examples/agriculture.yaml out"),
        help="judge the properties of a team in recordings: what fame run says while it runs",
    )  # fmt: skip
    judging.add_argument(
        "properties", type=Path, metavar="FILE.yaml",
        help="properties (NAME.properties.yaml), or a scenario that has some",
    )  # fmt: skip
    judging.add_argument(
        "runs", type=Path, nargs="+", metavar="RUN",
        help="a recording (.mcap), a bag of ROS 2, a log (.jsonl, .csv, .xes, .xes.gz, .ocel.json: of the model beside "
        "the properties), or a folder of them",
    )  # fmt: skip
    judging.add_argument(
        "--columns", action="append", default=[], type=naming, metavar="KEY=NAME",
        help="judge .xes files of another tool: what names the robot (org:resource unless said), the element by id or "
        "label (concept:name), the transition (lifecycle:transition) and the time (time:timestamp); case:NAME is "
        "that of the trace; repeatable",
    )  # fmt: skip
    add_library(judging)
    add_json(judging)


def _add_output(parser: Parser, metavar: str, help: str) -> None:
    parser.add_argument("-o", "--output", required=True, type=Path, metavar=metavar, help=help)


def _expect_recording(path: Path) -> None:
    if path.suffix.lower() != ".mcap":
        raise ConfigError(f"expected a file name that ends in .mcap, got {path.suffix!r}", file=str(path))


def record(arguments: Namespace) -> int:
    """Record until interrupted, and say what was recorded; the exit code is that of the properties."""
    from fame.log import Recording
    from fame.log.recording_file import RecordingFile
    from fame.log.team_recorder import TeamRecorder, TeamRecorderOptions
    from fame.log.writing import new_file
    from fame.properties.judgement import HEADS, exit_code
    from fame.scenario import serve

    _expect_recording(arguments.output)
    judging = load(JUDGE_FOR)(arguments, note) if arguments.properties is not None else None
    metadata = {"command": arguments.command_line}
    options = TeamRecorderOptions(robots=frozenset(arguments.robot), topics=arguments.log_topics, metadata=metadata)
    recorders: list[TeamRecorder] = []
    with new_file(arguments.output) as begin:

        def open_file() -> RecordingFile:
            return RecordingFile(begin())

        def build(scheduler: WallScheduler, middleware: Middleware) -> TeamRecorder:
            recorder = TeamRecorder(middleware, scheduler, open_file, options, note=note, judging=judging)
            recorders.append(recorder)
            note_ready(f"records to {arguments.output}")
            return recorder

        serve(arguments.middleware, arguments.network, build)
    (recorder,) = recorders
    if not recorder.begun:
        note("fame: received nothing from any robot: no recording was written")
        return 1
    with Recording(arguments.output) as recording:
        lost = "".join(f"; {count} batches of {robot} were lost" for robot, count in recorder.team.gaps.items())
        robots = ", ".join(recording.robots)
        note(f"{arguments.output}: {recording.duration:.1f} s of {robots}{lost}")
    if judging is None:
        return 0
    print(table(HEADS, [each.row for each in judging.judgements]))
    return exit_code(judging.judgements)


def convert(arguments: Namespace) -> int:
    options = {"level": arguments.level, "named": dict(arguments.object), "robots": arguments.robot}
    return _write("converting", partial(load(CONVERT_RECORDING), arguments.recording, **options), arguments)


def naming(text: str) -> tuple[str, str]:
    kind, _, variable = text.partition("=")
    if not kind or not variable:
        raise ArgumentTypeError(f"expected KEY=NAME, as in parcel=parcel_id or robot=org:resource, got {text!r}")
    return kind, variable


def merge(arguments: Namespace) -> int:
    from fame.log.merging import merge as merge_recordings

    return _write("merging", partial(merge_recordings, arguments.recordings), arguments)


def _write(doing: str, write: Callable[..., Iterable[str]], arguments: Namespace) -> int:
    """Write the output, and note what `write` warns of."""
    with progress_line(sys.stderr) as line:
        warnings = write(
            arguments.output,
            lambda done: line.write(f"{doing}: {done:.0%}", done) if line is not None else None,
        )
    for warning in warnings:
        note(f"fame: {warning}")
    return 0
