"""Commands for recordings: ``fame log record``, ``merge`` and ``convert``."""

from __future__ import annotations

import sys
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.arguments import Commands, Parser, add_types, command, group
from fame.cli.network import add_network, note_ready
from fame.cli.output import note
from fame.errors import ConfigError

if TYPE_CHECKING:
    from fame.clock import WallScheduler
    from fame.log.recording_file import RecordingFile
    from fame.log.team_recorder import TeamRecorder
    from fame.middleware.interface import Middleware


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = group(
        commands, "log", help="record a team on the network, merge recordings and convert them",
        examples=("fame log record -o run.mcap", "fame log convert run.mcap -o run.xes"),
    )  # fmt: skip
    parts = parser.add_subparsers(dest="part", required=True, metavar="SUBCOMMAND")
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
    add_network(recording)
    add_types(recording)

    converting = command(
        parts, "convert", convert,
        examples=("fame log convert run.mcap -o run.xes", "fame log convert run.mcap -o run.ocel.json"),
        help="convert a recording to .jsonl, .csv, .xes (process mining, IEEE 1849) or .ocel.json (OCEL 2.0)",
    )  # fmt: skip
    converting.add_argument("recording", type=Path, metavar="RUN.mcap")
    _add_output(converting, "FILE", "the log, in place of an old one; the end of its name selects the form")
    converting.add_argument(
        "--level", choices=("mission", "all"),
        help="OCEL: activities and labelled elements of the mission and its signals (mission, the default), or "
        "everything: also what is inside called files, and the messages of sensors and motors",
    )  # fmt: skip

    merging = command(
        parts, "merge", merge,
        examples=("fame log merge REX-*.mcap DINGO-*.mcap -o team.mcap",),
        help="merge recordings by time, such as those of fame engine --log",
    )  # fmt: skip
    merging.add_argument("recordings", type=Path, nargs="+", metavar="FILE.mcap")
    _add_output(merging, "FILE.mcap", "the merged recording, in place of an old one")


def _add_output(parser: Parser, metavar: str, help: str) -> None:
    parser.add_argument("-o", "--output", required=True, type=Path, metavar=metavar, help=help)


def _expect_recording(path: Path) -> None:
    if path.suffix.lower() != ".mcap":
        raise ConfigError(f"expected a file name that ends in .mcap, got {path.suffix!r}", file=str(path))


def record(arguments: Namespace) -> int:
    """Record until interrupted, and say what was recorded."""
    from fame.log import Recording
    from fame.log.recording_file import RecordingFile
    from fame.log.team_recorder import TeamRecorder
    from fame.log.writing import new_file
    from fame.scenario import serve

    _expect_recording(arguments.output)
    recorders: list[TeamRecorder] = []
    with new_file(arguments.output) as begin:

        def open_file() -> RecordingFile:
            return RecordingFile(begin())

        def build(scheduler: WallScheduler, middleware: Middleware) -> TeamRecorder:
            recorder = TeamRecorder(
                middleware,
                scheduler,
                open_file,
                topics=arguments.log_topics,
                robots=frozenset(arguments.robot),
                metadata={"command": arguments.command_line},
                note=note,
            )
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
    return 0


def convert(arguments: Namespace) -> int:
    """Convert a recording."""
    from fame.cli.output import progress_line
    from fame.log.conversion import convert as convert_recording

    with progress_line(sys.stderr) as line:
        warnings = convert_recording(
            arguments.recording,
            arguments.output,
            lambda done: line.write(f"converting: {done:.0%}", done) if line is not None else None,
            level=arguments.level,
        )
    for warning in warnings:
        note(f"fame: {warning}")
    return 0


def merge(arguments: Namespace) -> int:
    """Merge recordings."""
    from fame.cli.output import progress_line
    from fame.log.conversion import merge as merge_recordings

    with progress_line(sys.stderr) as line:
        warnings = merge_recordings(
            arguments.recordings,
            arguments.output,
            lambda done: line.write(f"merging: {done:.0%}", done) if line is not None else None,
        )
    for warning in warnings:
        note(f"fame: {warning}")
    return 0
