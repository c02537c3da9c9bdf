"""Where called processes come from: the file of the caller, then files of the library path.

`calledElement` names a process of the same file by id, else the file ``<name>.bpmn`` in a folder of the library path:
its process of that id or, if it has just one, that. A file is read once.
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


BUILT_IN = (_models() / "library", _models() / "monitoring")
"""The behaviours and the monitoring units that come with FAME."""


class Library:
    """The library path: `folders` (or one), that of the calling file and ``library`` in it, then what is built in.

    Raises ConfigError for a folder that there is not.
    """

    def __init__(self, folders: str | Path | Sequence[str | Path] = ()) -> None:
        self.folders = tuple(map(Path, [folders] if isinstance(folders, str | Path) else folders))
        for folder in self.folders:
            if not folder.is_dir():
                raise ConfigError("is no folder; the library path is of folders with .bpmn files", file=str(folder))
        self._files: dict[Path, Definitions] = {}

    def path(self, file: str) -> Iterator[Path]:
        """The folders to look in for what `file` calls."""
        yield from self.folders
        if file and not file.startswith("<"):
            here = Path(file).parent
            yield from (here, here / "library")
        yield from BUILT_IN

    def read(self, path: Path) -> Definitions:
        """A file, read once. Raises ModelError."""
        from fame.bpmn.reader import read

        key = path.resolve()
        if key not in self._files:
            self._files[key] = read(path)
        return self._files[key]

    def find(self, caller: Definitions, call: CallActivity) -> tuple[Definitions, Process]:
        """The process that a call activity names. Raises ModelError, which lists where it was looked for."""
        where = {"file": caller.file, "line": call.line, "element": call.id}
        if call.called_expression is not None:
            raise ModelError("the called element is computed at run time; name a process", **where)  # type: ignore[arg-type]
        if call.refused:
            raise ModelError(call.refused, **where)  # type: ignore[arg-type]
        if not call.called:
            raise ModelError("names no called element: give it the id of a process or a library file", **where)  # type: ignore[arg-type]
        process = caller.process(call.called)
        if process is not None:
            return caller, process
        looked = []
        for folder in self.path(caller.file):
            path = folder / f"{call.called}.bpmn"
            if os.path.isfile(path) and "/" not in call.called:  # pathlib raises for a name that is too long
                definitions = self.read(path)
                found = definitions.process(call.called)
                if found is None and len(definitions.processes) == 1:
                    found = definitions.processes[0]
                if found is not None:
                    return definitions, found
                has = ", ".join(item.id for item in definitions.processes)
                raise ModelError(f"{_short(path)} has no process {call.called!r}: it has {has}", **where)  # type: ignore[arg-type]
            looked.append("the built-in library" if folder in BUILT_IN else _short(folder))
        text = f"called element {call.called!r} is no process of this file, nor {call.called}.bpmn in"
        places = ", ".join(dict.fromkeys(looked))
        raise ModelError(f"{text} {places}{self._similar(caller, call.called)}", **where)  # type: ignore[arg-type]

    def _similar(self, caller: Definitions, called: str) -> str:
        """``; did you mean ...?`` with a name that differs in case, its ending, or a letter or two, if there is one."""
        known = {process.id for process in caller.processes}
        known.update(path.stem for folder in self.path(caller.file) for path in folder.glob("*.bpmn"))
        plain = called.strip().removesuffix(".bpmn").replace(" ", "").lower()
        similar = difflib.get_close_matches(plain, sorted(name.lower() for name in known), 1)
        return "".join(f"; did you mean {name!r}?" for name in sorted(known) if [name.lower()] == similar)

    def closure(self, definitions: Definitions, process: Process) -> list[tuple[Definitions, Process]]:
        """A process and all that it calls, at any depth, each once, in the order of meeting.

        A call that names nothing is for the compiler to refuse. Raises ModelError for one whose process is nowhere.
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
        """What each call in a closure names: for `fame.bpmn.extract_process`."""
        names: dict[str, tuple[Definitions, str]] = {}
        for home, item in self.closure(definitions, process):
            for node in _calls(item):
                there, target = self.find(home, node)
                names[node.called] = (there, target.id)
        return names


def _calls(process: Process) -> Iterator[CallActivity]:
    """The call activities of a process that name what they call."""
    nodes = (node for node in process.body.walk() if isinstance(node, CallActivity))
    return (node for node in nodes if node.called and not node.refused)


def _short(path: Path) -> str:
    """A path for people: from the working directory on, if it is in there."""
    return str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path)
