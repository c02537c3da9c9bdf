"""Declaring the arguments of commands: a parser that raises FAME's errors, and arguments that commands share."""

from __future__ import annotations

import argparse
import math
from argparse import ArgumentTypeError
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias

from fame.errors import ConfigError, FameError, UnavailableError
from fame.rooms import load
from fame.text import as_number, suggestion

if TYPE_CHECKING:
    from datetime import datetime

Commands: TypeAlias = "argparse._SubParsersAction[Parser]"
"""The object that commands are added to."""
ArgumentGroup: TypeAlias = "argparse._ArgumentGroup"
MISSION = {
    "new": "write a project: a mission of two robots, its world, tests, and fame.yaml",
    "demo": "write a project of two cars that seek a target, and run it: picture, film, recording",
    "run": "run a scenario (world, robots and model) or a model alone, in simulated time",
    "test": "run tests of missions with pytest; --cov-model: coverage of the models",
    "check": "report errors and likely mistakes in models and scenarios before anything moves",
    "campaign": "run a scenario many times with other seeds and values: success rate, causes of failures",
    "draw": "draw a model as SVG, with a log the path of that run; or a recording as a film",
    "view": "show a mission in the browser: a recording, a model while you draw it, a running team",
}
"""The commands of a mission, which ``fame --help`` describes without loading them."""


def _like(word: str, known: Iterable[str]) -> str:
    """A hint at the option that is spelt like `word`, else at all."""
    from difflib import get_close_matches

    named = {option.lstrip("-"): option for option in known}
    close = get_close_matches(word.lstrip("-").partition("=")[0], named, 1)
    return f"did you mean {named[close[0]]!r}?" if close else suggestion("", known)


def _formatter(width: int) -> Any:
    """The formatter of help in lines of that width: argparse would ask the terminal for each argument."""
    return partial(argparse.RawDescriptionHelpFormatter, width=width)


class Parser(argparse.ArgumentParser):
    """An argument parser that raises FameError instead of leaving the process."""

    def __init__(self, **options: Any) -> None:
        super().__init__(formatter_class=_formatter(78), allow_abbrev=False, **options)
        self.formatter_class: Any = self.formatter_class  # which checkers would take for a class
        self.given: list[tuple[argparse.Action, list[str]]] = []

    @property
    def arguments(self) -> Sequence[argparse.Action]:
        return self._actions

    def format_help(self) -> str:
        """Give the help, its description in lines that fit the terminal; examples stay in one line each."""
        from shutil import get_terminal_size
        from textwrap import fill

        width, description = get_terminal_size().columns - 2, self.description
        self.formatter_class = _formatter(width)
        self.description = fill(description, max(20, width)) if description else description
        try:
            return super().format_help()
        finally:
            self.description = description

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[argparse.Namespace, list[str]]:  # type: ignore[override]
        """Raise FameError for an unknown argument, with the name of the command that received it.

        Afterwards `given` has the arguments of the command line, each with its words.
        """
        self.given.clear()
        found, unknown = super().parse_known_args(args, namespace)
        if unknown:
            word, known = unknown[0], self._option_string_actions
            hint = f"unknown option {word!r}; {_like(word, known)}"
            self.error(hint if word.startswith("-") else f"unexpected argument {word!r}")
        return found, unknown

    def _get_values(self, action: argparse.Action, arg_strings: list[str]) -> Any:
        if action.option_strings or arg_strings:
            self.given.append((action, [word for word in arg_strings if word != "--"]))
        return super()._get_values(action, arg_strings)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Raise ArgumentError for a value that is not a choice; the message names the closest one, or all."""
        if action.choices is not None and value not in action.choices:
            raise argparse.ArgumentError(action, f"got {value!r}; {suggestion(value, action.choices)}")

    def error(self, message: str) -> NoReturn:
        raise FameError(f"{message} (see {self.prog} --help)")


class Version(argparse.Action):
    """``--version``: print the version and exit."""

    def __init__(self, **options: Any) -> None:
        super().__init__(nargs=0, default=argparse.SUPPRESS, **options)

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from fame import __version__

        print(f"fame {__version__}")
        parser.exit()


def command(
    commands: Commands,
    name: str,
    function: Callable[[argparse.Namespace], int],
    *,
    examples: Sequence[str],
    help: str = "",
) -> Parser:
    """Add a command that calls `function`. `help` is a sentence, `examples` are whole command lines."""
    made = group(commands, name, help=help or MISSION[name], examples=examples)
    made.set_defaults(command=function, leaf=made)
    made.add_argument("--no-project", action="store_true", help="ignore fame.yaml, which has defaults for a project")
    return made


def group(commands: Commands, name: str, *, help: str, examples: Sequence[str]) -> Parser:
    """Add a command that has subcommands."""
    lines = "\n".join(f"  {example}" for example in examples)
    return commands.add_parser(name, help=help, description=sentence(help), epilog=f"examples:\n{lines}")


def sentence(help: str) -> str:
    """Return what a command does, as a sentence."""
    return f"{help[0].upper()}{help[1:]}."


def number(expected: str, low: float, high: float) -> Callable[[str], float]:
    """Return a reader of numbers between two bounds, which `expected` tells, with them."""

    def read(text: str) -> float:
        if not low <= (found := as_number(text)) <= high:
            raise argparse.ArgumentTypeError(f"expected {expected}, got {text!r}")
        return found

    return read


def whole(expected: str, low: int, high: float = math.inf) -> Callable[[str], int]:
    """Return a reader of whole numbers, as `number`."""

    def read(text: str) -> int:
        if not text.isdecimal() or not low <= int(text) <= high:
            raise argparse.ArgumentTypeError(f"expected {expected}, got {text!r}")
        return int(text)

    return read


def namespace(text: str) -> str:
    """Read a namespace, whose slash at the beginning may be left out."""
    return text.strip("/")


natural: Callable[[str], int] = whole("a whole number from 0 on", 0)
positive: Callable[[str], float] = number("a number above 0", math.ulp(0.0), 1e15)  # from the smallest one


def assignment(text: str) -> tuple[str, Any]:
    """``cutoff=5``, ``names=[a, b]``: a value as YAML reads it."""
    from fame.config.loader import parse_document

    name, equals, value = text.partition("=")
    if not equals or not name:
        raise ArgumentTypeError(f"expected NAME=VALUE, as in cutoff=5, got {text!r}")
    try:
        return name.strip(), parse_document(value).data
    except ConfigError as error:
        raise ArgumentTypeError(f"{value!r}: {error.text}") from None


def epoch(text: str) -> datetime:
    """Return the date of second 0."""
    from fame.clock import parse_epoch

    try:
        return parse_epoch(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{error}; expected a date, or now") from None


class BackendNames:
    """What ``--middleware`` takes: FAME's own names, and those of other packages, which are looked up last."""

    def __init__(self, *more: str) -> None:
        self._own = (*more, "dds", "zenoh", "ros")

    def __contains__(self, name: object) -> bool:
        return name in self._own or name in self._added()

    def __iter__(self) -> Iterator[str]:
        return iter((*self._own, *self._added()))

    @staticmethod
    def _added() -> Mapping[str, str]:
        from fame.config.loader import registered

        return registered("fame.middleware")


def add_library(parser: Parser) -> None:
    """``--library DIR`` and ``--types DIR``, any number of times."""
    parser.add_argument(
        "--library", action="append", default=[], type=Path, metavar="DIR",
        help="folder with called processes; repeatable",
    )  # fmt: skip
    add_types(parser)


def add_types(parser: argparse.ArgumentParser) -> None:
    """``--types DIR``, any number of times; `register_types` makes them known."""
    parser.add_argument(
        "--types", action="append", default=[], type=Path, metavar="DIR",
        help="folder with .msg, .srv and .action files; repeatable",
    )  # fmt: skip


def register_types(arguments: argparse.Namespace) -> None:
    """Register the message types of ``--types``. Raises MessageError for a folder without any and for a wrong file."""
    for place in getattr(arguments, "types", ()):
        from fame.middleware.messages import register_files

        register_files(place)


def add_key(parser: argparse.ArgumentParser, help: str) -> None:
    """``--key FILE.key``; `private_key` reads it."""
    parser.add_argument("--key", type=Path, metavar="FILE.key", help=f"{help} (see fame keys)")


def private_key(arguments: argparse.Namespace) -> Any:
    """Return the secret key of ``--key``, None without it. Raises ConfigError."""
    if arguments.key is None:
        return None
    from fame.deploy.signing import read_private

    return read_private(arguments.key)


def add_trust(parser: argparse.ArgumentParser, help: str) -> None:
    """``--trust FILE.pub``, any number of times; `trusted_keys` reads them."""
    parser.add_argument("--trust", action="append", default=[], type=Path, metavar="FILE.pub", help=help)


def trusted_keys(arguments: argparse.Namespace) -> Sequence[Any]:
    """Return the public keys of ``--trust``. Raises ConfigError."""
    if not arguments.trust:
        return ()
    from fame.deploy.signing import read_trusted

    return read_trusted(arguments.trust)


def add_time_unit(parser: Parser, default: str) -> None:
    """``--time-unit``, of the numbers in the column of the times of CSV and Parquet files."""
    parser.add_argument(
        "--time-unit", choices=("s", "ms", "us", "ns"), help=f"unit of the column of the times (default: {default})"
    )


ROWS = ("rate", "start", "end", "anomaly_column", "benign")
"""What `add_rows` adds."""


def add_rows(parser: Parser) -> None:
    """What is said of the rows of CSV and Parquet files."""
    parser.add_argument("--rate", type=positive, metavar="HZ", help="rate of rows without times, or with other ones")
    parser.add_argument("--start", type=float, metavar="S", help="read each file from S s after its first row on")
    parser.add_argument("--end", type=positive, metavar="S", help="read each file until S s after its first row")
    parser.add_argument("--anomaly-column", metavar="NAME", help="column that is 0 in undisturbed rows: their labels")
    parser.add_argument(
        "--benign", metavar="CLASS", help="undisturbed class of a file of blocks, each behind a line with its class"
    )


def add_show(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--show", choices=("both", "diagram", "world"), default="both",
        help="what a film shows: the diagram with its tokens and the simulated world (default), or one of them",
    )  # fmt: skip


def add_properties(parser: Parser) -> None:
    parser.add_argument(
        "--properties", type=Path, metavar="FILE.yaml",
        help="judge these properties (NAME.properties.yaml), or those of a scenario",
    )  # fmt: skip


def add_from_room(parser: Parser | ArgumentGroup, options: str) -> None:
    """Declare the options that a room adds to a command; none if the room was taken away."""
    with suppress(UnavailableError):
        load(options)(parser)


def add_json(parser: Parser) -> None:
    parser.add_argument("--json", action="store_true", help="print one JSON object, also after an error")
