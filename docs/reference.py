"""The reference as Markdown, from what the code knows: its parsers, tables and docstrings.

A page has the comment ``<!-- generated: NAME -->`` where the text of ``GENERATED[NAME]`` is put in: up to the comment
``<!-- end -->``, if it has one, by ``python docs/reference.py``; else only on the site.
"""

from __future__ import annotations

import argparse
import inspect
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import partial
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any

from fame.bpmn.extension_properties import PROPERTIES
from fame.campaign import variation
from fame.cli import parser, project
from fame.cli.arguments import Parser
from fame.clock import Scheduler
from fame.imports import PURPOSES
from fame.middleware.local import LocalMiddleware
from fame.monitor.anomaly import learning_file
from fame.monitor.pipeline import configuration, run_trigger
from fame.monitor.pipeline.training_settings import Training
from fame.rooms import COMMANDS, PROCESSORS, ROOMS, load, room_of
from fame.scenario import plan
from fame.scenario.settings import NETWORK_KEYS
from fame.scripting.feel.functions.collections import COLLECTIONS, CONTEXTS
from fame.scripting.feel.functions.dates import MOMENTS
from fame.scripting.feel.functions.numbers import NUMBERS, RANGES
from fame.scripting.feel.functions.strings import TEXTS
from sim2d import config
from sim2d.robot import BUILT_IN, robot_class
from sim2d.world import World

PACKAGES = (
    "fame", "fame.bpmn", "fame.check", "fame.check.explore", "fame.clock", "fame.log", "fame.middleware",
    "fame.monitor", "fame.testing", "fame.testing.strategies", "sim2d", "robots",
)  # fmt: skip
"""The public packages (docs/python.md)."""
WIDTH = 90
"""Of a line of Python."""
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
    for group, names in COMMANDS.items():
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


# ---- Python ----------------------------------------------------------------------------------------------------------


def api() -> Iterator[str]:
    """The public names of each package, with their signatures and docstrings."""
    for package in PACKAGES:
        module = import_module(package)
        yield from (f"## `{package}`", "", *prose((module.__doc__ or "").partition("\n\n")[0]))
        for name in module.__all__:
            yield from public_name(package, name, getattr(module, name))


def public_name(package: str, name: str, value: Any) -> Iterator[str]:
    """A class with its methods and properties, a function, or a constant."""
    yield from (f"### `{package}.{name}`", "")
    if isinstance(value, type):
        plain = issubclass(value, Enum | Exception) or getattr(value, "_is_protocol", False)
        base = next(each.__name__ for each in value.__mro__[1:] if each.__name__[0] != "_")
        yield from code(f"class {name}({base})" if plain else signature(name, value, "class "))
        yield from prose(inspect.getdoc(value) or "")
        for member in dict.fromkeys(chain(*map(vars, value.__mro__))):
            yield from members(member, inspect.getattr_static(value, member))
    elif inspect.isroutine(value):
        yield from (*code(signature(name, value)), *prose(inspect.getdoc(value) or ""))
    else:
        yield from code(f"{name} = {value!r}")


def members(name: str, value: Any) -> Iterator[str]:
    """A public method or property of ours, with nothing for what else a class has."""
    value = getattr(value, "__func__", getattr(value, "func", value))  # of a class method, a cached property
    home = getattr(getattr(value, "fget", value), "__module__", "")
    if name[0] != "_" and home.split(".")[0] in ("fame", "robots", "sim2d"):
        yield from (f"#### `{name}`", "")
        yield from code(signature(name, value)) if inspect.isfunction(value) else ()
        yield from prose(inspect.getdoc(value) or "")


def code(text: str) -> Iterator[str]:
    """A block of Python."""
    yield from ("```python", text, "```", "")


def signature(name: str, function: Callable[..., Any], kind: str = "") -> str:
    """How a function or class is called: one argument a line where they do not fit into one."""
    found = inspect.signature(function)
    parts = [
        part.replace(
            annotation=Shown(part.annotation) if part.annotation is not part.empty else part.empty,
            default=Shown(default(part.default)) if part.default is not part.empty else part.empty,
        )
        for part in found.parameters.values()
        if part.name not in ("self", "cls")
    ]
    result = "" if kind or found.return_annotation is found.empty else f" -> {found.return_annotation}"
    text = str(inspect.Signature(parts))
    if len(name + text + result) > WIDTH:
        marks = [str(inspect.Signature([part]))[1:-1].removeprefix("*, ").removesuffix(", /") for part in parts]
        first = next((at for at, part in enumerate(parts) if part.kind is part.KEYWORD_ONLY), len(marks))
        if first < len(marks) and all(part.kind is not part.VAR_POSITIONAL for part in parts):
            marks.insert(first, "*")
        text = "(\n" + "".join(f"    {mark},\n" for mark in marks) + ")"
    return f"{kind}{name}{text}{result}"


class Shown(str):
    """Text that is shown as it is, without quotes."""

    __slots__ = ()
    __repr__ = str.__str__


def default(value: object) -> str:
    """A default value, if it is short."""
    text = repr(dict(value)) if isinstance(value, Mapping) else repr(value)
    return text if len(text) < 40 and "<" not in text else "..."


def prose(docstring: str) -> Iterator[str]:
    """A docstring as Markdown: its lists of names are tables, its examples blocks of code."""
    for part in re.split(r"\n\n+", docstring.strip()):
        rows = re.findall(r"^(\w[\w,. ]*?)  +(\S.*(?:\n +.*)*)$", part, re.MULTILINE)
        if part.startswith((">>>", " ")):
            yield from code(inspect.cleandoc(part))
        elif rows and len(rows) == len(re.findall(r"^\S", part, re.MULTILINE)):
            yield from table(("name", "meaning"), dict(rows))
        else:
            yield from (escaped(re.sub(r"``(.+?)``", r"`\1`", part)).replace("::", ":"), "")


# ---- functions of FEEL -----------------------------------------------------------------------------------------------


def feel() -> Iterator[str]:
    """The signatures of the functions, by what they are for."""
    groups = {
        "Numbers": NUMBERS, "Strings": TEXTS, "Lists": COLLECTIONS, "Contexts and null": CONTEXTS,
        "Dates and times": MOMENTS, "Ranges": RANGES,
    }  # fmt: skip
    for title, functions in groups.items():
        calls = (f"`{name}{each}`" for name, several in functions.items() for each in several)
        yield from ("", f"**{title}:** {', '.join(dict.fromkeys(calls))}")


# ---- what is executed and refused ------------------------------------------------------------------------------------

PLACES = (
    "process start", "event sub-process, interrupting", "event sub-process, not interrupting", "catch", "throw", "end",
    "boundary, interrupting", "boundary, not interrupting",
)  # fmt: skip


def tested(module: str) -> Any:
    """A module of the tests, which have what a table is about."""
    if (folder := str(Path(__file__).parent.parent / "tests")) not in sys.path:
        sys.path.insert(0, folder)
    return import_module(module)


def elements() -> Iterator[str]:
    """What the engine says of each event in each place, and of each activity: yes, a dash, or a letter."""
    page = tested("test_semantics_page")
    letters = {message: letter for letter, message in page.MESSAGES.items()}

    def cell(said: str, row: str) -> str:
        name = {"compensation": "compensate"}.get(row, row)
        if said.startswith(f"{name} events cannot be "):
            return str(page.NEVER)
        said = "error events cannot start a process" if said == f"{name} events cannot start a process" else said
        return letters[said] if said else "yes"

    kinds = ("once", *page.LOOPS, "as a compensation handler")
    for corner, rows, columns, made in (
        ("trigger or result", page.DEFINITIONS, PLACES, page.event),
        ("activity", page.ACTIVITIES, kinds, page.activity),
    ):  # fmt: skip
        yield from ("", f"| {corner} | {' | '.join(columns)} |", "| --- " * (len(columns) + 1) + "|")
        yield from (
            f"| {row} | {' | '.join(cell(page.refusal(made(row, of)), row) for of in columns)} |" for row in rows
        )


def refusals() -> Iterator[str]:
    """The messages of what is refused, but for those with a letter."""
    page = tested("test_semantics_page")
    yield from (f"- {escaped(message)}" for message in page.REFUSED if message not in page.MESSAGES.values())


def rooms() -> Iterator[str]:
    """The rooms around the core: what they import of each other, their lines to a twentieth, and what they are."""
    layers = tested("test_layers")
    lines, arrows = dict.fromkeys(("", *ROOMS), 0), {name: set[str]() for name in ROOMS}
    for module, path in layers.MODULES.items():
        lines[room_of(module)] += path.read_text("utf-8").count("\n")
    for item in layers.imports():
        source, target = room_of(item.source), room_of(item.target)
        if target not in ("", source):
            arrows[source].add(target)
    page = (Path(__file__).parent / "architecture.md").read_text("utf-8")
    drawn = {name: int(number.replace(",", "")) for name, number in re.findall(r'  (\w+)\["\1 · ([\d,]+)"\]', page)}
    yield from ("```mermaid", "flowchart LR")
    for name, number in ((name or "core", number) for name, number in lines.items()):
        before = drawn.get(name, 0)  # stays while right to a twentieth: few changes of the code change the page
        shown = before if 0.95 < before / number < 1.05 else round(number, 2 - len(str(number)))
        others = f" --> {' & '.join(sorted(arrows[name]))}" if arrows.get(name) else ""
        yield f'  {name}["{name} · {shown:,}"]{others}'
    yield from (f"  {' & '.join(ROOMS)} ==> core", "```", "")
    yield from ("| room | modules | for | extra |", "| --- | --- | --- | --- |")
    for name, room in ROOMS.items():
        modules = ", ".join(f"`{module}`" for module in room.modules)
        yield f"| {name} | {modules} | {room.about} | {f'`{room.extra}`' if room.extra else ''} |"


# ---- findings of checks ----------------------------------------------------------------------------------------------

CASES = {
    "errors": {"test_check_errors": "ERRORS"},
    "warnings": {
        "test_check_warnings": "WARNINGS",
        **{f"test_check_{of}": "WARNINGS" for of in ("flow", "signals", "scripts", "kinds", "concurrency")},
    },
}
"""The tests that have a model and a message for each problem."""


def findings(level: str) -> Iterator[str]:
    """What `fame check` says, by the names that tests give to the problems."""
    rows: dict[str, str] = {}
    for module, name in CASES[level].items():
        for problem, (_, message) in getattr(tested(module), name).items():
            rows.setdefault(message.partition(": ")[2].replace("|", chr(92) + "|"), escaped(problem))
    yield from ("| problem | example |", "| --- | --- |", *(f"| {name} | {text} |" for text, name in rows.items()))


# ---- extras ----------------------------------------------------------------------------------------------------------


def extras() -> Iterator[str]:
    """What each extra is for."""
    yield from ("| extra | for |", "| --- | --- |")
    for extra, purpose in PURPOSES.items():
        shown = re.sub(r"fame [a-z, ]*[a-z]|--[a-z]+( zenoh)?", lambda command: f"`{command[0]}`", purpose)
        yield f"| `{extra}` | {shown} |"


# ---- topics of robots ------------------------------------------------------------------------------------------------


def topics() -> Iterator[str]:
    """What a robot of each type publishes, subscribes and serves, as the graph shows it."""
    for name in BUILT_IN:
        middleware = LocalMiddleware(scheduler := Scheduler())
        robots = {"ROBOT": {"type": name, "at": [5, 5]}}
        World({"size": [10, 10], "robots": robots}, scheduler=scheduler, middleware=middleware)
        yield from (f"## {name}", "", "| topic | type | |", "| --- | --- | --- |")
        for topic in middleware.graph():
            does = "published" if topic.publishers else "subscribed"
            yield f"| `{topic.name.removeprefix('/ROBOT/')}` | {', '.join(topic.types)} | {does} |"
        for service, server in sorted(middleware.services.items()):
            yield f"| `{service.removeprefix('/ROBOT/')}` | {server.type} | service |"
        yield ""


# ---- keys of YAML files ----------------------------------------------------------------------------------------------


def keys() -> Iterator[str]:
    """The keys of each kind of file: from the tables of the validators, and parameters from their dataclasses."""
    for title, tables in FILES.items():
        yield from (f"## {title}", "")
        for about, known in tables.items():
            yield from (*([f"### {about}"] if about else []), *table(("key", "meaning"), known))
    yield "## Parameters of robots"
    for name in BUILT_IN:
        yield from (
            f"### `type: {name}`",
            *table(("key", "default, unit and meaning"), dict(parameters(robot_class(name).Parameters()))),
        )
    yield "## Processors of pipelines"
    for name, place in PROCESSORS.items():
        processor = load(place)
        yield from (f"### `Class: {name}`", "", *prose((inspect.getdoc(processor) or "").partition("\n\n")[0]))
        outputs = ", ".join(f"`{one}`" for one in processor.outputs)
        polls = any(one.name == "fields" for one in processor.parameters)
        yield from (f"Outputs: {outputs or ('those of `fields`' if polls else 'one per input, under its name')}.", "")
        about = {one.name: f"{one.description} ({one.default!r}{of_unit(one.unit)})" for one in processor.parameters}
        yield from table(("parameter", "meaning"), about)
    yield from ("## Training", "", *prose(inspect.getdoc(Training) or ""))


def parameters(defaults: Any, before: str = "") -> Iterator[tuple[str, str]]:
    """The key paths of a dataclass of parameters, each with its default and unit."""
    for one in fields(defaults):
        value = getattr(defaults, one.name)
        if is_dataclass(value):
            yield from parameters(value, f"{before}{one.name}.")
        else:
            yield f"{before}{one.name}", f"{value}{of_unit(one.metadata.get('unit', ''))}"


def of_unit(unit: str) -> str:
    """A unit behind what it is of."""
    return f" {unit}" if unit else ""


FILES: Mapping[str, Mapping[str, Mapping[str, str]]] = {
    "Scenarios": {
        "": plan.KEYS,
        "`complete`": plan.COMPLETE_KEYS,
        "`signal`": plan.SIGNAL_KEYS,
        "`network`": NETWORK_KEYS,
    },
    "Worlds": {
        "": config.KEYS,
        "`obstacles` and `targets`": config.OBSTACLE_KEYS,
        "`weeds`": config.WEED_KEYS,
        "`chargers`": config.CHARGER_KEYS,
        "`stations`": config.STATION_KEYS,
        "`parcels`": config.PARCEL_KEYS,
        "`doors`": config.DOOR_KEYS,
    },
    "fame.yaml": {"": project.KEYS},
    "Campaigns": {"": variation.KEYS},
    "Nodes of pipelines": {
        "": configuration.KEYS,
        "Entries of `Inputs` and `Outputs`": configuration.PORT_KEYS,
        "`Run`": run_trigger.KEYS,
    },
    "Learning files of anomaly detection": {"": learning_file.KEYS, "`Files`": learning_file.FILE_KEYS},
}
"""The tables of the validators."""
GENERATED: Mapping[str, Callable[[], Iterator[str]]] = {
    "commands": commands,
    "elements": elements,
    "refusals": refusals,
    "rooms": rooms,
    "extras": extras,
    "errors": partial(findings, "errors"),
    "warnings": partial(findings, "warnings"),
    "feel": feel,
    "keys": keys,
    "properties": properties,
    "python": api,
    "topics": topics,
}


_PLACE = re.compile(r"(<!-- generated: (\w+) -->\n?)(?:.*?(<!-- end -->)|)", re.DOTALL)


def generate(page: str, *, committed: bool = False) -> str:
    """A page with what its comments ask for: with an end, if that is `committed`, else without."""

    def text(found: re.Match[str]) -> str:
        if (found[3] is None) == committed:
            return found[0]
        made = re.sub(r"\n{3,}", "\n\n", "\n".join(GENERATED[found[2]]()))
        return f"{found[1]}\n{made.strip()}\n\n{found[3]}" if committed else made

    return _PLACE.sub(text, page)


def main() -> None:
    """Write what the pages have of the reference."""
    here = Path(__file__).parent
    for path in (here.parent / "README.md", *sorted(here.glob("*.md"))):
        old = path.read_text("utf-8")
        if (new := generate(old, committed=True)) != old:
            path.write_text(new, "utf-8")
            print(path)


if __name__ == "__main__":
    main()
