"""Finds called processes: in the file of the caller, then in files of the library path.

`calledElement` is the id of a process of the same file, or the name of a file ``<name>.bpmn`` in a folder of the
library path, which has a process of that id or only one process. Each file is looked for and read once.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterator, Sequence
from importlib.resources import files
from pathlib import Path

from fame.bpmn.model import CallActivity, Definitions, Process
from fame.errors import ConfigError, ModelError


def _models() -> Path:
    """Return the folder ``models``: inside the package where that is installed, beside it in a source tree."""
    package = Path(str(files("fame")))
    return next(path for path in (package / "models", package.parent / "models") if path.is_dir())


BUILT_IN: tuple[Path, ...] = (_models() / "library", _models() / "monitoring", _models() / "nav2")
"""The folders of behaviours, monitoring services and Nav2 calls that come with FAME."""


class Library:
    """The library path: `folders`, the folder of the calling file, its subfolder ``library``, the built-in library.

    Raises ConfigError for a folder that does not exist.
    """

    folders: tuple[Path, ...]

    def __init__(self, folders: str | Path | Sequence[str | Path] = ()) -> None:
        self.folders: tuple[Path, ...] = tuple(map(Path, [folders] if isinstance(folders, str | Path) else folders))
        for folder in self.folders:
            if not folder.is_dir():
                raise ConfigError("is not a folder; the library path has folders of .bpmn files", file=str(folder))
        self._files: dict[Path, Definitions] = {}
        self._found: dict[tuple[str, str], tuple[Definitions, Process]] = {}  # (file of the caller, called element)

    @property
    def declared(self) -> Library:
        """The library whose files declare the topics: this one, unless some of its processes are replaced."""
        return self

    def folders_for(self, file: str) -> Iterator[Path]:
        """The folders to search for the processes that `file` calls."""
        yield from self.folders
        if file and not file.startswith("<"):
            caller_folder = Path(file).parent
            yield from (caller_folder, caller_folder / "library")
        yield from BUILT_IN

    def read(self, path: Path) -> Definitions:
        """The model of a file, which is read once. Raises ModelError."""
        from fame.bpmn.reader import read

        key = path.resolve()
        if key not in self._files:
            self._files[key] = read(path)
        return self._files[key]

    def find(self, caller: Definitions, call: CallActivity) -> tuple[Definitions, Process]:
        """The process that a call activity calls, with its file. Raises ModelError, with the folders searched."""
        problem = _why_no_call(call)
        if problem:
            raise ModelError.at(call, problem, file=caller.file)
        process = caller.process(call.called)
        if process is not None:
            return caller, process
        key = (caller.file, call.called)
        if key not in self._found:
            self._found[key] = self._find_file(caller, call)
        return self._found[key]

    def _find_file(self, caller: Definitions, call: CallActivity) -> tuple[Definitions, Process]:
        searched = []
        for folder in self.folders_for(caller.file):
            path = folder / f"{call.called}.bpmn"
            if os.path.isfile(path) and "/" not in call.called:  # pathlib raises for a name that is too long
                definitions = self.read(path)
                process = definitions.process(call.called)
                if process is None and len(definitions.processes) == 1:
                    process = definitions.processes[0]
                if process is not None:
                    return definitions, process
                has = ", ".join(item.id for item in definitions.processes)
                text = f"{_short(path)} has no process {call.called!r}: it has {has}"
                raise ModelError.at(call, text, file=caller.file)
            searched.append("the built-in library" if folder in BUILT_IN else _short(folder))
        text = f"called element {call.called!r}: found neither a process of this file nor {call.called}.bpmn in"
        folders = ", ".join(dict.fromkeys(searched))
        raise ModelError.at(call, f"{text} {folders}{self._similar(caller, call.called)}", file=caller.file)

    def _similar(self, caller: Definitions, called: str) -> str:
        """``; did you mean ...?`` with a similar name of a process or library file, or an empty text."""
        known = {process.id for process in caller.processes}
        known.update(path.stem for folder in self.folders_for(caller.file) for path in folder.glob("*.bpmn"))
        plain = called.strip().removesuffix(".bpmn").replace(" ", "").lower()
        similar = difflib.get_close_matches(plain, sorted(name.lower() for name in known), 1)
        return "".join(f"; did you mean {name!r}?" for name in sorted(known) if [name.lower()] == similar)

    def closure(self, definitions: Definitions, process: Process) -> list[tuple[Definitions, Process]]:
        """A process and all processes that it calls, at any depth, each once.

        Calls without a called element are skipped, since the compiler refuses them. Raises ModelError for a called
        process that is not found.
        """
        found = [(definitions, process)]
        keys = {(definitions.file, process.id)}
        for home, item in found:
            for node in _calls(item):
                called = self.find(home, node)
                key = (called[0].file, called[1].id)
                if key not in keys:
                    keys.add(key)
                    found.append(called)
        return found

    def called(self, definitions: Definitions, process: Process) -> dict[str, tuple[Definitions, str]]:
        """Called element -> its file and process id, for all calls in the closure; see `fame.bpmn.extract_process`."""
        names: dict[str, tuple[Definitions, str]] = {}
        for home, item in self.closure(definitions, process):
            for node in _calls(item):
                there, target = self.find(home, node)
                names[node.called] = (there, target.id)
        return names


def _why_no_call(call: CallActivity) -> str:
    """Why a call activity cannot be resolved before the run, or empty."""
    if call.called_expression is not None:
        return "the called element is computed at run time; give the id of a process"
    if not call.called and not call.refused:
        return "has no called element: give it the id of a process or the name of a library file"
    return call.refused


def _calls(process: Process) -> Iterator[CallActivity]:
    """The call activities of a process that name what they call."""
    nodes = (node for node in process.body.walk() if isinstance(node, CallActivity))
    return (node for node in nodes if node.called and not node.refused)


def _short(path: Path) -> str:
    """A path for people: from the working directory on, if it is in there."""
    return str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path)
