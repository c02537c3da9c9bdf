"""The page of a model while it is drawn: its diagrams with the findings of `fame check`, updated at each save."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path, PurePath
from typing import Any

from fame.bpmn.library import BUILT_IN, Library, closure
from fame.bpmn.model import CallActivity, Definitions, Human, Process
from fame.bpmn.reader import read
from fame.check import Finding, check
from fame.check.scope import of_error
from fame.closing import Closing
from fame.config.loader import read_document
from fame.dataclasses import dataclass, field, replace
from fame.errors import ConfigError, FameError, ModelError
from fame.scenario.plan import ScenarioFile, known_to_check, read_scenario
from fame.view.catalogue import NOWHERE, Catalogue
from fame.view.mission import Chip, mission_json

_POLL = 0.25
"""Seconds between two looks at the files."""
Stamp = tuple[int, int]
"""When a file was written last (ns), and its size."""


def stamps_of(paths: Iterable[Path]) -> dict[Path, Stamp]:
    """Return the state of files on disk; one that is being replaced is not there for a moment."""
    found = {}
    for path in paths:
        with suppress(OSError):
            stat = path.stat()
            found[path] = stat.st_mtime_ns, stat.st_size
    return found


class FileWatch(Closing):
    """The source of a page without a run, about files that a thread watches until it is closed."""

    def __init__(self) -> None:
        self._version = 0  # of what was read
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="fame view: watch", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop watching."""
        self._closed.set()
        self._thread.join()

    def _watch(self) -> None:
        raise NotImplementedError

    def block(self, number: int) -> Mapping[str, Any]:
        raise LookupError(number)

    def news(self, known: Any) -> tuple[Any, list[Mapping[str, Any]]]:
        version = self._version
        return version, [] if known == version else [{"type": "reload", "version": version}]


@dataclass(slots=True)
class _Reading:
    """The content of the file at one time: the diagrams are those of the last one that could be read.

    files     the files that were read, or that a scenario names
    searched  folders of models in which a called process was not found
    """

    catalogue: Catalogue
    findings: list[Finding] = field(default_factory=list)
    files: tuple[Path, ...] = ()
    searched: tuple[Path, ...] = ()
    model: Definitions | None = None
    library: Library = field(default_factory=Library)
    scenario: ScenarioFile | None = None


class ModelWatch(FileWatch):
    """The source of a page that shows a model, or the model of a scenario, as it is now.

    It follows the files that were read, those with findings, and all models of folders where a called process was not
    found. `library` adds folders with called processes. Raises ConfigError if there is no such file, unless it is to
    `wait`.
    """

    def __init__(self, path: str | Path, library: Sequence[Path] = (), *, wait: bool = False) -> None:
        self._path, self._folders = Path(path), tuple(library)
        if not wait and not self._path.is_file():
            raise ConfigError("cannot be read: no such file", file=str(path))
        self._now = self._before = _Reading(Catalogue([]))
        self._stamps = dict[Path, Stamp]()
        self._follow(self._stamped())
        if wait:
            self._stamps = {}
        super().__init__()

    def _watch(self) -> None:
        while not self._closed.wait(_POLL):
            stamps = self._stamped()
            if stamps != self._stamps:
                self._follow(stamps)
                self._version += 1
                self.on_read()

    def _follow(self, stamps: dict[Path, Stamp]) -> None:
        """Read the files, whose stamps were taken before: what is saved while they are read is read again."""
        watched, self._stamps = self._watched(), stamps
        self._before, self._now = self._now, self._read()
        if self._stamps is stamps:  # nobody asked for another reading; the model may call other files now
            new = {*self._now.files} - watched if self._now.model is not None else ()
            stamped = self._stamped().items()
            self._stamps = {path: stamps.get(path, now) for path, now in stamped if path in stamps or path in new}

    def on_read(self) -> None:
        """Do more with what was read; in the thread that watches."""

    def _stamped(self) -> dict[Path, Stamp]:
        return stamps_of(self._watched())

    def _watched(self) -> set[Path]:
        told = (Path(finding.file) for finding in self._now.findings if finding.file)
        models = (path for folder in self._now.searched for path in folder.glob("*.bpmn"))
        return {self._path, *self._now.files, *told, *models}

    def _read(self) -> _Reading:
        """Read the file; if that fails, return the previous diagrams with the error."""
        named = _named(self._path)
        try:
            model, library, scenario = self._model()
            files, searched = _closure(model, library)
            found = check(model, library=library, **(known_to_check(scenario, model) if scenario is not None else {}))
            if _is_scenario(self._path) and not any(one.level == "error" for one in found):
                from fame.scenario.scenario import scenario_findings

                found += scenario_findings(self._path, library=self._folders)
            catalogue, names = Catalogue(files, library.find), (*named, *(Path(file.file) for file in files))
            return _Reading(catalogue, found, names, searched, model, library, scenario)
        except (ModelError, ConfigError) as error:
            problem = of_error(error)
        except FameError as error:
            problem = Finding("error", str(error), str(self._path))
        except Exception as error:  # the page shows it, and what is saved next is read all the same
            problem = Finding("error", f"it could not be checked: {type(error).__name__}: {error}", str(self._path))
        last = self._now
        return replace(last, findings=[problem], files=tuple(dict.fromkeys((*named, *last.files))), model=None)

    def _model(self) -> tuple[Definitions, Library, ScenarioFile | None]:
        if _is_scenario(self._path):
            scenario = read_scenario(self._path)
            return read(scenario.model), Library([*self._folders, *scenario.library]), scenario
        return read(self._path), Library(self._folders), None

    # ---- for the page ------------------------------------------------------------------------------------------------

    def mission(self) -> Mapping[str, Any]:
        version, now = self._version, self._now  # in this order: a reading in between has a later version, and is news
        return mission_json(
            "model",
            self._path.name,
            now.catalogue,
            (),
            chips=_chips(now.findings),
            findings=[self._finding(now.catalogue, one) for one in now.findings],
            version=version,
            empty=["The file cannot be shown", "\n".join(map(str, now.findings[:3]))],
        )

    def _finding(self, catalogue: Catalogue, finding: Finding) -> dict[str, Any]:
        number = next((file for file, one in enumerate(catalogue.files) if one.file == finding.file), 0)
        known = bool(finding.element) and bool(catalogue.candidates(finding.element))
        return {
            "severity": finding.level,
            "text": finding.text,
            "element": catalogue.number(number, finding.element) if known else NOWHERE,
            "where": PurePath(finding.file).name if finding.file else "",
            "line": finding.line,
        }

    def plane(self, number: int) -> Mapping[str, Any]:
        try:
            return self._now.catalogue.plane_json(number)
        except LookupError:  # of a page from before this reading, which is told to load again
            return self._before.catalogue.plane_json(number)

    def tasks(self, element: str) -> list[Human]:
        return self._now.catalogue.tasks(element)

    def control(self, command: Mapping[str, Any]) -> Mapping[str, Any]:
        raise FameError("a model cannot be controlled: no mission is running")


def _is_scenario(path: Path) -> bool:
    return path.suffix.lower() in (".yaml", ".yml")


def _named(path: Path) -> tuple[Path, ...]:
    """Return the files of model and world that a scenario names, whether they are there or not."""
    if _is_scenario(path):
        with suppress(ConfigError):
            keys = read_document(path).mapping()
            texts = (keys[name].data for name in ("model", "world") if name in keys)
            return tuple(path.parent / text for text in texts if isinstance(text, str))
    return ()


def _closure(model: Definitions, library: Library) -> tuple[list[Definitions], tuple[Path, ...]]:
    """Return the file and those of the processes that it calls, and the folders where others were not found: what is
    missing is a finding of the check."""
    files, searched = {model.file: model}, dict[Path, None]()

    def find(caller: Definitions, call: CallActivity) -> tuple[Definitions, Process] | None:
        with suppress(ModelError):
            return library.find(caller, call)
        searched.update(dict.fromkeys(folder for level in library.levels(caller) for folder in level))
        return None

    for process in model.processes:
        files.update((home.file, home) for home, _ in closure(model, process, find))
    return list(files.values()), tuple(folder for folder in searched if folder not in BUILT_IN)


def _chips(findings: Sequence[Finding]) -> list[Chip]:
    """How many findings there are of each level."""
    chips: list[Chip] = []
    for level, look in (("error", "failed"), ("warning", "warning"), ("note", "")):
        count = sum(finding.level == level for finding in findings)
        if count:
            chips.append((f"{count} {level}{'s' if count > 1 else ''}", look, "findings of fame check"))
    return chips or [("no problems found", "completed", "fame check has no finding")]
