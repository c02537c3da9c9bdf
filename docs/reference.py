"""What the site generates as reference, as Markdown, from what the code knows: its parsers, tables and docstrings.

A page has the comment ``<!-- generated: NAME -->`` where the text of ``GENERATED[NAME]`` is put in.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterator, Mapping

from fame.bpmn.extension_properties import PROPERTIES
from fame.cli import GROUPS, parser
from fame.cli.arguments import Parser

TITLES = {
    "mission": "A mission",
    "team": "A running team",
    "monitor": "Learned models",
    "log": "Recordings",
    "tools": "Tools",
}


def escaped(text: str) -> str:
    """A text in which Markdown has nothing to interpret, but for code between backticks."""
    parts = re.split(r"(`[^`]+`)", " ".join(text.split()))
    return "".join(part if part[:1] == "`" else re.sub(r"([\\<>*|\[\]_])", r"\\\1", part) for part in parts)


def table(heads: tuple[str, str], rows: Mapping[str, str]) -> Iterator[str]:
    """A table of two columns: code, and what it means. Nothing if it has no rows."""
    if rows:
        yield from ("", f"| {heads[0]} | {heads[1]} |", "| --- | --- |")
        yield from (f"| `{name.replace('|', chr(92) + '|')}` | {escaped(meaning)} |" for name, meaning in rows.items())
        yield ""


# ---- commands --------------------------------------------------------------------------------------------------------


def commands() -> Iterator[str]:
    """Every command with its arguments and examples, in the groups of ``fame --help``."""
    for group, names in GROUPS.items():
        yield from (f"## {TITLES[group]}", "")
        for name in [group] if group == "monitor" else names:
            yield from command(subcommands(parser(name))[name])


def command(made: Parser) -> Iterator[str]:
    """A command, then its subcommands."""
    inner = subcommands(made)
    yield from (f"{'#' * min(len(made.prog.split()) + 1, 4)} `{made.prog}`", "", escaped(made.description or ""), "")
    if not inner:
        yield from ("```sh", *(line.strip() for line in (made.epilog or "").splitlines()[1:]), "```", "")
        yield from table(("argument", "meaning"), dict(map(argument, shown(made))))
    for each in inner.values():
        yield from command(each)


def subcommands(made: Parser) -> Mapping[str, Parser]:
    """The commands that a parser begins."""
    return next((action.choices for action in made.arguments if isinstance(action.choices, dict)), {})


def shown(made: Parser) -> list[argparse.Action]:
    """The arguments that a command's help shows, but those of all commands."""
    common = ("--help", "--no-project")
    return [one for one in made.arguments if one.help != argparse.SUPPRESS and not {*common} & {*one.option_strings}]


def argument(action: argparse.Action) -> tuple[str, str]:
    """How an argument is written, and what it means."""
    choices = "|".join(map(str, action.choices or ()))
    value = action.metavar or choices or action.dest.upper()
    value = " ".join(value) if isinstance(value, tuple) else value
    written = f"{', '.join(action.option_strings)} {value if action.nargs != 0 else ''}".strip()
    return written, (action.help or "") % vars(action)


# ---- extension properties --------------------------------------------------------------------------------------------


def properties() -> Iterator[str]:
    """The extension properties of each kind of element."""
    for elements, meanings in PROPERTIES.items():
        yield from (f"## {elements}", *table(("property", "meaning"), meanings))


GENERATED: Mapping[str, Callable[[], Iterator[str]]] = {"commands": commands, "properties": properties}


def generate(page: str) -> str:
    """A page with what its comments ask for."""
    return re.sub(r"<!-- generated: (\w+) -->", lambda found: "\n".join(GENERATED[found[1]]()), page)
