"""Load YAML, and the Python objects that it names. Every mistake in a text is a ConfigError, with its line if known."""

from __future__ import annotations

import importlib
import importlib.util
import io
import sys
import traceback
from collections.abc import Mapping
from functools import cache
from os import PathLike
from os.path import isfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from fame.config.scalars import PLAIN, core_loader, note_scalar
from fame.config.values import ConfigValue, Source, join
from fame.errors import ConfigError, FameError
from fame.imports import explained
from fame.text import open_file, unreadable

if TYPE_CHECKING:
    import yaml

FileKind = Literal["scenario", "world", "node", "learning", "project"]
"""The kinds of configuration files."""
_USER = "fame_user_"
"""How the names of modules begin that a configuration names by their files."""
_KINDS: dict[FileKind, tuple[set[str], str, str]] = {
    "scenario": ({"model"}, "a scenario", "fame run"),
    "world": ({"robots", "size", "bounds"}, "a world", "fame world"),
    "node": ({"Inputs", "Outputs"}, "the configuration of a node", "fame monitor process, record or train"),
    "learning": ({"Files"}, "a learning file", "fame monitor adm learn"),
    "project": ({"scenarios", "tests"}, "a project", "fame run without a file, in its folder"),
}
"""Kind -> the keys that only such a file has, its name, and its commands."""


def read_document(path: str | PathLike[str], kind: FileKind | None = None) -> ConfigValue:
    """Return the content of a YAML file. Raises ConfigError, also if its keys are those of another kind of file."""
    file = str(path)
    try:
        with open_file(Path(path)) as stream, io.TextIOWrapper(stream, encoding="utf-8-sig") as decoded:
            text = decoded.read()
    except OSError as error:
        raise ConfigError(unreadable(error), file=file) from None
    except UnicodeDecodeError:
        raise ConfigError("is not UTF-8 text", file=file) from None
    document = parse_document(text, file)
    if kind is not None and (other := meant_for(document.data, kind)):
        raise ConfigError(other, file=file)
    return document


def parse_document(text: str, file: str = "") -> ConfigValue:
    """Return the content of a YAML text. Raises ConfigError, also for a key that is given twice."""
    import yaml  # an engine that waits for its process does without

    try:
        loader = core_loader()(text)
        node = loader.get_single_node()
        if node is None:
            return ConfigValue(None, "", Source(file))
        lines, columns = dict[str, int](), dict[str, int]()
        _note_lines(node, "", lines, columns, set(), file)
        return ConfigValue(loader.construct_document(node), "", Source(file, lines, columns))
    except yaml.MarkedYAMLError as error:
        mark = error.context_mark if error.context == "while scanning a simple key" else error.problem_mark
        line = mark.line + 1 if mark else 0
        raise ConfigError(f"is not valid YAML: {error.problem or error.context}", file=file, line=line) from None
    except (yaml.YAMLError, ValueError) as error:  # ValueError: numbers and dates that do not exist
        raise ConfigError(f"is not valid YAML: {error}", file=file) from None
    except RecursionError:
        raise ConfigError("is nested too deeply; expected a few levels", file=file) from None
    except (LookupError, AttributeError, TypeError, OverflowError):  # PyYAML's own, of `!!bool maybe` and its like
        raise ConfigError("is not valid YAML: the value after a tag (!!...) is of another kind", file=file) from None


def _note_lines(
    node: yaml.Node, path: str, lines: dict[str, int], columns: dict[str, int], seen: set[int], file: str
) -> None:
    """Fill `lines` and `columns` (1-based) with the key paths inside a node.

    Raises ConfigError for a key that is given twice.
    """
    lines.setdefault(path, node.start_mark.line + 1)
    if id(node) in seen:  # an alias, which may contain itself
        return
    seen.add(id(node))
    if isinstance(node.value, str):
        if node.start_mark.line == node.end_mark.line:
            columns[path] = node.start_mark.column + 1 + (node.style in ("'", '"'))  # type: ignore[attr-defined]
        if node.tag == PLAIN:
            note_scalar(node.value, file, lines[path], path)
        return
    keys: set[str] = set()
    for index, item in enumerate(node.value):
        if not isinstance(item, tuple):  # of a list; a mapping has pairs
            _note_lines(item, f"{path}[{index}]", lines, columns, seen, file)
            continue
        key, value = item
        line, inner = key.start_mark.line + 1, join(path, str(key.value))
        if key.value in keys and key.value != "<<":
            raise ConfigError("is given twice", file=file, line=line, element=inner)
        if isinstance(key.value, str):
            keys.add(key.value)
        lines[inner] = line
        _note_lines(value, inner, lines, columns, seen, file)


def meant_for(content: object, kind: FileKind) -> str:
    """Return a hint at the right command if a file has keys of another kind than `kind` and none
    of that kind; else empty.

    >>> meant_for({"Files": {}}, "node")
    'is a learning file, which is for fame monitor adm learn'
    >>> meant_for({"Inputs": {}, "Files": {}}, "node"), meant_for({"speed": 1}, "world"), meant_for(None, "world")
    ('', '', '')
    """
    keys = {key for key in content if isinstance(key, str)} if isinstance(content, Mapping) else set()
    if not keys & _KINDS[kind][0]:
        for telling, name, commands in _KINDS.values():
            if keys & telling:
                return f"is {name}, which is for {commands}"
    return ""


# ---- Python objects that a file names, or that a package registers ---------------------------------------------------


@cache
def registered(group: str) -> Mapping[str, str]:
    """Return what installed packages add to FAME in one group of entry points: name ->
    ``module:Name`` (docs/extending.md).

    Raises ConfigError for a name that two packages give to different things.
    """
    if not _is_named(group):
        return {}
    from importlib.metadata import entry_points

    found: dict[str, str] = {}
    for entry in entry_points(group=group):
        if found.setdefault(entry.name, entry.value) != entry.value:
            both = f"{found[entry.name]} and {entry.value}"
            raise ConfigError(f"two packages have the name {entry.name!r} in {group}: {both}; uninstall one")
    return found


def _is_named(group: str) -> bool:
    """Whether an installed package may add to a group. To ask this first spares most commands 15 of their 150 ms."""
    heading = f"[{group}]".encode()
    for folder in map(Path, sys.path):
        if folder.is_file():  # packed
            return True
        if any(heading in file.read_bytes() for file in folder.glob("*.*-info/entry_points.txt")):
            return True
    return False


def find_object(name: str, folder: Path) -> Any:
    """Return the object that ``module:Name`` or ``file.py:Name`` (relative to `folder`) names. Raises ConfigError."""
    module, attribute = split_name(name)
    try:
        return getattr(_module(module, folder), attribute)
    except AttributeError:
        raise ConfigError(f"{module} has no {attribute!r}") from None


def split_name(name: str) -> tuple[str, str]:
    """Return the module or file, and the name in it, of ``module:Name`` or ``module.Name``. Raises ConfigError."""
    module, _, attribute = name.rpartition(":" if ":" in name else ".")
    if not module:
        raise ConfigError(f"expected module:Name or file.py:Name, got {name!r}")
    return module, attribute


def _module(name: str, folder: Path) -> Any:
    """A module by name or from a file. Raises ConfigError."""
    try:
        return _from_file((folder / name).resolve()) if name.endswith(".py") else importlib.import_module(name)
    except FameError:
        raise
    except Exception as error:  # whatever the code of a user's module raises
        reason = explained(error) or f"{type(error).__name__}: {error}"
        raise ConfigError(f"{name} cannot be imported: {reason}") from error


def raised_by_user(error: BaseException) -> ConfigError | None:
    """Return what to say of an error that code from a user's file has raised; None if it is another's."""
    place: tuple[str, int] | None = None
    for frame, line in traceback.walk_tb(error.__traceback__):
        module = str(frame.f_globals.get("__name__"))
        if module.startswith(_USER):
            place = frame.f_code.co_filename, line
        elif module.partition(".")[0] in ("fame", "robots", "sim2d"):
            place = None
    return ConfigError(f"{type(error).__name__}: {error}", file=place[0], line=place[1]) if place is not None else None


def _from_file(path: Path) -> Any:
    known = f"{_USER}{path.stem}_{abs(hash(str(path)))}"
    if known in sys.modules:
        return sys.modules[known]
    specification = importlib.util.spec_from_file_location(known, path)
    if specification is None or specification.loader is None or not isfile(path):
        raise ConfigError(f"there is no file {path}")
    module = sys.modules[known] = importlib.util.module_from_spec(specification)
    try:
        specification.loader.exec_module(module)
    except BaseException:
        del sys.modules[known]
        raise
    return module
