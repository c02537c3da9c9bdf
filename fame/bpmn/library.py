"""Finds called processes.

A call names a process by its id. It is looked for in the file of the call, then level by level: in the folders of
``--library``, beside that file, in the folder ``library`` there, and in FAME's own library. At each level it is the
process with that id in any file, or the only process of ``<name>.bpmn``. If there are several, it is that of
``<name>.bpmn``, since copied files often keep the id of what they were copied from; else the level is ambiguous.

Files are searched for the ids of their processes as text; only those that have the name are read. A file that nobody
calls may therefore be broken. A model that was sent has no folder, and nothing is looked for beside it.
"""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from os.path import isdir
from pathlib import Path

from fame.bpmn.model import CallActivity, Definitions, Process
from fame.errors import ConfigError, ModelError

Find = Callable[[Definitions, CallActivity], tuple[Definitions, Process] | None]
"""The process that a call activity of a file calls, with its file; None if it is not known."""


def _models() -> Path:
    """Return the folder ``models``: inside the package where that is installed, beside it in a source tree."""
    package = Path(__file__).resolve().parent.parent
    return next(path for path in (package / "models", package.parent / "models") if path.is_dir())


BUILT_IN: tuple[Path, ...] = (_models() / "library", _models() / "monitoring", _models() / "nav2")
"""The folders of behaviours, monitoring services and Nav2 calls that come with FAME."""


class Library:
    """Where called processes are found: see above. `folders` are those of ``--library``.

    Raises ConfigError for a folder that does not exist.
    """

    def __init__(self, folders: str | Path | Sequence[str | Path] = ()) -> None:
        self.folders: tuple[Path, ...] = tuple(map(Path, [folders] if isinstance(folders, str | Path) else folders))
        for folder in self.folders:
            if not isdir(folder):
                raise ConfigError("is not a folder; the library path has folders of .bpmn files", file=str(folder))
        self._files: dict[Path, Definitions] = {}
        self._folders: dict[Path, dict[Path, frozenset[str]]] = {}  # the files of a folder, and their processes
        self._unreadable: dict[Path, list[Path]] = {}
        self._sent: set[str] = set()
        self._found: dict[tuple[str, Path | None, str], tuple[Definitions, Process]] = {}
        self._passed_over: dict[tuple[str, Path | None, str], list[str]] = {}

    @property
    def declared(self) -> Library:
        """The library whose files declare the topics: this one, unless some of its processes are replaced."""
        return self

    def levels(self, caller: Definitions) -> Iterator[tuple[Path, ...]]:
        """Yield the folders to search for the processes that a file calls, level by level."""
        yield self.folders
        if caller.path is not None:
            yield (caller.path.parent,)
            yield (caller.path.parent / "library",)
        yield BUILT_IN

    def names(self, caller: Definitions) -> set[str]:
        """Return what a file can call: the ids of processes, and the names of files."""
        known = {process.id for process in caller.processes}
        for path, ids in (
            each for level in self.levels(caller) for folder in level for each in self._listed(folder).items()
        ):
            known |= {path.stem, *ids}
        return known

    def read(self, path: Path) -> Definitions:
        """Return the model of a file, which is read once. Raises ModelError.

        Models are told apart by the names of their files: that of a model that was sent is not given to a file.
        """
        from fame.bpmn.reader import read

        key = path.resolve()
        if key not in self._files:
            self._files[key] = read(key if str(path) in self._sent else path)
        return self._files[key]

    def find(self, caller: Definitions, call: CallActivity) -> tuple[Definitions, Process]:
        """Return the process that a call activity calls, with its file. Raises ModelError, with
        the folders searched."""
        problem = _why_no_call(call)
        if problem:
            raise ModelError.at(call, problem, file=caller.file)
        process = caller.process(call.called)
        if process is not None:
            return caller, process
        key = (caller.file, caller.path, call.called)
        if key not in self._found:
            if caller.path is not None:
                self._files.setdefault(caller.path.resolve(), caller)
            elif caller.sent:
                self._sent.add(caller.file)
            self._found[key] = self._search(caller, call)
        return self._found[key]

    def passed_over(self, caller: Definitions, call: CallActivity) -> list[str]:
        """Return the files of other processes that a call found by `find` may mean, too."""
        return self._passed_over.get((caller.file, caller.path, call.called), [])

    def _search(self, caller: Definitions, call: CallActivity) -> tuple[Definitions, Process]:
        for level in self.levels(caller):
            candidates = self._named(level, caller, call.called)
            candidates += [one for one in self._with_id(level, call.called) if one not in candidates]
            best = candidates
            if len(candidates) > 1:
                best = [(home, process) for home, process in candidates if Path(home.file).stem == call.called]
            if len(best) == 1:
                others = [_short(Path(home.file)) for home, _ in candidates if home is not best[0][0]]
                self._passed_over[caller.file, caller.path, call.called] = sorted(others)
                return best[0]
            if candidates:
                places = " and ".join(sorted(_short(Path(home.file)) for home, _ in candidates))
                text = f"called element {call.called!r} is ambiguous: expected one process, found {places}"
                raise ModelError.at(call, text, file=caller.file)
        raise ModelError.at(call, self._not_found(caller, call.called), file=caller.file)

    def _with_id(self, level: Sequence[Path], name: str) -> list[tuple[Definitions, Process]]:
        """The processes with that id. Raises ModelError if the only file that seems to have one cannot be read."""
        candidates: list[tuple[Definitions, Process]] = []
        broken: list[ModelError] = []
        for path in self._unique(level, lambda path, ids: name in ids):
            try:
                home = self.read(path)
            except ModelError as error:
                broken.append(error)
            else:
                process = home.process(name)  # what looked like one may stand in a comment
                candidates += [(home, process)] if process is not None else []
        if broken and not candidates:
            raise broken[0]
        return candidates

    def _named(self, level: Sequence[Path], caller: Definitions, name: str) -> list[tuple[Definitions, Process]]:
        """The only process of each file ``<name>.bpmn``; no file means itself. Raises ModelError."""
        homes = [self.read(path) for path in self._unique(level, lambda path, ids: path.stem == name)]
        return [(home, home.processes[0]) for home in homes if len(home.processes) == 1 and home.path != caller.path]

    def _unique(self, level: Sequence[Path], wanted: Callable[[Path, frozenset[str]], bool]) -> list[Path]:
        """The wanted files of a level, each once, whatever the names of its folders."""
        listed = (each for folder in level for each in self._listed(folder).items())
        return list({path.resolve(): path for path, ids in listed if wanted(path, ids)}.values())

    def _listed(self, folder: Path) -> dict[Path, frozenset[str]]:
        """The files of a folder, with the ids that their processes seem to have. It is looked through once."""
        if folder not in self._folders:
            self._folders[folder] = (_built_in if folder in BUILT_IN else _ids_in)(folder)
        return self._folders[folder]

    def _not_found(self, caller: Definitions, name: str) -> str:
        folders = [folder for level in self.levels(caller) for folder in level]
        places = dict.fromkeys("the built-in library" if folder in BUILT_IN else _short(folder) for folder in folders)
        text = f"called element {name!r}: found neither a process of this file nor {name}.bpmn in {', '.join(places)}"
        for path in (path for folder in folders for path in self._listed(folder) if path.stem == name):
            has = ", ".join(process.id for process in self.read(path).processes) or "none"
            text += f"; {_short(path)} has no process {name!r}: it has {has}"
        broken = [_short(path) for folder in folders for path in self._broken(folder)]
        if broken:
            more = f" and {len(broken) - _SHOWN} more" if len(broken) > _SHOWN else ""
            text += f"; cannot be read, and may have it: {', '.join(broken[:_SHOWN])}{more}"
        return text + self._similar(caller, name)

    def _broken(self, folder: Path) -> list[Path]:
        """What cannot be read: the folder, or files of it."""
        if folder not in self._unreadable:
            denied = folder.is_dir() and not os.access(folder, os.R_OK | os.X_OK)
            broken = [] if folder in BUILT_IN else [path for path in self._listed(folder) if not _is_readable(path)]
            self._unreadable[folder] = [folder] if denied else broken
        return self._unreadable[folder]

    def _similar(self, caller: Definitions, called: str) -> str:
        """``; did you mean ...?`` with a similar name of a process or library file, or an empty text."""
        known = self.names(caller)
        plain = called.strip().removesuffix(".bpmn").replace(" ", "").lower()
        similar = difflib.get_close_matches(plain, sorted(name.lower() for name in known), 1)
        return "".join(f"; did you mean {name!r}?" for name in sorted(known) if [name.lower()] == similar)

    def is_own(self, caller: Definitions, called: Definitions) -> bool:
        """Return whether FAME's own library supplies a file that is called, not ``--library`` or a
        folder of the caller."""
        *given, own = self.levels(caller)
        folder = called.path.parent.resolve() if called.path is not None else None
        return folder in own and all(folder != one.resolve() for level in given for one in level)

    def closure(self, definitions: Definitions, process: Process) -> list[tuple[Definitions, Process]]:
        """Return a process and all processes that it calls, at any depth, each once.

        Calls without a called element are skipped, since the compiler refuses them. Raises ModelError for a called
        process that is not found.
        """
        return closure(definitions, process, self.find)


def closure(definitions: Definitions, process: Process, find: Find) -> list[tuple[Definitions, Process]]:
    """Return a process and all that it calls and `find` knows, at any depth, each once, breadth first."""
    processes = [(definitions, process)]
    keys = {(identity(definitions), process.id)}
    for home, item in processes:
        for called in (find(home, call) for call in calls_of(item)):
            if called is not None and (identity(called[0]), called[1].id) not in keys:
                keys.add((identity(called[0]), called[1].id))
                processes.append(called)
    return processes


def identity(definitions: Definitions) -> str | bytes:
    """Return what tells a file from others: its name, or its content if it has no name."""
    return definitions.file or definitions.source


def calls_of(process: Process) -> Iterator[CallActivity]:
    """Return the call activities of a process that name what they call."""
    return (call for call in process.body.calls() if call.called and not call.refused)


def _why_no_call(call: CallActivity) -> str:
    """Why a call activity cannot be resolved before the run, or empty."""
    if call.called_expression is not None:
        return "the called element is computed at run time; give the id of a process"
    if not call.called and not call.refused:
        return "has no called element: give it the id of a process or the name of a library file"
    return call.refused


def comes_with_fame(file: str) -> bool:
    """Return whether a file is one of FAME's own library."""
    return any(Path(file).resolve().is_relative_to(folder.resolve()) for folder in BUILT_IN)


def _short(path: Path) -> str:
    """A path for people: from the working directory on, if it is in there."""
    return str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path)


# ---- files as text ---------------------------------------------------------------------------------------------------

_SHOWN = 3
_PROCESS = re.compile(rb"<(?:[^\s<>:/]+:)?process(\s(?:[^<>\"']|\"[^\"]*\"|'[^']*')*+)>")
_ID = re.compile(rb"\sid\s*=\s*(?:\"([^\"]*)\"|'([^']*)')")
_OTHER_ENCODING = re.compile(rb"\A\s*<\?xml[^>]*\sencoding\s*=\s*[\"'](?!utf-8|us-ascii)", re.IGNORECASE)


def _entries(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)
    except OSError:
        return []


def _ids_in(folder: Path) -> dict[Path, frozenset[str]]:
    """The files of a folder, with the ids that their processes seem to have."""
    names = sorted(name for name in _entries(folder) if name.endswith(".bpmn") and name[0] != ".")
    return {path: _process_ids(_content(path)) for path in (folder / name for name in names) if path.is_file()}


_built_in = cache(_ids_in)
"""The same of a folder of FAME, whose files do not change."""


def _content(path: Path) -> bytes:
    """The content of a file; nothing if it cannot be read."""
    from fame.bpmn.reader.xml import read_file

    try:
        return read_file(path)
    except (OSError, ModelError):
        return b""


def _process_ids(content: bytes) -> frozenset[str]:
    """The ids that the processes of a file seem to have: a comment counts, too."""
    from html import unescape

    if b"\0" in content or _OTHER_ENCODING.match(content):
        content = _as_utf8(content)
    ids = (part for found in _PROCESS.finditer(content) for pair in _ID.findall(found[1]) for part in pair if part)
    return frozenset(unescape(id.decode(errors="replace")) for id in ids)


def _as_utf8(content: bytes) -> bytes:
    from lxml import etree

    from fame.bpmn.reader.xml import parse

    try:
        return etree.tostring(parse(content, ""), encoding="utf-8")
    except ModelError:
        return b""


def _is_readable(path: Path) -> bool:
    from fame.bpmn.reader.xml import parse

    try:
        parse(_content(path), str(path))
    except ModelError:
        return False
    return True
