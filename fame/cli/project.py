"""The project of a command: ``fame.yaml``, found from the current folder upwards, has defaults for arguments.

A command takes what it has an argument for; what the command line says wins. Recordings and campaigns keep the whole
command: with these defaults written out, and absolute paths.
"""

from __future__ import annotations

import os
import shlex
from argparse import Action, Namespace
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli import output
from fame.cli.arguments import BackendNames, Parser
from fame.dataclasses import dataclass
from fame.errors import ConfigError
from fame.text import suggestion

if TYPE_CHECKING:
    from fame.config.values import ConfigValue

FILE = "fame.yaml"
_LISTS = ("scenarios", "tests", "library", "types", "properties")
KEYS = {
    "name": "by default the name of the folder",
    "scenarios": "what `fame run` and `fame campaign` run (the first one) and `fame check` checks; models (.bpmn), too",
    "tests": "what `fame test` runs",
    "library": "folders with called processes",
    "types": "folders with .msg, .srv and .action files",
    "properties": "what `fame log record` and `fame view` of a team judge (the first one)",
    "coverage": "`fame test` without arguments fails below this model coverage, %",
    "middleware": "of the running team: `dds`, `zenoh` or `ros`",
    "keys": "`{sign: FILE.key, trust: [FILE.pub]}`: signs deployments and requests; what engines and commands trust",
}
"""Of fame.yaml, with their meanings."""
_POSITIONAL = {
    "run scenario": "scenarios",
    "campaign scenario": "scenarios",
    "check models": "scenarios",
    "edit subject": "scenarios",
    "test paths": "tests",
    "library folders": "library",
}
"""Argument of a command -> the key whose files it is without. One file is the first."""
_OPTIONS = {"library": "library", "types": "types", "trust": "trust", "key": "sign", "middleware": "middleware",
            "properties": "properties"}  # fmt: skip
"""Option, whatever the command -> key. Folders are searched after those of the command line."""
_NOT_TAKEN: Mapping[str, Callable[[Namespace], bool]] = {
    "campaign scenario": lambda given: given.resume is not None,
    "run middleware": lambda given: True,  # of a running team; a run is simulated unless the command line says so
    "run key": lambda given: given.middleware == "local",
    "judge properties": lambda given: True,  # its own first argument
    "view properties": lambda given: given.subject is not None,
    "view key": lambda given: not given.control,
    "edit subject": lambda given: given.fetch or given.modeler is not None,
    "keys key": lambda given: given.action == "new",
    "engine trust": lambda given: given.insecure,
    "splitter trust": lambda given: given.insecure,
}


@dataclass(frozen=True, slots=True)
class Project:
    """A project. `values` has the checked values by key; files are looked for when a command takes them."""

    file: Path
    name: str
    values: Mapping[str, Sequence[ConfigValue]]
    coverage: float | None = None

    def taken(self, key: str) -> list[Path | str]:
        """Return the values of a key: a word, or paths from here. Raises ConfigError for a file that does not exist."""
        if key == "middleware":
            return [value.text() for value in self.values.get(key, ())]
        return [self._found(value) for value in self.values.get(key, ())]

    def _found(self, value: ConfigValue) -> Path:
        path = Path(os.path.normpath(self.file.parent / value.text()))
        if not path.exists():
            beside = sorted(os.listdir(path.parent)) if path.parent.is_dir() else ()
            raise value.error(f"there is no {value.text()!r}; {suggestion(path.name, beside)}")
        return Path(os.path.relpath(path))


def find(start: Path) -> Path | None:
    """Return the file of the project around a folder: upwards to the first repository, home, or end of the file system.

    Raises ConfigError for a file of another user: it names code and keys.
    """
    home = Path(os.path.expanduser("~"))
    for folder in (start, *start.parents):
        file = folder / FILE
        if os.path.lexists(file):
            for info in (file.lstat(), file.stat()):  # of a link, and of what it leads to
                if hasattr(os, "geteuid") and info.st_uid != os.geteuid():
                    text = (
                        "belongs to another user, and it names code and keys: copy it, or ignore it with --no-project"
                    )
                    raise ConfigError(text, file=str(file))
            return file
        if (folder / ".git").exists() or folder == home or os.path.ismount(folder):
            break
    return None


def read(file: Path) -> Project:
    """Read the file of a project. Raises ConfigError with file, line and key."""
    from fame.config.loader import read_document
    from fame.config.values import entries

    if file.is_dir():
        raise ConfigError("expected a file, got a folder; fame new NAME writes a project", file=str(file))
    document = read_document(file, "project")
    keys = document.mapping(KEYS) if document.data is not None else {}
    values: dict[str, Sequence[ConfigValue]] = {key: keys[key].items() for key in _LISTS if key in keys}
    signing = entries(keys, "keys", ("sign", "trust"))
    values |= {"sign": [signing["sign"]]} if "sign" in signing else {}
    values |= {"trust": signing["trust"].items()} if "trust" in signing else {}
    for value in (value for listed in values.values() for value in listed):
        value.text()
    if "middleware" in keys:
        keys["middleware"].choice(BackendNames(), "dds, zenoh or ros")
        values["middleware"] = [keys["middleware"]]
    name = keys["name"].text() if "name" in keys else file.parent.name
    return Project(file, name, values, keys["coverage"].number(minimum=0, maximum=100) if "coverage" in keys else None)


def apply(arguments: Namespace) -> None:
    """Fill in what the project says and the command line does not, and name the project if that is anything.

    `arguments.project` is the project or None, `arguments.command_line` the command that does the same anywhere.
    Raises ConfigError, also for an argument that neither has.
    """
    leaf: Parser = arguments.leaf
    known = {f"{leaf.prog.split()[-1]} {action.dest}": action for action in leaf.arguments}
    wanted = {name: action for name, action in known.items() if name in _POSITIONAL or action.dest in _OPTIONS}
    here = Path.cwd() if wanted and not arguments.no_project else None
    file = find(here) if here is not None else None
    arguments.project = read(file) if file is not None else None
    taken: list[tuple[Action, list[str]]] = []
    if arguments.project is not None:
        taken = [each for name, action in wanted.items() for each in _take(arguments, name, action)]
        arguments.command_line = _whole_command(leaf, taken)
    _expect_positional(arguments, wanted)
    if taken and arguments.project is not None:
        name, place = arguments.project.name, str(arguments.project.file)
        output.named["project"] = {"name": name, "file": place}
        if not (getattr(arguments, "json", False) or getattr(arguments, "quiet", False)):
            output.note(f"fame: project {name}: {place}")


def _take(arguments: Namespace, name: str, action: Action) -> Iterator[tuple[Action, list[str]]]:
    """Fill in an argument, and give it with its words."""
    adds, given = action.dest in ("library", "types"), any(action is each for each, _ in arguments.leaf.given)
    if (given and not adds) or (name in _NOT_TAKEN and _NOT_TAKEN[name](arguments)):
        return
    found = arguments.project.taken(_POSITIONAL.get(name) or _OPTIONS[action.dest])
    if not found:
        return
    old = getattr(arguments, action.dest)
    if isinstance(old, list):
        found = [value for value in found if os.path.abspath(value) not in map(os.path.abspath, old)]
        setattr(arguments, action.dest, [*old, *found])
    else:
        del found[1:]
        setattr(arguments, action.dest, found[0])
    for words in [found] if not action.option_strings else [[value] for value in found]:
        yield action, list(map(str, words))


def _expect_positional(arguments: Namespace, wanted: Mapping[str, Action]) -> None:
    """Raise ConfigError without the files of a command that needs some."""
    for name, action in wanted.items():
        needs = name in ("run scenario", "check models") and not getattr(arguments, action.dest)
        if needs and arguments.project is None:
            text = f"expected {action.metavar}, or a project here or above ({FILE}; fame new NAME writes one)"
            raise ConfigError(text)
        if needs:
            text = f"names no scenarios: expected scenarios: [FILE.yaml], or {action.metavar} on the command line"
            raise ConfigError(text, file=str(arguments.project.file))


def _whole_command(leaf: Parser, taken: Sequence[tuple[Action, list[str]]]) -> str:
    """The command line with what was `taken`, which does the same in any folder."""
    positional, options = list[str](), list[str]()
    for action, words in (*leaf.given, *taken):
        whole = [os.path.abspath(word) if action.type is Path and word != "-" else word for word in words]
        if not action.option_strings:
            positional += whole
        elif len(whole) == 1:
            options.append(f"{action.option_strings[-1]}={whole[0]}")
        else:
            options += [action.option_strings[-1], *whole]
    return shlex.join([*leaf.prog.split(), *positional, "--no-project", *options])
