"""The `fame` command.

Exit code 0: done. 1: the mission or a check failed. 2: the request was wrong. 3: not known. 130: interrupted. Every
error is one line on stderr or, with ``--json``, in the one object on stdout. A command is a function that declares it
(`fame.rooms.COMMANDS`), and a function of its parsed arguments that returns the exit code, where heavy parts are
imported.
"""

from __future__ import annotations

import os
import shlex
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from io import TextIOWrapper
from types import FrameType
from typing import Any

from fame.cli import output
from fame.cli.arguments import MISSION, Commands, Parser, Version, group as add_group, register_types, sentence
from fame.cli.output import error_object, note, print_json
from fame.errors import NOT_KNOWN, FameError, UnavailableError, ValueChanged
from fame.rooms import COMMANDS, ROOMS, load, room_of

_PARTS = {
    "team": ("the commands for a running team; each is also a command of its own", "fame team status"),
    "monitor": ("learned models on the data of robots: record, train, process, judge", "fame monitor train own.yaml"),
}
"""The groups whose commands are parts of a command: help and example."""
NAMES = tuple(
    name for group, names in COMMANDS.items() for name in ((group,) if group in _PARTS else ()) + tuple(names)
    if group != "monitor" or name == group
)  # fmt: skip
_HELP = ("-h", "--help", "--version")
"""What needs no command: those of a mission are described, the others are listed by their names."""
_BROKEN_PIPE, _INTERRUPTED = 141, 130  # as shells report a process that SIGPIPE or SIGINT ended


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line (that of the process by default) and return the exit code."""
    output.named.clear()
    words = [*(sys.argv[1:] if argv is None else argv), "--ros-args"]  # which launch files append, with what follows
    given = _with_new_name(words[: words.index("--ros-args")])
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a name that the terminal cannot show is no reason to fail
    with _noting_interrupts() as interrupts, _noting_changed_values():
        try:
            alone = len(given) == 1 and given[0] in (*_PARTS, "log")
            given = given or ["--help"]
            arguments = parser(*given[:2]).parse_args([*given, "--help"] if alone else given)
            from fame.cli import project

            arguments.command_line = shlex.join(["fame", *given])
            project.apply(arguments)
            register_types(arguments)
            code: int = arguments.command(arguments)
            sys.stdout.flush()
        except BrokenPipeError:
            # Whoever read our output has left. What is still buffered would raise again at exit, so it goes nowhere.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return _BROKEN_PIPE
        except KeyboardInterrupt as interrupt:
            return _report(FameError("interrupted"), interrupt, given, _INTERRUPTED)
        except FameError as error:
            return _report(error, error, given, error.exit_code)
        except OSError as error:
            return _report(
                FameError(f"{error.filename or 'input or output'}: {error.strerror or error}"), error, given, 2
            )
        except MemoryError as error:
            return _report(FameError("no memory is left"), error, given, 1)
        except Exception as error:
            if interrupts:
                return _report(FameError("interrupted"), error, given, _INTERRUPTED)
            from fame.config.loader import raised_by_user
            from fame.imports import explained

            if (reason := explained(error) or raised_by_user(error)) is not None:
                return _report(reason, error, given, 2)
            text = f"{type(error).__name__}: {error} (this is a bug in FAME; set FAME_DEBUG=1 for the traceback)"
            return _report(FameError(text), error, given, 1)
    return code


@contextmanager
def _noting_changed_values() -> Iterator[None]:
    """Print each value that earlier releases read in another way, once."""
    noted = set[str]()
    with warnings.catch_warnings():
        warnings.simplefilter("always", ValueChanged)
        show = warnings.showwarning

        def note_once(message: Warning | str, category: type[Warning], *place: Any) -> None:
            if not issubclass(category, ValueChanged):
                show(message, category, *place)
            elif str(message) not in noted:
                noted.add(str(message))
                note(f"fame: note: {message}")

        warnings.showwarning = note_once  # type: ignore[assignment]
        yield


@contextmanager
def _noting_interrupts() -> Iterator[list[int]]:
    """Collect each Ctrl-C while the block lasts: a library may turn it into another error, as numpy does on import."""
    noted: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        __tracebackhide__ = True  # pytest names the line that was interrupted
        noted.append(number)
        signal.default_int_handler(number, frame)

    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not ours or threading.current_thread() is not threading.main_thread():
        yield noted
        return
    signal.signal(signal.SIGINT, note)
    try:
        yield noted
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _with_new_name(given: list[str]) -> list[str]:
    """A command line with the new name of its command, which is said if the name is old."""
    if not given or given[0] not in COMMANDS["monitor"]:
        return given
    if "--json" not in given:
        note(f"fame: note: fame {given[0]} is now fame monitor {given[0]}")
    return ["monitor", *given]


def parser(name: str = "", part: str = "") -> Parser:
    """Return the parser of the command that is asked for by its words, else of all commands."""
    top = _Top(prog="fame")
    top.add_argument("--version", action=Version, help="show the version and exit")
    commands = top.add_subparsers(metavar="COMMAND", required=True, parser_class=Parser)
    for group, declarations in COMMANDS.items() if name not in _HELP else ():
        if group in _PARTS and (name == group or name not in NAMES):
            about, example = _PARTS[group]
            made = add_group(commands, group, help=about, examples=(example,))
            parts = made.add_subparsers(metavar="SUBCOMMAND", required=True)
            _declare(parts, declarations, part)
            if name == group and not parts.choices:
                load(next(iter(declarations.values())))  # which says what is lacking
        if group != "monitor" and (name in declarations or name not in NAMES):
            _declare(commands, declarations, name)
    return top


def _declare(commands: Commands, declarations: Mapping[str, str], name: str) -> None:
    """Declare the command of a name, else all whose rooms are there."""
    for place in dict.fromkeys([declarations[name]] if name in declarations else declarations.values()):
        with suppress(UnavailableError) if name not in declarations else nullcontext():
            load(place)(commands)


class _Top(Parser):
    """The parser of all commands, whose help is one screen."""

    def format_help(self) -> str:
        from textwrap import wrap

        core = _of_room("")
        missions = [f" {name:10}{sentence(MISSION[name])}" for name in core["mission"]]
        return "\n".join(
            [
                "usage: fame [-h] [--version] COMMAND ...",
                "Run the missions of a team of robots from BPMN 2.0 collaboration diagrams.",
                *("a mission:", *missions),
                "a running team, also as fame team COMMAND:",
                *wrap(" ".join(core["team"]), 96, initial_indent=" ", subsequent_indent=" "),
                *("recordings and tools:", " log record | convert | merge | judge", f" {' '.join(core['tools'])}"),
                "of parts that an installation may lack:",
                *_room_lines(),
                "fame COMMAND --help describes a command; fame team, fame monitor and fame log list theirs.",
                "Exit codes: 0 success, 1 the mission or a check failed, 2 wrong request, 3 not known, 130 Ctrl-C.\n",
            ]
        )


def _of_room(room: str) -> dict[str, dict[str, str]]:
    """The commands of a room by group; with no name, those of the core."""
    return {
        group: {name: place for name, place in names.items() if room_of(place.partition(":")[0]) == room}
        for group, names in COMMANDS.items()
    }


def _room_lines() -> Iterator[str]:
    """A line for each room that has commands."""
    for room, about in ROOMS.items():
        parts = _of_room(room)
        names = [f"monitor {'|'.join(parts.pop('monitor'))}"] if parts["monitor"] else []
        names += [name for commands in parts.values() for name in commands]
        if names:
            yield f" {'; '.join(names)}: {about.about}"


def _report(error: FameError, cause: BaseException, given: Sequence[str], code: int) -> int:
    """Print an error as one line, or as the one JSON object, and return the exit code."""
    status = {_INTERRUPTED: "interrupted", NOT_KNOWN: "partial"}.get(code, "error")
    if os.environ.get("FAME_DEBUG"):
        import traceback

        traceback.print_exception(cause)
    if "--json" in given:
        print_json(error_object(error, cause, status))
    else:
        for line in (error, *getattr(error, "__notes__", ())):
            note(f"fame: {line}" if code == _INTERRUPTED else f"fame: error: {line}")
    return code
