"""The `fame` command.

Exit code 0: done. 1: the mission or a check failed. 2: the request was wrong. 3: not known. 130: interrupted. Every
error is one line on stderr or, with ``--json``, in the one object on stdout. A command is a function that declares it
(`_DECLARATIONS`), and a function of its parsed arguments that returns the exit code; heavy parts are imported there.
"""

from __future__ import annotations

import os
import shlex
import signal
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from io import TextIOWrapper
from types import FrameType

from fame.cli import output, project
from fame.cli.arguments import Parser, Version, register_types
from fame.cli.network import without_ros_arguments
from fame.cli.output import error_object, note, print_json
from fame.errors import NOT_KNOWN, FameError

_DECLARATIONS: Mapping[str, str] = {
    "new": "new.add_new",
    "demo": "new.add_demo",
    "run": "run.add",
    "split": "models.add_split",
    "check": "check.add",
    "convert": "models.add_convert",
    "draw": "models.add_draw",
    "library": "models.add_library_command",
    "templates": "models.add_templates",
    "view": "view.add",
    "engine": "engine.add",
    "deploy": "deployment.add_deploy",
    "splitter": "deployment.add_splitter",
    "router": "network.add_router",
    "status": "robots.add_status",
    "log": "logs.add",
    **dict.fromkeys(("complete", "activate", "abort", "retry", "set", "move"), "robots.add_requests"),
    "world": "worlds.add_world",
    **dict.fromkeys(("pause", "resume"), "worlds.add_time"),
    "keys": "deployment.add_keys",
    "process": "pipelines.add_process",
    "record": "pipelines.add_record",
    "train": "pipelines.add_train",
    "judge": "monitors.add_judge",
    "model": "monitors.add_model",
    "param": "ros.add_param",
    "topic": "ros.add_topic",
    "adm": "adm.add",
    "test": "testing.add",
    "campaign": "campaign.add",
}
"""The function that declares each command. A module is imported when one of its commands is asked for: an engine starts
without what the other commands need."""
COMMANDS = tuple(_DECLARATIONS)
_BROKEN_PIPE, _INTERRUPTED = 141, 130  # as shells report a process that SIGPIPE or SIGINT ended


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line (that of the process by default) and return the exit code."""
    output.named.clear()
    given = without_ros_arguments(sys.argv[1:] if argv is None else argv)
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a name that the terminal cannot show is no reason to fail
    with _noting_interrupts() as interrupts:
        try:
            arguments = parser(*given[:1]).parse_args(given or ["--help"])
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
        except Exception as error:
            if interrupts:
                return _report(FameError("interrupted"), error, given, _INTERRUPTED)
            text = f"{type(error).__name__}: {error} (this is a bug in FAME; set FAME_DEBUG=1 for the traceback)"
            return _report(FameError(text), error, given, 1)
    return code


@contextmanager
def _noting_interrupts() -> Iterator[list[int]]:
    """Collect each Ctrl-C while the block lasts: a library may turn it into another error, as numpy does on import."""
    noted: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
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


def parser(name: str = "") -> Parser:
    """The parser of the command that is `asked` for, else of all commands."""
    top = Parser(
        prog="fame",
        description="Run the missions of a team of robots from BPMN 2.0 collaboration diagrams.",
        epilog="fame COMMAND --help describes the options of a command.\n"
        "Exit codes: 0 success, 1 the mission or a check failed, 2 the request was wrong, 3 not known (a search\n"
        "that was not exhaustive has found no error), 130 after Ctrl-C.",
    )
    top.add_argument("--version", action=Version, help="show the version and exit")
    commands = top.add_subparsers(metavar="COMMAND", required=True)
    for place in dict.fromkeys([_DECLARATIONS[name]] if name in COMMANDS else _DECLARATIONS.values()):
        module, add = place.split(".")
        getattr(import_module(f"fame.cli.{module}"), add)(commands)
    return top


def _report(error: FameError, cause: BaseException, given: Sequence[str], code: int) -> int:
    """Print an error as one line, or as the one JSON object, and return the exit code."""
    status = {_INTERRUPTED: "interrupted", NOT_KNOWN: "partial"}.get(code, "error")
    if os.environ.get("FAME_DEBUG"):
        import traceback

        traceback.print_exception(cause)
    if "--json" in given:
        print_json(error_object(error, cause, status))
    else:
        note(f"fame: {error}" if code == _INTERRUPTED else f"fame: error: {error}")
    return code
